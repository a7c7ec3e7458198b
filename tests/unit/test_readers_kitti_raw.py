# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The KITTI raw reader on a drive made by hand."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from adafusion.datasets import Dataset
from adafusion.datasets.recording import write_recording
from adafusion.readers.kitti_raw import read, recognises
from adafusion.types import UserError

DRIVE = "2011_09_26/2011_09_26_drive_0001_sync"
# the OXTS unit sits 0.8 m behind and below the Velodyne, all axes alike
CALIBRATION = {
    "calib_imu_to_velo.txt": "calib_time: 25-May-2012\nR: 1 0 0 0 1 0 0 0 1\nT: -0.8 0 -0.8\n",
    "calib_velo_to_cam.txt": "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.08 -0.27\n",
    "calib_cam_to_cam.txt": (
        "R_rect_00: 1 0 0 0 1 0 0 0 1\n"
        "P_rect_02: 700 0 6 42 0 700 4 0 0 0 1 0\n"
        "P_rect_03: 700 0 6 -336 0 700 4 0 0 0 1 0\n"
    ),
}
# scans 10 ms after the packets, images 20 ms after; 2011-09-26 13:00:00 UTC is 1317042000 s
SECOND = 1_317_042_000
PACKETS = [f"2011-09-26 13:00:0{i}.000000000" for i in range(4)]
SCANS = [f"2011-09-26 13:00:0{i}.010000999" for i in range(4)]
IMAGES = [f"2011-09-26 13:00:0{i}.020000000" for i in range(4)]


def packet(latitude: float, yaw: float, speed_north: float = 0.0) -> str:
    """On the middle meridian of UTM zone 32N, where the grid's north is north."""
    numbers = [latitude, 9.0, 100.0, 0.0, 0.0, yaw, speed_north, 0.0] + [0.0] * 22
    return " ".join(map(str, numbers))


def png(level: int) -> bytes:
    return cv2.imencode(".png", np.full((8, 12, 3), level, np.uint8))[1].tobytes()


@pytest.fixture
def src(tmp_path: Path) -> Path:
    drive = tmp_path / "raw" / DRIVE
    for sensor, times in (("oxts", PACKETS), ("velodyne_points", SCANS), ("image_02", IMAGES)):
        (drive / sensor / "data").mkdir(parents=True)
        (drive / sensor / "timestamps.txt").write_text("\n".join(times) + "\n")
    for name, text in CALIBRATION.items():
        (drive.parent / name).write_text(text)
    for i in range(4):
        text = packet(49.0 + 1e-4 * i, yaw=np.pi / 2, speed_north=10.0)
        (drive / f"oxts/data/{i:010d}.txt").write_text(text)
        cloud = struct.pack("<4f", 10.0, 0.0, -1.73, 0.3) + struct.pack("<4f", 5.0, 2.0, 0.27, 0.9)
        (drive / f"velodyne_points/data/{i:010d}.bin").write_bytes(cloud)
        (drive / f"image_02/data/{i:010d}.png").write_bytes(png(10 * i))
    return tmp_path / "raw"


def prepare(src: Path, out: Path, **options: object) -> Dataset:
    return write_recording(read(src, **options), out).dataset  # type: ignore[arg-type]


def test_times_are_exact_and_those_of_the_scans(src: Path, tmp_path: Path) -> None:
    frames = prepare(src, tmp_path / "out").frames
    assert [f.timestamp_us for f in frames] == [(SECOND + i) * 1_000_000 + 10_000 for i in range(4)]
    assert frames[1].image_time_us == (SECOND + 1) * 1_000_000 + 20_000
    assert {f.run for f in frames} == {"2011_09_26_drive_0001"}


def test_poses_lie_on_the_utm_grid_under_the_velodyne(src: Path, tmp_path: Path) -> None:
    dataset = prepare(src, tmp_path / "out")
    # 49 N 9 E is at easting 500000, northing 5427455.781; the Velodyne is 0.8 m ahead of the unit
    # and 0.8 m above it, the ground 1.73 m below that; 10 ms at 10 m/s carry it on by 0.1 m
    expected = [500_000.0, 5_427_455.781 + 0.8 + 0.1, 100.0 + 0.8 - 1.73]
    np.testing.assert_allclose(dataset.positions_m[0], expected, atol=0.005)
    steps = np.diff(dataset.positions_m, axis=0)
    np.testing.assert_allclose(steps, [[0.0, 0.9996 * 11.1212, 0.0]] * 3, atol=1e-3)
    T = dataset.frames[0].T_world_body
    assert T is not None
    np.testing.assert_allclose(T[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-9)
    assert dataset.world == "UTM zone 32N"


def test_yaw_is_turned_from_north_to_the_north_of_the_grid(src: Path, tmp_path: Path) -> None:
    file = src / DRIVE / "oxts/data/0000000000.txt"
    file.write_text(packet(49.0, yaw=0.0).replace(" 9.0 ", " 8.4 ", 1))
    T = prepare(src, tmp_path / "out").frames[0].T_world_body
    assert T is not None
    # west of the middle meridian, the way north leads nearer to it, so north and east are turned
    # clockwise on the grid: by 0.6 degrees times the sine of the latitude
    turn = np.arctan2(T[1, 0], T[0, 0])
    assert turn == pytest.approx(-np.deg2rad(0.6) * np.sin(np.deg2rad(49.0)), rel=1e-3)


def test_points_stand_on_the_ground_and_images_keep_their_bytes(src: Path, tmp_path: Path) -> None:
    dataset = prepare(src, tmp_path / "out")
    points = dataset.load(dataset.frames[0]).points_body
    np.testing.assert_allclose(points, [[10.0, 0.0, 0.0], [5.0, 2.0, 2.0]], atol=1e-6)
    name = dataset.frames[3].image
    assert name is not None
    assert (dataset.root / name).read_bytes() == png(30)


def test_the_calibration_places_both_cameras(src: Path) -> None:
    (src / DRIVE / "image_03/data").mkdir(parents=True)
    (src / DRIVE / "image_03/timestamps.txt").write_text("\n".join(IMAGES))
    for camera, left in (("image_02", 0.06), ("image_03", -0.48)):
        calibration = read(src, camera=camera).info.calibration["2011_09_26_drive_0001"]
        T = np.array(calibration["T_body_camera"])
        np.testing.assert_allclose(T[:3, 3], (0.27, left, 1.65), atol=1e-12)
        np.testing.assert_allclose(T[:3, :3], [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)
        assert calibration["K"] == [[700.0, 0.0, 6.0], [0.0, 700.0, 4.0], [0.0, 0.0, 1.0]]


def test_lost_scans_packets_and_times_are_borne_and_told(src: Path, tmp_path: Path) -> None:
    drive = src / DRIVE
    (drive / "velodyne_points/data/0000000001.bin").unlink()  # its line is empty, as in the set
    lines = [SCANS[0], "", *SCANS[2:]]
    (drive / "velodyne_points/timestamps.txt").write_text("\n".join(lines))
    (drive / "oxts/data/0000000003.txt").unlink()
    recording = read(src)
    assert recording.notes == [
        "1 of 4 frames of 2011_09_26_drive_0001 have no time, or no packet of oxts within 100 ms: "
        "left out"
    ]
    frames = write_recording(recording, tmp_path / "out").dataset.frames
    lacking = [(f.image is None, f.cloud is None) for f in frames]
    assert lacking == [(False, False), (False, True), (False, False)]
    assert frames[1].timestamp_us == (SECOND + 1) * 1_000_000 + 20_000  # of the image
    assert frames[1].image_time_us is None


def test_frames_may_be_thinned_and_drives_chosen(src: Path) -> None:
    assert len(list(read(src, every_m=20.0).shots)) == 2
    assert read(src, runs=["2011_09_26_drive_0001"]).total == 4
    with pytest.raises(UserError, match="no run 'x': choose from 2011_09_26_drive_0001"):
        read(src, runs=["x"])
    with pytest.raises(UserError, match=r"image_00.* is none of image_02, image_03"):
        read(src, camera="image_00")


def test_the_layout_is_recognised(src: Path, tmp_path: Path) -> None:
    assert recognises(src)
    assert not recognises(src / "2011_09_26")
    assert not recognises(tmp_path / "nothing")
    with pytest.raises(UserError, match="give the folder above"):
        read(src / "2011_09_26")


def rewrite(name: str, change: Callable[[str], str]) -> Callable[[Path], None]:
    def damage(src: Path) -> None:
        path = src / DRIVE / name
        path.write_text(change(path.read_text()))

    return damage


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda t: t[:20], r"0001\.txt: line 1 is not 30"),
        (lambda t: "", r"0001\.txt holds 0 packets"),
        (lambda t: t.replace("9.0", "99"), "near UTM zone"),
        (lambda t: t.replace("100.0", "1e9"), "no packet of"),
    ],
)
def test_a_damaged_packet_costs_its_frame_alone(
    src: Path, tmp_path: Path, change: Callable[[str], str], told: str
) -> None:
    rewrite("oxts/data/0000000001.txt", change)(src)
    with pytest.raises(UserError, match=told):
        prepare(src, tmp_path / "out")
    recording = read(src)
    assert recording.total == 4
    written = write_recording(recording, tmp_path / "out", skip_bad=True)
    [skipped] = written.skipped
    assert skipped.key == f"2011_09_26_drive_0001/{(SECOND + 1) * 1_000_000 + 10_000}"
    assert re.search(told, skipped.reason)
    assert [f.timestamp_us // 10**6 - SECOND for f in written.dataset.frames] == [0, 2, 3]


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (rewrite("oxts/timestamps.txt", lambda t: t.replace("13:00:02", "25:00:02")), "line 3"),
        (rewrite("oxts/timestamps.txt", lambda t: t[:40]), r"timestamps\.txt: line 2 is no time"),
        (rewrite("../calib_imu_to_velo.txt", lambda t: t.replace("R: 1", "R: 2")), "no rigid"),
        (rewrite("../calib_velo_to_cam.txt", lambda t: ""), r"calib_velo_to_cam\.txt has no R"),
        (rewrite("../calib_cam_to_cam.txt", lambda t: t.replace("700", "0")), "no projection"),
    ],
)
def test_damaged_tables_are_named(src: Path, damage: Callable[[Path], None], told: str) -> None:
    damage(src)
    with pytest.raises(UserError, match=told):
        read(src)
