# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a check says: how bad it is, what was found, what that means and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Int

from adafusion.doctor.table import Table

# "skip": the data do not say what the check needs, so it says nothing; not the same as "ok"
Level = Literal["ok", "skip", "warn", "fail"]
LEVELS: tuple[Level, ...] = ("skip", "ok", "warn", "fail")  # by how bad it is

EXAMPLES = 5  # frames that a finding names: enough to look at, few enough to read


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """The outcome of one check."""

    check: str
    level: Level
    what: str  # found, with numbers
    why: str = ""  # it matters: what goes wrong with such data
    remedy: str = ""
    frames: tuple[str, ...] = ()  # keys of a few frames at fault


def ok(check: str, what: str) -> Finding:
    """The check found nothing wrong."""
    return Finding(check=check, level="ok", what=what)


def skip(check: str, what: str) -> Finding:
    """The check has nothing to look at, or another finding makes its answer worthless."""
    return Finding(check=check, level="skip", what=what)


def examples(table: Table, rows: Iterable[int] | Int[np.ndarray, " n"]) -> tuple[str, ...]:
    """Keys of the first few of these rows."""
    return tuple(table.frames[int(row)].key for row in list(rows)[:EXAMPLES])


def by_run(
    table: Table, rows: Int[np.ndarray, " n"]
) -> Iterator[tuple[str, Bool[np.ndarray, " n"]]]:
    """Each run that has some of `rows`, with which of them are its own."""
    for number, run in enumerate(table.runs):
        own = table.run[rows] == number
        if own.any():
            yield run, own


def percent(share: float) -> str:
    """0.123 as `12 %`; below ten percent with one decimal."""
    return f"{100 * share:.0f} %" if share >= 0.1 or share == 0 else f"{100 * share:.1f} %"


def judge(value: float, *, warn: float, fail: float) -> Level:
    """Grade a value of which more is worse."""
    return "fail" if value > fail else "warn" if value > warn else "ok"
