# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""When the files of a plain folder were taken, from their names and the poses."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from adafusion.readers.pose_files import (
    EPOCH_US,
    US_PER,
    PoseTable,
    epoch_unit,
    parse_stamp,
    to_us,
)
from adafusion.types import UserError

_ROW_US = 1_000_000  # where poses have no times, row i is i seconds


def name_times(
    images: Collection[str], clouds: Collection[str], table: PoseTable, path: Path, slop_us: int
) -> tuple[dict[str, int], Int64[np.ndarray, " n"]]:
    """Time of every name (without suffix) and of every pose, microseconds.

    The rules are those that `adafusion.readers.folder.reader` states; UserError where none of them
    fits, or where two do and tell different times.
    """
    names = sorted({*images, *clouds})
    stamps = {name: _stamp_us(name) for name in names}
    times = {name: at for name, at in stamps.items() if at is not None}
    if table.time_us is not None and table.time_us[-1] < EPOCH_US and _whole(names):
        times = {}  # the clock of the poses began at 0: so did that of the names, if they are times
    if len(times) == len(names):
        if table.time_us is not None:
            return times, table.time_us
        leading = sorted(times[name] for name in (clouds or images))
        if len(leading) == len(table) and len(set(leading)) == len(leading):
            return times, np.array(leading, dtype=np.int64)  # row i is the i-th file
        raise UserError(
            f"{path} has {len(table)} poses without times for {len(leading)} "
            f"{'clouds' if clouds else 'images'}: give poses with times (TUM, or a .csv)"
        )
    if times:
        other = next(name for name in names if name not in times)
        raise UserError(
            f"{path.parent} has files named by times, as {next(iter(times))}, and others, as "
            f"{other}: name all of a run in one way"
        )
    pose_us = np.arange(len(table), dtype=np.int64) * _ROW_US
    if table.time_us is not None:
        pose_us = table.time_us
    by_row = _rows(names, len(table))
    by_clock = _clock(names, table.time_us, slop_us)
    at_rows = None if by_row is None else {n: int(pose_us[row]) for n, row in by_row.items()}
    if at_rows and by_clock and max(abs(at_rows[n] - by_clock[n]) for n in names) > slop_us:
        raise UserError(
            f"{names[0]} to {names[-1]} may be rows of {path} or times on its clock: rename the "
            f"files to seconds with a decimal point, or give poses without times for rows"
        )
    if found := by_clock or at_rows:
        return found, pose_us
    raise UserError(
        f"{len(names)} names from {names[0]} to {names[-1]} fit neither the {len(table)} rows of "
        f"{path} nor times in it: name files by times on its clock, or by a row's number from 0 on"
    )


def _stamp_us(name: str) -> int | None:
    """Time that a name is beyond doubt; None for others."""
    value = parse_stamp(name)
    unit = None if value is None else "s" if "." in name else epoch_unit(value)
    if value is None or unit is None or "e" in name.lower():
        return None
    try:
        return to_us(value, unit)
    except ValueError:
        return None


def _whole(names: Collection[str]) -> dict[str, int] | None:
    """The names as whole numbers, where all are."""
    if all(name.isascii() and name.isdigit() and len(name) < 19 for name in names):
        return {name: int(name) for name in names}
    return None


def _rows(names: Collection[str], rows: int) -> dict[str, int] | None:
    """Row of the poses of each name: in order, where there are as many; else by its number."""
    numbers = _whole(names)
    if len(names) == rows:
        order = sorted(names, key=lambda name: (numbers[name] if numbers else 0, name))
        return {name: row for row, name in enumerate(order)}
    if numbers is not None and max(numbers.values()) < rows:
        return numbers
    return None


def _clock(
    names: Collection[str], pose_us: Int64[np.ndarray, " n"] | None, slop_us: int
) -> dict[str, int] | None:
    """Small whole numbers as times on the clock of the poses, in the unit whose span is nearest.

    None unless half of them at least lie within the times of the poses.
    """
    numbers = _whole(names)
    if numbers is None or pose_us is None or len(names) < 2 or len(pose_us) < 2:
        return None
    values = np.array(list(numbers.values()))
    span, poses_span = int(np.ptp(values)), int(pose_us[-1] - pose_us[0])
    if span == 0:
        return None
    unit = min(US_PER, key=lambda u: abs(np.log(span * float(US_PER[u]) / poses_span)))
    times = values * float(US_PER[unit])
    inside = (times >= pose_us[0] - slop_us) & (times <= pose_us[-1] + slop_us)
    if inside.mean() < 0.5 or times.max() >= 2**62:
        return None
    return {name: round(at) for name, at in zip(numbers, times.tolist(), strict=True)}
