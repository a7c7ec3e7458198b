# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded data: every format that is read, by name, and the way from any of them to a dataset."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from adafusion.datasets.recording import Recording, Written, write_recording
from adafusion.readers import (
    bag,
    boreas,
    folder,
    kitti_odometry,
    kitti_raw,
    mulran,
    nclt,
    nuscenes,
    opr,
    pointnetvlad,
    robotcar,
)
from adafusion.types import Progress, UserError, silent

logger = logging.getLogger(__name__)


class Reader(NamedTuple):
    """One format."""

    about: str
    recognises: Callable[[Path], bool]  # whether a folder or file is laid out like this
    read: Callable[..., Recording]  # of the source and options, all with defaults

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the options that `read` knows."""
        return tuple(inspect.signature(self.read).parameters)[1:]


# the plain folder comes last: it recognises what the others have names for
READERS: dict[str, Reader] = {
    "robotcar": Reader("Oxford RobotCar, as recorded", robotcar.recognises, robotcar.read),
    "pointnetvlad": Reader(
        "submaps of the PointNetVLAD benchmark", pointnetvlad.recognises, pointnetvlad.read
    ),
    "nclt": Reader("NCLT, as recorded", nclt.recognises, nclt.read),
    "opr": Reader("NCLT or Oxford, made ready by OpenPlaceRecognition", opr.recognises, opr.read),
    "kitti-odometry": Reader(
        "KITTI odometry benchmark", kitti_odometry.recognises, kitti_odometry.read
    ),
    "kitti-raw": Reader("KITTI raw drives", kitti_raw.recognises, kitti_raw.read),
    "boreas": Reader("Boreas", boreas.recognises, boreas.read),
    "mulran": Reader("MulRan", mulran.recognises_mulran, mulran.read_mulran),
    "helipr": Reader("HeLiPR", mulran.recognises_helipr, mulran.read_helipr),
    "nuscenes": Reader("nuScenes keyframes", nuscenes.recognises, nuscenes.read),
    "bag": Reader("bags of ROS 1 or ROS 2, without ROS", bag.recognises, bag.read),
    "folder": Reader("images, clouds and a table of poses", folder.recognises, folder.read),
}


def guess_kind(src: str | Path) -> str:
    """Name of the format that `src` is laid out in; UserError where none or several fit."""
    src = Path(src)
    if not src.exists():
        raise UserError(f"{src} is missing: give the folder or file as its source gave it")
    kinds = [kind for kind, reader in READERS.items() if reader.recognises(src)]
    if len(kinds) > 1 and kinds[-1] == "folder":
        kinds.pop()
    if len(kinds) == 1:
        return kinds[0]
    found = f"may be {' or '.join(kinds)}" if kinds else "is laid out like no format known here"
    raise UserError(
        f"{src} {found}: name the kind, one of {', '.join(READERS)}, which then says what it misses"
    )


def read_recording(src: str | Path, kind: str | None = None, **options: object) -> Recording:
    """What a reader finds at `src`; `kind` None guesses the format.

    `options` are those of the reader, as `runs` or `every_m`. UserError for an unknown kind, for an
    option that this kind does not know, and for whatever is wrong with the source.
    """
    src = Path(src)
    kind = guess_kind(src) if kind is None else kind
    if kind not in READERS:
        raise UserError(f"unknown format {kind!r}: choose from {', '.join(READERS)}")
    if not src.exists():
        raise UserError(f"{src} is missing: give the folder or file as its source gave it")
    reader = READERS[kind]
    if unknown := sorted(set(options) - set(reader.options)):
        names = ", ".join(f"--{name.replace('_', '-')}" for name in reader.options)
        raise UserError(
            f"{kind} knows no --{unknown[0].replace('_', '-')}: its options are {names or 'none'}"
        )
    return reader.read(src, **options)


def prepare(
    src: str | Path,
    out: str | Path,
    kind: str | None = None,
    *,
    workers: int = 1,
    skip_bad: bool = False,
    progress: Progress = silent,
    note: Callable[[str], None] = logger.warning,
    **options: object,
) -> Written:
    """Turn recorded data at `src` into the dataset `out`: `read_recording`, `write_recording`.

    What a person should know of the recording (frames without a partner in time, rows without a
    fix) is told to `note`.
    """
    recording = read_recording(src, kind, **options)
    try:
        return write_recording(
            recording, out, workers=workers, skip_bad=skip_bad, progress=progress
        )
    finally:
        for line in recording.notes:
            note(line)
