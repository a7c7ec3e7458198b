# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The gate from arrays to tensors: raw image and points in, what the network eats out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float, Float32, Shaped, UInt8
from torch import Tensor

from adafusion.config import identity
from adafusion.files import fingerprint
from adafusion.preprocess.elevation import Elevation, RigCamera, elevation_map, lift
from adafusion.preprocess.ground import Ground, remove_ground
from adafusion.preprocess.image import Crop, ImageSettings, from_unit, resize, to_unit
from adafusion.preprocess.points import PointSet, sample_points
from adafusion.preprocess.voxels import VoxelGrid, pack, to_float, unpack, voxelize

__all__ = [
    "Crop",
    "Elevation",
    "Ground",
    "ImageSettings",
    "PointSet",
    "Preprocess",
    "RigCamera",
    "VoxelGrid",
]

VERSION = 2  # raised when equal settings begin to give other numbers


@dataclass(frozen=True, kw_only=True)
class Preprocess:
    """Everything that happens between the sensors and the network; a model file carries its own.

    `lidar` says what the cloud becomes: `voxels` (1, X, Y, Z) in [0, 1], `points` (count, 3), or
    `elevation` (3, rows, columns), heights and where the camera sees them. The settings of the
    other two are not looked at.
    """

    image: ImageSettings = field(default_factory=ImageSettings)
    ground: Ground = field(default_factory=Ground)
    lidar: Literal["voxels", "points", "elevation"] = "voxels"
    voxels: VoxelGrid = field(default_factory=VoxelGrid)
    points: PointSet = field(default_factory=PointSet)
    elevation: Elevation = field(default_factory=Elevation)

    def __post_init__(self) -> None:
        if self.lidar not in ("voxels", "points", "elevation"):
            raise ValueError(f"lidar {self.lidar!r}: choose voxels, points or elevation")

    def __call__(
        self,
        image: UInt8[np.ndarray, "h w 3"] | None,
        points_body: Float[np.ndarray, "n 3"] | None,
    ) -> tuple[Float[Tensor, "3 h2 w2"] | None, Float[Tensor, ...] | None]:
        """Both tensors of one observation; None stays None."""
        return (
            None if image is None else self.image_tensor(image),
            None if points_body is None else self.lidar_tensor(points_body),
        )

    def image_tensor(self, image: UInt8[np.ndarray, "h w 3"]) -> Float[Tensor, "3 h2 w2"]:
        """RGB bytes of any size to float32 of the size in the settings, their colours scaled."""
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            raise ValueError(
                f"image must be RGB uint8 of shape (h, w, 3), not {image.dtype} {image.shape}"
            )
        return from_unit(to_unit(torch.from_numpy(resize(image, self.image))), self.image)

    def lidar_tensor(self, points_body: Float[np.ndarray, "n 3"]) -> Float32[Tensor, ...]:
        """Points in metres in the body frame (z = 0 the ground) to what the network takes."""
        if points_body.dtype.kind != "f" or points_body.ndim != 2 or points_body.shape[1] != 3:
            raise ValueError(
                "points must be floats of shape (n, 3), in metres, "
                f"not {points_body.dtype} {points_body.shape}"
            )
        return self.load_lidar(self.store_lidar(points_body)[None])[0]

    @property
    def lidar_shape(self) -> tuple[int, ...]:
        """Shape of one frame's LiDAR tensor."""
        if self.lidar == "voxels":
            return (1, *self.voxels.shape)
        return (self.points.count, 3) if self.lidar == "points" else (3, *self.elevation.shape)

    @property
    def stored_lidar(self) -> tuple[tuple[int, ...], np.dtype[Any]]:
        """Shape and type of what `store_lidar` gives."""
        if self.lidar == "points":
            return (self.points.count, 3), np.dtype(np.float32)
        if self.lidar == "elevation":
            return self.elevation.shape, np.dtype(np.uint8)
        shape, occupancy = self.voxels.shape, self.voxels.occupancy
        if occupancy == "binary":  # eight cells a byte
            return (math.ceil(math.prod(shape) / 8),), np.dtype(np.uint8)
        return shape, np.dtype(np.uint8 if occupancy == "count" else np.float16)

    def store_lidar(self, points_body: Float[np.ndarray, "n 3"]) -> Shaped[np.ndarray, ...]:
        """What is kept of a cloud on disk: as small as it can be without losing anything."""
        if self.lidar == "elevation":  # the ground is what it maps
            return elevation_map(points_body, self.elevation)
        points = remove_ground(points_body, self.ground)
        if self.lidar == "points":
            return sample_points(points, self.points)
        stored = voxelize(points, self.voxels)
        return pack(stored) if self.voxels.occupancy == "binary" else stored

    def load_lidar(self, stored: Shaped[np.ndarray, "b ..."]) -> Float32[Tensor, "b ..."]:
        """The tensors of frames that `store_lidar` kept."""
        if self.lidar == "points":
            return torch.from_numpy(stored)
        if self.lidar == "elevation":
            return torch.from_numpy(lift(stored, self.elevation, self.image.crop))
        if self.voxels.occupancy == "binary":
            stored = unpack(stored, self.voxels.shape)
        return torch.from_numpy(to_float(stored, self.voxels)).unsqueeze(1)

    @property
    def fingerprint(self) -> str:
        """Equal exactly when the settings, and the code's way with them, are equal."""
        return fingerprint(f"preprocess {VERSION}", identity(self))
