# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The second pass over a bag: images and clouds joined in time, as they stream by."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from statistics import median_low
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64

from adafusion.datasets.recording import Shot
from adafusion.readers.bag.files import messages
from adafusion.readers.bag.frames import POSE_GAP_US
from adafusion.readers.bag.messages import Damaged, Message, header
from adafusion.readers.bag.place import Placed
from adafusion.readers.bag.sensors import decode_cloud, decode_picture, encoded_suffix
from adafusion.readers.bag.survey import NUM_LAGS
from adafusion.readers.track import Track
from adafusion.types import Frame

_WAIT_NS = 2_000_000_000  # how long a cloud waits for a later image, or an image for its cloud
_MOST_WAITING = 100  # of each sensor, whatever the times of recording: a camera's in two seconds
_WILD_US = 60_000_000  # no recorder lags so much from one message to the next


class _Timed(NamedTuple):
    at_us: int
    message: Message


def stream_shots(run: Placed, every_m: float, slop_ms: float, notes: list[str]) -> Iterator[Shot]:
    """One pass over images and clouds, which holds no more of them than wait for each other.

    Where the bag breaks off, all frames before come first, then Damaged.
    """
    topics = run.seen.topics
    both = topics.cloud is not None and topics.image is not None
    left_out: Counter[str] = Counter()
    kept_m: Float64[np.ndarray, " 3"] | None = None
    times_us: list[int] = []  # the first and the last
    stream = _stamped(run, left_out)
    for first, second in _pairs(stream, topics.cloud or topics.image, both, round(slop_ms * 1000)):
        times_us[1:] = [first.at_us]
        left_out["all"] += 1
        T = _pose_at(run.track, first.at_us)
        if T is None:
            left_out["outside"] += 1
        elif kept_m is not None and np.linalg.norm(T[:3, 3] - kept_m) < every_m:
            continue
        elif both and second is None:
            left_out["alone"] += 1
        else:
            kept_m = T[:3, 3]
            yield _shot(run, T, first, second)
    notes += _describe(run, left_out, times_us, slop_ms)
    if run.seen.fault:
        raise Damaged(run.seen.fault)


def _describe(
    run: Placed, left_out: Counter[str], times_us: list[int], slop_ms: float
) -> Iterator[str]:
    """What a person should know of a run that has streamed by."""
    name, topics = run.seen.bag.run, run.seen.topics
    what, total = ("clouds" if topics.cloud else "images"), left_out["all"]
    if left_out["outside"]:
        sensor, poses = (
            f"{t[0] / 1e6:.1f} to {t[-1] / 1e6:.1f} s" for t in (times_us, run.track.time_us)
        )
        yield (
            f"{name}: {left_out['outside']} of {total} {what} lie outside the poses, or where "
            f"these have a gap of more than {POSE_GAP_US // 10**6} s: left out ({what} from "
            f"{sensor}, poses from {poses}; far apart, their drivers stamp by different clocks)"
        )
    if left_out["alone"]:
        yield (
            f"{name}: {left_out['alone']} of {total} clouds have no image within {slop_ms:g} ms: "
            "left out"
        )
    if left_out["unstamped"]:
        yield f"{name}: {left_out['unstamped']} messages have no stamp: recording times are used"
    if left_out["wild"]:
        yield (
            f"{name}: {left_out['wild']} messages have a stamp that is off by more than "
            f"{_WILD_US // 10**6} s, going by when those around them were recorded: left out"
        )
    if left_out["damaged"]:
        yield f"{name}: {left_out['damaged']} messages are damaged: left out"
    if left_out["back"]:
        yield f"{name}: {left_out['back']} messages go back in time: left out"
    if topics.cloud is None or topics.image is None:
        yield f"{name}: there are {what} alone, the other sensor has no topic"


def _stamped(run: Placed, left_out: Counter[str]) -> Iterator[_Timed]:
    """Images and clouds as they were recorded, by rising time of each, as far as the bag goes."""
    topics = [name for name in (run.seen.topics.image, run.seen.topics.cloud) if name]
    lags_us = {name: deque(run.seen.lags_us[name], NUM_LAGS) for name in topics}
    latest: dict[str, int] = {}
    try:
        for message in messages(run.seen.bag, topics):
            try:
                stamp_us = header(message).stamp_us
            except Damaged:
                left_out["damaged"] += 1
                continue
            received_us = message.received_ns // 1000
            left_out["unstamped"] += stamp_us == 0
            at_us = stamp_us or received_us
            if stamp_us and _is_wild(received_us - stamp_us, lags_us[message.topic]):
                left_out["wild"] += 1
                continue
            if at_us <= latest.get(message.topic, -1):
                left_out["back"] += 1
                continue
            latest[message.topic] = at_us
            yield _Timed(at_us, message)
    except Damaged as error:
        run.seen.fault = str(error)


def _is_wild(lag_us: int, recent_us: deque[int]) -> bool:
    """Whether a stamp is no time of its clock, by how late the last messages were recorded.

    The lag is entered among them: where a clock is set anew, the middle soon follows.
    """
    recent_us.append(lag_us)
    return abs(lag_us - median_low(recent_us)) > _WILD_US


def _pairs(
    stream: Iterator[_Timed], lead: str | None, both: bool, slop_us: int
) -> Iterator[tuple[_Timed, _Timed | None]]:
    """Every message of the topic `lead` with the nearest in time of the other, if it is near.

    Sensors arrive late by different times: a message waits until the other sensor has passed it,
    or until two seconds have gone by, or too many wait.
    """
    waiting: deque[_Timed] = deque()
    others: deque[_Timed] = deque()
    latest = 0

    def near(first: _Timed) -> _Timed | None:
        best = min(others, key=lambda other: abs(other.at_us - first.at_us), default=None)
        return best if best is not None and abs(best.at_us - first.at_us) <= slop_us else None

    for one in stream:
        if not both:
            yield one, None
            continue
        (waiting if one.message.topic == lead else others).append(one)
        now_ns = one.message.received_ns
        while waiting and (
            (others and others[-1].at_us >= waiting[0].at_us)
            or now_ns - waiting[0].message.received_ns > _WAIT_NS
            or len(waiting) > _MOST_WAITING
        ):
            first = waiting.popleft()
            latest = first.at_us
            yield first, near(first)
        oldest = (waiting[0].at_us if waiting else latest) - slop_us
        while others and (
            others[0].at_us < oldest
            or now_ns - others[0].message.received_ns > _WAIT_NS
            or len(others) > _MOST_WAITING
        ):
            others.popleft()
    for first in waiting:
        yield first, near(first)


def _pose_at(track: Track, at_us: int) -> Float64[np.ndarray, "4 4"] | None:
    """The pose at a time; None where the poses do not reach."""
    after = int(np.searchsorted(track.time_us, at_us))
    around = slice(max(after - 1, 0), after + 1)
    times = track.time_us[around]
    part, at = Track(times, track.T_world_body[around]), np.array([at_us])
    if not part.near(at, POSE_GAP_US)[0]:
        return None
    return part.at(at)[0]


def _shot(run: Placed, T: Float[np.ndarray, "4 4"], first: _Timed, second: _Timed | None) -> Shot:
    topics = run.seen.topics
    image, cloud = (second, first) if topics.cloud else (first, None)
    T_body_lidar = run.calibration.T_body_lidar
    apart = second is not None and second.at_us != first.at_us
    x, y, z = T[:3, 3].tolist()
    lens = replace(run.calibration, T_body_camera=None, T_body_lidar=None)
    return Shot(
        frame=Frame(
            run=run.seen.bag.run,
            timestamp_us=first.at_us,
            position_m=(x, y, z),
            T_world_body=T if run.oriented else None,
            image_time_us=second.at_us if second is not None and apart else None,
        ),
        image=partial(decode_picture, image.message, lens, run.size) if image else None,
        cloud=None
        if cloud is None or T_body_lidar is None
        else partial(decode_cloud, cloud.message, T_body_lidar),
        image_suffix=encoded_suffix(image.message, lens) if image else ".png",
    )
