# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where NCLT's robot was: the ground truth, and what GPS and the inertial unit said.

    groundtruth_<run>.csv   utime; x north, y east, z down; roll, pitch, yaw; or NaN
    gps.csv                 utime, mode, satellites, latitude, longitude, altitude, course, speed
    ms25_euler.csv          utime, roll, pitch, heading

Metres and radians, R = Rz Ry Rx, in the robot's frame with z down. GPS positions come to metres by
the paper's formula: sines of the differences to the origin, times the radii of curvature that the
ellipsoid of 1972 has there.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial.transform import Rotation

from adafusion.readers.sensors import T_ENU_NED, T_FLU_FRD
from adafusion.readers.text import read_numbers
from adafusion.readers.track import Track
from adafusion.types import UserError

ORIGIN_DEG, ORIGIN_ALTITUDE_M = (42.293227, -83.709657), 270.0
_EQUATOR_M, _POLE_M = 6_378_135.0, 6_356_750.0
_FIX_3D = 3  # mode of a GPS row with an altitude

# the longest times between two rows that a frame may lie in
_GPS_GAP_US, _EULER_GAP_US = 1_000_000, 200_000
_LATEST_US = 2**53  # beyond it, a number in a table is no whole one

_REMEDY = "fetch it again from NCLT's site"


def read_truth(path: Path) -> tuple[Float64[np.ndarray, "n 7"], int]:
    """Time and pose of each row of a ground-truth file, by rising time; how many rows were none."""
    table = read_numbers(path, 7, remedy=_REMEDY, delimiter=",", allow_nan=True)
    rows = _rising(table, path)
    if len(rows) == 0:
        raise UserError(f"{path} holds no pose: {_REMEDY}")
    return rows, len(table) - len(rows)


def track_around(rows: Float64[np.ndarray, "n 7"], at_us: Int64[np.ndarray, " k"]) -> Track:
    """Poses in our world and body of the rows next to some times: a day has hundreds of thousands.

    Rows are times with x, y, z and roll, pitch, yaw as NCLT gives them.
    """
    time_us = rows[:, 0].astype(np.int64)
    after = np.clip(np.searchsorted(time_us, at_us), 0, len(rows) - 1)
    near = np.unique(np.concatenate([[0], np.maximum(after - 1, 0), after]))
    T = np.tile(np.eye(4), (len(near), 1, 1))
    T[:, :3, :3] = Rotation.from_euler("xyz", rows[near, 4:]).as_matrix()  # about fixed axes
    T[:, :3, 3] = rows[near, 1:4]
    return Track(time_us[near], T_ENU_NED @ T @ T_FLU_FRD)


def read_ins(
    gps_file: Path, euler_file: Path, at_us: Int64[np.ndarray, " k"]
) -> tuple[Bool[np.ndarray, " k"], Float64[np.ndarray, "k 4 4"]]:
    """Poses that GPS (position) and inertial unit (attitude) gave, and at which times they did."""
    gps = _read_fixes(gps_file)
    angles = read_numbers(euler_file, 4, remedy=_REMEDY, delimiter=",", allow_nan=True)
    angles = _rising(np.insert(angles, [1, 1, 1], 0.0, axis=1), euler_file)
    known = np.zeros(len(at_us), dtype=bool)
    T = np.tile(np.eye(4), (len(at_us), 1, 1))
    if len(gps) and len(angles):
        places, turns = (track_around(rows, at_us) for rows in (gps, angles))
        known = places.near(at_us, _GPS_GAP_US) & turns.near(at_us, _EULER_GAP_US)
        T[known] = turns.at(at_us[known])
        T[known, :3, 3] = places.at(at_us[known])[:, :3, 3]
    return known, T


def _read_fixes(path: Path) -> Float64[np.ndarray, "n 7"]:
    """Times and positions of a gps.csv, as rows of a ground-truth file that is never turned."""
    table = read_numbers(path, None, remedy=_REMEDY, delimiter=",", allow_nan=True)
    if table.shape[1] < 6:
        raise UserError(f"{path} has {table.shape[1]} columns, not utime to altitude: {_REMEDY}")
    utime, mode, _, latitude, longitude, altitude_m = table[:, :6].T
    origin, longitude_0 = np.radians(ORIGIN_DEG)
    squashed = (_EQUATOR_M * np.cos(origin)) ** 2 + (_POLE_M * np.sin(origin)) ** 2
    north_radius_m = (_EQUATOR_M * _POLE_M) ** 2 / squashed**1.5
    east_radius_m = _EQUATOR_M**2 / squashed**0.5 * np.cos(origin)
    rows = np.zeros((len(table), 7))
    rows[:, 0] = utime
    rows[:, 1] = np.sin(latitude - origin) * north_radius_m
    rows[:, 2] = np.sin(longitude - longitude_0) * east_radius_m
    rows[:, 3] = ORIGIN_ALTITUDE_M - altitude_m
    return _rising(rows[mode == _FIX_3D], path)


def _rising(table: Float64[np.ndarray, "n 7"], path: Path) -> Float64[np.ndarray, "m 7"]:
    """Rows that are finite and later than all before them."""
    rows = table[np.isfinite(table).all(axis=1)]
    time_us = rows[:, 0]
    if len(rows) and (time_us.min() < 0 or time_us.max() >= _LATEST_US):
        raise UserError(f"{path}: the first column holds no microseconds: {_REMEDY}")
    before = np.maximum.accumulate(np.concatenate([[-1.0], time_us[:-1]]))
    return rows[time_us > before[: len(rows)]]
