# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Point clouds to an elevation map in front of the vehicle, and where the camera sees its cells.

Cell (i, j) of a map of N rows and M columns lies (N - i - 1/2) cells ahead of the vehicle and
(M/2 - j - 1/2) cells to its left, as in CORAL (Pan et al., ICRA 2021): row 0 is the farthest.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from scipy import ndimage

from adafusion.geometry import invert, transform
from adafusion.preprocess.image import Crop

EMPTY = 0  # grey level of a cell that no point fell in
OUTSIDE = 2.0  # image coordinate of a cell that the camera does not see: beyond [-1, 1]


@dataclass(frozen=True, kw_only=True)
class RigCamera:
    """The camera of the rig that a model was trained for."""

    K: tuple[tuple[float, ...], ...]  # 3x3, pixels of the whole image
    T_body_camera: tuple[tuple[float, ...], ...]  # 4x4; the camera looks along z, x right, y down
    size: tuple[int, int]  # (height, width) of the whole image
    distortion: tuple[float, ...] = ()  # k1, k2, p1, p2, k3; (): none

    def __post_init__(self) -> None:
        object.__setattr__(self, "K", _matrix(self.K, 3))
        object.__setattr__(self, "T_body_camera", _matrix(self.T_body_camera, 4))
        object.__setattr__(self, "size", tuple(operator.index(n) for n in self.size))
        object.__setattr__(self, "distortion", tuple(float(k) for k in self.distortion))


@dataclass(frozen=True, kw_only=True)
class Elevation:
    """The highest point of each cell, `step_m` a grey level above `lowest_m`; 0 is empty.

    Points above the top level (254 steps) hang over the road and are left out. One pass fills an
    empty inner cell with the mean of its neighbours that are not.
    """

    shape: tuple[int, int] = (80, 80)
    cell_m: float = 0.5
    lowest_m: float = -2.0
    step_m: float = 0.02
    camera: RigCamera | None = None  # None until a training takes it from its dataset

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", tuple(operator.index(n) for n in self.shape))
        if len(self.shape) != 2 or min(self.shape) < 3 or min(self.cell_m, self.step_m) <= 0:
            raise ValueError(f"{self} is no map: rows, columns, cell_m and step_m are positive")


def elevation_map(
    points_body: Float[np.ndarray, "n 3"], settings: Elevation
) -> UInt8[np.ndarray, "rows columns"]:
    """Grey levels: 1 + whole steps above the lowest height, 0 where there is no point."""
    rows, columns = settings.shape
    x, y, z = points_body.astype(np.float64).T
    row = rows - 1 - np.floor(x / settings.cell_m)
    column = columns // 2 - 1 - np.floor(y / settings.cell_m)
    level = np.floor((z - settings.lowest_m) / settings.step_m) + 1
    kept = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    kept &= (level >= 1) & (level <= 255)
    grey = np.zeros(settings.shape, np.uint8)
    cells = row[kept].astype(np.intp), column[kept].astype(np.intp)
    np.maximum.at(grey, cells, level[kept].astype(np.uint8))
    return _fill(grey)


def _fill(grey: UInt8[np.ndarray, "rows columns"]) -> UInt8[np.ndarray, "rows columns"]:
    """Empty inner cells become the mean of those of their 3x3 neighbours that are not empty."""
    ones = np.ones((3, 3))
    known = ndimage.convolve((grey != EMPTY).astype(float), ones, mode="constant")
    total = ndimage.convolve(grey.astype(float), ones, mode="constant")
    inner = np.zeros(grey.shape, bool)
    inner[1:-1, 1:-1] = True
    fill = inner & (grey == EMPTY) & (known > 0)
    filled = grey.copy()
    filled[fill] = np.round(total[fill] / known[fill])
    return filled


def lift(
    grey: UInt8[np.ndarray, "b rows columns"], settings: Elevation, crop: Crop
) -> Float32[np.ndarray, "b 3 rows columns"]:
    """Height in [0, 1], and x and y of each cell in the image, from -1 to 1 (left to right, down).

    The image is the one that is left after `crop`. A cell that is empty or out of sight has
    x = y = 2. ValueError where the settings have no camera.
    """
    if settings.camera is None:
        raise ValueError("an elevation map is lifted into the image of a camera: set one")
    rows, columns = settings.shape
    ahead = (rows - 0.5 - np.arange(rows)) * settings.cell_m
    left = (columns / 2 - 0.5 - np.arange(columns)) * settings.cell_m
    height = settings.lowest_m + (grey.astype(np.float64) - 0.5) * settings.step_m
    where = np.empty((*grey.shape, 3))
    where[..., 0], where[..., 1], where[..., 2] = ahead[:, None], left, height
    xy = _project(where.reshape(-1, 3), settings.camera, crop).reshape(*grey.shape, 2)
    seen = (grey != EMPTY) & (np.abs(xy) <= 1.0).all(axis=-1)
    xy[~seen] = OUTSIDE
    parts = [grey / 255.0, xy[..., 0], xy[..., 1]]
    return np.stack(parts, axis=1).astype(np.float32)


def _project(
    points_body: Float[np.ndarray, "n 3"], camera: RigCamera, crop: Crop
) -> Float[np.ndarray, "n 2"]:
    """Where the camera sees points, in [-1, 1] of the cropped image; OUTSIDE behind it."""
    points = transform(invert(np.array(camera.T_body_camera)), points_body)
    in_front = points[:, 2] > 0.1
    xy = np.full((len(points), 2), OUTSIDE)
    if in_front.any():
        pixels, _ = cv2.projectPoints(
            points[in_front],
            np.zeros(3),
            np.zeros(3),
            np.array(camera.K),
            np.array(camera.distortion) if camera.distortion else np.zeros(5),
        )
        h, w = camera.size
        low = np.array([round(w * crop.left), round(h * crop.top)])
        high = np.array([w - round(w * crop.right), h - round(h * crop.bottom)])
        # pixel centres are whole numbers: the image begins half a pixel before the first
        xy[in_front] = 2.0 * (pixels[:, 0] + 0.5 - low) / (high - low) - 1.0
    return xy


def _matrix(values: object, n: int) -> tuple[tuple[float, ...], ...]:
    matrix = np.array(values, dtype=np.float64)
    if matrix.shape != (n, n) or not np.isfinite(matrix).all():
        raise ValueError(f"{values} is no {n}x{n} matrix of finite numbers")
    return tuple(tuple(float(v) for v in row) for row in matrix)
