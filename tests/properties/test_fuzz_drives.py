# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever the files of a drive hold, a reader gives a value or says what is wrong."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adafusion.readers import boreas, kitti_odometry, kitti_raw, mulran, nuscenes
from adafusion.readers.ground import measure_height
from adafusion.readers.nuscenes.tables import read_table
from adafusion.readers.sensors import read_xyz
from adafusion.types import UserError

few = settings(max_examples=80, deadline=None)

KITTI = {
    "poses/00.txt": "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 10\n",
    "sequences/00/times.txt": "0.0\n0.1\n",
    "sequences/00/calib.txt": "P2: 700 0 6 42 0 700 4 0 0 0 1 0\nTr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n",
    "sequences/00/velodyne/000000.bin": "0123456789abcdef",
}
RAW = {
    "d/calib_imu_to_velo.txt": "R: 1 0 0 0 1 0 0 0 1\nT: -0.8 0 -0.8\n",
    "d/calib_velo_to_cam.txt": "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.08 -0.27\n",
    "d/calib_cam_to_cam.txt": "R_rect_00: 1 0 0 0 1 0 0 0 1\nP_rect_02: 7 0 6 4 0 7 4 0 0 0 1 0\n",
    "d/d_drive_1_sync/oxts/timestamps.txt": "2011-09-26 13:00:00.000000000\n",
    "d/d_drive_1_sync/oxts/data/0.txt": "49.0 9.0 100 0 0 1 0 0" + " 0" * 22,
    "d/d_drive_1_sync/velodyne_points/timestamps.txt": "2011-09-26 13:00:00.010000000\n",
    "d/d_drive_1_sync/velodyne_points/data/0.bin": "0123456789abcdef",
}
BOREAS = {
    "boreas-1/applanix/lidar_poses.csv": (
        "GPSTime,easting,northing,altitude,roll,pitch,heading\n10,1,2,3,0.1,0.2,0.3\n"
    ),
    "boreas-1/calib/P_camera.txt": "7 0 6 0\n0 7 4 0\n0 0 1 0\n",
    "boreas-1/calib/T_camera_lidar.txt": "0 -1 0 0\n0 0 -1 -0.8\n1 0 0 -0.3\n0 0 0 1\n",
    "boreas-1/calib/T_applanix_lidar.txt": "0 -1 0 0\n1 0 0 0\n0 0 1 0.3\n0 0 0 1\n",
    "boreas-1/lidar/10.bin": "0123456789abcdef01234567",
}
MULRAN = {
    "A/global_pose.csv": "1000,1,0,0,3,0,1,0,4,0,0,1,5\n3000,1,0,0,3,0,1,0,4,0,0,1,5\n",
    "A/Ouster/2000.bin": "0123456789abcdef",
}
HELIPR = {
    "A/LiDAR_GT/Ouster_gt.txt": "1000 1 2 3 0 0 0 1\n3000 1 2 3 0 0 0 1\n",
    "A/LiDAR/Ouster/2000.bin": "0123456789abcdef0123456789",
}
SENSOR = {"token": "c", "sensor_token": "t", "translation": [0, 0, 1], "rotation": [1, 0, 0, 0]}
SEEN = {"token": "d", "sample_token": "s", "ego_pose_token": "p", "is_key_frame": True}
NUSCENES = {
    f"v1.0-x/{name}.json": json.dumps(rows)
    for name, rows in {
        "log": [{"token": "l", "location": "here"}],
        "scene": [{"token": "e", "name": "scene-1", "log_token": "l"}],
        "sensor": [{"token": "t", "channel": "LIDAR_TOP"}, {"token": "k", "channel": "CAM_FRONT"}],
        "calibrated_sensor": [SENSOR],
        "sample": [{"token": "s", "scene_token": "e"}],
        "sample_data": [
            SEEN | {"calibrated_sensor_token": "c", "filename": "a.bin", "timestamp": 9}
        ],
        "ego_pose": [{"token": "p", "translation": [1, 2, 0], "rotation": [1, 0, 0, 0]}],
    }.items()
} | {"a.bin": "0123456789abcdef0123"}

READERS: list[tuple[dict[str, str], Callable[[Path], object]]] = [
    (KITTI, kitti_odometry.read),
    (RAW, kitti_raw.read),
    (BOREAS, lambda src: boreas.read(src, lidar_height_m=2.0)),
    (MULRAN, lambda src: mulran.read_mulran(src, lidar_height_m=2.0)),
    (HELIPR, lambda src: mulran.read_helipr(src, lidar_height_m=2.0)),
    (NUSCENES, nuscenes.read),
]
WORDS = [
    b"nan",
    b"-1",
    b"1e999",
    b"1e300",
    b"9" * 30,
    b"\0",
    b"\xff",
    b"\n",
    b",",
    b" ",
    b'"',
    b"0",
]


def mutate(data: bytes, draw: st.DataObject) -> bytes:
    """Cut a stretch out of a file and put something else there."""
    start = draw.draw(st.integers(0, len(data)))
    end = draw.draw(st.integers(start, min(len(data), start + 6)))
    filling = draw.draw(st.sampled_from(WORDS) | st.binary(max_size=4))
    rest = b"" if draw.draw(st.integers(0, 9)) == 0 else data[end:]
    return data[:start] + filling + rest


@pytest.mark.parametrize("which", range(len(READERS)))
@few
@given(draw=st.data())
def test_a_reader_survives_mutated_tables(
    which: int, draw: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    files, read = READERS[which]
    src = tmp_path_factory.mktemp("drive", numbered=True)
    for name, text in files.items():
        (src / name).parent.mkdir(parents=True, exist_ok=True)
        (src / name).write_text(text)
    assert list(read(src).shots)  # type: ignore[attr-defined]
    for _ in range(draw.draw(st.integers(1, 2))):
        path = src / draw.draw(st.sampled_from([name for name in files if "bin" not in name]))
        path.write_bytes(mutate(path.read_bytes(), draw))
    try:
        shots = list(read(src).shots)  # type: ignore[attr-defined]
    except UserError:
        return
    for shot in shots:
        assert np.isfinite(shot.frame.position_m).all()


@few
@given(data=st.binary(max_size=200), record=st.sampled_from([16, 19, 20, 22, 24, 25, 26, 29]))
def test_a_cloud_of_any_bytes_is_points_or_is_refused(
    data: bytes, record: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "cloud.bin"
    path.write_bytes(data)
    try:
        points = read_xyz(path, record)
    except UserError:
        return
    assert points.shape == (len(data) // record, 3)
    assert tuple(points[0]) == struct.unpack("<3f", data[:12])
    assert np.isfinite(points).all()


@few
@given(data=st.binary(min_size=16, max_size=4096))
def test_the_height_is_measured_or_asked_for(
    data: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "scan.bin"
    path.write_bytes(data[: len(data) // 16 * 16])
    try:
        height = measure_height([lambda: read_xyz(path, 16)], "the run")
    except UserError:
        return
    assert np.isfinite(height)


@few
@given(data=st.binary(max_size=60) | st.text('[]{},:"0a \n', max_size=60).map(str.encode))
def test_a_table_of_any_bytes_is_records_or_is_refused(
    data: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "table.json"
    path.write_bytes(data)
    try:
        records = list(read_table(path))
    except UserError:
        return
    assert all(isinstance(record, dict) for record in records)
