# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""How much of a bag may come into memory at once, whatever its bytes claim.

rosbags reads as much as a length says, and unpacks as much as there is: a file of a few kilobytes
may hold gigabytes. Here a read, a chunk and a message end at `MOST_BYTES`.
"""

from __future__ import annotations

import bz2
import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

MOST_BYTES = 2**28  # recorders close a chunk at a few megabytes, and a message is no larger
MOST_TIMES = 100  # nothing that a sensor measured packs so well: for whole files, on disk


@cache
def bound_unpacking() -> None:
    """Have rosbags unpack no more than `MOST_BYTES` at a time; for all of the process."""
    bag1: Any = import_module("rosbags.rosbag1.reader")
    mcap: Any = import_module("rosbags.rosbag2.storage_mcap")
    bag2: Any = import_module("rosbags.rosbag2.reader")
    zstd, lz4 = bag2.zstd, import_module("lz4.frame")
    unpack_zstd = partial(unpack, zstd.ZstdDecompressor)
    unpack_lz4 = partial(unpack, lz4.LZ4FrameDecompressor)
    bag1.decompressors.update(bz2=partial(unpack, bz2.BZ2Decompressor), lz4=unpack_lz4)
    mcap.DECOMPRESSORS.update(zstd=unpack_zstd, lz4=unpack_lz4)
    bag2.zstd = SimpleNamespace(decompress=unpack_zstd, open=partial(_opened, zstd.open))


def unpack(decompressor: Callable[[], Any], data: bytes, claim: int | None = None) -> bytes:
    """What `data` was packed from, `claim` bytes at most; ValueError as soon as there is more."""
    most = MOST_BYTES if claim is None else claim
    if most > MOST_BYTES:
        raise ValueError(f"a chunk claims {most} bytes, more than {MOST_BYTES}")
    out = b""
    while data:  # one frame after another
        one = decompressor()
        out += one.decompress(data, most + 1 - len(out))
        if len(out) > most:
            raise ValueError(f"a chunk unpacks to more than {most} bytes")
        if not one.eof:
            raise ValueError("a chunk is cut")
        data = one.unused_data
    return out


class CappedPath(type(Path())):  # type: ignore[misc]  # of the system's own class, before 3.12
    """A path whose file hands out no more than `MOST_BYTES` at a time."""

    def open(self, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
        """As `Path.open`."""
        if mode != "rb":
            return super().open(mode, *args, **kwargs)
        return _CappedFile(io.FileIO(self))


class _CappedFile(io.BufferedReader):
    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > MOST_BYTES:
            raise ValueError(f"a record claims {size} bytes, more than {MOST_BYTES}")
        return super().read(size)

    def readline(self, size: int | None = -1, /) -> bytes:
        return super().readline(MOST_BYTES if size is None or size < 0 else size)


@contextmanager
def _opened(open_zstd: Callable[..., Any], file: BinaryIO, mode: str) -> Iterator[_Counted]:
    """A packed file as it was."""
    size = os.fstat(file.fileno()).st_size
    with open_zstd(file, mode) as inside:
        yield _Counted(inside, max(MOST_BYTES, MOST_TIMES * size))


class _Counted:
    """A file that is no longer than `most` bytes; ValueError as soon as it is."""

    def __init__(self, file: BinaryIO, most: int) -> None:
        self._file, self._most, self._left = file, most, most

    def read(self, size: int) -> bytes:
        data = self._file.read(size)
        self._left -= len(data)
        if self._left < 0:
            raise ValueError(f"a packed file holds more than {self._most} bytes")
        return data
