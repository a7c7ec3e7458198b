# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What several readers decode alike: records of points, kept images, poses; axes they turn."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import numpy as np
from jaxtyping import Float, Float32

from adafusion.datasets.sensor_files import check_points, decode_image, read_bytes
from adafusion.geometry import is_rigid, transform
from adafusion.types import UserError

# axes north east down in a world east north up, forward right down in a body forward left up
T_ENU_NED = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
T_FLU_FRD = np.diag([1.0, -1.0, -1.0, 1.0])  # its own inverse

_FARTHEST_M = 1e8  # no vehicle is that far from any origin


def check_rigid(T: Float[np.ndarray, "*n 4 4"], what: str, remedy: str) -> None:
    """UserError, which begins with `what`, unless T, or all of a stack, are rigid motions."""
    with np.errstate(over="ignore", invalid="ignore"):
        if is_rigid(T) and np.abs(T).max(initial=0.0) < _FARTHEST_M:
            return
        bad = [row for row, one in enumerate(T.reshape(-1, 4, 4)) if not is_rigid(one)]
    where = f": row {bad[0] + 1}" if T.ndim > 2 and bad else ""
    raise UserError(f"{what}{where} is no rigid motion: {remedy}")


def encoded_image(path: Path) -> bytes:
    """Bytes of an image file, found whole, to be kept as they are."""
    data = read_bytes(path, "image")
    decode_image(data, path)
    return data


def read_xyz(path: Path, record_bytes: int) -> Float32[np.ndarray, "n 3"]:
    """x y z of a file of equal records that begin with them as little-endian float32.

    UserError where it is cut short, empty or not finite.
    """
    data = read_bytes(path, "cloud")
    if len(data) % record_bytes:
        raise UserError(
            f"{path} is cut short: {len(data)} bytes are no whole number of {record_bytes}-byte "
            f"points; replace it with a whole cloud, or leave it out"
        )
    records = np.frombuffer(data, np.uint8).reshape(-1, record_bytes)
    return check_points(np.ascontiguousarray(records[:, :12]).view("<f4"), path)


def without_origin(points: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "m 3"]:
    """Points but those at 0 0 0, which a LiDAR gives for rays that never came back."""
    return points[points.any(axis=1)]


def to_body(
    read: Callable[[Path], Float32[np.ndarray, "n 3"]],
    path: Path,
    T_body_lidar: Float[np.ndarray, "4 4"],
) -> Float32[np.ndarray, "n 3"]:
    """Points of a file of a LiDAR, in the body frame."""
    return transform(T_body_lidar, read(path))


def refuse(reason: str) -> NoReturn:
    """What a `Shot` does whose file or pose was found damaged; the reason names it."""
    raise UserError(reason)


def world_of(positions_m: Float[np.ndarray, "n 3"], utm: str, local: str) -> str:
    """Name of the world: `utm` where coordinates are as large as in no local frame."""
    return utm if np.abs(positions_m[:, :2]).max() > 100_000.0 else local
