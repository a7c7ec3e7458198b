# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Augmentation stays within its bounds and repeats itself from the same generator state."""

from __future__ import annotations

import colorsys

import numpy as np
import pytest
import torch

from adafusion.preprocess.augment import (
    IMAGE_ERASE_AREA,
    IMAGE_ERASE_ASPECT,
    blank_sensors,
    color_jitter,
    erase_boxes,
    hue_jitter,
    jitter_points,
    turn_hue,
)


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


RED, GREEN, BLUE, YELLOW, PINK = (
    2.0 * torch.tensor(rgb)[:, None, None] - 1.0
    for rgb in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0.6, 0.8))
)


@pytest.mark.parametrize(
    ("turn", "before", "after"),
    [
        (1 / 3, RED, GREEN),
        (1 / 3, GREEN, BLUE),
        (-1 / 3, RED, BLUE),
        (1 / 6, RED, YELLOW),
        (-1 / 6, GREEN, YELLOW),
        (1 / 3, PINK, PINK.roll(1, 0)),
        (1.0, PINK, PINK),
    ],
)
def test_a_turned_hue_is_the_colour_further_on_the_circle(
    turn: float, before: torch.Tensor, after: torch.Tensor
) -> None:
    turned = turn_hue(before[None].expand(1, 3, 2, 2), torch.tensor([turn]))
    torch.testing.assert_close(turned, after[None].expand(1, 3, 2, 2))


def test_a_turned_hue_keeps_the_greatest_and_the_least_component_and_grey() -> None:
    images = pictures()
    turned = turn_hue(images, torch.tensor([0.1, 0.27, -0.4, 0.5]))
    torch.testing.assert_close(turned.amax(dim=1), images.amax(dim=1))
    torch.testing.assert_close(turned.amin(dim=1), images.amin(dim=1))
    torch.testing.assert_close(turn_hue(images, torch.zeros(4)), images)
    grey = torch.full((1, 3, 2, 2), 0.3)
    torch.testing.assert_close(turn_hue(grey, torch.tensor([0.2])), grey)


def test_turned_hues_are_those_of_the_hsv_model() -> None:
    images, turn = pictures(), torch.tensor([0.05, -0.1, 0.3, -0.45])
    expected = images.clone()
    for image, by in zip(expected, turn.tolist(), strict=True):
        for pixel in image.flatten(1).T:
            h, s, v = colorsys.rgb_to_hsv(*((pixel + 1) / 2).tolist())
            pixel[:] = 2 * torch.tensor(colorsys.hsv_to_rgb((h + by) % 1.0, s, v)) - 1
    torch.testing.assert_close(turn_hue(images, turn), expected)


def test_hues_turn_alike_from_the_same_state_each_image_by_its_own_share() -> None:
    same = RED[None].expand(200, 3, 1, 1)
    turned = hue_jitter(same, seeded(), 0.1)
    assert torch.equal(turned, hue_jitter(same, seeded(), 0.1))
    assert torch.equal(turned[30:50], hue_jitter(same[30:50], seeded(), 0.1, (200, slice(30, 50))))
    green, blue = ((turned[:, i, 0, 0] + 1) / 2 / 6 for i in (1, 2))  # towards yellow, towards pink
    share = torch.where(green > blue, green, -blue)
    assert 0.09 < share.max() <= 0.1
    assert -0.1 <= share.min() < -0.09
    assert len(share.unique()) > 190
    with pytest.raises(ValueError, match="half a circle"):
        hue_jitter(same, seeded(), 0.6)


def test_an_erased_box_is_black_upright_and_of_an_area_within_bounds() -> None:
    images = torch.rand(100, 3, 60, 80, generator=seeded(0))  # nothing is black
    erased = erase_boxes(images, seeded(), chance=1.0)
    for image, before in zip(erased, images, strict=True):
        black = (image == -1.0).all(dim=0)
        assert torch.equal(image[:, ~black], before[:, ~black])
        rows, columns = black.any(dim=1), black.any(dim=0)
        height, width = int(rows.sum()), int(columns.sum())
        assert torch.equal(black, rows[:, None] & columns[None])
        first = int(rows.float().argmax()), int(columns.float().argmax())
        assert rows[first[0] : first[0] + height].all()
        assert columns[first[1] : first[1] + width].all()
        rounding = (height + width) / 2 / (60 * 80)
        low, high = IMAGE_ERASE_AREA
        assert low - rounding < height * width / (60 * 80) < high + rounding
        low, high = IMAGE_ERASE_ASPECT
        assert 0.9 * low < height / width < 1.1 * high
    assert float((erased == -1.0).float().mean()) == pytest.approx(0.25, abs=0.03)
    assert 0.4 < float((erased[..., 30, 40] == -1.0).float().mean()) < 0.8  # somewhere else in each


@pytest.mark.parametrize(("height", "width"), [(4, 400), (400, 4), (1, 1)])
def test_a_box_fits_an_image_of_any_shape(height: int, width: int) -> None:
    erased = erase_boxes(torch.zeros(20, 3, height, width), seeded(), chance=1.0)
    share = (erased == -1.0).float().mean(dim=(1, 2, 3))
    assert ((share > 0.02) & (share <= 1.0)).all()


def test_about_the_share_asked_for_is_erased_and_alike_from_the_same_state() -> None:
    images = torch.zeros(2000, 3, 4, 5)
    erased = erase_boxes(images, seeded(), chance=0.5)
    assert (images == 0.0).all()
    assert torch.equal(erased, erase_boxes(images, seeded(), chance=0.5))
    touched = (erased == -1.0).flatten(1).any(dim=1)
    assert float(touched.float().mean()) == pytest.approx(0.5, abs=0.03)
    part = erase_boxes(images[7:19], seeded(), 0.5, (2000, slice(7, 19)))
    assert torch.equal(part, erased[7:19])
    assert torch.equal(erase_boxes(images, seeded(), chance=0.0), images)


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
