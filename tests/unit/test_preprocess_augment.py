# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Augmentation stays within its bounds and repeats itself from the same generator state."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from adafusion.preprocess.augment import blank_sensors, color_jitter, jitter_points


def pictures(n: int = 4) -> torch.Tensor:
    return torch.rand(n, 3, 6, 8, generator=torch.Generator().manual_seed(0)) * 2 - 1


def seeded(seed: int = 1) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_points_move_by_the_noise_asked_for() -> None:
    points = np.zeros((20_000, 3), dtype=np.float32)
    moved = jitter_points(points, np.random.default_rng(0), sigma_m=0.1, clip_m=10.0)
    assert moved.dtype == np.float32
    assert moved.std() == pytest.approx(0.1, rel=0.02)
    assert abs(moved.mean()) < 0.002


def test_no_point_moves_further_than_the_clip() -> None:
    points = np.random.default_rng(1).uniform(-20, 20, (1000, 3))
    moved = jitter_points(points, np.random.default_rng(0), sigma_m=0.1, clip_m=0.05)
    assert np.abs(moved - points).max() == pytest.approx(0.05)


def test_points_are_jittered_alike_from_the_same_state_and_left_as_they_were() -> None:
    points = np.ones((10, 3), dtype=np.float32)
    first = jitter_points(points, np.random.default_rng(3))
    np.testing.assert_array_equal(first, jitter_points(points, np.random.default_rng(3)))
    assert (points == 1).all()


def test_colours_change_alike_from_the_same_state_and_the_images_stay() -> None:
    images = pictures()
    before = images.clone()
    first, second = color_jitter(images, seeded()), color_jitter(images, seeded())
    assert torch.equal(first, second)
    assert torch.equal(images, before)
    assert not torch.equal(first, color_jitter(images, seeded(2)))


def test_every_image_of_a_batch_changes_in_its_own_way() -> None:
    same = pictures(1).expand(5, -1, -1, -1)
    changed = color_jitter(same, seeded())
    assert len({tuple(image.flatten().tolist()) for image in changed}) == 5


def test_brightness_alone_scales_towards_black() -> None:
    grey = torch.zeros(64, 3, 2, 2)  # 0.5 in [0, 1]
    changed = color_jitter(grey, seeded(), brightness=0.2, contrast=0.0, saturation=0.0)
    factor = (changed + 1)[:, 0, 0, 0]
    assert factor.min() >= 0.8
    assert factor.max() <= 1.2
    assert factor.max() - factor.min() > 0.3


def test_contrast_and_saturation_leave_a_grey_image_alone() -> None:
    grey = torch.full((8, 3, 4, 4), 0.3)
    changed = color_jitter(grey, seeded(), brightness=0.0)
    torch.testing.assert_close(changed, grey)


def test_saturation_keeps_the_grey_of_every_pixel() -> None:
    images = pictures(8) / 2  # far enough from black and white for nothing to be clipped
    changed = color_jitter(images, seeded(), brightness=0.0, contrast=0.0)
    luma = torch.tensor([0.299, 0.587, 0.114])[:, None, None]
    torch.testing.assert_close((changed * luma).sum(1), (images * luma).sum(1))
    assert not torch.allclose(changed, images)


def test_strength_zero_changes_nothing() -> None:
    images = pictures()
    changed = color_jitter(images, seeded(), brightness=0.0, contrast=0.0, saturation=0.0)
    torch.testing.assert_close(changed, images)


def test_colours_stay_in_range_at_full_strength() -> None:
    changed = color_jitter(pictures(32), seeded(), brightness=1.0, contrast=1.0, saturation=1.0)
    assert changed.min() == -1
    assert changed.max() == 1


@pytest.mark.parametrize("strength", [-0.1, 1.5])
def test_refuses_a_strength_that_would_turn_colours_over(strength: float) -> None:
    with pytest.raises(ValueError, match=r"\[0, 1\]"):
        color_jitter(pictures(), seeded(), contrast=strength)


def test_blanking_takes_one_sensor_from_its_share_of_frames() -> None:
    images, voxels = torch.ones(4000, 3, 2, 2), torch.ones(4000, 1, 2, 2, 2)
    blank_sensors(images, voxels, 0.3, np.random.default_rng(0))
    no_image = (images == -1.0).flatten(1).all(dim=1)
    no_cloud = (voxels == 0.0).flatten(1).all(dim=1)
    assert not (no_image & no_cloud).any()
    assert float(no_image.float().mean()) == pytest.approx(0.15, abs=0.02)
    assert float(no_cloud.float().mean()) == pytest.approx(0.15, abs=0.02)
    assert (images[~no_image] == 1.0).all()
    assert (voxels[~no_cloud] == 1.0).all()
