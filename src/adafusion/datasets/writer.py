# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Writes our own dataset form: a dataset is either whole or not there, and resumes."""

from __future__ import annotations

import errno
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from types import TracebackType

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from jaxtyping import Float

from adafusion.datasets.native import (
    SCHEMA,
    SCHEMA_VERSION,
    Dataset,
    DatasetInfo,
    open_dataset,
    partial_folder,
    table_path,
)
from adafusion.datasets.sensor_files import IMAGE_SUFFIXES, write_observation
from adafusion.datasets.splits import Regions
from adafusion.files import atomic_path, claim_folder, write_text
from adafusion.types import Frame, Observation, UserError

SKIPPED_FILE = "skipped.txt"  # beside dataset.yaml, where a dataset lacks what was damaged


class DatasetWriter:
    """Writes a dataset that is either whole or not there, and resumes one that was cut off.

        with DatasetWriter(out, info) as writer:
            for frame, observation in drive:
                writer.add(frame, observation)

    Files go to `folder`, which is `<out>.partial`. Leaving the block well writes the tables and
    renames the folder to `out`; leaving it by an exception keeps the folder. A job that resumes
    asks `has` for each frame and records what is there already by `add_written`.
    """

    def __init__(self, out: str | Path, info: DatasetInfo) -> None:
        self.out = Path(out)
        self.info = info
        self.folder = partial_folder(self.out)
        self._frames: dict[str, Frame] = {}
        self._skipped = ""

    def __enter__(self) -> DatasetWriter:
        if self.out.exists():
            raise UserError(f"{self.out} exists: choose another folder, or remove it first")
        draft = self.folder / "dataset.yaml"
        try:
            claim_folder(self.folder, draft.name)
            if not draft.exists():
                write_text(draft, _to_yaml(self.info))
        except OSError as error:
            raise _cannot_write(self.folder, error) from error
        # runs are listed in it if the end came between the last two steps
        begun = draft.read_text(encoding="utf-8").partition("\nruns:\n")[0]
        if begun.rstrip() != _to_yaml(self.info).rstrip():
            raise UserError(
                f"{self.folder} was begun with other settings: remove it, or repeat the settings "
                f"that its dataset.yaml shows"
            )
        return self

    def has(self, run: str, timestamp_us: int, *, image: bool = True, cloud: bool = True) -> bool:
        """Whether the files of this frame are there already, of the sensors that are asked for."""
        there = self.written(run, timestamp_us)
        return (not image or there[0] is not None) and (not cloud or there[1] is not None)

    def written(self, run: str, timestamp_us: int) -> tuple[str | None, str | None]:
        """Names of the image and the cloud of this frame that are there already."""
        images = [f"{run}/images/{timestamp_us}{suffix}" for suffix in IMAGE_SUFFIXES]
        image = next((name for name in images if (self.folder / name).exists()), None)
        cloud = f"{run}/clouds/{timestamp_us}.npy"
        return image, cloud if (self.folder / cloud).exists() else None

    def add(self, frame: Frame, observation: Observation, image_suffix: str = ".png") -> Frame:
        """Write `observation` and record `frame`; return the frame with its file names."""
        check_run_name(frame.run)
        image, cloud = write_observation(
            self.folder, frame.run, frame.timestamp_us, observation, image_suffix
        )
        frame = replace(frame, image=image, cloud=cloud)
        self.add_written(frame)
        return frame

    def add_written(self, frame: Frame) -> None:
        """Record a frame whose files lie in `folder` already, under the names that it gives."""
        check_run_name(frame.run)
        if frame.key in self._frames:
            raise ValueError(f"frame {frame.key} is written twice")
        for name in (frame.image, frame.cloud):
            if name is not None and not (self.folder / name).is_file():
                raise ValueError(f"frame {frame.key} names {name}, which nobody wrote")
        self._frames[frame.key] = frame

    def list_skipped(self, text: str) -> None:
        """Say in `SKIPPED_FILE` what the dataset lacks."""
        self._skipped = text

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, OSError) and error.errno in _DISK_FULL:
            raise _cannot_write(self.folder, error) from error
        if error is None:
            try:
                self._finish()
            except OSError as late:
                raise _cannot_write(self.folder, late) from late

    def _finish(self) -> None:
        if not self._frames:
            raise UserError(f"{self.out}: there is no frame to write; nothing was made")
        runs: dict[str, list[Frame]] = {}
        for frame in sorted(self._frames.values(), key=lambda f: (f.run, f.timestamp_us)):
            runs.setdefault(frame.run, []).append(frame)
        self._remove_strays()
        if self._skipped:
            write_text(self.folder / SKIPPED_FILE, self._skipped)
        for run, frames in runs.items():
            with atomic_path(table_path(self.folder, run)) as temporary:
                pq.write_table(_to_table(frames), temporary, write_page_checksum=True)
        counts = {run: len(frames) for run, frames in runs.items()}
        write_text(self.folder / "dataset.yaml", _to_yaml(self.info, counts))
        open_dataset(self.folder)  # nothing takes the name of a dataset that cannot be opened
        self.folder.rename(self.out)

    def _remove_strays(self) -> None:
        """Delete what no frame names: temporaries of a killed process, frames since left out."""
        named = {name for f in self._frames.values() for name in (f.image, f.cloud)}
        for path in list(self.folder.rglob("*")):
            name = path.relative_to(self.folder).as_posix()
            if path.is_file() and name not in named and name != "dataset.yaml":
                path.unlink()


def write_regions(dataset: Dataset, regions: Regions, about: str) -> Dataset:
    """Give a dataset other regions, in one step, and open it anew; nothing else changes.

    `about` says how they were made, and is kept with the conventions. The fingerprint changes: what
    is trained or judged under other regions is something else.
    """
    plain = {
        name: [[float(edge) for edge in box] for box in boxes] for name, boxes in regions.items()
    }
    counts = dict(Counter(frame.run for frame in dataset.frames))
    conventions = {**dataset.info.conventions, "regions": about}
    text = _to_yaml(replace(dataset.info, regions=plain, conventions=conventions), counts)
    try:
        write_text(dataset.root / "dataset.yaml", text)
    except OSError as error:
        raise UserError(
            f"{dataset.root / 'dataset.yaml'} cannot be written ({error.strerror}): its regions "
            "are what they were; free space, or copy the dataset to a folder of your own"
        ) from error
    return open_dataset(dataset.root)


_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


def _cannot_write(folder: Path, error: OSError) -> UserError:
    return UserError(
        f"{folder} cannot be written ({error.strerror}): free space or choose another folder, then "
        f"repeat the command; whole frames are kept"
    )


_LONGEST_NAME_BYTES = 200  # file systems take 255
_RESERVED = ("dataset.yaml", SKIPPED_FILE)


def check_run_name(run: str) -> None:
    """UserError where a run's name cannot name a folder of its own."""
    if (
        not run.isprintable()  # which lone surrogates are not either
        or not 0 < len(run.encode()) <= _LONGEST_NAME_BYTES
        or run.startswith(".")
        or Path(run).name != run
        or "\\" in run
        or run.casefold() in _RESERVED
    ):
        raise UserError(
            f"run name {run!r} cannot name a folder: use letters, digits, - and _, at most "
            f"{_LONGEST_NAME_BYTES} bytes"
        )


def _to_yaml(info: DatasetInfo, counts: dict[str, int] | None = None) -> str:
    values: dict[str, object] = {"schema_version": SCHEMA_VERSION, **asdict(info)}
    if counts is not None:
        values["runs"] = counts
    return yaml.safe_dump(values, sort_keys=False, allow_unicode=True)


def _to_table(frames: Sequence[Frame]) -> pa.Table:

    def column(poses: Iterable[Float[np.ndarray, "4 4"] | None]) -> list[list[float] | None]:
        return [None if T is None else T.ravel().tolist() for T in poses]

    table = pa.table(
        {
            "timestamp_us": [f.timestamp_us for f in frames],
            **{axis: [f.position_m[i] for f in frames] for i, axis in enumerate("xyz")},
            "T_world_body": column(f.T_world_body for f in frames),
            "T_world_ins": column(f.T_world_ins for f in frames),
            "image": [f.image for f in frames],
            "cloud": [f.cloud for f in frames],
            "zone": [f.zone for f in frames],
            "image_time_us": [f.image_time_us for f in frames],
            "cloud_time_us": [f.cloud_time_us for f in frames],
        },
        schema=SCHEMA,
    )
    # tables without these times stay what they were before there was a place for them
    unused = [n for n in ("image_time_us", "cloud_time_us") if table[n].null_count == len(table)]
    return table.drop_columns(unused)
