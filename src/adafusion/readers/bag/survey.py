# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a bag says of itself before any image or cloud is decoded: topics, frames, poses, lenses.

Topics are those given, or the one there is of its kind. Poses come from odometry or stamped poses
where there is one such topic, else from /tf, else from a GPS receiver. The stamps in the headers
count, not the times of recording, which lag behind.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
from jaxtyping import Float64, Int64

from adafusion.readers.bag.files import Bag, Topic, as_table, messages, topics_of
from adafusion.readers.bag.frames import FrameTree, PoseLog
from adafusion.readers.bag.messages import (
    CAMERA_INFO,
    CLOUD,
    COMPRESSED,
    FIX,
    IMAGE,
    POSES,
    TRANSFORMS,
    Damaged,
    Header,
    Message,
    decode_camera_info,
    decode_fix,
    decode_pose,
    decode_transforms,
    header,
)
from adafusion.readers.calibration import Calibration
from adafusion.types import UserError

NUM_LAGS = 9  # messages whose middle says how a sensor's clock differs from the recorder's


@dataclass(frozen=True, slots=True)
class Topics:
    """Which topics of a bag are read; None for what there is not."""

    image: str | None
    cloud: str | None
    pose: Topic | None
    camera_info: str | None
    transforms: tuple[Topic, ...]
    num_frames: int  # messages of the cloud, or of the image where there is no cloud


@dataclass(eq=False)
class Survey:
    """What the first pass over a bag gathers: tables of times and poses, nothing large."""

    bag: Bag
    topics: Topics
    image_frame: str = ""
    cloud_frame: str = ""
    # by topic of a sensor: how late its first messages were recorded, by its own clock
    lags_us: dict[str, list[int]] = field(default_factory=dict)
    tree: FrameTree = field(default_factory=FrameTree)
    poses: PoseLog = field(default_factory=PoseLog)
    pose_frame: str = ""  # whose poses they are, "" where the topic does not say
    world_frame: str = ""
    calibration: Calibration = field(default_factory=Calibration)
    size: tuple[int, int] | None = None  # (width, height) of the images it is of
    notes: list[str] = field(default_factory=list)
    fault: str = ""  # where the bag breaks off, "" where it is whole
    fix_times: array[int] = field(default_factory=lambda: array("q"))
    fix_places: array[float] = field(default_factory=lambda: array("d"))

    def fixes(self) -> tuple[Int64[np.ndarray, " n"], Float64[np.ndarray, "n 3"]]:
        """Times and places (latitude, longitude, height) of a GPS receiver, by rising time."""
        times, rows = np.unique(np.array(self.fix_times, dtype=np.int64), return_index=True)
        return times, np.array(self.fix_places).reshape(-1, 3)[rows]


def choose_topics(
    bag: Bag,
    image_topic: str | None,
    cloud_topic: str | None,
    pose_topic: str | None,
    poses_elsewhere: bool,
) -> Topics:
    """The topics to read; UserError lists all where it takes a person to choose."""
    topics = topics_of(bag)

    def choose(option: str, given: str | None, kinds: Collection[str]) -> Topic | None:
        fits = [one for one in topics if one.kind in kinds]
        if given is not None:
            for one in fits:
                if one.name.lstrip("/") == given.lstrip("/"):
                    return one
            what = " or ".join(kind.replace("/msg/", "/") for kind in kinds)
            raise UserError(
                f"{bag.run} has no {given} of {what}; its topics:\n{as_table(topics)}\n"
                f"give another {option}"
            )
        fits = [one for one in fits if _is_of_interest(one, fits)]
        if len(fits) > 1:
            raise UserError(
                f"{bag.run} has several topics that could be meant:\n{as_table(fits)}\n"
                f"choose with {option}"
            )
        return fits[0] if fits else None

    image = choose("--image-topic", image_topic, (IMAGE, COMPRESSED))
    cloud = choose("--cloud-topic", cloud_topic, (CLOUD,))
    if image is None and cloud is None:
        raise UserError(
            f"{bag.run} has neither images nor clouds; its topics:\n{as_table(topics)}\n"
            "give a bag with sensor_msgs/Image, CompressedImage or PointCloud2"
        )
    pose = None
    if pose_topic is not None:
        pose = choose("--pose-topic", pose_topic, (*POSES, FIX, *TRANSFORMS))
    elif not poses_elsewhere:
        pose = choose("--pose-topic", None, POSES)
        moving = [one for one in topics if one.kind in TRANSFORMS and not _is_static(one.name)]
        if pose is None and not moving:
            pose = choose("--pose-topic", None, (FIX,))
    return Topics(
        image=image.name if image else None,
        cloud=cloud.name if cloud else None,
        pose=pose,
        camera_info=_camera_info(topics, image.name) if image else None,
        transforms=tuple(one for one in topics if one.kind in TRANSFORMS),
        num_frames=(cloud or image or topics[0]).count,
    )


def survey(bag: Bag, topics: Topics) -> Survey:
    """Read everything but images and clouds, and of these the first headers.

    Where the bag breaks off, what came before counts: the fault is for the second pass to raise.
    Single messages that are damaged are left out. Damaged where no image or no cloud can be read.
    """
    seen = Survey(bag, topics)
    seen.image_frame, seen.cloud_frame = (
        _meet(seen, topic) if topic else "" for topic in (topics.image, topics.cloud)
    )
    small = {one.name for one in topics.transforms}
    small |= {topics.pose.name} if topics.pose else set()
    small |= {topics.camera_info} if topics.camera_info else set()
    damaged = 0
    try:
        for message in messages(bag, small):
            try:
                _take(seen, message)
            except Damaged:
                damaged += 1
    except Damaged as error:
        seen.fault = str(error)
    if damaged:
        seen.notes.append(f"{bag.run}: {damaged} poses or transforms are damaged: left out")
    if seen.poses.refused:
        seen.notes.append(
            f"{bag.run}: {seen.poses.refused} poses are not finite or have no direction: left out"
        )
    return seen


def is_rectified(topic: str) -> bool:
    """Whether a name says that the images are rectified, as /camera/image_rect_color does."""
    return re.search(r"(?:^|[/_])rect(?:[/_]|ified|$)", topic) is not None


def _meet(seen: Survey, topic: str) -> str:
    """Enter the lags of a sensor's first messages; the frame of the first, as a sensor has one."""
    first: list[tuple[Header, int]] = []
    try:
        for message in islice(messages(seen.bag, [topic]), NUM_LAGS):
            with suppress(Damaged):
                first.append((header(message), message.received_ns // 1000))
    except Damaged:
        if not first:
            raise
    seen.lags_us[topic] = [at - head.stamp_us for head, at in first if head.stamp_us]
    return first[0][0].frame if first else ""


def _take(seen: Survey, message: Message) -> None:
    """Enter a message of any of the small kinds."""
    recorded_us = message.received_ns // 1000
    if message.kind in TRANSFORMS:
        static = _is_static(message.topic)
        for one in decode_transforms(message):
            seen.tree.add(one._replace(stamp_us=one.stamp_us or recorded_us), static)
    elif message.kind in POSES:
        one = decode_pose(message)
        seen.world_frame, seen.pose_frame = one.parent, one.child
        seen.poses.add(one._replace(stamp_us=one.stamp_us or recorded_us))
    elif message.kind == FIX:
        if (place := decode_fix(message)) is not None:
            seen.fix_times.append(header(message).stamp_us or recorded_us)
            seen.fix_places.extend(place)
    elif seen.size is None and seen.topics.image is not None:  # the first camera info
        info = decode_camera_info(message, is_rectified(seen.topics.image))
        seen.calibration, seen.size = info.calibration, info.size
        if info.note:
            seen.notes.append(f"{seen.bag.run}: {info.note}")


def _is_static(topic: str) -> bool:
    return topic.endswith("_static")


def _is_of_interest(topic: Topic, others: list[Topic]) -> bool:
    """Whether a topic of the right type is one that a person would choose."""
    plain = topic.name.removesuffix("/compressed")
    copy = plain != topic.name and any(one.name == plain for one in others)
    return not copy and re.search(r"(?:^|[/_])(?:depth|compressedDepth)", topic.name) is None


def _camera_info(topics: list[Topic], image: str) -> str | None:
    """The camera info beside an image's topic, as image_transport names it."""
    infos = [one.name for one in topics if one.kind == CAMERA_INFO]
    parts = image.removesuffix("/compressed").split("/")
    # /camera/image_raw and /camera/left/image_rect/... lie beside a camera_info some levels up
    for depth in range(len(parts) - 1, 0, -1):
        if (name := "/".join([*parts[:depth], "camera_info"])) in infos:
            return name
    return infos[0] if len(infos) == 1 else None
