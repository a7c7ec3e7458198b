# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What the readers of drives share: runs, files by number, clouds, the ground below."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from adafusion.datasets.sensor_files import check_points, decode_image, read_bytes
from adafusion.geometry import is_rigid, transform
from adafusion.types import UserError

_STAMP = re.compile(r"[0-9]{1,19}")
_FARTHEST_M = 1e8  # no vehicle is that far from any origin
_NEAR_M, _FAR_M = 3.0, 15.0  # where a cloud shows the ground that the vehicle stands on
_THICK_M = 0.05
_TILT_RAD = np.deg2rad(6.0)
_PLANES = 300  # tried for each cloud
_PROBES = 9  # clouds looked at


def matches(src: Path, *patterns: str) -> bool:
    """Whether something at `src` fits each glob pattern; never raises."""
    try:
        return all(any(src.glob(pattern)) for pattern in patterns)
    except (OSError, ValueError):
        return False


def choose_runs(src: Path, there: Iterable[str], runs: Sequence[str] | None) -> list[str]:
    """The runs asked for, all if None, sorted; UserError lists those there are for any other."""
    names = sorted(there)
    chosen = names if runs is None else sorted(set(runs))
    if unknown := sorted(set(chosen) - set(names)):
        raise UserError(f"{src} has no run {unknown[0]!r}: choose from {', '.join(names)}")
    if not chosen:
        raise UserError(f"no run of {src} is chosen: choose from {', '.join(names)}")
    return chosen


def files_by_stamp(folder: Path, *suffixes: str) -> dict[int, Path]:
    """Files whose names are whole numbers (indices, times of any unit), by that number, rising."""
    try:
        paths = [path for path in folder.iterdir() if path.suffix in suffixes]
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except OSError as error:
        raise UserError(
            f"{folder} cannot be read ({error.strerror}): give it read access"
        ) from error
    stamped = ((int(path.stem), path) for path in paths if _STAMP.fullmatch(path.stem))
    return dict(sorted((stamp, path) for stamp, path in stamped if stamp < 2**62))


def check_rigid(T: Float[np.ndarray, "*n 4 4"], what: str, remedy: str) -> None:
    """UserError, which begins with `what`, unless T, or all of a stack, are rigid motions."""
    with np.errstate(over="ignore", invalid="ignore"):
        if is_rigid(T) and np.abs(T).max(initial=0.0) < _FARTHEST_M:
            return
        bad = [row for row, one in enumerate(T.reshape(-1, 4, 4)) if not is_rigid(one)]
    where = f": row {bad[0] + 1}" if T.ndim > 2 and bad else ""
    raise UserError(f"{what}{where} is no rigid motion: {remedy}")


def is_projection(K: Float[np.ndarray, "3 3"]) -> bool:
    """Whether K looks like the intrinsics of a camera, so that it can be inverted."""
    return bool(
        np.isfinite(K).all()
        and K[0, 0] > 0
        and K[1, 1] > 0
        and np.abs(K).max() < 1e6
        and np.allclose(K[[1, 2, 2], [0, 0, 1]], 0.0)
        and K[2, 2] == 1.0
    )


def encoded_image(path: Path) -> bytes:
    """Bytes of an image file, found whole, to be kept as they are."""
    data = read_bytes(path, "image")
    decode_image(data, path)
    return data


def read_points(path: Path, record_bytes: int) -> Float32[np.ndarray, "n 3"]:
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


def measure_height(
    clouds: Sequence[Callable[[], Float[np.ndarray, "n 3"]]], where: str | Path
) -> float:
    """Height of a LiDAR above the ground, to the centimetre, from a few clouds spread evenly.

    The clouds have z up and the LiDAR at the origin; the ground is the largest nearly level plane
    around it. Damaged clouds are passed over; UserError where none is left.
    """
    heights = []
    for row in sorted({row * (len(clouds) - 1) // (_PROBES - 1) for row in range(_PROBES)}):
        try:
            height = _ground_below(clouds[row]())
        except UserError:
            continue
        if height is not None:
            heights.append(height)
    if not heights:
        raise UserError(f"no cloud of {where} shows the ground: give --lidar-height-m")
    return round(float(np.median(heights)), 2)


def _ground_below(points: Float[np.ndarray, "n 3"]) -> float | None:
    """How far below the origin the largest nearly level plane lies; None where there is none."""
    points = points.astype(np.float64)
    away = np.hypot(points[:, 0], points[:, 1])
    near = points[(away > _NEAR_M) & (away < _FAR_M) & (points[:, 2] < 0.0)]
    if len(near) < 100:
        return None
    rng = np.random.default_rng(0)
    few = near[rng.permutation(len(near))[:3000]]
    corners = few[rng.integers(len(few), size=(_PLANES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    level = np.abs(normals[:, 2]) > np.cos(_TILT_RAD) * lengths
    level &= lengths > 1e-6
    if not level.any():
        return None
    # z = slope_x x + slope_y y + offset: three numbers a plane
    slopes = -normals[level, :2] / normals[level, 2:]
    offsets = corners[level, 0, 2] - (slopes * corners[level, 0, :2]).sum(axis=1)
    apart = np.abs(few[:, 2:] - few[:, :2] @ slopes.T - offsets)  # (points, planes)
    best = int((apart < _THICK_M).sum(axis=0).argmax())
    on = near[np.abs(near[:, 2] - near[:, :2] @ slopes[best] - offsets[best]) < _THICK_M]
    design = np.column_stack([on[:, :2], np.ones(len(on))])
    return -float(np.linalg.lstsq(design, on[:, 2], rcond=None)[0][2])


def world_of(positions_m: Float[np.ndarray, "n 3"], utm: str, local: str) -> str:
    """Name of the world: `utm` where coordinates are as large as in no local frame."""
    return utm if np.abs(positions_m[:, :2]).max() > 100_000.0 else local
