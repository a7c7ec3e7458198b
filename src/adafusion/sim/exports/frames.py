# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Poses as recorded data sets write them: north, east, down, and bodies with x forward, z down.

The synthetic world has x east, y north, z up; its bodies x forward, y left, z up.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float, Float64, Int64
from scipy.spatial.transform import Rotation

from adafusion.geometry import pose, rotation_from_rpy
from adafusion.sim.run.route import Drive

T_NED_WORLD = pose(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), (0.0, 0.0, 0.0))
T_UP_DOWN = pose(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 0.0))  # z-down body in the z-up body
EARTH_RADIUS_M = 6_378_137.0


def pose_of(numbers: Sequence[float]) -> Float64[np.ndarray, "4 4"]:
    """Pose of x, y, z in metres and roll, pitch, yaw in radians; R = Rz Ry Rx."""
    x, y, z, roll, pitch, yaw = numbers
    return pose(rotation_from_rpy(roll, pitch, yaw), (x, y, z))


def six_numbers(T: Float[np.ndarray, "n 4 4"]) -> Float64[np.ndarray, "n 6"]:
    """The inverse of `pose_of`, row by row."""
    yaw_pitch_roll = Rotation.from_matrix(T[:, :3, :3]).as_euler("ZYX")
    return np.concatenate([T[:, :3, 3], yaw_pitch_roll[:, ::-1]], axis=1)


def ins_along(
    way: Drive, T_world_body: Float[np.ndarray, "k 4 4"], time_us: Int64[np.ndarray, " k"]
) -> Float64[np.ndarray, "k 4 4"]:
    """What the GPS/INS unit says at any times at which the true poses are given."""
    shift = way.T_world_ins[:, :3, 3] - way.T_world_body[:, :3, 3]
    R_error = way.T_world_body[:, :3, :3].swapaxes(1, 2) @ way.T_world_ins[:, :3, :3]
    error = np.concatenate([shift, Rotation.from_matrix(R_error).as_rotvec()], axis=1)
    knots = (way.timestamp_us - way.timestamp_us[0]).astype(float)
    at = (time_us - way.timestamp_us[0]).astype(float)
    between = np.column_stack([np.interp(at, knots, column) for column in error.T])
    T = T_world_body.copy()
    T[:, :3, 3] += between[:, :3]
    T[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(between[:, 3:]).as_matrix()
    return T


def geodetic(
    north_m: Float[np.ndarray, " n"],
    east_m: Float[np.ndarray, " n"],
    origin_deg: tuple[float, float],
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Latitude and longitude in radians of points near an origin, on a sphere."""
    latitude, longitude = np.radians(origin_deg)
    return (
        latitude + north_m / EARTH_RADIUS_M,
        longitude + east_m / (EARTH_RADIUS_M * np.cos(latitude)),
    )


def table(rows: Iterable[Sequence[object]], *header: str) -> bytes:
    """Comma-separated text; NumPy's numbers print as Python's."""
    lines = [",".join(header)] if header else []
    lines += [",".join(map(str, row)) for row in rows]
    return ("\n".join(lines) + "\n").encode()
