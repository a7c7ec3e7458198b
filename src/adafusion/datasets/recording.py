# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A recording as its reader describes it, and the one loop that turns any of them into a dataset.

A reader looks at tables and file names alone and says which frames there will be, and how each
one's image and cloud are decoded. `write_recording` does that, on all cores, a few frames at a
time whatever the length of the recording; it resumes, skips what is damaged where it is told to,
and says where the time went.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from adafusion.datasets.native import Dataset, DatasetInfo, open_dataset
from adafusion.datasets.sensor_files import check_points, write_cloud, write_image
from adafusion.datasets.writer import SKIPPED_FILE as SKIPPED_FILE
from adafusion.datasets.writer import DatasetWriter, check_run_name
from adafusion.types import Frame, Progress, UserError, silent
from adafusion.workers import map_in_processes


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """One frame of a recording, its files not yet made.

    The functions travel to other processes, so they must be picklable: `functools.partial` of a
    function at the top of a module, with small arguments (paths and numbers; what is large and
    shared is read again by each process, behind `functools.cache`). They raise UserError, which
    names the file, the offset where there is one, and the remedy.
    """

    frame: Frame  # whose `image` and `cloud` are None
    # RGB; or the bytes of a PNG or JPEG file, checked already, to be kept as they are
    image: Callable[[], UInt8[np.ndarray, "h w 3"] | bytes] | None
    cloud: Callable[[], Float[np.ndarray, "n 3"]] | None  # body frame, metres
    image_suffix: str = ".png"  # ".jpg" where the bytes are JPEG


@dataclass(frozen=True, kw_only=True)
class Recording:
    """All that a reader found."""

    # `source` names the reader's settings (spacing, camera, slop): another setting, another dataset
    info: DatasetInfo
    # read once, in order; a generator where the source is a stream. An iterator may raise UserError
    # for what is damaged and go on with the next shot
    shots: Iterable[Shot]
    total: int | None = None  # how many, where that is known
    # what a person should know, as "12 of 400 scans have no image within 10 ms: left out"; a
    # generator of shots may append to it to the end
    notes: list[str] = field(default_factory=list)


class Skipped(NamedTuple):
    """A frame that was left out, or the end of a stream that broke off."""

    key: str  # "run/timestamp_us"; "" where no frame is known
    reason: str  # names file and remedy


@dataclass(frozen=True, kw_only=True)
class Written:
    """What became of a recording."""

    dataset: Dataset
    skipped: tuple[Skipped, ...]
    resumed: int  # frames that an earlier, unfinished job had written
    seconds: float
    # seconds of work, over all processes: finding the next frame, decoding, writing
    reading_s: float
    decoding_s: float
    writing_s: float

    @property
    def frames_per_second(self) -> float:
        """Of those written by this call."""
        return (len(self.dataset.frames) - self.resumed) / self.seconds

    @property
    def decode_share(self) -> float:
        """Share of the work that was decoding, in [0, 1]."""
        return self.decoding_s / max(self.reading_s + self.decoding_s + self.writing_s, 1e-9)


def write_recording(
    recording: Recording,
    out: str | Path,
    *,
    workers: int = 1,
    skip_bad: bool = False,
    progress: Progress = silent,
) -> Written:
    """Decode every frame of a recording and write it as the dataset `out`.

    A few frames for each of `workers` processes are in memory at a time. A job that was cut off
    goes on where it was when it is asked for the same again. With `skip_bad` a frame whose image or
    cloud is damaged is left out and listed, and so is the rest of a stream that breaks off;
    otherwise UserError names the first. There is no `out` then, and none without frames.
    """
    start = time.perf_counter()
    clock = _Clock()
    skipped: list[Skipped] = []
    kept = resumed = 0
    with DatasetWriter(out, recording.info) as writer:
        tasks = _tasks(recording, writer, skip_bad, skipped, clock)
        work = partial(_make, writer.folder, skip_bad)
        made = map_in_processes(work, tasks, workers)
        for result in progress(made, total=recording.total, desc="preparing"):
            clock.decoding += result.decoding_s
            clock.writing += result.writing_s
            if result.fault is not None:
                skipped.append(Skipped(result.frame.key, result.fault))
                continue
            kept += 1
            resumed += result.was_there
            writer.add_written(result.frame)
        if skipped and not kept:
            first = "; ".join(one.reason for one in skipped[:3])
            raise UserError(f"{out}: no frame is left, {len(skipped)} faults were found: {first}")
        writer.list_skipped("".join(f"{one.key or 'the rest'}: {one.reason}\n" for one in skipped))
    return Written(
        dataset=open_dataset(out),
        skipped=tuple(skipped),
        resumed=resumed,
        seconds=time.perf_counter() - start,
        reading_s=clock.reading,
        decoding_s=clock.decoding,
        writing_s=clock.writing,
    )


@dataclass
class _Clock:
    """Seconds of work."""

    reading: float = 0.0
    decoding: float = 0.0
    writing: float = 0.0


class _Result(NamedTuple):
    """What a process says of a frame."""

    frame: Frame
    fault: str | None = None  # why the frame is left out
    was_there: bool = False
    decoding_s: float = 0.0
    writing_s: float = 0.0


def _tasks(
    recording: Recording,
    writer: DatasetWriter,
    skip_bad: bool,
    skipped: list[Skipped],
    clock: _Clock,
) -> Iterator[Shot]:
    """Frames still to be decoded; those an earlier job wrote have no functions left."""
    shots = iter(recording.shots)
    seen: set[str] = set()
    while True:
        before = time.perf_counter()
        try:
            shot = next(shots, None)
        except UserError as error:  # a stream that breaks off; another may come after it
            if not skip_bad:
                raise
            skipped.append(Skipped("", str(error)))
            continue
        finally:
            clock.reading += time.perf_counter() - before
        if shot is None:
            return
        frame = shot.frame
        check_run_name(frame.run)
        if frame.key in seen:
            fault = f"two frames of run {frame.run} have the time {frame.timestamp_us}: remove one"
            if not skip_bad:
                raise UserError(fault)
            skipped.append(Skipped(frame.key, fault))
            continue
        seen.add(frame.key)
        image, cloud = writer.written(frame.run, frame.timestamp_us)
        if (image or shot.image is None) and (cloud or shot.cloud is None):
            frame = replace(
                frame,
                image=image if shot.image else None,
                cloud=cloud if shot.cloud else None,
            )
            shot = replace(shot, frame=frame, image=None, cloud=None)
        yield shot


def _make(folder: Path, skip_bad: bool, shot: Shot) -> _Result:
    """Decode and write one frame; both files or none."""
    frame, start = shot.frame, time.perf_counter()
    if shot.image is None and shot.cloud is None:
        return _Result(frame, was_there=True)
    try:
        image = None if shot.image is None else shot.image()
        points = None if shot.cloud is None else check_points(shot.cloud(), frame.key)
    except UserError as error:
        if not skip_bad:
            raise
        return _Result(frame, str(error), decoding_s=time.perf_counter() - start)
    decoded = time.perf_counter()
    where = folder, frame.run, frame.timestamp_us
    frame = replace(
        frame,
        image=None if image is None else write_image(*where, image, shot.image_suffix),
        cloud=None if points is None else write_cloud(*where, points),
    )
    return _Result(frame, decoding_s=decoded - start, writing_s=time.perf_counter() - decoded)
