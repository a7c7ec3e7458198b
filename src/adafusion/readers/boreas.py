# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Boreas (Burnett et al., IJRR 2023): one camera and a 128-beam LiDAR over a year of weather.

    <src>/boreas-2021-08-05-13-34/
        camera/<us>.png             rectified
        lidar/<us>.bin              float32 x y z intensity laser time
        applanix/lidar_poses.csv    GPSTime (us, as the file's name), easting, northing, altitude,
                                    velocity, roll, pitch, heading, ...: pose of the LiDAR
        calib/P_camera.txt, calib/T_camera_lidar.txt, calib/T_applanix_lidar.txt

After the data reference of its development kit. Times are UTC, of the middle of a scan and of an
exposure. The rotation of a pose is R_world_lidar = Rx(-roll) Ry(-pitch) Rz(-heading). The Applanix
frame has x right, y forward, z up, the LiDAR is turned against it by some 45 degrees; the body
frame lies under the LiDAR, on the ground, and has the axes of the Applanix: x forward, y left.

How high the LiDAR is, the files do not say: it is measured from a few clouds where it is not given.
The world is the release's east-north-up frame, or UTM zone 17N in tables of an earlier release,
told apart by how large the numbers are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, Int64
from scipy.spatial.transform import Rotation

from adafusion.datasets.native import CONVENTIONS, DatasetInfo
from adafusion.datasets.recording import Recording, Shot
from adafusion.datasets.sensor_files import IMAGE_SUFFIXES
from adafusion.geometry import invert, pose
from adafusion.readers.calibration import is_camera_matrix
from adafusion.readers.ground import measure_height
from adafusion.readers.runs import choose_runs, files_by_stamp, matches
from adafusion.readers.sensors import (
    check_rigid,
    encoded_image,
    read_xyz,
    to_body,
    world_of,
)
from adafusion.readers.text import read_numbers, read_records
from adafusion.readers.track import Track, keyframes, nearest
from adafusion.types import Frame, UserError

_RECORD_BYTES = 24  # float32 x y z intensity laser time
_POSE_COLUMNS = ("GPSTime", "easting", "northing", "altitude", "roll", "pitch", "heading")
_POSE_GAP_US = 250_000  # poses come with the scans, at 10 Hz
_FETCH = "fetch the run again, with its folders applanix and calib"

# x forward, y left of axes x right, y forward
_R_BODY_APPLANIX = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def recognises(src: Path) -> bool:
    """Whether `src` holds runs with poses of the LiDAR."""
    return matches(src, "boreas-*/applanix/lidar_poses.csv")


def read(
    src: str | Path,
    *,
    runs: Sequence[str] | None = None,
    every_m: float = 5.0,
    slop_ms: float = 50.0,
    lidar_height_m: float | None = None,
) -> Recording:
    """Read the tables of Boreas runs, as "boreas-2021-08-05-13-34".

    A frame is a scan with a pose, and the image nearest in time; scans without an image within
    `slop_ms` are left out, unless the run has no images at all. `lidar_height_m` None measures it.
    """
    src = Path(src)
    folders = {f.name: f for f in src.glob("boreas-*") if f.is_dir()}
    if not folders:
        raise UserError(f"{src} holds no boreas-<date>: give the folder above the runs")
    notes: list[str] = []
    drives = [
        _read_drive(folders[run], every_m, slop_ms, notes)
        for run in choose_runs(src, folders, runs)
    ]
    worlds = {drive.world for drive in drives}
    if len(worlds) > 1:
        raise UserError(f"the runs of {src} are in {' and in '.join(sorted(worlds))}: choose some")
    if lidar_height_m is None:
        scans = [partial(_level, p, d.R_body_lidar) for d in drives for p in d.clouds]
        lidar_height_m = measure_height(scans, src)
        notes.append(f"the LiDAR is {lidar_height_m:.2f} m above the ground, by the clouds")
    thinned = f", a frame every {every_m:g} m" if every_m > 0 else ""
    info = DatasetInfo(
        name="boreas",
        version="2023",
        source=f"Boreas (Burnett et al., IJRR 2023){thinned}, images within {slop_ms:g} ms",
        licence="CC BY 4.0",
        synthetic=False,
        world=worlds.pop(),
        sensors={
            "camera": "FLIR Blackfly S, rectified",
            "lidar": f"Velodyne Alpha Prime, {lidar_height_m:.2f} m above the ground",
        },
        calibration={drive.run: drive.calibration(lidar_height_m) for drive in drives},
        conventions={**CONVENTIONS, "world": "x east, y north, z up; z of the ground"},
    )
    return Recording(
        info=info,
        shots=(shot for drive in drives for shot in _shots(drive, lidar_height_m)),
        total=sum(len(drive.clouds) for drive in drives),
        notes=notes,
    )


def read_poses(
    path: str | Path,
) -> tuple[Int64[np.ndarray, " n"], Float64[np.ndarray, "n 4 4"]]:
    """Times in microseconds, rising, and T_world_lidar of a `lidar_poses.csv`."""
    rows = []
    for number, record in read_records(path, _POSE_COLUMNS, remedy=_FETCH):
        try:
            rows.append((int(record["GPSTime"]), *(float(record[n]) for n in _POSE_COLUMNS[1:])))
        except ValueError:
            raise UserError(f"{path}: line {number} is no pose: {_FETCH}") from None
        if not 0 <= rows[-1][0] < 2**62 or not np.isfinite(rows[-1][1:]).all():
            raise UserError(f"{path}: line {number} is no pose: {_FETCH}")
        if len(rows) > 1 and rows[-2][0] >= rows[-1][0]:
            raise UserError(f"{path}: line {number} is no later time: {_FETCH}")
    if not rows:
        raise UserError(f"{path} holds no poses: {_FETCH}")
    values = np.array([row[1:] for row in rows])
    T_world_lidar = np.tile(np.eye(4), (len(rows), 1, 1))
    T_world_lidar[:, :3, :3] = Rotation.from_euler("XYZ", -values[:, 3:]).as_matrix()
    T_world_lidar[:, :3, 3] = values[:, :3]
    check_rigid(T_world_lidar, str(path), _FETCH)
    return np.array([row[0] for row in rows], np.int64), T_world_lidar


@dataclass(frozen=True, eq=False)
class _Drive:
    """One run: everything but the images and clouds, and the height of the LiDAR."""

    run: str
    world: str
    K: Float64[np.ndarray, "3 3"]
    R_body_lidar: Float64[np.ndarray, "3 3"]
    T_camera_lidar: Float64[np.ndarray, "4 4"]
    cloud_us: Int64[np.ndarray, " n"]  # of the frames
    image_us: Int64[np.ndarray, " n"] | None
    T_world_lidar: Float64[np.ndarray, "n 4 4"]
    clouds: list[Path]
    images: list[Path] | None

    def calibration(self, lidar_height_m: float) -> dict[str, list[list[float]]]:
        T_body_lidar = pose(self.R_body_lidar, (0.0, 0.0, lidar_height_m))
        T_body_camera = T_body_lidar @ invert(self.T_camera_lidar)
        return {
            "K": self.K.tolist(),
            "T_body_camera": T_body_camera.tolist(),
            "T_body_lidar": T_body_lidar.tolist(),
        }


def _read_drive(folder: Path, every_m: float, slop_ms: float, notes: list[str]) -> _Drive:
    run = folder.name
    P = _read_matrix(folder / "calib/P_camera.txt", rows=(3, 4))
    if not is_camera_matrix(P[:3, :3]):
        raise UserError(f"{folder / 'calib/P_camera.txt'} is no projection: {_FETCH}")
    T_camera_lidar = _read_motion(folder / "calib/T_camera_lidar.txt")
    R_body_lidar = _R_BODY_APPLANIX @ _read_motion(folder / "calib/T_applanix_lidar.txt")[:3, :3]
    track = Track(*read_poses(folder / "applanix/lidar_poses.csv"))

    clouds = files_by_stamp(folder / "lidar", ".bin")
    if not clouds:
        raise UserError(f"{folder / 'lidar'} holds no <microseconds>.bin: {_FETCH}")
    times = np.array(list(clouds), np.int64)
    kept = track.near(times, _POSE_GAP_US)
    if not kept.all():
        notes.append(f"{(~kept).sum()} of {len(kept)} scans of {run} have no pose: left out")
    times = times[kept]

    images = files_by_stamp(folder / "camera", *IMAGE_SUFFIXES)
    image_us = None
    if images:
        there_us = np.array(list(images), np.int64)
        image_us = there_us[nearest(there_us, times)]
        close = np.abs(image_us - times) <= slop_ms * 1000
        if not close.all():
            notes.append(
                f"{(~close).sum()} of {len(close)} scans of {run} have no image within "
                f"{slop_ms:g} ms: left out"
            )
        times, image_us = times[close], image_us[close]
    else:
        notes.append(f"{folder / 'camera'} holds no images: {run} has clouds alone")
    if len(times) == 0:
        raise UserError(f"no scan of {folder} has a pose and an image: fetch them, or --slop-ms")

    T_world_lidar = track.at(times)
    rows = keyframes(T_world_lidar[:, :3, 3], every_m)
    return _Drive(
        run=run,
        world=world_of(T_world_lidar[:, :3, 3], "UTM zone 17N", "Boreas ENU"),
        K=P[:3, :3],
        R_body_lidar=R_body_lidar,
        T_camera_lidar=T_camera_lidar,
        cloud_us=times[rows],
        image_us=None if image_us is None else image_us[rows],
        T_world_lidar=T_world_lidar[rows],
        clouds=[clouds[us] for us in times[rows].tolist()],
        images=None if image_us is None else [images[us] for us in image_us[rows].tolist()],
    )


def _shots(drive: _Drive, lidar_height_m: float) -> Iterator[Shot]:
    T_body_lidar = pose(drive.R_body_lidar, (0.0, 0.0, lidar_height_m))
    T_lidar_body = invert(T_body_lidar)
    for row, path in enumerate(drive.clouds):
        T_world_body = drive.T_world_lidar[row] @ T_lidar_body
        image = None if drive.images is None else drive.images[row]
        cloud_us = int(drive.cloud_us[row])
        image_us = None if drive.image_us is None else int(drive.image_us[row])
        yield Shot(
            frame=Frame(
                run=drive.run,
                timestamp_us=cloud_us,
                position_m=tuple(T_world_body[:3, 3].tolist()),
                T_world_body=T_world_body,
                image_time_us=None if image_us == cloud_us else image_us,
            ),
            image=None if image is None else partial(encoded_image, image),
            cloud=partial(to_body, _read_scan, path, T_body_lidar),
            image_suffix=".png" if image is None else image.suffix,
        )


def _read_scan(path: Path) -> Float32[np.ndarray, "n 3"]:
    return read_xyz(path, _RECORD_BYTES)


def _level(path: Path, R_body_lidar: Float64[np.ndarray, "3 3"]) -> Float32[np.ndarray, "n 3"]:
    """A scan with the axes of the body, the LiDAR still at the origin."""
    return to_body(_read_scan, path, pose(R_body_lidar, (0.0, 0.0, 0.0)))


def _read_matrix(path: Path, rows: tuple[int, ...]) -> Float64[np.ndarray, "rows 4"]:
    matrix = read_numbers(path, 4, remedy=_FETCH)
    if len(matrix) not in rows:
        raise UserError(f"{path} has {len(matrix)} rows, not {rows[-1]}: {_FETCH}")
    return matrix


def _read_motion(path: Path) -> Float64[np.ndarray, "4 4"]:
    T = _read_matrix(path, rows=(4,))
    check_rigid(T, str(path), _FETCH)
    return T
