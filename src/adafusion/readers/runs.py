# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Folders of runs whose files are named by their time, and the tables that name them."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from adafusion.types import UserError

_STAMP = re.compile(r"[0-9]{1,19}")


def matches(src: Path, *patterns: str) -> bool:
    """Whether something at `src` fits each glob pattern; never raises."""
    try:
        return all(any(src.glob(pattern)) for pattern in patterns)
    except (OSError, ValueError):
        return False


def choose_runs(
    src: Path,
    there: Iterable[str],
    runs: Sequence[str] | None,
    preferred: Collection[str] = (),
) -> list[str]:
    """The runs asked for, in that order; if None, those preferred that are there, or else all.

    UserError lists those there are for any other.
    """
    names = sorted(there)
    if runs is None:
        chosen = [name for name in names if name in preferred] or names
    else:
        chosen = list(dict.fromkeys(runs))
    if unknown := [name for name in chosen if name not in names]:
        raise UserError(f"{src} has no run {unknown[0]!r}: choose from {', '.join(names)}")
    if not chosen:
        raise UserError(f"no run of {src} is chosen: choose from {', '.join(names)}")
    return chosen


def files_by_stamp(folder: Path, *suffixes: str) -> dict[int, Path]:
    """Files whose names are whole numbers (indices, times of any unit), by that number, rising.

    Empty where there is no folder; UserError where two names are one number.
    """
    try:
        paths = [path for path in folder.iterdir() if path.suffix in suffixes]
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except OSError as error:
        raise UserError(
            f"{folder} cannot be read ({error.strerror}): give it read access"
        ) from error
    stamped = sorted((int(path.stem), path) for path in paths if _STAMP.fullmatch(path.stem))
    for (stamp, path), (after, other) in pairwise(stamped):
        if stamp == after:
            raise UserError(f"{path} and {other.name} have the same number: remove one")
    return {stamp: path for stamp, path in stamped if stamp < 2**62}


def file_times(folder: Path, suffix: str) -> Int64[np.ndarray, " n"]:
    """Times of files named `<time><suffix>`, rising: their names can be made from the times."""
    files = files_by_stamp(folder, suffix)
    times = [time for time, path in files.items() if path.name == f"{time}{suffix}"]
    return np.array(times, dtype=np.int64)


def whole(text: str, table: Path, line: int) -> int:
    """A time in microseconds; UserError names the line."""
    if not _is_stamp(text):
        raise UserError(
            f"{table}: line {line} has {text!r} for a time in microseconds: fetch it again"
        )
    return int(text)


def _is_stamp(text: str) -> bool:
    """Digits as `str` gives them, below 2^63: the name of a file is made from the number."""
    return (
        text.isascii() and text.isdecimal() and len(text) < 19 and (text[0] != "0" or text == "0")
    )


def number(text: str, table: Path, line: int) -> float:
    """A finite number; UserError names the line."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise UserError(f"{table}: line {line} has {text!r} for a number: fetch it again")
    return value
