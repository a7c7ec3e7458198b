# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Poses of a vehicle from the tables that people keep them in.

.csv            a header, then rows; see `read_poses` for the names of its columns
any other name  rows of 8 numbers, TUM: t tx ty tz qx qy qz qw
                rows of 12 numbers, KITTI: 3x4 T_world_body row by row, without times
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float64, Int64
from scipy.spatial.transform import Rotation

from adafusion.geometry import is_rigid
from adafusion.readers.text import read_records, read_text
from adafusion.readers.utm import grid_from_north, to_utm, zone_of
from adafusion.types import UserError

US_PER = {
    "s": Decimal(1_000_000),
    "ms": Decimal(1000),
    "us": Decimal(1),
    "ns": Decimal(1) / 1000,
}
EPOCH_US = 630_000_000 * 10**6  # 1990 in Unix time: before it, a clock counts from its own start
_EPOCH_END_US = 4_200_000_000 * 10**6  # 2103
_STAMP = re.compile(r"[0-9]{1,20}(\.[0-9]{0,30})?([eE][+-]?[0-9]{1,2})?")
_LAST_US = 2**62

_TIMES = ("timestamp", "time", "t", "stamp")
_POSITIONS = (  # x y z in metres
    ("x", "y", "z"),
    ("tx", "ty", "tz"),
    ("px", "py", "pz"),
    ("position_x", "position_y", "position_z"),
    ("easting", "northing", "altitude"),
    ("easting", "northing", "up"),
    ("easting", "northing", "z"),
    ("longitude", "latitude", "altitude"),  # degrees, degrees, metres
    ("lon", "lat", "alt"),
)
_QUATERNIONS = (
    ("qx", "qy", "qz", "qw"),
    ("orientation_x", "orientation_y", "orientation_z", "orientation_w"),
)
_REMEDY = "give TUM rows (t tx ty tz qx qy qz qw), KITTI rows (3x4), or a .csv with a header"


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseTable:
    """Poses in the order of their file."""

    time_us: Int64[np.ndarray, " n"] | None  # strictly rising; None where the file has no times
    T_world_body: Float64[np.ndarray, "n 4 4"]
    has_rotation: bool  # False: only positions are known, the rotations are the identity
    zone: str | None = None  # UTM zone as "30N", where the file has latitudes and longitudes

    def __len__(self) -> int:
        return len(self.T_world_body)


def read_poses(path: str | Path, zone: str | None = None) -> PoseTable:
    """Read a table of poses; UserError names file and line, and the columns that are understood.

    Columns of a .csv, in any order and case; `x [m]` is `x_m`, and `_m` may be left out:
    time `timestamp`, `time`, `t`, `stamp`, with `_s`, `_ms`, `_us`, `_ns`; position `x y [z]`,
    `tx ty [tz]`, `px py [pz]`, `position_x ...`, `easting northing [altitude | up | z]`, or
    degrees `latitude longitude [altitude]`, `lat lon [alt]`; rotation `qx qy qz qw`,
    `orientation_x ...`, `roll pitch yaw`, `yaw` (from x towards y), or `heading` (of a compass,
    from y towards x); angles in radians, or `yaw_deg`. Other columns are ignored.

    A time without a unit counts seconds, milliseconds, microseconds or nanoseconds since 1970 where
    it is large enough to (1990 to 2103, the four do not overlap). Else it is in seconds if it has a
    decimal point or the table is TUM's; whole numbers in a .csv are refused. Latitudes become
    UTM, x east, y north of the grid, in `zone` or else in that of the first row; the rotations
    beside them, which are against true east and north, are turned to the grid.
    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        return _read_csv(path, zone)
    lines: list[int] = []
    rows: list[list[str]] = []
    for line, text in enumerate(read_text(path, _REMEDY).splitlines(), start=1):
        if text.strip() and not text.lstrip().startswith("#"):
            lines.append(line)
            rows.append(text.split())
    columns = len(rows[0]) if rows else 0
    if columns not in (8, 12):
        raise UserError(f"{path} has rows of {columns} numbers: {_REMEDY}")
    first = 1 if columns == 8 else 0
    numbers = np.zeros((len(rows), columns - first))
    for i, (line, words) in enumerate(zip(lines, rows, strict=True)):
        if len(words) != columns:
            raise UserError(f"{path}: line {line} has {len(words)} numbers, not {columns}")
        numbers[i] = [_number(word, path, line) for word in words[first:]]
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    if columns == 12:
        T[:, :3] = numbers.reshape(-1, 3, 4)
        if not is_rigid(T):
            line = next(line for line, one in zip(lines, T, strict=True) if not is_rigid(one))
            raise UserError(f"{path}: line {line} is no rigid motion: {_REMEDY}")
        return PoseTable(time_us=None, T_world_body=T, has_rotation=True)
    T[:, :3, 3] = numbers[:, :3]
    T[:, :3, :3] = _from_quaternions(numbers[:, 3:], path, lines)
    time_us = _times([row[0] for row in rows], "", "s", path, lines)
    return PoseTable(time_us=time_us, T_world_body=T, has_rotation=True)


def parse_stamp(word: str) -> Decimal | None:
    """A number that may be a time, exactly as it is written; None where it is none."""
    return Decimal(word) if _STAMP.fullmatch(word) else None


def epoch_unit(value: Decimal) -> str | None:
    """In which unit `value` is a time since 1970 that a recording can have; None in no one."""
    for unit, us in US_PER.items():
        if EPOCH_US <= value * us < _EPOCH_END_US:
            return unit
    return None


def to_us(value: Decimal, unit: str) -> int:
    """Microseconds, rounded; ValueError where a table has no room for them."""
    us = int((value * US_PER[unit]).to_integral_value())
    if us >= _LAST_US:
        raise ValueError(f"{value} {unit} is no time of a recording")
    return us


def _times(
    words: Sequence[str], unit: str, default: str, path: Path, lines: Sequence[int]
) -> Int64[np.ndarray, " n"]:
    """Times of a column. `unit` "": by magnitude, else `default`, "" where that is not known."""
    values: list[Decimal] = []
    for word, line in zip(words, lines, strict=True):
        value = parse_stamp(word)
        if value is None:
            raise UserError(f"{path}: line {line} has no time but {word[:40]!r}: {_REMEDY}")
        values.append(value)
    units = {epoch_unit(value) for value in values}
    found = units.pop() if len(units) == 1 else None
    in_seconds = default or ("s" if any("." in word for word in words) else "")
    unit = unit or found or in_seconds
    if not unit:
        raise UserError(
            f"{path}: its times, as {words[0]}, may be in any unit: name the column timestamp_s, "
            f"timestamp_ms, timestamp_us or timestamp_ns"
        )
    try:
        time_us = np.array([to_us(value, unit) for value in values], dtype=np.int64)
    except ValueError as error:
        raise UserError(f"{path}: {error}: {_REMEDY}") from error
    if (np.diff(time_us) <= 0).any():
        line = lines[1 + int(np.argmax(np.diff(time_us) <= 0))]
        raise UserError(f"{path}: line {line} is no later than the line before: sort, or remove it")
    return time_us


def _read_csv(path: Path, zone: str | None) -> PoseTable:
    lines: list[int] = []
    rows: list[dict[str, str]] = []
    names: dict[str, str] = {}
    for line, record in read_records(path, (), remedy=_REMEDY):
        names = names or {_plain(raw): raw for raw in record}
        lines.append(line)
        rows.append(record)
    if not rows:
        raise UserError(f"{path} has no rows below a header: {_REMEDY}")

    def column(name: str) -> Float[np.ndarray, " n"]:
        raw = names[name]
        return np.array(
            [_number(row[raw], path, line) for row, line in zip(rows, lines, strict=True)]
        )

    x, y = next((p[:2] for p in _POSITIONS if set(p[:2]) <= set(names)), ("", ""))
    if not x:
        raise UserError(
            f"{path} has the columns {', '.join(names)[:200]}, no position: name two of them x, y, "
            f"or easting, northing, or latitude, longitude"
        )
    z = next((p[2] for p in _POSITIONS if p[:2] == (x, y) and p[2] in names), None)
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, 0, 3], T[:, 1, 3] = column(x), column(y)
    if z is not None:
        T[:, 2, 3] = column(z)
    R_grid_enu = np.eye(3)
    if x.startswith("lon"):
        longitude_deg, latitude_deg = T[:, 0, 3].copy(), T[:, 1, 3].copy()
        try:
            zone = zone or zone_of(latitude_deg[0], longitude_deg[0])
            T[:, :2, 3] = to_utm(latitude_deg, longitude_deg, zone)
            R_grid_enu = grid_from_north(latitude_deg, longitude_deg, zone)
        except ValueError as error:
            raise UserError(f"{path}: {error}: mend it, or prepare runs one by one") from error
    else:
        zone = None

    quaternion = next((q for q in _QUATERNIONS if set(q) <= set(names)), None)
    yaw, heading = _angle_name(names, "yaw"), _angle_name(names, "heading")
    if quaternion:
        values = np.stack([column(name) for name in quaternion], axis=1)
        T[:, :3, :3] = _from_quaternions(values, path, lines)
    elif yaw or heading:
        if yaw:
            about_z = _radians(column(yaw), yaw, path)
        else:
            about_z = np.pi / 2 - _radians(column(str(heading)), str(heading), path)
        tilt = [_angle_name(names, "pitch"), _angle_name(names, "roll")]
        about_yx = [_radians(column(n), n, path) if n else np.zeros(len(rows)) for n in tilt]
        angles = np.stack([about_z, *about_yx], axis=1)
        T[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()

    has_rotation = bool(quaternion or yaw or heading)
    if has_rotation:
        T[:, :3, :3] = R_grid_enu @ T[:, :3, :3]

    time_us = None
    in_units = [(f"{name}{'_' * bool(u)}{u}", u) for name in _TIMES for u in ("", *US_PER)]
    if time := next(((name, unit) for name, unit in in_units if name in names), None):
        raw = names[time[0]]
        time_us = _times([row[raw] for row in rows], time[1], "", path, lines)
    return PoseTable(time_us=time_us, T_world_body=T, has_rotation=has_rotation, zone=zone)


def _plain(name: str) -> str:
    """A column's name without what writers add to it: `#Position X [m]` is `position_x`."""
    words = re.findall(r"[a-z0-9]+", name.lower())
    return "_".join(words[:-1] if len(words) > 1 and words[-1] == "m" else words)


def _number(word: str, path: Path, line: int) -> float:
    try:
        value = float(word)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise UserError(f"{path}: line {line} has {word[:40]!r} for a number: mend or remove it")
    return value


def _angle_name(names: Mapping[str, str], name: str) -> str | None:
    return next((n for n in (name, f"{name}_rad", f"{name}_deg") if n in names), None)


def _radians(values: Float[np.ndarray, " n"], name: str, path: Path) -> Float[np.ndarray, " n"]:
    if name.endswith("_deg"):
        return np.radians(values)
    if np.abs(values).max() > 7.0:  # more than a turn
        raise UserError(f"{path}: {name} is not in radians: name the column {name}_deg")
    return values


def _from_quaternions(
    xyzw: Float[np.ndarray, "n 4"], path: Path, lines: Sequence[int]
) -> Float[np.ndarray, "n 3 3"]:
    wrong = np.abs(np.linalg.norm(xyzw, axis=1) - 1) > 0.01
    if wrong.any():
        line = lines[int(np.argmax(wrong))]
        raise UserError(f"{path}: line {line} has a quaternion whose length is not 1: {_REMEDY}")
    return Rotation.from_quat(xyzw).as_matrix()
