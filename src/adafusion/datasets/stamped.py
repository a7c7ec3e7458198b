# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Folders of runs whose files are named by their time, and the tables that name them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from adafusion.types import UserError


def choose_runs(there: Sequence[str], runs: Sequence[str] | None, root: Path) -> list[str]:
    """Check that the chosen `runs` are there, in any order; None takes them all."""
    chosen = sorted(set(there if runs is None else runs))
    if not chosen:
        raise UserError(f"no run of {root} is chosen: choose from {', '.join(there)}")
    if missing := [run for run in chosen if run not in there]:
        raise UserError(f"{root} has no run {missing[0]}: choose from {', '.join(there)}")
    return chosen


def is_synthetic(src: Path) -> bool:
    """Whether a manifest at `src` says that no real sensor saw it."""
    try:
        manifest = json.loads((src / "manifest.json").read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(manifest, dict) and manifest.get("synthetic") is True


def stamps(folder: Path, suffix: str) -> set[int]:
    """Times that files of a folder are named by; {} where there is no folder."""
    names = (path.name.removesuffix(suffix) for path in folder.glob(f"*{suffix}"))
    return {int(name) for name in names if _is_stamp(name)}


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
