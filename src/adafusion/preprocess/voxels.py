# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Point clouds to voxel grids, by one loop over the points."""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass
from typing import Literal, get_args, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Shaped, UInt8
from scipy import ndimage

Occupancy = Literal["binary", "count", "soft", "tdf"]

FULL_COUNT = 15  # points in a cell from which `count` is 1


@dataclass(frozen=True, kw_only=True)
class VoxelGrid:
    """An axis-aligned box in the body frame, cut into `shape` equal cells.

    `index` says which cell a point p falls in, per axis, with u = (p - lower) * shape / (upper -
    lower); it counts where 0 <= cell < shape. A point that is not finite falls in none.

    * `floor`: cell = floor(u), so a cell owns its lower face.
    * `round`: cell = u rounded half to even, as in the released code, which moves every cell down
      by half its size; for weights that were trained so.

    `occupancy` says what a cell holds, always in [0, 1]:

    * `binary`: 1 where at least one point fell, else 0 (the paper's).
    * `count`: log(1 + min(n, 15)) / log(16) for the n points that fell in the cell.
    * `soft`: every point shares a weight of 1 among the 8 cells whose centres surround it,
      trilinearly, and a cell holds min(1, sum of its shares); shares beyond the box are lost.
    * `tdf`, a truncated distance field: 1 - min(d, t) / t, with d the distance in metres from this
      cell's centre to that of the nearest occupied cell, and t twice the longest edge of a cell.
      An empty cloud is 0 everywhere.
    """

    lower_m: tuple[float, float, float] = (-20.0, -20.0, 0.0)
    upper_m: tuple[float, float, float] = (20.0, 20.0, 5.0)
    shape: tuple[int, int, int] = (72, 72, 48)
    index: Literal["floor", "round"] = "floor"
    occupancy: Occupancy = "binary"

    def __post_init__(self) -> None:
        # equal grids must be equal as text too, for fingerprints: 20 is 20.0 and -0.0 is 0.0
        object.__setattr__(self, "lower_m", tuple(float(v) + 0.0 for v in self.lower_m))
        object.__setattr__(self, "upper_m", tuple(float(v) + 0.0 for v in self.upper_m))
        object.__setattr__(self, "shape", tuple(operator.index(n) for n in self.shape))
        if not len(self.lower_m) == len(self.upper_m) == len(self.shape) == 3:
            raise ValueError("lower_m, upper_m and shape of a voxel grid need three values each")
        if not all(
            -math.inf < lo < hi < math.inf
            for lo, hi in zip(self.lower_m, self.upper_m, strict=True)
        ):
            raise ValueError(f"upper_m {self.upper_m} must exceed lower_m {self.lower_m}")
        if min(self.shape) < 1:
            raise ValueError(f"grid shape {self.shape} must be positive numbers of cells")
        if self.index not in ("floor", "round"):
            raise ValueError(f"unknown voxel index {self.index!r}; choose floor or round")
        if self.occupancy not in get_args(Occupancy):
            raise ValueError(
                f"unknown occupancy {self.occupancy!r}; choose binary, count, soft or tdf"
            )

    @property
    def cell_m(self) -> tuple[float, float, float]:
        """Edges of a cell in metres."""
        x, y, z = (
            (hi - lo) / n for lo, hi, n in zip(self.lower_m, self.upper_m, self.shape, strict=True)
        )
        return x, y, z


def voxelize(points_body: Float[np.ndarray, "n 3"], grid: VoxelGrid) -> Shaped[np.ndarray, "x y z"]:
    """What each cell of `grid` holds, in the form that is stored: see `to_float` for the values.

    `binary` gives bool; `count` uint8, the number of points up to 255; `soft` and `tdf` float16.
    Points are metres in the body frame; their order changes nothing, not even the last bit.
    """
    lower = np.array(grid.lower_m)
    scale = np.array(grid.shape) / (np.array(grid.upper_m) - lower)
    rounded = grid.index == "round"
    if grid.occupancy == "soft":
        shares = _splat(points_body, lower, scale, grid.shape, rounded)
        return (shares / _ONE).astype(np.float16)
    counts = _count(points_body, lower, scale, grid.shape, rounded)
    if grid.occupancy == "count":
        return counts
    if grid.occupancy == "binary":
        return counts > 0
    return _distance_field(counts > 0, grid)


def to_float(
    stored: Shaped[np.ndarray, "*b x y z"], grid: VoxelGrid
) -> Float[np.ndarray, "*b x y z"]:
    """Values in [0, 1] as float32 from what `voxelize` stored."""
    if grid.occupancy == "count":
        return _COUNT_VALUES[stored]
    return stored.astype(np.float32)


def pack(occupied: Bool[np.ndarray, "x y z"]) -> UInt8[np.ndarray, " bytes"]:
    """Eight cells of a binary grid in a byte; the last byte is filled up with zeros."""
    return np.packbits(occupied)


def unpack(
    packed: UInt8[np.ndarray, "*b bytes"], shape: tuple[int, int, int]
) -> Bool[np.ndarray, "*b x y z"]:
    """Undo `pack`, for one grid or a batch."""
    bits = np.unpackbits(packed, axis=-1, count=math.prod(shape))
    return bits.view(np.bool_).reshape(*packed.shape[:-1], *shape)


_COUNT_VALUES = (np.log1p(np.minimum(np.arange(256), FULL_COUNT)) / np.log1p(FULL_COUNT)).astype(
    np.float32
)
_ONE = 1 << 24  # shares are summed as integers, whose sum knows no order


def _distance_field(
    occupied: Bool[np.ndarray, "x y z"], grid: VoxelGrid
) -> Float[np.ndarray, "x y z"]:
    if not occupied.any():
        return np.zeros(grid.shape, np.float16)
    truncation_m = 2.0 * max(grid.cell_m)
    distance_m = ndimage.distance_transform_edt(~occupied, sampling=grid.cell_m)
    return (1.0 - np.minimum(distance_m, truncation_m) / truncation_m).astype(np.float16)


# The kernels are compiled, so run-time type checks must not wrap them: hence no_type_check.
# A point is tested as a float, before it becomes an index: NaN fails every comparison.


@numba.njit(cache=True, nogil=True)
@no_type_check
def _count(points, lower, scale, shape, rounded):
    counts = np.zeros(shape, np.uint8)
    for i in range(points.shape[0]):
        x = (points[i, 0] - lower[0]) * scale[0]
        y = (points[i, 1] - lower[1]) * scale[1]
        z = (points[i, 2] - lower[2]) * scale[2]
        if rounded:
            x, y, z = np.rint(x), np.rint(y), np.rint(z)
        if 0 <= x < shape[0] and 0 <= y < shape[1] and 0 <= z < shape[2]:
            cell = int(x), int(y), int(z)  # not negative, so this is the floor
            if counts[cell] < 255:
                counts[cell] += 1
    return counts


@numba.njit(cache=True, nogil=True)
@no_type_check
def _splat(points, lower, scale, shape, rounded):
    shares = np.zeros(shape, np.int32)
    centre = 0.0 if rounded else 0.5  # where in u a cell's centre lies
    for i in range(points.shape[0]):
        x = (points[i, 0] - lower[0]) * scale[0] - centre
        y = (points[i, 1] - lower[1]) * scale[1] - centre
        z = (points[i, 2] - lower[2]) * scale[2] - centre
        if not (-1 < x < shape[0] and -1 < y < shape[1] and -1 < z < shape[2]):
            continue
        x0, y0, z0 = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
        for dx in range(2):
            for dy in range(2):
                for dz in range(2):
                    a, b, c = x0 + dx, y0 + dy, z0 + dz
                    if 0 <= a < shape[0] and 0 <= b < shape[1] and 0 <= c < shape[2]:
                        weight = (1 - abs(x - a)) * (1 - abs(y - b)) * (1 - abs(z - c))
                        total = shares[a, b, c] + np.int32(weight * _ONE)
                        shares[a, b, c] = min(total, _ONE)
    return shares
