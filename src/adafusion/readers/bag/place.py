# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where a robot was and where its sensors sit, from what the first pass over its bag gathered."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from adafusion.geometry import invert, pose
from adafusion.readers.bag.files import as_table, topics_of
from adafusion.readers.bag.messages import FIX, POSES, Damaged
from adafusion.readers.bag.survey import Survey
from adafusion.readers.calibration import Calibration
from adafusion.readers.pose_files import PoseTable
from adafusion.readers.track import Track
from adafusion.readers.utm import to_utm
from adafusion.types import UserError

BASES = ("base_footprint", "base_link")  # in this order
WORLDS = ("map", "world", "odom")


@dataclass(frozen=True, eq=False)
class Placed:
    """One bag whose poses and extrinsics are known: ready to be streamed."""

    seen: Survey
    track: Track  # of the body
    oriented: bool  # else the track's positions alone mean something
    calibration: Calibration
    size: tuple[int, int] | None  # (width, height) of the images that K is of, where it is known
    poses_from: str  # what gave them, and in which world frame


@dataclass(frozen=True, eq=False)
class _Body:
    """The body frame, and what of the tree is joined to it."""

    base: str | None  # the vehicle's frame in the tree
    T_body_base: Float64[np.ndarray, "4 4"]  # a lift, and nothing else
    T_body_lidar: Float64[np.ndarray, "4 4"] | None


def place(
    seen: Survey,
    trajectory: PoseTable | None,
    zone: str | None,
    given: Calibration,
    lidar_height_m: float | None,
) -> Placed:
    """Join poses and extrinsics; `trajectory` and `given` go before what the bag says.

    `zone`: that of UTM, which is the world where poses are GPS fixes.
    """
    body = _body(seen, given, lidar_height_m)
    topic = seen.topics.pose
    oriented, frame, track = True, "", None
    poses_from = topic.name if topic else "/tf"
    if trajectory is not None:
        poses_from, oriented, track = "a file", trajectory.has_rotation, _track_of_table(trajectory)
    elif topic is not None and topic.kind in POSES:
        frame = seen.pose_frame
        track = seen.poses.track() if len(seen.poses) else None
    elif topic is not None and topic.kind == FIX:
        oriented, track = False, _track_of_fixes(seen, zone)
    else:
        frame = body.base or seen.cloud_frame or seen.image_frame
        track = _track_of_tree(seen, frame)
    if track is None:
        if seen.fault:
            raise Damaged(seen.fault)
        raise UserError(
            f"{seen.bag.run}: {poses_from} gives no poses of the vehicle; its "
            f"topics:\n{as_table(topics_of(seen.bag))}\n"
            "choose with --pose-topic, or give a trajectory with --poses FILE"
        )
    if trajectory is None and oriented and seen.world_frame:
        poses_from += f" in {seen.world_frame}"
    if oriented:
        T_body_pose = _of_body(seen, frame, body)
        track = Track(track.time_us, track.T_world_body @ invert(T_body_pose))
    lens = given if given.K is not None else seen.calibration
    return Placed(
        seen,
        track,
        oriented,
        replace(lens, T_body_camera=_camera(seen, given, body), T_body_lidar=body.T_body_lidar),
        None if given.K is not None else seen.size,
        poses_from,
    )


def _base(seen: Survey) -> str | None:
    """The frame of the vehicle that the tree joins with its LiDAR, or with its camera."""
    sensor = seen.cloud_frame if seen.topics.cloud else seen.image_frame
    for name in BASES:
        for frame in seen.tree.frames():
            if frame.split("/")[-1] == name and seen.tree.between(frame, sensor) is not None:
                return frame
    return None


def _body(seen: Survey, given: Calibration, lidar_height_m: float | None) -> _Body:
    """Where the ground is; UserError where nothing says how high above it the LiDAR sits."""
    base = _base(seen)
    if seen.topics.cloud is None:
        return _Body(base, np.eye(4), None)
    if given.T_body_lidar is not None:
        if lidar_height_m is not None:
            raise UserError("--calibration has T_body_lidar: leave --lidar-height-m out")
        return _Body(base, np.eye(4), given.T_body_lidar)
    T_base_lidar = None if base is None else seen.tree.between(base, seen.cloud_frame)
    if T_base_lidar is not None:
        height_m = float(T_base_lidar[2, 3])
        lift_m = 0.0 if lidar_height_m is None else lidar_height_m - height_m
        T_body_base = pose(np.eye(3), (0.0, 0.0, lift_m))
        return _Body(base, T_body_base, T_body_base @ T_base_lidar)
    if lidar_height_m is None:
        raise UserError(
            f"{seen.bag.run}: no transform leads from base_footprint or base_link to "
            f"{seen.cloud_frame!r}, the frame of {seen.topics.cloud}: give the LiDAR's height "
            "above the ground with --lidar-height-m (0 where z = 0 is the ground already), or "
            "T_body_lidar with --calibration"
        )
    return _Body(None, np.eye(4), pose(np.eye(3), (0.0, 0.0, lidar_height_m)))


def _of_body(seen: Survey, frame: str, body: _Body) -> Float64[np.ndarray, "4 4"]:
    """T_body_frame of the frame whose poses are known."""
    if frame and frame == seen.cloud_frame and body.T_body_lidar is not None:
        return body.T_body_lidar
    if not frame or body.base is None:
        return body.T_body_base
    T_base_frame = seen.tree.between(body.base, frame)
    if T_base_frame is None:
        seen.notes.append(
            f"{seen.bag.run}: no transform leads from {body.base} to {frame}, whose poses are "
            f"read: taken as those of {body.base}"
        )
        return body.T_body_base
    return body.T_body_base @ T_base_frame


def _camera(seen: Survey, given: Calibration, body: _Body) -> Float64[np.ndarray, "4 4"] | None:
    """T_body_camera, through the LiDAR where there is one."""
    if given.T_body_camera is not None:
        return given.T_body_camera
    start, T_body_start = body.base, body.T_body_base
    if body.T_body_lidar is not None:
        start, T_body_start = seen.cloud_frame, body.T_body_lidar
    T_start_camera = None if start is None else seen.tree.between(start, seen.image_frame)
    return None if T_start_camera is None else T_body_start @ T_start_camera


def _track_of_tree(seen: Survey, frame: str) -> Track | None:
    """Poses of `frame` in the map, or what there is of a world above it."""
    above = seen.tree.ancestors(frame)[1:]
    named = [up for name in WORLDS for up in above if up.split("/")[-1] == name]
    if not above:
        return None
    seen.world_frame, seen.pose_frame = (named or above[-1:])[0], frame
    return seen.tree.track(seen.world_frame, frame)


def _track_of_fixes(seen: Survey, zone: str | None) -> Track | None:
    """Positions of the antenna, without a direction."""
    times, places = seen.fixes()
    if zone is None or len(times) == 0:
        return None
    T = np.tile(np.eye(4), (len(times), 1, 1))
    try:
        T[:, :2, 3] = to_utm(places[:, 0], places[:, 1], zone)
    except ValueError as error:
        raise UserError(f"{seen.bag.run}: {error}: prepare the runs one by one (--runs)") from error
    T[:, 2, 3] = places[:, 2]
    return Track(times, T)


def _track_of_table(table: PoseTable) -> Track | None:
    """A trajectory; None where it has no times."""
    return None if table.time_us is None else Track(table.time_us, table.T_world_body)
