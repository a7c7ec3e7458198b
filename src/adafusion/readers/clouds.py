# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Point clouds in the files that LiDAR tools write: .bin, .npy, .pcd, .ply, .las.

    .bin    float32 x y z, or x y z intensity as KITTI has it; see `count_columns`
    .npy    floats (N, 3 or more), x y z first
    .pcd    Point Cloud Library 0.7: ascii, binary, binary_compressed; fields in any order and type
    .ply    Stanford polygon file: ascii, binary of either byte order; its element `vertex`
    .las    ASPRS LAS 1.0 to 1.4, point formats 0 to 10, scale and offset applied

How bytes become coordinates is in `cloud_formats`; here is what is done with any of them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Shaped

from adafusion.datasets.sensor_files import check_points, damaged, load_array, read_bytes
from adafusion.readers.cloud_formats import PARSERS, join_columns
from adafusion.readers.sensors import without_origin
from adafusion.types import UserError

CLOUD_SUFFIXES = (".bin", ".npy", ".pcd", ".ply", ".las")
FAR_M = 10_000.0  # beyond it no LiDAR sees: a mark for no return, or the coordinates of a map

_FEW_NUMBERS = 256  # of a .bin that is too small to tell its columns by its signs


def read_points(path: str | Path, *, columns: int | None = None) -> Float32[np.ndarray, "n 3"]:
    """Read x y z of a cloud, metres, in the frame that the file has; UserError where it is damaged.

    Points that are not finite, lie beyond 10 km or at 0 0 0 are left out: so sensors mark rays that
    met nothing. (Only a .bin, which has no other sign of damage, is refused for a NaN.) `columns`,
    3 or 4, says how many numbers a point of a .bin has where the file itself does not tell.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    try:
        if suffix == ".npy":
            points = _npy(load_array(path))
        elif suffix == ".bin":
            numbers = _floats(read_bytes(path, "cloud"), columns)
            points = check_points(numbers[:, :3], path)
        elif suffix in PARSERS:
            points = PARSERS[suffix](read_bytes(path, "cloud"))
        elif suffix == ".laz":
            raise UserError(f"{path} is compressed: unpack it to .las (`laszip`, `pdal translate`)")
        else:
            raise UserError(
                f"{path} is no cloud by its suffix: save it as {', '.join(CLOUD_SUFFIXES)}"
            )
    except ValueError as error:
        raise damaged(path, str(error), "cloud") from error
    with np.errstate(invalid="ignore"):
        near = (np.abs(points) < FAR_M).all(axis=1)
        far = np.isfinite(points).all(axis=1) & ~near
    if far.sum() > near.sum():
        raise UserError(
            f"{path}: most points lie more than {FAR_M / 1000:.0f} km from the origin: they are in "
            f"the coordinates of a map; save each cloud in the frame of its sensor, in metres"
        )
    return check_points(without_origin(points[near].astype(np.float32)), path)


def count_columns(numbers: Float32[np.ndarray, " n"]) -> int:
    """How many numbers a point of a .bin has: 3, x y z, or 4, with an intensity.

    The length must be a multiple of it, and the signs must agree: with 3 columns every fourth
    number is now an x, now a y, now a z, and so as often below 0 as all numbers are (0.5 to 1.5
    times as often); an intensity is not. Where signs cannot tell (nothing below 0, or fewer than
    256 numbers) the length alone decides. ValueError where neither fits, or both do.
    """
    fits = [columns for columns in (3, 4) if len(numbers) % columns == 0]
    if len(numbers) >= _FEW_NUMBERS and (numbers < 0).any():
        ratio = (numbers[3::4] < 0).mean() / (numbers < 0).mean()
        spoken_for = 3 if 0.5 <= ratio <= 1.5 else 4 if ratio < 0.5 else 0
        fits = [columns for columns in fits if columns == spoken_for]
    if len(fits) != 1:
        raise ValueError(
            "may have 3 numbers a point or 4: save its points as .npy (N, 3), or pass `columns` to "
            "`read_points`; if neither fits, the file is no float32 cloud or damaged"
        )
    return fits[0]


def _floats(data: bytes, columns: int | None) -> Float32[np.ndarray, "n columns"]:
    if len(data) % 12 and len(data) % 16:
        raise ValueError(f"is cut short: {len(data)} bytes are no whole number of points")
    numbers = np.frombuffer(data, "<f4").astype(np.float32, copy=False)
    if columns is None:
        columns = count_columns(numbers) if len(numbers) else 4
    if columns not in (3, 4) or len(numbers) % columns:
        raise ValueError(f"holds {len(numbers)} numbers, not points of {columns}")
    return numbers.reshape(-1, columns)


def _npy(array: Shaped[np.ndarray, "*shape"]) -> Float[np.ndarray, "n 3"]:
    if array.dtype.kind != "f" or array.ndim != 2 or array.shape[1] < 3:
        raise ValueError(f"holds {array.dtype} {array.shape}, not floats (N, 3 or more)")
    return join_columns(*array[:, :3].T)
