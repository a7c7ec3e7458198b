# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Preprocessed frames on disk: decode and voxelise once, read in a fraction of a millisecond.

    <cache_dir>/<fingerprint>/index.json    what this is, and how many frames are done
    <cache_dir>/<fingerprint>/images.npy    (N, h, w, 3) uint8, resized
    <cache_dir>/<fingerprint>/lidar.npy     (N, ...) what `Preprocess.store_lidar` keeps
    <cache_dir>/<fingerprint>/rows.npy      (N,) which sensors a frame has, and checksums

A frame takes 391 kB at 300 x 400 and 72 x 72 x 48 binary cells. The fingerprint is that of the
dataset and the settings, so a change of either builds a new cache beside the old one, which may be
deleted at any time.
"""

from __future__ import annotations

import io
import json
import logging
import math
import os
import shutil
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, Protocol, runtime_checkable

import numpy as np
import torch
from filelock import FileLock
from jaxtyping import Bool, Float, Float32, Int, Shaped, UInt8
from torch import Tensor

from adafusion.config import to_plain
from adafusion.files import fingerprint, write_json
from adafusion.preprocess import Preprocess
from adafusion.preprocess.image import from_unit, resize, to_unit
from adafusion.types import Frame, Observation, Progress, UserError, silent

log = logging.getLogger(__name__)

CACHE_VERSION = 2
CHECKPOINT = 128  # frames between two flushes: what a killed build loses at most

_ROW = np.dtype(
    [("has_image", "?"), ("has_cloud", "?"), ("images_crc", "<u4"), ("lidar_crc", "<u4")]
)


@runtime_checkable
class FrameSource(Protocol):
    """What a cache needs of a dataset; `adafusion.datasets.native.Dataset` is one."""

    @property
    def root(self) -> Path:
        """Its folder, for messages."""
        ...

    @property
    def frames(self) -> Sequence[Frame]:
        """All frames, in the order of the rows."""
        ...

    @property
    def fingerprint(self) -> str:
        """Changes whenever what `load` gives may change."""
        ...

    def load(self, frame: Frame, /) -> Observation:
        """Read what the sensors saw at one of `frames`."""
        ...


@dataclass(frozen=True, eq=False)
class PreparedFrames:
    """The frames of one dataset, preprocessed, as memory maps; `rows` index `frames`.

    A sensor that a frame lacks reads as zeros, with `has_image` or `has_cloud` False there. Each
    row is checked against its checksum when it is first read: UserError where the disk lost it.
    """

    folder: Path
    frames: tuple[Frame, ...]
    settings: Preprocess
    _arrays: dict[str, Shaped[np.ndarray, "n ..."]] = field(repr=False)
    _rows: Shaped[np.ndarray, " n"] = field(repr=False)
    _checked: dict[str, Bool[np.ndarray, " n"]] = field(repr=False)

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def has_image(self) -> Bool[np.ndarray, " n"]:
        """Which frames have an image."""
        return self._rows["has_image"]

    @property
    def has_cloud(self) -> Bool[np.ndarray, " n"]:
        """Which frames have a point cloud."""
        return self._rows["has_cloud"]

    def images_u8(self, rows: Int[np.ndarray, " b"]) -> UInt8[Tensor, "b h w 3"]:
        """Resized RGB images; a missing one is black."""
        return torch.from_numpy(self._read("images", rows))

    def lidar(self, rows: Int[np.ndarray, " b"]) -> Float32[Tensor, "b ..."]:
        """LiDAR tensors as `Preprocess.lidar_tensor` gives them; those of no cloud are empty."""
        return self.settings.load_lidar(self._read("lidar", rows))

    def tensors(
        self, rows: Int[np.ndarray, " b"]
    ) -> tuple[Float32[Tensor, "b 3 h w"], Float32[Tensor, "b ..."]]:
        """What the network eats, to the bit as `settings` makes it from the raw frames."""
        return from_unit(to_unit(self.images_u8(rows)), self.settings.image), self.lidar(rows)

    def _read(self, name: str, rows: Int[np.ndarray, " b"]) -> Shaped[np.ndarray, "b ..."]:
        values = self._arrays[name][rows]
        checked = self._checked[name]
        for row, value in zip(rows, values, strict=True):
            if not checked[row]:
                if _crc(value) != self._rows[f"{name}_crc"][row]:
                    raise _damaged(self.folder / f"{name}.npy", f"frame {self.frames[row].key}")
                checked[row] = True
        return values


@dataclass(frozen=True, eq=False)
class PreparedSet:
    """Several prepared datasets as one, for training over several worlds.

    Rows run through all frames of the first part, then of the second, and so on.
    """

    parts: tuple[PreparedFrames, ...]

    def __post_init__(self) -> None:
        if not self.parts:
            raise ValueError("a prepared set needs at least one dataset")
        if len({part.settings for part in self.parts}) > 1:
            raise ValueError("all datasets of a prepared set must share one preprocessing")

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def settings(self) -> Preprocess:
        """The preprocessing that all parts share."""
        return self.parts[0].settings

    @cached_property
    def frames(self) -> tuple[Frame, ...]:
        """Frames of all parts."""
        return tuple(frame for part in self.parts for frame in part.frames)

    @cached_property
    def positions(self) -> Float[np.ndarray, "n 2"]:
        """Where each row is, x and y in metres, each world in its own frame."""
        return np.array([frame.position_m[:2] for frame in self.frames], dtype=np.float64)

    @cached_property
    def worlds(self) -> Int[np.ndarray, " n"]:
        """Which part each row belongs to: positions compare within one world only."""
        return np.repeat(np.arange(len(self.parts)), [len(part) for part in self.parts])

    @cached_property
    def runs(self) -> Int[np.ndarray, " n"]:
        """Which run each row belongs to, numbered through all worlds."""
        number: dict[tuple[int, str], int] = {}
        return np.array(
            [
                number.setdefault((int(world), frame.run), len(number))
                for world, frame in zip(self.worlds, self.frames, strict=True)
            ]
        )

    @cached_property
    def has_image(self) -> Bool[np.ndarray, " n"]:
        """Which rows have an image."""
        return np.concatenate([part.has_image for part in self.parts])

    @cached_property
    def has_cloud(self) -> Bool[np.ndarray, " n"]:
        """Which rows have a point cloud."""
        return np.concatenate([part.has_cloud for part in self.parts])

    def images_u8(self, rows: Int[np.ndarray, " b"]) -> UInt8[Tensor, "b h w 3"]:
        """As `PreparedFrames.images_u8`."""
        return self._gather(PreparedFrames.images_u8, rows)

    def lidar(self, rows: Int[np.ndarray, " b"]) -> Float32[Tensor, "b ..."]:
        """As `PreparedFrames.lidar`."""
        return self._gather(PreparedFrames.lidar, rows)

    def tensors(
        self, rows: Int[np.ndarray, " b"]
    ) -> tuple[Float32[Tensor, "b 3 h w"], Float32[Tensor, "b ..."]]:
        """As `PreparedFrames.tensors`."""
        return from_unit(to_unit(self.images_u8(rows)), self.settings.image), self.lidar(rows)

    def _gather(
        self,
        read: Callable[[PreparedFrames, Int[np.ndarray, " b"]], Tensor],
        rows: Int[np.ndarray, " b"],
    ) -> Tensor:
        """Read each row from its part and put them back in the order asked for."""
        rows = np.arange(len(self))[rows]  # negative rows count from the end, as elsewhere
        worlds = self.worlds[rows]
        local = rows - np.searchsorted(self.worlds, worlds)
        present = np.unique(worlds)
        if len(present) < 2:  # the usual case needs no second copy
            return read(self.parts[int(present[0]) if len(present) else 0], local)
        pieces = [read(self.parts[world], local[worlds == world]) for world in present]
        return torch.cat(pieces)[torch.from_numpy(np.argsort(np.argsort(worlds, kind="stable")))]


def prepare_cache(
    dataset: FrameSource,
    settings: Preprocess,
    cache_dir: str | Path,
    *,
    progress: Progress = silent,
    workers: int = 2,
) -> PreparedFrames:
    """Open the cache of `dataset` under `settings`; build it first, or its rest, where it is not.

    Building streams: memory holds a few frames a worker. It may be killed at any time; the next
    call goes on from the last checkpoint. Two processes that need the same cache take turns.
    `workers` are threads, as decoding, resizing and voxelising leave the interpreter free.

    A cache follows `dataset.fingerprint`: it does not notice what that does not, such as a raw file
    overwritten by another of the same size.

    Raises UserError for a frame that cannot be read, a full disk, or a damaged cache.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, not {workers}")
    if not dataset.frames:
        raise UserError(f"{dataset.root} has no frames to prepare: record or simulate some")
    key = fingerprint(f"cache {CACHE_VERSION}", dataset.fingerprint, settings.fingerprint)
    folder = Path(cache_dir) / key
    if _read_index(folder)[0] < len(dataset.frames):
        folder.mkdir(parents=True, exist_ok=True)
        with FileLock(folder / "lock"):  # let go by the system when its process dies
            _build(dataset, settings, folder, progress, workers)
    return _open(folder, tuple(dataset.frames), settings)


# --------------------------------------------------------------------------------------- building


def _build(
    dataset: FrameSource, settings: Preprocess, folder: Path, progress: Progress, workers: int
) -> None:
    done, rows_crc = _read_index(folder)  # again: another process may have built it meanwhile
    n = len(dataset.frames)
    if done == n:
        return
    layout = _layout(n, settings)
    row_bytes = sum(_row_bytes(shape, dtype) for shape, dtype in layout.values())
    needed, free = (n - done) * row_bytes, shutil.disk_usage(folder).free
    if needed > free:
        raise UserError(
            f"{folder} needs {needed / 1e9:.1f} GB and its disk has {free / 1e9:.1f} GB left: "
            "make room or choose another cache folder"
        )
    if done:
        log.info("%s: going on after %d of %d frames", folder, done, n)

    def prepare(frame: Frame) -> dict[str, bytes]:
        return _prepare(dataset.load(frame), settings, layout)

    with ExitStack() as stack:
        # appended, not memory-mapped: a full disk is then an error and no crash
        files = {
            name: stack.enter_context(_open_growing(folder / f"{name}.npy", shape, dtype, done))
            for name, (shape, dtype) in layout.items()
        }
        pool = stack.enter_context(ThreadPoolExecutor(workers))
        rows = _in_order(pool, prepare, dataset.frames[done:], ahead=2 * workers)
        for row in progress(rows, total=n - done, desc=f"preparing {dataset.root.resolve().name}"):
            for name, file in files.items():
                file.write(row[name])
            rows_crc = zlib.crc32(row["rows"], rows_crc)
            done += 1
            if done % CHECKPOINT == 0 or done == n:
                for file in files.values():
                    file.flush()
                    os.fsync(file.fileno())
                # only now: the index must never promise more than the disk holds
                _write_index(folder, dataset, settings, done, rows_crc)


def _prepare(
    seen: Observation,
    settings: Preprocess,
    layout: dict[str, tuple[tuple[int, ...], np.dtype[Any]]],
) -> dict[str, bytes]:
    """The bytes of one frame's row in each file."""
    values = {name: np.zeros(shape[1:], dtype) for name, (shape, dtype) in layout.items()}
    if seen.image is not None:
        values["images"] = resize(seen.image, settings.image)
    if seen.points_body is not None:
        values["lidar"] = settings.store_lidar(seen.points_body)
    row = values["rows"]
    row["has_image"], row["has_cloud"] = seen.image is not None, seen.points_body is not None
    row["images_crc"], row["lidar_crc"] = _crc(values["images"]), _crc(values["lidar"])
    return {name: value.tobytes() for name, value in values.items()}


def _in_order(
    pool: ThreadPoolExecutor,
    work: Callable[[Frame], dict[str, bytes]],
    frames: Sequence[Frame],
    ahead: int,
) -> Iterator[dict[str, bytes]]:
    """`pool.map`, but never more than `ahead` results wait in memory."""
    waiting: deque[Future[dict[str, bytes]]] = deque()
    try:
        for frame in frames:
            waiting.append(pool.submit(work, frame))
            if len(waiting) > ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()


def _layout(n: int, settings: Preprocess) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
    """Shape and dtype of each file's array."""
    lidar_shape, lidar_dtype = settings.stored_lidar
    return {
        "images": ((n, *settings.image.size, 3), np.dtype(np.uint8)),
        "lidar": ((n, *lidar_shape), lidar_dtype),
        "rows": ((n,), _ROW),
    }


def _row_bytes(shape: tuple[int, ...], dtype: np.dtype[Any]) -> int:
    return math.prod(shape[1:]) * dtype.itemsize


@contextmanager
def _open_growing(
    path: Path, shape: tuple[int, ...], dtype: np.dtype[Any], done: int
) -> Iterator[BinaryIO]:
    """An .npy file to append rows to; its header counts all rows from the start.

    Whatever lies beyond the first `done` rows is cut off: nobody vouches for it.
    """
    buffer = io.BytesIO()
    descr = np.lib.format.dtype_to_descr(dtype)
    np.lib.format.write_array_header_1_0(
        buffer, {"descr": descr, "fortran_order": False, "shape": shape}
    )
    header = buffer.getvalue()
    size = len(header) + done * _row_bytes(shape, dtype)
    if done == 0:
        path.write_bytes(header)
    elif not path.is_file() or path.stat().st_size < size:
        raise _damaged(path, f"shorter than its {done} frames")
    with path.open("r+b") as file:
        if file.read(len(header)) != header:
            raise _damaged(path, "another header than this version writes")
        file.truncate(size)
        file.seek(size)
        yield file


# ---------------------------------------------------------------------------------------- opening


def _open(folder: Path, frames: tuple[Frame, ...], settings: Preprocess) -> PreparedFrames:
    n = len(frames)
    arrays: dict[str, np.ndarray] = {}
    for name, (shape, dtype) in _layout(n, settings).items():
        path = folder / f"{name}.npy"
        try:
            array = np.load(path, mmap_mode="r")
        except (OSError, ValueError, EOFError) as error:
            raise _damaged(path, str(error)) from error
        if array.shape != shape or array.dtype != dtype:
            raise _damaged(path, f"{array.dtype} {array.shape} instead of {dtype} {shape}")
        arrays[name] = np.asarray(array)
    rows = arrays.pop("rows")
    if (n, _crc(rows)) != _read_index(folder):
        raise _damaged(folder / "rows.npy", "wrong checksum")
    checked = {name: np.zeros(n, np.bool_) for name in arrays}
    return PreparedFrames(folder, frames, settings, arrays, rows, checked)


def _read_index(folder: Path) -> tuple[int, int]:
    """How many frames are on disk, and the checksum of their `rows`; (0, 0) before the first."""
    path = folder / "index.json"
    try:
        index = json.loads(path.read_text(encoding="utf-8"))
        return int(index["done"]), int(index["rows_crc"])
    except FileNotFoundError:
        return 0, 0
    except (ValueError, KeyError, TypeError) as error:
        raise _damaged(path, f"no index: {error!r}") from error


def _write_index(
    folder: Path, dataset: FrameSource, settings: Preprocess, done: int, rows_crc: int
) -> None:
    write_json(
        folder / "index.json",
        {
            "dataset": str(dataset.root),
            "dataset_fingerprint": dataset.fingerprint,
            "preprocess": to_plain(settings),
            "frames": len(dataset.frames),
            "done": done,
            "rows_crc": rows_crc,
        },
    )


def _crc(array: np.ndarray) -> int:
    return zlib.crc32(array.data)


def _damaged(path: Path, what: str) -> UserError:
    return UserError(f"{path} is damaged ({what}): delete {path.parent}, it will be built again")
