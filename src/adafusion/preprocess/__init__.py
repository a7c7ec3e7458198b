# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The gate from arrays to tensors: raw image and points in, what the network eats out."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from adafusion.config import to_plain
from adafusion.files import fingerprint
from adafusion.preprocess.ground import Ground, remove_ground
from adafusion.preprocess.image import Crop, ImageSettings, resize, to_unit
from adafusion.preprocess.voxels import VoxelGrid, to_float, voxelize

__all__ = ["Crop", "Ground", "ImageSettings", "Preprocess", "VoxelGrid"]

VERSION = 1  # raised when equal settings begin to give other numbers


@dataclass(frozen=True, kw_only=True)
class Preprocess:
    """Everything that happens between the sensors and the network; a model file carries its own."""

    image: ImageSettings = field(default_factory=ImageSettings)
    ground: Ground = field(default_factory=Ground)
    voxels: VoxelGrid = field(default_factory=VoxelGrid)

    def __call__(
        self,
        image: UInt8[np.ndarray, "h w 3"] | None,
        points_body: Float[np.ndarray, "n 3"] | None,
    ) -> tuple[Float[Tensor, "3 h2 w2"] | None, Float[Tensor, "1 x y z"] | None]:
        """Both tensors of one observation; None stays None."""
        return (
            None if image is None else self.image_tensor(image),
            None if points_body is None else self.voxel_tensor(points_body),
        )

    def image_tensor(self, image: UInt8[np.ndarray, "h w 3"]) -> Float[Tensor, "3 h2 w2"]:
        """RGB bytes of any size to float32 in [-1, 1] of the size in the settings."""
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            raise ValueError(
                f"image must be RGB uint8 of shape (h, w, 3), not {image.dtype} {image.shape}"
            )
        return to_unit(torch.from_numpy(resize(image, self.image)))

    def voxel_tensor(self, points_body: Float[np.ndarray, "n 3"]) -> Float[Tensor, "1 x y z"]:
        """Points in metres in the body frame (z = 0 the ground) to float32 cells in [0, 1]."""
        if points_body.dtype.kind != "f" or points_body.ndim != 2 or points_body.shape[1] != 3:
            raise ValueError(
                "points must be floats of shape (n, 3), in metres, "
                f"not {points_body.dtype} {points_body.shape}"
            )
        stored = voxelize(remove_ground(points_body, self.ground), self.voxels)
        return torch.from_numpy(to_float(stored, self.voxels))[None]

    @property
    def fingerprint(self) -> str:
        """Equal exactly when the settings, and the code's way with them, are equal."""
        canonical = json.dumps(to_plain(self), sort_keys=True, separators=(",", ":"))
        return fingerprint(f"preprocess {VERSION}", canonical)
