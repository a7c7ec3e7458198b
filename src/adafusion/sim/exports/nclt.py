# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The raw layout of NCLT, the University of Michigan North Campus Long-Term data set.

    velodyne_data/<run>/velodyne_sync/<utime>.bin   8 bytes a point: x, y, z uint16, intensity and
                                                    laser uint8; metres = value * 0.005 - 100
    images/<run>/lb3/Cam5/<utime>.tiff              front camera, lying on its side, distorted
    ground_truth/groundtruth_<run>.csv              utime, x north, y east, z down, roll, pitch, yaw
    sensor_data/<run>/gps.csv, ms25_euler.csv       position and attitude of a GPS/INS unit
    cam_params/K_cam5.csv, x_lb3_c5.csv             intrinsics; pose in the Ladybug, m and degrees
    U2D_Cam5_<width>X<height>.txt                   where an undistorted pixel lies in the picture

Points are in the robot's body frame: x forward, y right, z down, on the ground. The HDL-32E hangs
upside down, so laser 0 looks up, and fans follow each other against the clock seen from above.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float, Float64, Int, Int64, UInt8

from adafusion.geometry import invert, transform
from adafusion.sim.exports.frames import (
    T_NED_WORLD,
    T_UP_DOWN,
    geodetic,
    ins_along,
    pose_of,
    six_numbers,
    table,
)
from adafusion.sim.exports.layout import Layout, Piece
from adafusion.sim.exports.pictures import encode_image, shrinkage, undistortion
from adafusion.sim.numeric import keyed_rng, keyed_seed
from adafusion.sim.run.route import Drive, pose_along
from adafusion.sim.sensing.camera import Camera
from adafusion.sim.sensing.lidar import HDL_32E, Lidar, ray_directions, scan_ranges
from adafusion.sim.studio import PROFILES, Job, Studio

WIDTH, HEIGHT, FOCAL = 1616, 1232, 399.433184  # of Cam5's pictures, pixels
ORIGIN_DEG, ORIGIN_ALTITUDE_M = (42.293227, -83.709657), 270.0
BODY_LB3 = (0.035, 0.002, -1.23, -179.93, -0.23, 0.50)  # metres, degrees; readers know it by heart
BODY_VELODYNE_M = (0.002, -0.004, -0.957)
TRIGGER_US = 8_000  # scans and pictures miss each other by up to this
TRUTH_US, EULER_US, GPS_US = 10_000, 20_000, 200_000
NAN_ROWS = 3  # the true track begins with rows that hold no pose

SIMPLIFIED = [
    "one picture and one scan about every 10 m; the recordings have several a second",
    "Cam5 alone, its axes parallel to the body's, its principal point in the middle",
    "pictures a power of two times smaller than 1616 x 1232",
    "Brown distortion in place of the Ladybug's own",
    "a scan is taken from one pose; intensity is 0",
    "gps.csv has 0 satellites and no gaps; latitude and longitude lie on a sphere",
]


def lay_out(job: Job) -> Layout:
    """The runs of a job in NCLT's layout."""
    profile = PROFILES[job.profile]
    camera = ladybug(shrinkage(WIDTH, profile.camera.size[1]))
    studio = Studio(job, camera=camera, lidar=velodyne(profile.lidar.steps))
    calibration = {
        "K_cam5": raw_intrinsics(camera).tolist(),
        "distortion": list(camera.distortion),
        "x_body_lb3": list(BODY_LB3),
        "x_lb3_c5": lb3_camera(camera).tolist(),
        "x_body_velodyne": list(BODY_VELODYNE_M),
    }
    return Layout({"calibration": calibration, "simplified": SIMPLIFIED}, _pieces(studio))


def _pieces(studio: Studio) -> Iterator[Piece]:
    camera = studio.camera
    h, w = camera.size[1], camera.size[0]  # the picture lies on its side
    yield Piece("cam_params/K_cam5.csv", lambda: table(raw_intrinsics(camera).tolist()))
    yield Piece("cam_params/x_lb3_c5.csv", lambda: table([lb3_camera(camera).tolist()]))
    yield Piece(f"U2D_Cam5_{w}X{h}.txt", lambda: encode_u2d(u2d(camera)))
    for run in studio.conditions:
        way = studio.drive(run)
        yield Piece(f"ground_truth/groundtruth_{run}.csv", partial(_truth, studio, way))
        yield Piece(f"sensor_data/{run}/gps.csv", partial(_gps, studio, way))
        yield Piece(f"sensor_data/{run}/ms25_euler.csv", partial(_euler, studio, way))
        scan_us = _scan_times(studio.job.seed, run, way)
        for k, time_us in enumerate(way.timestamp_us.tolist()):
            yield Piece(f"images/{run}/lb3/Cam5/{time_us}.tiff", partial(_picture, studio, run, k))
            if not studio.conditions[run].lidar_dead:
                utime = int(scan_us[k])
                yield Piece(
                    f"velodyne_data/{run}/velodyne_sync/{utime}.bin",
                    partial(_scan, studio, run, utime),
                )


# ------------------------------------------------------------------------------------------ camera


def ladybug(divisor: int) -> Camera:
    """Cam5 held upright, `divisor` times smaller than the real one."""
    return Camera(
        size=(WIDTH // divisor, HEIGHT // divisor),
        focal=FOCAL / HEIGHT,
        height_m=-BODY_LB3[2],
        forward_m=BODY_LB3[0] + 0.042,  # it looks out of the side of the Ladybug
        pitch_down_rad=0.0,
        distortion=(-0.06, 0.004, 0.0, 0.0, 0.0),
    )


def raw_intrinsics(camera: Camera) -> Float64[np.ndarray, "3 3"]:
    """K of the picture on its side: x is down and y is left of the upright one."""
    (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
    return np.array([[fy, 0.0, cy], [0.0, fx, camera.size[1] - 1 - cx], [0.0, 0.0, 1.0]])


def lb3_camera(camera: Camera) -> Float64[np.ndarray, " 6"]:
    """Pose of the camera on its side in the Ladybug's frame: metres and degrees."""
    x_down_y_left = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], *np.eye(4)[2:].tolist()])
    T_body_camera = T_UP_DOWN @ camera.T_body_camera @ x_down_y_left
    T_body_lb3 = pose_of((*BODY_LB3[:3], *np.radians(BODY_LB3[3:]).tolist()))
    numbers = six_numbers((invert(T_body_lb3) @ T_body_camera)[None])[0]
    return np.concatenate([numbers[:3], np.degrees(numbers[3:])])


def u2d(camera: Camera) -> Float64[np.ndarray, "h w 2"]:
    """For each pixel of the undistorted picture on its side: row and column in the raw one."""
    column, row = np.moveaxis(undistortion(camera), -1, 0)
    return np.rot90(np.stack([camera.size[1] - 1 - column, row], axis=-1))


def encode_u2d(row_column: Float[np.ndarray, "h w 2"]) -> bytes:
    """The text of a U2D map: width and height, then `row column raw-row raw-column` a pixel."""
    h, w = row_column.shape[:2]
    lines = [f"dims({w},{h})"]
    for i in range(h):
        lines += [f"{i} {j} {v:.6f} {u:.6f}" for j, (v, u) in enumerate(row_column[i].tolist())]
    return ("\n".join(lines) + "\n").encode()


def encode_picture(upright: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """A TIFF of an upright RGB picture, turned onto its side."""
    return encode_image(np.rot90(upright), ".tiff")


def _picture(studio: Studio, run: str, k: int) -> bytes:
    return encode_picture(studio.image(run, k))


# ------------------------------------------------------------------------------------------- laser


def velodyne(steps: int) -> Lidar:
    """The HDL-32E as it hangs on the robot."""
    return replace(
        HDL_32E,
        steps=steps,
        lowest_deg=-HDL_32E.highest_deg,
        highest_deg=-HDL_32E.lowest_deg,
        height_m=-BODY_VELODYNE_M[2],
    )


def laser_ids() -> UInt8[np.ndarray, " 32"]:
    """Laser of each beam, lowest beam first.

    Numbers alternate between the two halves of the sensor's lasers, counted from its own bottom,
    which is at the top here.
    """
    from_top = np.arange(32, dtype=np.uint8)[::-1]
    return np.where(from_top < 16, 2 * from_top, 2 * (from_top - 16) + 1)


def encode_scan(
    points: Float[np.ndarray, "n 3"],
    laser: UInt8[np.ndarray, " n"],
    intensity: UInt8[np.ndarray, " n"],
) -> bytes:
    """A velodyne_sync file of points in the body frame (z down), metres; ValueError if too far."""
    counts = np.round((points + 100.0) / 0.005)
    if len(points) and not (counts.min() >= 0 and counts.max() <= 65535):
        raise ValueError("a coordinate is not within -100 to 227.675 m")
    records = np.empty(len(points), np.dtype([("xyz", "<u2", 3), ("i", "u1"), ("laser", "u1")]))
    records["xyz"], records["i"], records["laser"] = counts, intensity, laser
    return records.tobytes()


def _scan_times(seed: int, run: str, way: Drive) -> Int64[np.ndarray, " n"]:
    """When the laser scanned: near the pictures, and within the drive."""
    rng = keyed_rng(seed, "run", run, "velodyne", "trigger")
    late = rng.integers(-TRIGGER_US, TRIGGER_US + 1, len(way.timestamp_us))
    return np.clip(way.timestamp_us + late, way.path_time_us[0], way.path_time_us[-1])


def _scan(studio: Studio, run: str, utime: int) -> bytes:
    conditions, lidar, seed = studio.conditions[run], studio.lidar, studio.job.seed
    T_world_body = pose_along(studio.world, studio.drive(run), np.array([utime]))[0]
    scene = studio.scene_at(run, utime, T_world_body)
    T_body_lidar = np.eye(4)
    T_body_lidar[:3, 3] = T_UP_DOWN[:3, :3] @ BODY_VELODYNE_M
    T_world_lidar = studio.lifted(run, T_world_body) @ T_body_lidar
    ranges = scan_ranges(
        scene,
        lidar,
        conditions,
        T_world_lidar,
        keyed_seed(seed, "run", run, "velodyne", utime),
        studio.run_seed(run),
    )
    # beams by number, steps against the clock, one firing of all lasers after the other
    order = np.argsort(laser_ids())
    points = (ray_directions(lidar) * ranges[..., None])[order, ::-1].swapaxes(0, 1)
    hit = ranges[order, ::-1].T > 0.0
    laser = np.broadcast_to(np.arange(32, dtype=np.uint8), hit.shape)[hit]
    points_body = transform(T_UP_DOWN, transform(T_body_lidar, points[hit]))
    return encode_scan(points_body, laser, np.zeros_like(laser))


# ------------------------------------------------------------------------------------------- poses


def _every(way: Drive, period_us: int) -> Int64[np.ndarray, " n"]:
    return np.arange(way.path_time_us[0], way.path_time_us[-1], period_us)


def _poses(
    studio: Studio, way: Drive, time_us: Int64[np.ndarray, " n"], *, true: bool
) -> Float64[np.ndarray, "n 6"]:
    """Poses of the z-down body in north, east, down: the true ones, or what the INS says."""
    T = pose_along(studio.world, way, time_us)
    if not true:
        T = ins_along(way, T, time_us)
    return six_numbers(T_NED_WORLD @ T @ T_UP_DOWN)


def _truth(studio: Studio, way: Drive) -> bytes:
    time_us = _every(way, TRUTH_US)
    before = time_us[0] + TRUTH_US * np.arange(-NAN_ROWS, 0)
    nothing = np.full((NAN_ROWS, 6), np.nan)
    return encode_track(
        np.concatenate([before, time_us]),
        np.concatenate([nothing, _poses(studio, way, time_us, true=True)]),
    )


def encode_track(utime: Int[np.ndarray, " n"], poses: Float[np.ndarray, "n 6"]) -> bytes:
    """A ground-truth file: utime; x north, y east, z down in metres; angles in radians."""
    return table(
        (t, *(f"{value:.6f}" for value in row))
        for t, row in zip(utime.tolist(), poses.tolist(), strict=True)
    )


def _gps(studio: Studio, way: Drive) -> bytes:
    """Utime, fix mode, satellites, latitude, longitude in radians, altitude, course, speed."""
    time_us = _every(way, GPS_US)
    north, east, down = _poses(studio, way, time_us, true=False).T[:3]
    latitude, longitude = geodetic(north, east, ORIGIN_DEG)
    seconds = (time_us - time_us[0]) * 1e-6
    v_north, v_east = np.gradient(north, seconds), np.gradient(east, seconds)
    columns = zip(
        time_us.tolist(),
        latitude.tolist(),
        longitude.tolist(),
        (ORIGIN_ALTITUDE_M - down).tolist(),
        np.arctan2(v_east, v_north).tolist(),
        np.hypot(v_north, v_east).tolist(),
        strict=True,
    )
    return table(
        (t, 3, 0, f"{lat:.12f}", f"{lon:.12f}", f"{z:.3f}", f"{course:.6f}", f"{speed:.3f}")
        for t, lat, lon, z, course, speed in columns
    )


def _euler(studio: Studio, way: Drive) -> bytes:
    """Utime, roll, pitch, heading in radians."""
    time_us = _every(way, EULER_US)
    angles = _poses(studio, way, time_us, true=False)[:, 3:]
    return table(
        (t, *(f"{value:.6f}" for value in row))
        for t, row in zip(time_us.tolist(), angles.tolist(), strict=True)
    )
