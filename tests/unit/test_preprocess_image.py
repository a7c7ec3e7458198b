# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Images are cropped by shares, resized without aliasing, and scaled to [-1, 1]."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from adafusion.preprocess import Crop, ImageSettings
from adafusion.preprocess.image import resize, to_unit


def flat(height: int, width: int, value: int = 0) -> np.ndarray:
    return np.full((height, width, 3), value, dtype=np.uint8)


def test_crops_shares_of_the_raw_size() -> None:
    image = flat(10, 20)
    image[2:9, 5:18] = 200  # what is left after cutting 2 above, 1 below, 5 left, 2 right
    crop = Crop(top=0.2, bottom=0.1, left=0.25, right=0.1)
    assert (resize(image, ImageSettings(size=(7, 13), crop=crop)) == 200).all()


def test_crops_the_same_part_at_every_resolution() -> None:
    crop = Crop(bottom=0.25)
    for scale in (1, 2, 5):
        image = flat(8 * scale, 8 * scale, 90)
        image[6 * scale :] = 255
        assert (resize(image, ImageSettings(size=(3, 3), crop=crop)) == 90).all()


def test_shrinking_lets_every_pixel_count() -> None:
    image = flat(64, 64)
    image[::8, ::8] = 255  # sampling alone would meet all of these points, or none
    shrunk = resize(image, ImageSettings(size=(8, 8)))
    assert abs(shrunk.mean() - image.mean()) < 1.5
    assert shrunk.max() < 20


def test_enlarging_is_bilinear() -> None:
    image = flat(1, 2)
    image[0, 1] = 100
    # new centres lie at -0.25, 0.25, 0.75, 1.25 in units of the old ones, clamped to [0, 1]
    assert resize(image, ImageSettings(size=(1, 4)))[0, :, 0].tolist() == [0, 25, 75, 100]


def test_shrinks_one_axis_while_it_enlarges_the_other() -> None:
    assert (
        resize(flat(100, 10, 7), ImageSettings(size=(20, 30))).tolist() == flat(20, 30, 7).tolist()
    )


def test_keeps_an_image_of_the_right_size_as_it_is() -> None:
    image = np.random.default_rng(0).integers(0, 256, (6, 5, 3), dtype=np.uint8)
    np.testing.assert_array_equal(resize(image, ImageSettings(size=(6, 5))), image)


def test_takes_read_only_and_reversed_arrays() -> None:
    image = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    settings = ImageSettings(size=(12, 16))
    expected = resize(image, settings)
    image.flags.writeable = False
    np.testing.assert_array_equal(resize(image, settings), expected)
    np.testing.assert_array_equal(resize(image[..., ::-1], settings), expected[..., ::-1])


def test_scales_bytes_to_exactly_plus_and_minus_one() -> None:
    image = torch.tensor([0, 255, 51], dtype=torch.uint8).reshape(1, 1, 3)
    assert to_unit(image)[:, 0, 0].tolist() == [-1.0, 1.0, pytest.approx(-0.6)]


def test_puts_channels_first_in_a_batch_as_in_one_image() -> None:
    images = torch.from_numpy(
        np.random.default_rng(0).integers(0, 256, (2, 4, 5, 3), dtype=np.uint8)
    )
    batch = to_unit(images)
    assert batch.shape == (2, 3, 4, 5)
    assert batch.is_contiguous()
    assert torch.equal(batch[1], to_unit(images[1]))
    assert batch[1, 2, 3, 4] == pytest.approx(int(images[1, 3, 4, 2]) / 127.5 - 1, abs=1e-6)


@pytest.mark.parametrize("bad", [{"top": 1.0}, {"left": -0.1}, {"top": 0.5, "bottom": 0.5}])
def test_refuses_a_crop_that_leaves_nothing(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"share of the image|leaves nothing"):
        Crop(**bad)


def test_refuses_an_image_too_small_for_its_crop() -> None:
    with pytest.raises(ValueError, match="leaves nothing of an image of 1 x 4 pixels"):
        resize(flat(1, 4), ImageSettings(crop=Crop(top=0.6)))


@pytest.mark.parametrize("size", [(0, 4), (3, -1)])
def test_refuses_an_empty_size(size: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="must be a positive"):
        ImageSettings(size=size)
