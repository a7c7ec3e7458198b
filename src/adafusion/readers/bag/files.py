# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Which recordings of ROS lie in a folder, which topics they have, and their messages in order.

drive.bag                             ROS 1
drive.mcap, drive.db3                 one file of ROS 2
drive/metadata.yaml, drive/*.mcap     ROS 2, with or without its metadata.yaml
drive_0.bag, drive_1.bag, ...         one recording in parts, where the first ends in _0
<folder>/<any of these>               several, each a run
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adafusion.readers.bag.limits import CappedPath, bound_unpacking
from adafusion.readers.bag.messages import NO_ROSBAGS, Damaged, Message, refused
from adafusion.types import UserError

SUFFIXES = (".bag", ".mcap", ".db3")
METADATA = "metadata.yaml"


@dataclass(frozen=True, slots=True)
class Bag:
    """One recording."""

    run: str
    parts: tuple[Path, ...]  # in order of time: files, or the folder of a metadata.yaml


@dataclass(frozen=True, slots=True, order=True)
class Topic:
    """What one name in a bag carries."""

    name: str
    kind: str  # "sensor_msgs/msg/Image"
    count: int


def find_bags(src: Path) -> list[Bag]:
    """All recordings at `src`, by name; none where there is none."""
    if src.is_file():
        return [Bag(src.stem, (src,))] if src.suffix in SUFFIXES else []
    found = _of_folder(src)
    if not _is_bag2(src):
        for folder in sorted(path for path in _visible(src) if path.is_dir()):
            inside = _of_folder(folder)
            # a folder of one recording names it, as ROS 2 does
            found += [Bag(folder.name, inside[0].parts)] if len(inside) == 1 else inside
    runs = [bag.run for bag in found]
    if twice := sorted({run for run in runs if runs.count(run) > 1}):
        raise UserError(f"{src} holds several bags named {', '.join(twice)}: rename them")
    return sorted(found, key=lambda bag: bag.run)


def topics_of(bag: Bag) -> list[Topic]:
    """Topics that have messages, by name."""
    counts: dict[tuple[str, str], int] = {}
    for part in bag.parts:
        with _opened(part) as reader:
            for connection in reader.connections:
                key = str(connection.topic), str(connection.msgtype)
                counts[key] = counts.get(key, 0) + int(connection.msgcount)
    return sorted(Topic(*key, count) for key, count in counts.items() if count > 0)


def as_table(topics: Iterable[Topic]) -> str:
    """One line a topic: name, type, number of messages."""
    rows = [(one.name, one.kind.replace("/msg/", "/"), str(one.count)) for one in topics]
    widths = [max((len(row[i]) for row in rows), default=0) for i in range(3)]
    return "\n".join(
        f"  {name:{widths[0]}}  {kind:{widths[1]}}  {count:>{widths[2]}}"
        for name, kind, count in rows
    )


def messages(bag: Bag, topics: Collection[str]) -> Iterator[Message]:
    """Messages of some topics in the order in which they were recorded, one at a time.

    Damaged where the bag is cut, or counts more messages than it has: what came before was whole.
    """
    for part in bag.parts:
        with _opened(part) as reader:
            wanted = [one for one in reader.connections if one.topic in topics]
            if not wanted:  # the library takes none for all
                continue
            ros1 = part.suffix == ".bag"
            left = sum(int(one.msgcount) for one in wanted)
            for connection, received_ns, raw in reader.messages(wanted):
                if not isinstance(raw, bytes):  # SQLite keeps whatever it was given
                    raise TypeError(f"a message of {connection.topic} is no bytes")
                left -= 1
                yield Message(
                    str(part), connection.topic, connection.msgtype, ros1, received_ns, raw
                )
            if left > 0:  # a chunk was overwritten, and what is there reads as if it were empty
                raise Damaged(
                    f"{part} counts {left} messages more than can be read: {_remedy(part)}"
                )


@contextmanager
def _opened(part: Path) -> Iterator[Any]:
    try:
        from rosbags import rosbag1, rosbag2
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(NO_ROSBAGS) from error
    _refuse_unmerged(part)
    bound_unpacking()
    with refused(part, _remedy(part)):
        path = CappedPath(part)
        reader = rosbag1.Reader(path) if part.suffix == ".bag" else rosbag2.Reader(path)
        with reader:
            yield reader


def _remedy(part: Path) -> str:
    """What brings most of a damaged bag back."""
    if part.suffix == ".bag":
        return f"try `rosbag reindex {part.name}`, or leave it out with --runs"
    if part.suffix == ".mcap":
        return f"try `mcap recover {part.name} -o whole.mcap`, or leave it out with --runs"
    if part.suffix == ".db3":
        return f"try `sqlite3 {part.name} .recover`, or leave it out with --runs"
    return f"try `ros2 bag reindex {part.name}`, or leave it out with --runs"


def _refuse_unmerged(part: Path) -> None:
    """Damaged where SQLite was killed while it recorded, and keeps messages beside its file."""
    for file in part.glob("*.db3") if part.is_dir() else [part]:
        log = file.with_name(f"{file.name}-wal")
        if file.suffix == ".db3" and log.is_file() and log.stat().st_size:
            raise Damaged(
                f"{log} holds messages that {file.name} lacks: merge them with "
                f"`sqlite3 {file.name} 'PRAGMA wal_checkpoint(TRUNCATE)'`"
            )


def _of_folder(folder: Path) -> list[Bag]:
    """Recordings right in a folder."""
    if _is_bag2(folder):
        return [Bag(folder.resolve().name, (folder,))]
    files = {path.name: path for path in _visible(folder) if path.suffix in SUFFIXES}
    bags: dict[str, list[tuple[int, Path]]] = {}
    for _, path in sorted(files.items()):
        match = re.fullmatch(r"(.+)_(\d+)", path.stem)
        # loop_1.bag and loop_2.bag are two drives; parts of one count from 0
        if match and f"{match[1]}_0{path.suffix}" in files:
            bags.setdefault(match[1], []).append((int(match[2]), path))
        else:
            bags.setdefault(path.stem, []).append((0, path))
    return [Bag(run, tuple(path for _, path in sorted(parts))) for run, parts in bags.items()]


def _is_bag2(folder: Path) -> bool:
    """Whether the metadata.yaml of a folder is that of a bag: of the first lines, nothing else."""
    try:
        with (folder / METADATA).open("rb") as file:
            return b"rosbag2_bagfile_information" in file.read(4096)
    except OSError:
        return False


def _visible(folder: Path) -> list[Path]:
    try:
        return [path for path in folder.iterdir() if not path.name.startswith(".")]
    except OSError as error:
        raise UserError(
            f"{folder} cannot be read ({error.strerror}): give a bag, or a folder of bags"
        ) from error
