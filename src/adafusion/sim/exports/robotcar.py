# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The raw layout of the Oxford RobotCar data set.

<run>/stereo/centre/<timestamp>.png   8-bit Bayer GBRG, distorted
<run>/stereo.timestamps               a timestamp and the number of its chunk a line
<run>/lms_front/<timestamp>.bin       float64 x, y in metres in the fan's plane, reflectance
<run>/lms_front.timestamps
<run>/gps/ins.csv, <run>/rtk.csv      measured and true poses of the INS, north-east-down
models/stereo_narrow_left.txt         fx fy cx cy; then the 4x4 from image to camera axes
models/stereo_narrow_left_distortion_lut.bin   float64, all columns, then all rows
extrinsics/{stereo,ins,lms_front}.txt          x y z roll pitch yaw, as seen from the camera
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from jaxtyping import Float, Int, Int64, UInt8

from adafusion.sim.exports.frames import T_NED_WORLD, geodetic, ins_along, six_numbers, table
from adafusion.sim.exports.layout import Layout, Piece
from adafusion.sim.exports.pictures import encode_image, shrinkage, undistortion
from adafusion.sim.exports.pushbroom import (
    CAMERA_FORWARD_M,
    CAMERA_HEIGHT_M,
    INS,
    LMS_FRONT,
    Sweep,
    mounting,
)
from adafusion.sim.run.route import pose_along
from adafusion.sim.sensing.camera import Camera
from adafusion.sim.sensing.sensor import mosaic
from adafusion.sim.studio import PROFILES, Job, Studio

WIDTH, HEIGHT, FOCAL = 1280, 960, 964.829  # of the stereo camera's pictures, pixels
BAYER = "GBRG"
POSE_US = 20_000
ORIGIN_DEG = (51.76, -1.26)
STEREO = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # the others are told from here
MODEL = "stereo_narrow_left"  # whose picture is the one in the centre
CHUNK = 1  # recordings come in several; this is one
INS_COLUMNS = (
    *("latitude", "longitude", "altitude", "northing", "easting", "down", "utm_zone"),
    *("velocity_north", "velocity_east", "velocity_down", "roll", "pitch", "yaw"),
)

SIMPLIFIED = [
    "one picture about every 10 m; the recordings have 16 a second",
    "the centre camera alone, its principal point in the middle, a power of two times smaller than "
    "1280 x 960, with Brown distortion",
    "a scan of lms_front is taken from one pose; reflectance is 0; beams without an echo are left "
    "out; objects in traffic move every 0.1 s",
    "northing and easting count from the world's origin; latitude and longitude lie on a sphere",
    "the INS never loses its fix",
]


def lay_out(job: Job) -> Layout:
    """The runs of a job in RobotCar's layout."""
    camera = bumblebee(shrinkage(WIDTH, PROFILES[job.profile].camera.size[1]))
    studio = Studio(job, camera=camera)
    calibration = {
        "K": camera.K.tolist(),
        "distortion": list(camera.distortion),
        "bayer": BAYER,
        "stereo": list(STEREO),
        "ins": list(INS),
        "lms_front": list(LMS_FRONT),
        "T_body_ins": mounting(INS).tolist(),
        "T_body_lms_front": mounting(LMS_FRONT).tolist(),
    }
    return Layout({"calibration": calibration, "simplified": SIMPLIFIED}, _pieces(studio))


def _pieces(studio: Studio) -> Iterator[Piece]:
    camera = studio.camera
    yield Piece(f"models/{MODEL}.txt", lambda: encode_model(camera.K))
    yield Piece(f"models/{MODEL}_distortion_lut.bin", lambda: encode_lut(undistortion(camera)))
    for name, numbers in (("stereo", STEREO), ("ins", INS), ("lms_front", LMS_FRONT)):
        yield Piece(f"extrinsics/{name}.txt", partial(encode_extrinsics, numbers))
    for run, conditions in studio.conditions.items():
        way = studio.drive(run)
        yield Piece(f"{run}/stereo.timestamps", partial(encode_timestamps, way.timestamp_us))
        yield Piece(f"{run}/rtk.csv", partial(_poses, studio, run, true=True))
        yield Piece(f"{run}/gps/ins.csv", partial(_poses, studio, run, true=False))
        for k, time_us in enumerate(way.timestamp_us.tolist()):
            yield Piece(f"{run}/stereo/centre/{time_us}.png", partial(_picture, studio, run, k))
        if not conditions.lidar_dead:
            sweep = Sweep(studio, run)
            yield Piece(f"{run}/lms_front.timestamps", partial(encode_timestamps, sweep.time_us))
            for k, time_us in enumerate(sweep.time_us.tolist()):
                yield Piece(f"{run}/lms_front/{time_us}.bin", partial(_scan, sweep, k))


def encode_timestamps(time_us: Int[np.ndarray, " n"]) -> bytes:
    """The text of a `.timestamps` file."""
    return "".join(f"{t} {CHUNK}\n" for t in time_us.tolist()).encode()


# ------------------------------------------------------------------------------------------ camera


def bumblebee(divisor: int) -> Camera:
    """The stereo camera's eye in the centre, `divisor` times smaller than the real one."""
    return Camera(
        size=(HEIGHT // divisor, WIDTH // divisor),
        focal=FOCAL / WIDTH,
        height_m=CAMERA_HEIGHT_M,
        forward_m=CAMERA_FORWARD_M,
        pitch_down_rad=0.0,
        distortion=(-0.2, 0.06, 0.0, 0.0, 0.0),
    )


def encode_lut(column_row: Float[np.ndarray, "h w 2"]) -> bytes:
    """A distortion look-up table: all columns by rows of the picture, then all rows."""
    return np.moveaxis(column_row, -1, 0).astype("<f8").tobytes()


def encode_model(K: Float[np.ndarray, "3 3"]) -> bytes:
    """The text of a camera model: from x right, y down, z forward to x forward, y right, z down."""
    lines = [f"{K[0, 0]:.6f} {K[1, 1]:.6f} {K[0, 2]:.6f} {K[1, 2]:.6f}"]
    axes = ((0, 0, 1, 0), (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 0, 1))
    lines += [" ".join(f"{value:.6f}" for value in row) for row in axes]
    return ("\n".join(lines) + "\n").encode()


def encode_extrinsics(numbers: Sequence[float]) -> bytes:
    """The text of an extrinsics file."""
    return (" ".join(f"{value:.4f}" for value in numbers) + "\n").encode()


def encode_picture(rgb: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """A grey PNG of the picture as the sensor gives it."""
    return encode_image(mosaic(rgb, BAYER), ".png")


def _picture(studio: Studio, run: str, k: int) -> bytes:
    return encode_picture(studio.image(run, k))


# ------------------------------------------------------------------------------------------- laser


def encode_scan(points: Float[np.ndarray, "n 2"], reflectance: Float[np.ndarray, " n"]) -> bytes:
    """A scan file of points in the plane of the fan, metres."""
    return np.column_stack([points, reflectance]).astype("<f8").tobytes()


def _scan(sweep: Sweep, k: int) -> bytes:
    points = sweep.scan(k)
    return encode_scan(points, np.zeros(len(points)))


# ------------------------------------------------------------------------------------------- poses


def _poses(studio: Studio, run: str, *, true: bool) -> bytes:
    """What rtk.csv holds, or ins.csv."""
    way = studio.drive(run)
    # one row past the end, lest the last scans lie between no two poses
    last = int(way.path_time_us[-1])
    time_us = np.append(np.arange(int(way.path_time_us[0]), last, POSE_US), last)
    T = pose_along(studio.world, way, time_us)
    if not true:
        T = ins_along(way, T, time_us)
    return encode_poses(time_us, T_NED_WORLD @ T @ mounting(INS), status=not true)


def encode_poses(
    time_us: Int64[np.ndarray, " n"], T_ned_ins: Float[np.ndarray, "n 4 4"], *, status: bool
) -> bytes:
    """The text of ins.csv, or without its column of status that of rtk.csv."""
    poses = six_numbers(T_ned_ins)
    latitude, longitude = (np.degrees(a) for a in geodetic(poses[:, 0], poses[:, 1], ORIGIN_DEG))
    velocity = np.gradient(poses[:, :3], (time_us - time_us[0]) * 1e-6, axis=0)

    def rows() -> Iterator[list[str]]:
        for k, t in enumerate(time_us.tolist()):
            x, y, z, *angles = poses[k].tolist()
            row = [str(t), *(["INS_SOLUTION_GOOD"] if status else [])]
            row += [f"{latitude[k]:.10f}", f"{longitude[k]:.10f}", f"{-z:.6f}"]
            row += [f"{x:.6f}", f"{y:.6f}", f"{z:.6f}", "local"]
            yield row + [f"{value:.6f}" for value in (*velocity[k].tolist(), *angles)]

    return table(rows(), "timestamp", *(["ins_status"] if status else []), *INS_COLUMNS)
