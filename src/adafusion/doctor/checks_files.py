# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Files: are they there, can they be read, is each of them another one?"""

from __future__ import annotations

import hashlib
import itertools
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from adafusion.doctor.findings import Finding, by_run, examples, judge, ok, percent
from adafusion.doctor.looks import LEAST_STEP_M, Look
from adafusion.doctor.table import Table

SENSORS = ("image", "cloud")
ALONE = {"image": "lidar-s", "cloud": "image-s"}  # models for sets that have none of it
COPIED_SHARE = 0.5  # of a run's files that are files of another run: it is no run of its own
FROZEN_FAIL_SHARE = 0.1

# Mean difference of thumbs, grey values. Scenes metres apart differ by 2 and more even by night;
# one scene photographed twice by a standing camera, or encoded twice, by a few tenths.
SAME_SCENE = 0.5
FLAT_SPREAD = 5.0  # images with less contrast (night, fog, a wall) look alike for good reason

_BLOCK = 4096
_Groups = list[list[int]]  # rows of frames with identical files


def sensors(table: Table) -> Finding:
    """Whether every frame has an image, a cloud and a pose."""
    check, n = "sensors", len(table.frames)
    lacking = {
        "image": np.array([f.image is None for f in table.frames]),
        "cloud": np.array([f.cloud is None for f in table.frames]),
        # where none has any, as with submaps, that is how the data are
        "orientation": ~table.has_pose & table.has_pose.any(),
    }
    n_lacking = {name: int(lacks.sum()) for name, lacks in lacking.items() if lacks.any()}
    if not n_lacking:
        return ok(check, f"all {n} frames have image, cloud and place")
    rows = np.flatnonzero(np.logical_or.reduce(list(lacking.values())))
    words = ", ".join(f"{count} have no {name}" for name, count in n_lacking.items())
    runs = [run for run, _ in by_run(table, rows)]
    remedy = next(
        (
            f"Where there is no such sensor, take --model {m}."
            for s, m in ALONE.items()
            if lacking[s].all()
        ),
        "Prepare with a larger --slop-ms if sensors only miss each other in time; else leave it: a "
        "map takes such frames.",
    )
    return Finding(
        check=check,
        level="warn",
        what=f"of {n} frames {words}; runs {', '.join(runs[:5])}",
        why="Training and evaluation of a fused model leave out frames that lack a sensor; checks "
        "of axes need the orientation.",
        remedy=remedy,
        frames=examples(table, rows),
    )


def readable(table: Table, looks: Sequence[Look]) -> Finding:
    """Whether files can be decoded."""
    check = "readable files"
    bad = [look for look in looks if look.faults]
    if not bad:
        return ok(check, f"those of {len(looks)} frames opened: all whole, finite, not empty")
    return Finding(
        check=check,
        level="fail",
        what=f"{len(bad)} of {len(looks)} frames opened have damaged files: {bad[0].faults[0]}",
        why="Whatever reads such a frame stops: a training after hours, a map half built.",
        remedy="Prepare again with --skip-bad, which leaves damaged frames out and lists them.",
        frames=examples(table, [look.row for look in bad]),
    )


def same_files(table: Table, root: Path) -> dict[str, _Groups]:
    """Of each sensor, groups of rows whose files are equal byte for byte, of all frames."""
    return {
        sensor: _equal(
            [
                (row, root / name)
                for row, frame in enumerate(table.frames)
                if (name := getattr(frame, sensor)) is not None
            ]
        )
        for sensor in SENSORS
    }


def duplicates(table: Table, same: dict[str, _Groups]) -> Finding:
    """Frames apart that hold one and the same file: a run copied, a message recorded twice."""
    check = "duplicates"
    rows: set[int] = set()
    words, copied = [], 0.0
    for sensor, groups in same.items():
        apart = [row for group in groups if not _consecutive(table, group) for row in group]
        between = [row for group in groups if len(set(table.run[group])) > 1 for row in group]
        if apart:
            words.append(f"{len(apart)} frames share their {sensor} with another")
        rows |= set(apart)
        for number in range(len(table.runs)):
            own = int((table.run == number).sum())
            copied = max(copied, sum(table.run[row] == number for row in between) / own)
    if not rows:
        return ok(check, "no file is there twice")
    return Finding(
        check=check,
        level="fail" if copied > COPIED_SHARE else "warn",
        what="; ".join(words)
        + (f"; {percent(copied)} of a run's files are those of another run" if copied else ""),
        why="A query that finds its own copy counts as right: recall is too high. Copies of other "
        "places are wrong matches.",
        remedy="Leave the copied run out, or prepare it from its own files.",
        frames=examples(table, sorted(rows)),
    )


def frozen(table: Table, same: dict[str, _Groups], looks: Sequence[Look]) -> Finding:
    """Sensors that show the last picture or scan again while the vehicle moves on."""
    check = "frozen sensors"
    rows: set[int] = set()
    words = []
    for sensor, groups in same.items():
        stuck = {
            row
            for group in groups
            for before, row in itertools.pairwise(group)
            if row == before + 1
            and table.run[row] == table.run[before]
            and table.step_after[before] >= LEAST_STEP_M
        }
        if sensor == "image":
            stuck |= {
                look.row
                for look in looks
                if look.likeness is not None
                and look.likeness < SAME_SCENE
                and look.moved_m is not None
                and look.moved_m >= LEAST_STEP_M
                and look.image is not None
                and look.image.spread >= FLAT_SPREAD
            }
        if stuck:
            words.append(f"{len(stuck)} frames repeat the {sensor} before though the vehicle moved")
        rows |= stuck
    if not rows:
        return ok(check, "no image and no cloud is repeated while the vehicle moves")
    return Finding(
        check=check,
        level=judge(len(rows) / len(table.frames), warn=0.0, fail=FROZEN_FAIL_SHARE),
        what="; ".join(words),
        why="A place is learnt with the picture of another.",
        remedy="Leave these frames out; look at the driver or the recorder of the sensor.",
        frames=examples(table, sorted(rows)),
    )


def _consecutive(table: Table, group: list[int]) -> bool:
    """Whether a group is one stretch of one run."""
    return group[-1] - group[0] == len(group) - 1 and len(set(table.run[group])) == 1


def _equal(files: list[tuple[int, Path]]) -> _Groups:
    """Group files of equal content: by size, then by a few blocks, then by all bytes.

    Nearly all are told apart by size, so a dataset of gigabytes is compared in seconds.
    """
    groups = [files]
    for key in (_size, _sketch, _digest):
        groups = [part for group in groups for part in _split(group, key)]
    return [[row for row, _ in group] for group in groups]


def _split(
    files: Iterable[tuple[int, Path]], key: Callable[[Path], object]
) -> list[list[tuple[int, Path]]]:
    parts: dict[object, list[tuple[int, Path]]] = defaultdict(list)
    for row, path in files:
        parts[key(path)].append((row, path))
    return [part for part in parts.values() if len(part) > 1]


def _size(path: Path) -> int:
    return path.stat().st_size


def _sketch(path: Path) -> bytes:
    """The middle and the end of a file: heads of one format are all alike."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(size // 2)
        middle = file.read(_BLOCK)
        file.seek(max(size - _BLOCK, 0))
        return middle + file.read(_BLOCK)


def _digest(path: Path) -> bytes:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()
