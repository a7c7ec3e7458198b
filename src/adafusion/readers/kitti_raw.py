# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""KITTI raw data (Geiger, Lenz, Stiller, Urtasun, IJRR 2013), synced and rectified drives.

    <src>/2011_09_26/calib_{imu_to_velo,velo_to_cam,cam_to_cam}.txt
    <src>/2011_09_26/2011_09_26_drive_0009_sync/
        {image_02,velodyne_points,oxts}/timestamps.txt   one line an index
        image_02/data/0000000000.png                     left colour camera, rectified
        velodyne_points/data/0000000000.bin              float32 x y z reflectance
        oxts/data/0000000000.txt                         GPS/INS packet, 30 numbers

Files of one index belong together; indices may be missing. Timestamps are text with nanoseconds,
read as UTC and cut to microseconds; a line is empty where a scan was lost. That of the Velodyne is
the instant it faced forward.

The OXTS unit gives latitude and longitude (WGS84), altitude, and roll, pitch, yaw of axes x
forward, y left, z up, yaw counter-clockwise from east. All drives share one world: x and y are
easting and northing of UTM zone 32N, yaw is corrected by the angle between north and the grid's
north (0.4 degrees in Karlsruhe), z is the altitude of the ground under the Velodyne.
"""

from __future__ import annotations

import re
from calendar import timegm
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from adafusion.datasets.native import CONVENTIONS, DatasetInfo
from adafusion.datasets.recording import Recording, Shot
from adafusion.datasets.sensor_files import IMAGE_SUFFIXES
from adafusion.geometry import invert, pose, rotation_from_rpy
from adafusion.readers.kitti_odometry import (
    T_BODY_LIDAR,
    VELODYNE_HEIGHT_M,
    read_matrices,
    read_velodyne,
    split_projection,
)
from adafusion.readers.runs import choose_runs, files_by_stamp, matches
from adafusion.readers.sensors import check_rigid, encoded_image, refuse, to_body
from adafusion.readers.text import read_numbers, read_text
from adafusion.readers.track import keyframes
from adafusion.readers.utm import grid_from_north, to_utm
from adafusion.types import Frame, UserError

ZONE = "32N"
WORLD = f"UTM zone {ZONE}"
CAMERAS = ("image_02", "image_03")

_LONGEST_CARRY_S = 0.1  # a packet further than this from its scan is another's
_FETCH = "fetch the drive again, synced and rectified, and the calibration of its date"
_STAMP = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)\.(\d{9})")


def recognises(src: Path) -> bool:
    """Whether `src` holds dates with synced drives."""
    return matches(src, "*/*_drive_*_sync/oxts/timestamps.txt")


def read(
    src: str | Path,
    *,
    runs: Sequence[str] | None = None,
    every_m: float = 0.0,
    camera: str = "image_02",
) -> Recording:
    """Read the tables of KITTI raw drives, one run a drive.

    `runs` are names such as "2011_09_26_drive_0009". A frame needs a time and a packet of the
    GPS/INS unit, and an image or a cloud. The time is that of its cloud, if it has one, and the
    pose its packet's, carried on by the packet's velocity for the milliseconds between them. A
    frame whose packet is damaged is there and refuses to be decoded.
    """
    src = Path(src)
    if camera not in CAMERAS:
        raise UserError(f"camera {camera!r} is none of {', '.join(CAMERAS)}: choose one")
    folders = {f.name.removesuffix("_sync"): f for f in sorted(src.glob("*/*_drive_*_sync"))}
    if not folders:
        raise UserError(f"{src} holds no <date>/<date>_drive_<number>_sync: give the folder above")
    notes: list[str] = []
    drives = [
        _read_drive(folders[run], run, camera, every_m, notes)
        for run in choose_runs(src, folders, runs)
    ]
    thinned = f", a frame every {every_m:g} m" if every_m > 0 else ""
    info = DatasetInfo(
        name="kitti-raw",
        version="2013",
        source=f"KITTI raw data (Geiger, Lenz, Stiller, Urtasun, IJRR 2013), {camera}{thinned}",
        licence="CC BY-NC-SA 3.0",
        synthetic=False,
        world=WORLD,
        sensors={
            "camera": f"{camera}: colour camera, rectified",
            "lidar": f"Velodyne HDL-64E, {VELODYNE_HEIGHT_M} m above the ground",
        },
        calibration={drive.run: drive.calibration for drive in drives},
        conventions={**CONVENTIONS, "world": f"x easting, y northing of {WORLD}, z up"},
    )
    return Recording(
        info=info,
        shots=(shot for drive in drives for shot in _shots(drive)),
        total=sum(len(drive.indices) for drive in drives),
        notes=notes,
    )


@dataclass(frozen=True)
class _Drive:
    """One drive: everything but the images and clouds."""

    run: str
    calibration: dict[str, list[list[float]]]
    indices: list[int]
    cloud_us: list[int | None]
    image_us: list[int | None]
    T_world_body: dict[int, Float[np.ndarray, "4 4"]]
    faults: dict[int, str]  # what is amiss with the packets of frames that have no pose
    images: dict[int, Path]
    clouds: dict[int, Path]


def _read_drive(folder: Path, run: str, camera: str, every_m: float, notes: list[str]) -> _Drive:
    calibration = _read_calibration(folder.parent, camera)
    images = files_by_stamp(folder / camera / "data", *IMAGE_SUFFIXES)
    clouds = files_by_stamp(folder / "velodyne_points/data", ".bin")
    packets = files_by_stamp(folder / "oxts/data", ".txt")
    seen = sorted(images.keys() | clouds.keys())
    if not seen:
        raise UserError(f"{folder} has no {camera}/data and no velodyne_points/data: {_FETCH}")
    packet_us = _read_times(folder / "oxts/timestamps.txt")
    image_us = _read_times(folder / camera / "timestamps.txt") if images else []
    cloud_us = _read_times(folder / "velodyne_points/timestamps.txt") if clouds else []

    poses: dict[int, Float[np.ndarray, "4 4"]] = {}
    faults: dict[int, str] = {}
    for index in seen:
        at_us = _at(cloud_us, index) if index in clouds else _at(image_us, index)
        from_us = _at(packet_us, index)
        if at_us is None or from_us is None or index not in packets:
            continue
        carry_s = (at_us - from_us) * 1e-6
        if abs(carry_s) > _LONGEST_CARRY_S:
            continue
        try:
            poses[index] = _read_pose(packets[index], carry_s) @ calibration["T_imu_body"]
        except UserError as error:
            faults[index] = str(error)
    indices = sorted(poses)
    if lost := len(seen) - len(poses) - len(faults):
        notes.append(
            f"{lost} of {len(seen)} frames of {run} have no time, or no packet of oxts within "
            f"{_LONGEST_CARRY_S * 1e3:.0f} ms: left out"
        )
    if not indices:
        if faults:
            raise UserError(next(iter(faults.values())))
        raise UserError(f"{folder}: no frame has a time and a packet of oxts/data: {_FETCH}")
    kept = keyframes(np.array([poses[index][:3, 3] for index in indices]), every_m)
    return _Drive(
        run=run,
        calibration={name: T.tolist() for name, T in calibration.items() if name != "T_imu_body"},
        indices=sorted([*(indices[row] for row in kept), *faults]),
        cloud_us=cloud_us,
        image_us=image_us,
        T_world_body=poses,
        faults=faults,
        images=images,
        clouds=clouds,
    )


def _shots(drive: _Drive) -> Iterator[Shot]:
    for index in drive.indices:
        image, cloud = drive.images.get(index), drive.clouds.get(index)
        image_us = None if image is None else _at(drive.image_us, index)
        at_us = _at(drive.cloud_us, index) if cloud is not None else image_us
        if at_us is None:
            raise ValueError(f"frame {index} of {drive.run} was chosen without a time")
        if index in drive.faults:
            frame = Frame(run=drive.run, timestamp_us=at_us, position_m=(0.0, 0.0, 0.0))
            yield Shot(frame=frame, image=None, cloud=partial(refuse, drive.faults[index]))
            continue
        T_world_body = drive.T_world_body[index]
        yield Shot(
            frame=Frame(
                run=drive.run,
                timestamp_us=at_us,
                position_m=tuple(T_world_body[:3, 3].tolist()),
                T_world_body=T_world_body,
                image_time_us=None if image_us == at_us else image_us,
            ),
            image=None if image is None else partial(encoded_image, image),
            cloud=None if cloud is None else partial(to_body, read_velodyne, cloud, T_BODY_LIDAR),
            image_suffix=".png" if image is None else image.suffix,
        )


def _at(times_us: Sequence[int | None], index: int) -> int | None:
    return times_us[index] if index < len(times_us) else None


def _read_times(path: Path) -> list[int | None]:
    """Microseconds since the epoch, line by line; None for an empty line."""
    times: list[int | None] = []
    for number, line in enumerate(read_text(path, _FETCH).splitlines(), start=1):
        if not line.strip():
            times.append(None)
            continue
        match = _STAMP.fullmatch(line.strip())
        try:
            if match is None:
                raise ValueError
            second = timegm(datetime.fromisoformat(match[1]).timetuple())
        except ValueError:
            raise UserError(
                f"{path}: line {number} is no time as 2011-09-26 13:02:25.594360375: {_FETCH}"
            ) from None
        times.append(second * 1_000_000 + int(match[2]) // 1000)
    return times


def _read_pose(path: Path, carry_s: float) -> Float[np.ndarray, "4 4"]:
    """T_world_imu of a packet, `carry_s` seconds later."""
    rows = read_numbers(path, 30, remedy=_FETCH)
    if len(rows) != 1:
        raise UserError(f"{path} holds {len(rows)} packets, not one: {_FETCH}")
    latitude, longitude, altitude, roll, pitch, yaw, north, east = rows[0, :8]
    up, turn = rows[0, 10], rows[0, 17:20]
    if np.abs(rows[0, 2:]).max() > 1e5:
        raise UserError(f"{path} is no packet of a vehicle on the road: {_FETCH}")
    at = np.array([latitude]), np.array([longitude])
    try:
        [here], [grid] = to_utm(*at, ZONE), grid_from_north(*at, ZONE)
    except ValueError as error:
        raise UserError(f"{path}: {error}: {_FETCH}") from None
    start = pose(grid @ rotation_from_rpy(roll, pitch, yaw), (*here, altitude))
    start[:3, 3] += carry_s * grid @ (east, north, up)
    start[:3, :3] = start[:3, :3] @ Rotation.from_rotvec(carry_s * turn).as_matrix()
    return start


def _read_calibration(date: Path, camera: str) -> dict[str, Float[np.ndarray, "rows columns"]]:
    """K of the camera, the sensors in the body frame, and the body in that of the OXTS unit."""
    T_velo_imu = _read_motion(date / "calib_imu_to_velo.txt")
    T_cam0_velo = _read_motion(date / "calib_velo_to_cam.txt")
    path, number = date / "calib_cam_to_cam.txt", camera[-2:]
    shapes = {"R_rect_00": (3, 3), f"P_rect_{number}": (3, 4)}
    R_rect_cam0, P = read_matrices(path, shapes, _FETCH)
    check_rigid(pose(R_rect_cam0, (0.0, 0.0, 0.0)), f"{path}: R_rect_00", _FETCH)
    K, T_camera_rect = split_projection(P, f"{path}: P_rect_{number}", _FETCH)
    T_camera_velo = T_camera_rect @ pose(R_rect_cam0, (0.0, 0.0, 0.0)) @ T_cam0_velo
    return {
        "K": K,
        "T_body_camera": T_BODY_LIDAR @ invert(T_camera_velo),
        "T_body_lidar": T_BODY_LIDAR,
        "T_imu_body": invert(T_velo_imu) @ invert(T_BODY_LIDAR),
    }


def _read_motion(path: Path) -> Float[np.ndarray, "4 4"]:
    R, t = read_matrices(path, {"R": (3, 3), "T": (3, 1)}, _FETCH)
    T = pose(R, t[:, 0])
    check_rigid(T, str(path), _FETCH)
    return T
