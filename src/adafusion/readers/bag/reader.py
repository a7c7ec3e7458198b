# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 1 (.bag) and ROS 2 (.mcap, .db3, folders), read without ROS; `files` has the layouts.

What is converted:
* Time is that of the headers (of recording where a header has none), nanoseconds cut to
  microseconds. A frame has the time of its cloud, and the image nearest to it.
* Points go from their own frame into the body's by /tf and /tf_static: the body is base_footprint,
  or base_link, taken to lie on the ground. `lidar_height_m` lifts it so that the LiDAR comes to lie
  at that height. Where no transform joins the two, the body lies under the LiDAR, with its axes.
* A pose of another frame (odometry names its child, LiDAR odometry its LiDAR) is moved to the
  body. Its world is the message's or map, world, odom of /tf: z up by REP 103 and 105.
* GPS fixes give positions of the antenna and no direction: UTM in the zone of the first fix, and
  the receiver's height.
* Images become RGB without distortion, under the K of the camera info.

Sources: the message definitions of ROS (`messages`), REP 103 and 105.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from adafusion.datasets.native import DatasetInfo
from adafusion.datasets.recording import Recording, Shot
from adafusion.readers.bag.files import Bag, Topic, as_table, find_bags, topics_of
from adafusion.readers.bag.messages import Damaged
from adafusion.readers.bag.place import Placed, place
from adafusion.readers.bag.stream import stream_shots
from adafusion.readers.bag.survey import Survey, Topics, choose_topics, survey
from adafusion.readers.calibration import Calibration, read_calibration
from adafusion.readers.manifest import mark_synthetic
from adafusion.readers.pose_files import PoseTable, read_poses
from adafusion.readers.track import keyframes
from adafusion.readers.utm import zone_of
from adafusion.types import UserError

A = TypeVar("A")
B = TypeVar("B")


def recognises(src: Path) -> bool:
    """Whether `src` is a bag, or a folder of bags."""
    try:
        return bool(find_bags(src))
    except (UserError, OSError, ValueError):
        return False


def list_topics(src: str | Path) -> list[Topic]:
    """What the bags at `src` hold, all taken together."""
    counts: Counter[tuple[str, str]] = Counter()
    for bag in _bags(Path(src), None):
        counts.update({(one.name, one.kind): one.count for one in topics_of(bag)})
    return sorted(Topic(*key, count) for key, count in counts.items())


def describe_topics(src: str | Path) -> str:
    """The same as a table: name, type, number of messages."""
    return as_table(list_topics(src))


def read(
    src: str | Path,
    *,
    runs: Sequence[str] | None = None,
    every_m: float = 5.0,
    slop_ms: float = 50.0,
    image_topic: str | None = None,
    cloud_topic: str | None = None,
    pose_topic: str | None = None,
    poses: str | Path | None = None,
    calibration: str | Path | None = None,
    lidar_height_m: float | None = None,
) -> Recording:
    """Look through the bags at `src`, each a run, for what is needed before images and clouds.

    A frame is taken every `every_m` metres where a cloud has an image within `slop_ms`, from a
    single stream of messages. `poses`: a trajectory of the vehicle in place of the bag's, as
    `pose_files` reads it; a file for one bag, a folder with <run>.txt or .csv for several.
    `calibration`: a file as `calibration` reads it, in place of what the bag says.

    Of several bags a damaged one loses its own frames alone: the shots raise its fault, and go on
    with the next bag when they are asked for more. A bag that cannot be read at all is told first.
    """
    src = Path(src)
    if not 0 <= slop_ms <= 1000 or not 0 <= every_m < np.inf:
        raise UserError("--slop-ms is within 0 and 1000, --every-m is 0 or more: mend the option")
    given = Calibration() if calibration is None else read_calibration(calibration)
    bags = _bags(src, runs)
    faults: list[Damaged] = []

    def choose(bag: Bag) -> tuple[Bag, Topics]:
        given = image_topic, cloud_topic, pose_topic
        return bag, choose_topics(bag, *given, poses_elsewhere=poses is not None)

    chosen = _whole(choose, bags, faults)
    tables = {} if poses is None else _read_tables(Path(poses), bags)
    notes: list[str] = []
    seen = _whole(lambda one: survey(*one), chosen, faults)
    zone = next((table.zone for table in tables.values()), None) or _zone(seen)
    ready = _whole(
        lambda one: place(one, tables.get(one.bag.run), zone, given, lidar_height_m), seen, faults
    )
    if not ready:
        raise faults[0]
    if len({run.oriented for run in ready}) > 1:
        raise UserError(
            f"{src}: some bags have GPS fixes alone and some poses, of another world: choose bags "
            "of one kind with --runs, or their poses with --pose-topic"
        )
    for run in ready:
        notes += run.seen.notes
    if len(ready) > 1 and zone is None:
        notes.append(
            "poses of all runs are taken to share one world: where each starts at an origin of its "
            "own, as odometry does, prepare the runs one by one (--runs)"
        )
    calibrations = {run.seen.bag.run: run.calibration.as_plain() for run in ready}
    first = next(iter(calibrations.values()))
    same = all(one == first for one in calibrations.values())
    settings = f"a frame every {every_m:g} m, image within {slop_ms:g} ms of the cloud"
    if poses is not None:
        settings += f", poses of {Path(poses).name}"
    info = DatasetInfo(
        name="bag",
        version="1",
        source=f"ROS bags: {'; '.join(_describe(run) for run in ready)}; {settings}",
        licence="not stated in the bag",
        synthetic=False,
        world="" if zone is None else f"UTM zone {zone}",
        calibration=first if same else calibrations,
    )
    return Recording(
        info=mark_synthetic(info, src, same_world=False),
        shots=_Shots(faults, [stream_shots(run, every_m, slop_ms, notes) for run in ready]),
        total=sum(_expected(run, every_m) for run in ready),
        notes=notes,
    )


def _bags(src: Path, runs: Sequence[str] | None) -> list[Bag]:
    bags = {bag.run: bag for bag in find_bags(src)}
    if not bags:
        raise UserError(f"{src} holds no bag: give a .bag, .mcap or .db3, or a folder of them")
    if unknown := sorted(set(runs or ()) - set(bags)):
        raise UserError(f"{src} has no bag {', '.join(unknown)}: choose from {', '.join(bags)}")
    return [bag for run, bag in bags.items() if runs is None or run in runs]


def _read_tables(poses: Path, bags: Sequence[Bag]) -> dict[str, PoseTable]:
    """The trajectory of every run, all in the zone of the first if they are of latitudes."""
    if not poses.is_dir() and len(bags) > 1:
        raise UserError(
            f"{poses} is one file for {len(bags)} bags: give a folder with <run>.txt or .csv for "
            "each, or choose one bag with --runs"
        )
    tables: dict[str, PoseTable] = {}
    for bag in bags:
        table = poses / f"{bag.run}.csv"
        path = (
            poses if not poses.is_dir() else table if table.is_file() else table.with_suffix(".txt")
        )
        zone = next((known.zone for known in tables.values()), None)
        tables[bag.run] = read_poses(path, zone)
        if tables[bag.run].time_us is None:
            raise UserError(f"{path} has no times: give rows of `t tx ty tz qx qy qz qw`")
    return tables


def _zone(seen: Sequence[Survey]) -> str | None:
    """The UTM zone of the first fix of all."""
    for one in seen:
        _, places = one.fixes()
        if len(places):
            try:
                return zone_of(*places[0, :2].tolist())
            except ValueError as error:
                raise UserError(f"{one.bag.run}: {error}: give poses with --poses") from error
    return None


def _expected(run: Placed, every_m: float) -> int:
    """About how many frames there will be."""
    count = run.seen.topics.num_frames
    stride = max(1, len(run.track.time_us) // max(count, 1))
    positions = run.track.T_world_body[::stride, :3, 3]
    return min(count, len(keyframes(positions, every_m))) if every_m > 0 else count


def _describe(run: Placed) -> str:
    topics, distortion = run.seen.topics, run.calibration.distortion
    model = "fisheye " if run.calibration.fisheye else ""
    lens = f" ({model}distortion {list(distortion)} undone)" if run.calibration.bends else ""
    parts = [
        f"images of {topics.image}{lens}" if topics.image else "",
        f"clouds of {topics.cloud}" if topics.cloud else "",
        f"poses of {run.poses_from}",
    ]
    return f"{run.seen.bag.run} ({', '.join(part for part in parts if part)})"


def _whole(step: Callable[[A], B], items: Iterable[A], faults: list[Damaged]) -> list[B]:
    """What a step makes of every item that is not damaged; of the others the faults."""
    made = []
    for item in items:
        try:
            made.append(step(item))
        except Damaged as fault:
            faults.append(fault)
    return made


class _Shots:
    """Shots of one bag after the other; a bag that has raised a fault has come to its end."""

    def __init__(self, faults: Iterable[Damaged], runs: Iterable[Iterator[Shot]]) -> None:
        self._faults, self._runs = deque(faults), deque(runs)

    def __iter__(self) -> Iterator[Shot]:
        return self

    def __next__(self) -> Shot:
        if self._faults:
            raise self._faults.popleft()
        while self._runs:
            if (shot := next(self._runs[0], None)) is not None:
                return shot
            self._runs.popleft()
        raise StopIteration
