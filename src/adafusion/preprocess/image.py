# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Camera images: crop, resize, scale to [-1, 1]."""

from __future__ import annotations

import operator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import functional

# of the pixels of that collection, colours in [0, 1]; what its networks were trained with
IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


@dataclass(frozen=True, kw_only=True)
class Crop:
    """What to cut off each side, as shares of the raw height or width: the bonnet, the sky.

    Shares and not pixels, so that one setting serves every resolution of the same camera.
    """

    top: float = 0.0
    bottom: float = 0.0
    left: float = 0.0
    right: float = 0.0

    def __post_init__(self) -> None:
        for side in ("top", "bottom", "left", "right"):
            share = (
                float(getattr(self, side)) + 0.0
            )  # + 0.0 turns -0.0 into 0.0: equal values, equal text
            if not 0.0 <= share < 1.0:
                raise ValueError(f"crop {side} {share} must be a share of the image in [0, 1)")
            object.__setattr__(self, side, share)
        if self.top + self.bottom >= 1.0 or self.left + self.right >= 1.0:
            raise ValueError(f"{self} leaves nothing of the image")


@dataclass(frozen=True, kw_only=True)
class ImageSettings:
    """Crop first, then resize to `size` (height, width), then scale the colours.

    `unit` colours lie in [-1, 1]; `imagenet` ones have the mean and spread of that collection's
    pixels taken out, as networks trained on it expect.
    """

    size: tuple[int, int] = (300, 400)
    crop: Crop = field(default_factory=Crop)
    colours: Literal["unit", "imagenet"] = "unit"

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", tuple(operator.index(n) for n in self.size))
        if len(self.size) != 2 or min(self.size) < 1:
            raise ValueError(f"image size {self.size} must be a positive (height, width)")
        if self.colours not in ("unit", "imagenet"):
            raise ValueError(f"colours {self.colours!r}: choose unit or imagenet")


def resize(
    image: UInt8[np.ndarray, "h w 3"], settings: ImageSettings
) -> UInt8[np.ndarray, "h2 w2 3"]:
    """Crop and resize an RGB image, keeping uint8.

    Bilinear; where it shrinks, the filter widens so that every pixel of the original counts, as in
    Pillow and therefore in the released loader. Plain bilinear sampling would look at 4 pixels in
    a neighbourhood of dozens, and alias foliage and brickwork.
    """
    height, width = image.shape[:2]
    crop = settings.crop
    top, bottom = round(height * crop.top), height - round(height * crop.bottom)
    left, right = round(width * crop.left), width - round(width * crop.right)
    if top >= bottom or left >= right:
        raise ValueError(f"{crop} leaves nothing of an image of {height} x {width} pixels")
    # torch takes neither read-only nor reversed arrays, such as a BGR image turned to RGB by [::-1]
    kept = torch.from_numpy(np.require(image[top:bottom, left:right], requirements=["C", "W"]))
    resized = functional.interpolate(
        kept.permute(2, 0, 1)[None], settings.size, mode="bilinear", antialias=True
    )
    return np.ascontiguousarray(resized[0].permute(1, 2, 0).numpy())


def to_unit(images: UInt8[Tensor, "*b h w 3"]) -> Float[Tensor, "*b 3 h w"]:
    """Bytes to float32, channels first: x / 127.5 - 1, so 0 gives -1 and 255 gives 1 exactly."""
    channels_first = images.movedim(-1, -3).contiguous()  # while it is bytes, a quarter of the size
    return channels_first.to(torch.float32).div_(127.5).sub_(1.0)


def from_unit(
    images: Float[Tensor, "*b 3 h w"], settings: ImageSettings
) -> Float[Tensor, "*b 3 h w"]:
    """Colours in [-1, 1] scaled as the settings say."""
    if settings.colours == "unit":
        return images
    mean, spread = (images.new_tensor(v)[:, None, None] for v in (IMAGENET_MEAN, IMAGENET_STD))
    return ((images + 1.0) / 2.0 - mean) / spread
