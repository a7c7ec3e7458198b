# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The files of Oxford RobotCar, one by one: poses, camera models, mounting, pictures, scans.

Facts of the formats are those of the data set's paper (Maddern, Pascoe, Linegar, Newman, IJRR
2017), its site's documentation, and its development kit. All frames of the vehicle have x forward,
y right, z down; a rotation is given as R = Rz(yaw) Ry(pitch) Rx(roll).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8
from scipy.spatial.transform import Rotation

from adafusion.datasets.sensor_files import decode_image, read_bytes
from adafusion.geometry import invert, is_rigid, pose, rotation_from_rpy
from adafusion.readers.calibration import is_camera_matrix
from adafusion.readers.text import read_numbers, read_records
from adafusion.types import UserError

GOOD = "INS_SOLUTION_GOOD"
NEAREST_M, FARTHEST_M = 0.05, 100.0  # what a laser of this vehicle can have seen
SCAN_BYTES = 24  # three float64 a point
LARGEST = 1e8  # of any number in a table of poses; a northing has seven digits

_CALIBRATION = "take the models and extrinsics of the data set's development kit"


class Camera(NamedTuple):
    """What belongs to the pictures of one folder."""

    model: str  # in models/
    extrinsics: str  # in extrinsics/
    demosaic: int  # the OpenCV code of its Bayer pattern


CAMERAS = {
    # the picture in the centre is the left one of the narrow pair
    "stereo/centre": Camera("stereo_narrow_left", "stereo", cv2.COLOR_BayerGBRG2RGB),
    "stereo/left": Camera("stereo_wide_left", "stereo", cv2.COLOR_BayerGBRG2RGB),
    "stereo/right": Camera("stereo_wide_right", "stereo", cv2.COLOR_BayerGBRG2RGB),
    "mono_left": Camera("mono_left", "mono_left", cv2.COLOR_BayerRGGB2RGB),
    "mono_right": Camera("mono_right", "mono_right", cv2.COLOR_BayerRGGB2RGB),
    "mono_rear": Camera("mono_rear", "mono_rear", cv2.COLOR_BayerRGGB2RGB),
}
LIDARS = ("lms_front", "ldmrs")


# ------------------------------------------------------------------------------------ what is there


def runs_there(src: Path) -> list[str]:
    """Folders with a sensor of this vehicle in them."""
    sensors = (*CAMERAS, *LIDARS)
    return sorted(
        path.name
        for path in src.iterdir()
        if path.is_dir() and any((path / sensor).is_dir() for sensor in sensors)
    )


def ins_file(src: Path, run: str) -> Path:
    """Where a run's ins.csv should be."""
    return src / run / "gps" / "ins.csv"


def rtk_file(src: Path, run: str) -> Path:
    """Where a run's rtk.csv is, or should be."""
    apart = src / "rtk" / run / "rtk.csv"
    return apart if apart.is_file() else src / run / "rtk.csv"


def has_poses(src: Path, run: str) -> bool:
    """Whether anything says where a run was."""
    return ins_file(src, run).is_file() or rtk_file(src, run).is_file()


# ------------------------------------------------------------------------------------------- poses


class Poses(NamedTuple):
    """What rtk.csv or ins.csv says, by rising time."""

    time_us: Int64[np.ndarray, " n"]
    T_ned_ins: Float64[np.ndarray, "n 4 4"]  # in northing, easting, down
    notes: list[str]


def read_poses(path: Path) -> Poses:
    """Read rtk.csv or ins.csv, by the names of its columns.

    Rows in which the INS says that its solution is not good are left out, and so are rows that
    repeat a time; rows out of order are sorted.
    """
    remedy = "unpack it again from the data set's archives"
    columns = ("northing", "easting", "down", "roll", "pitch", "yaw")
    times: list[int] = []
    numbers: list[list[float]] = []
    bad = 0
    for line, row in read_records(path, ("timestamp", *columns), remedy=remedy):
        if row.get("ins_status", GOOD) != GOOD:  # rtk.csv has no such column
            bad += 1
            continue
        try:
            time_us, values = int(row["timestamp"]), [float(row[name]) for name in columns]
        except ValueError:
            time_us, values = -1, []
        if not 0 <= time_us < 2**62 or not all(abs(value) < LARGEST for value in values):
            raise UserError(f"{path}: line {line} has no time or no finite pose: {remedy}")
        times.append(time_us)
        numbers.append(values)
    rising, kept = np.unique(np.array(times, np.int64), return_index=True)
    notes = [f"{path}: {bad} rows are not {GOOD}: left out"] if bad else []
    if repeated := len(times) - len(kept):
        notes.append(f"{path}: {repeated} rows repeat the time of an earlier one: left out")
    return Poses(rising, _poses_of(np.array(numbers).reshape(-1, 6)[kept]), notes)


def read_extrinsics(path: Path) -> Float64[np.ndarray, "4 4"]:
    """The motion in a file of `x y z roll pitch yaw`; what it maps to what, only its user knows."""
    numbers = read_numbers(path, 6, remedy=_CALIBRATION)
    if len(numbers) != 1 or (np.abs(numbers) > 100.0).any():
        raise UserError(f"{path} is not one line of x y z roll pitch yaw: {_CALIBRATION}")
    x, y, z, roll, pitch, yaw = numbers[0].tolist()
    return pose(rotation_from_rpy(roll, pitch, yaw), (x, y, z))


def _poses_of(numbers: Float64[np.ndarray, "n 6"]) -> Float64[np.ndarray, "n 4 4"]:
    T = np.tile(np.eye(4), (len(numbers), 1, 1))
    if len(numbers) == 0:
        return T
    T[:, :3, :3] = Rotation.from_euler("ZYX", numbers[:, :2:-1]).as_matrix()
    T[:, :3, 3] = numbers[:, :3]
    return T


# ------------------------------------------------------------------------------------------ camera


class Model(NamedTuple):
    """A camera model."""

    K: Float64[np.ndarray, "3 3"]  # of the undistorted picture
    T_camera_optical: Float64[np.ndarray, "4 4"]  # z along the view to x forward, z down


def read_model(path: Path) -> Model:
    """Read `fx fy cx cy` and the 4x4 matrix from the optical axes to those of the camera."""
    numbers = read_numbers(path, 4, remedy=_CALIBRATION)
    if len(numbers) != 5 or (np.abs(numbers) > 1e6).any():
        raise UserError(f"{path} is not 5 lines of 4 numbers: {_CALIBRATION}")
    fx, fy, cx, cy = numbers[0].tolist()
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    if not is_camera_matrix(K) or not is_rigid(numbers[1:]):
        raise UserError(f"{path} is no pinhole camera with a rigid motion: {_CALIBRATION}")
    return Model(K, numbers[1:])


def read_picture(path: Path, table: Path, demosaic: int) -> UInt8[np.ndarray, "h w 3"]:
    """The picture in colour and without distortion, which `table` says how to take out.

    In this order: between two pixels of the raw mosaic lies no colour to look up.
    """
    raw = decode_image(read_bytes(path, "image"), path)
    if (raw != raw[..., :1]).any():
        raise UserError(
            f"{path} is a colour picture, not the Bayer mosaic of the recording: give the "
            "pictures as they are in the data set's archives"
        )
    columns, rows = _maps(table, *raw.shape[:2])
    colour = cv2.cvtColor(np.ascontiguousarray(raw[..., 0]), demosaic)
    return cv2.remap(colour, columns, rows, cv2.INTER_LINEAR)


@lru_cache(maxsize=2)
def _maps(
    path: Path, height: int, width: int
) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Column and row in the raw picture of every pixel of the undistorted one."""
    try:
        size = path.stat().st_size
    except OSError as error:
        raise UserError(f"{path} cannot be read ({error.strerror}): {_CALIBRATION}") from error
    if size != 16 * height * width:
        raise UserError(
            f"{path} has {size} bytes, not the {16 * height * width} of a {width} x {height} "
            f"picture: {_CALIBRATION}, for the camera that took the pictures"
        )
    table = np.frombuffer(read_bytes(path, "table"), "<f8").reshape(2, height, width)
    if not (np.abs(table) < 1e6).all():
        raise UserError(f"{path} holds pixels that are not finite: {_CALIBRATION}")
    return table[0].astype(np.float32), table[1].astype(np.float32)


# ---------------------------------------------------------------------------------------- mounting


def find_calibration(src: Path, calibration: str | Path | None) -> Path:
    """The folder that holds `models` and `extrinsics`."""
    kit = "robotcar-dataset-sdk"
    given = [src, src / kit, src.absolute().parent / kit]
    folders = given if calibration is None else [Path(calibration)]
    for folder in folders:
        if (folder / "models").is_dir() and (folder / "extrinsics").is_dir():
            return folder
    raise UserError(
        f"{' or '.join(map(str, folders))}: there are no models/ and extrinsics/: put the "
        f"development kit ({kit}) there, or name its folder as the calibration"
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Rig:
    """The sensors that are read and where they sit; `stereo` has x forward, y right, z down."""

    camera: str
    lidar: str
    table: Path  # that takes the distortion out of pictures
    K: Float64[np.ndarray, "3 3"]
    T_stereo_optical: Float64[np.ndarray, "4 4"]
    T_stereo_lidar: Float64[np.ndarray, "4 4"]
    T_stereo_ins: Float64[np.ndarray, "4 4"]


def read_rig(folder: Path, camera: str, lidar: str) -> Rig:
    """Read what the folder with `models` and `extrinsics` says of a camera and a LiDAR."""
    kind = CAMERAS[camera]
    model = read_model(folder / "models" / f"{kind.model}.txt")
    extrinsics = folder / "extrinsics"
    # the kit's files give INS and lasers as seen from the stereo camera, but a camera's file gives
    # the stereo camera as seen from it: only so does mono_left look to the left
    T_camera_stereo = read_extrinsics(extrinsics / f"{kind.extrinsics}.txt")
    return Rig(
        camera=camera,
        lidar=lidar,
        table=folder / "models" / f"{kind.model}_distortion_lut.bin",
        K=model.K,
        T_stereo_optical=invert(T_camera_stereo) @ model.T_camera_optical,
        T_stereo_lidar=read_extrinsics(extrinsics / f"{lidar}.txt"),
        T_stereo_ins=read_extrinsics(extrinsics / "ins.txt"),
    )


# ------------------------------------------------------------------------------------------- laser


def read_scan(folder: Path, flat: bool, time_us: int) -> Float64[np.ndarray, "n 3"]:
    """Points of one scan in the sensor's frame, metres; beams without an echo are left out.

    A `flat` scan holds x, y and the reflectance of a fan; the other kind x, y, z.
    """
    path = folder / f"{time_us}.bin"
    data = read_bytes(path, "scan")
    if len(data) % SCAN_BYTES:
        raise UserError(
            f"{path} is cut short: {len(data)} bytes are no whole number of {SCAN_BYTES}-byte "
            "points; unpack it again, or remove it"
        )
    points = np.frombuffer(data, "<f8").reshape(-1, 3).copy()
    if flat:
        points[:, 2] = 0.0
    inside = (np.abs(points) <= FARTHEST_M).all(axis=1)  # false for NaN; squares stay small
    points = points[inside]
    far = np.linalg.norm(points, axis=1)
    return points[(far >= NEAREST_M) & (far <= FARTHEST_M)]
