# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The Boreas reader on a run made by hand."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from adafusion.datasets import Dataset
from adafusion.datasets.recording import write_recording
from adafusion.readers.boreas import read, recognises
from adafusion.types import UserError

RUN = "boreas-2021-08-05-13-34"
START_US = 1_628_184_886_518_266
HEADER = (
    "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,"
    "angvel_z,angvel_y,angvel_x"
)
# The LiDAR is turned left by a quarter against the Applanix (x right, y forward), so that its x
# looks ahead, and its y left. The camera looks along x of the LiDAR, 0.3 m ahead of it and 0.8 m
# below.
CALIBRATION = {
    "P_camera.txt": "1400 0 1200 0\n0 1400 1000 0\n0 0 1 0\n0 0 0 1\n",
    "T_applanix_lidar.txt": "0 -1 0 0\n1 0 0 0\n0 0 1 0.3\n0 0 0 1\n",
    "T_camera_lidar.txt": "0 -1 0 0\n0 0 -1 -0.8\n1 0 0 -0.3\n0 0 0 1\n",
}


def png(level: int) -> bytes:
    return cv2.imencode(".png", np.full((8, 12, 3), level, np.uint8))[1].tobytes()


def scan(height_m: float = 2.0) -> bytes:
    """A level ground, two metres below the LiDAR, with a post."""
    ground = [(x, y, -height_m) for x in np.linspace(-9, 9, 25) for y in np.linspace(-9, 9, 25)]
    points = [(4.0, 1.0, 0.5), *ground]
    return b"".join(struct.pack("<6f", *p, 7.0, 3.0, 0.01) for p in points)


@pytest.fixture
def src(tmp_path: Path) -> Path:
    """Four scans 0.1 s and 10 m apart along east; images 20 ms after; the last one is far off."""
    run = tmp_path / "boreas" / RUN
    for name in ("camera", "lidar", "applanix", "calib"):
        (run / name).mkdir(parents=True)
    rows = [HEADER]
    for i in range(4):
        us = START_US + 100_000 * i
        # the sign of heading is the other way round: 0 looks east, +90 degrees south
        rows.append(f"{us},{100.0 + 10 * i},50.0,20.0,100,0,0,0,0,0,0,0,0")
        (run / "lidar" / f"{us}.bin").write_bytes(scan())
        late_us = 20_000 if i < 3 else 70_000
        (run / "camera" / f"{us + late_us}.png").write_bytes(png(i))
    (run / "applanix/lidar_poses.csv").write_text("\n".join(rows) + "\n")
    for name, text in CALIBRATION.items():
        (run / "calib" / name).write_text(text)
    return tmp_path / "boreas"


def prepare(src: Path, out: Path, **options: object) -> Dataset:
    return write_recording(read(src, **options), out).dataset  # type: ignore[arg-type]


def test_scans_find_their_poses_and_the_images_nearest_in_time(src: Path, tmp_path: Path) -> None:
    recording = read(src)
    assert recording.notes == [
        f"1 of 4 scans of {RUN} have no image within 50 ms: left out",
        "the LiDAR is 2.00 m above the ground, by the clouds",
    ]
    dataset = write_recording(recording, tmp_path / "out").dataset
    assert [frame.timestamp_us - START_US for frame in dataset.frames] == [0, 100_000, 200_000]
    assert [f.image_time_us for f in dataset.frames] == [
        START_US + 100_000 * i + 20_000 for i in range(3)
    ]
    np.testing.assert_allclose(
        dataset.positions_m, [[100.0 + 10 * i, 50.0, 18.0] for i in range(3)], atol=1e-9
    )
    name = dataset.frames[1].image
    assert name is not None
    assert (dataset.root / name).read_bytes() == png(1)
    assert dataset.world == "Boreas ENU"


def test_a_greater_slop_takes_more_images(src: Path) -> None:
    assert read(src, slop_ms=80.0).total == 4


def test_heading_roll_and_pitch_turn_as_the_data_reference_says(src: Path) -> None:
    csv = src / RUN / "applanix/lidar_poses.csv"
    row = f"{START_US},0,0,0,0,0,0,"
    for angles, forward in (
        ("0,0,0", (1.0, 0.0, 0.0)),
        (f"0,0,{np.pi / 2}", (0.0, -1.0, 0.0)),  # R = Rx(-roll) Ry(-pitch) Rz(-heading)
        (f"0,{0.1},0", (np.cos(0.1), 0.0, np.sin(0.1))),
        (f"{0.1},0,{np.pi / 2}", (0.0, -np.cos(0.1), np.sin(0.1))),
    ):
        csv.write_text(f"{HEADER}\n{row}{angles},0,0,0\n")
        (shot,) = read(src, lidar_height_m=2.0).shots
        T = shot.frame.T_world_body
        assert T is not None
        np.testing.assert_allclose(T[:3, 0], forward, atol=1e-12)  # the body's x is the LiDAR's


def test_points_and_sensors_are_in_the_body_frame(src: Path, tmp_path: Path) -> None:
    dataset = prepare(src, tmp_path / "out")
    points = dataset.load(dataset.frames[0]).points_body
    assert points is not None
    np.testing.assert_allclose(points[0], (4.0, 1.0, 2.5), atol=1e-5)
    assert abs(points[1:, 2]).max() < 1e-5
    T = np.array(dataset.info.calibration[RUN]["T_body_camera"])
    np.testing.assert_allclose(T[:3, 3], (0.3, 0.0, 1.2), atol=1e-12)
    np.testing.assert_allclose(T[:3, 2], (1.0, 0.0, 0.0), atol=1e-12)  # it looks ahead
    assert dataset.info.calibration[RUN]["K"][0] == [1400.0, 0.0, 1200.0]


def test_a_lidar_that_is_mounted_askew_is_turned_into_the_body(src: Path, tmp_path: Path) -> None:
    # with the axes of the Applanix, the LiDAR's y looks ahead: a point at y = 4 is 4 m ahead
    identity = "1 0 0 0\n0 1 0 0\n0 0 1 0.3\n0 0 0 1\n"
    (src / RUN / "calib/T_applanix_lidar.txt").write_text(identity)
    cloud = struct.pack("<6f", 0.0, 4.0, 0.5, 7, 3, 0.0)
    for path in (src / RUN / "lidar").iterdir():
        path.write_bytes(cloud)
    dataset = prepare(src, tmp_path / "out", lidar_height_m=1.5)
    points = dataset.load(dataset.frames[0]).points_body
    np.testing.assert_allclose(points, [[4.0, 0.0, 2.0]], atol=1e-6)


def test_a_run_without_images_gives_clouds_alone(src: Path) -> None:
    for path in (src / RUN / "camera").iterdir():
        path.unlink()
    recording = read(src)
    assert recording.total == 4
    assert "has clouds alone" in recording.notes[0]
    assert all(shot.image is None for shot in recording.shots)


def test_scans_without_a_pose_are_left_out_and_told(src: Path) -> None:
    (src / RUN / "lidar" / f"{START_US - 1_000_000}.bin").write_bytes(scan())
    recording = read(src)
    assert recording.total == 3
    assert f"1 of 5 scans of {RUN} have no pose: left out" in recording.notes


def test_frames_are_thinned_by_travel(src: Path) -> None:
    times = [shot.frame.timestamp_us - START_US for shot in read(src, every_m=15.0).shots]
    assert times == [0, 200_000]


def test_large_coordinates_are_those_of_utm(src: Path, tmp_path: Path) -> None:
    csv = src / RUN / "applanix/lidar_poses.csv"
    csv.write_text(csv.read_text().replace(",50.0,", ",4848821.0,"))
    assert prepare(src, tmp_path / "out").world == "UTM zone 17N"


def test_the_layout_is_recognised_and_runs_can_be_chosen(src: Path) -> None:
    assert recognises(src)
    assert not recognises(src / RUN)
    assert read(src, runs=[RUN]).total == 3
    with pytest.raises(UserError, match=f"no run 'x': choose from {RUN}"):
        read(src, runs=["x"])
    with pytest.raises(UserError, match="give the folder above"):
        read(src / RUN)


def rewrite(name: str, change: Callable[[str], str]) -> Callable[[Path], None]:
    def damage(src: Path) -> None:
        path = src / RUN / name
        path.write_text(change(path.read_text()))

    return damage


POSES = "applanix/lidar_poses.csv"


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (rewrite(POSES, lambda t: t[:-20]), r"lidar_poses\.csv: line 5 has 5 fields"),
        (rewrite(POSES, lambda t: t.replace("110.0", "x")), "line 3 is no pose"),
        (rewrite(POSES, lambda t: t.replace("110.0", "nan")), "line 3 is no pose"),
        (rewrite(POSES, lambda t: t.replace("110.0", "1e300")), "no rigid motion"),
        (rewrite(POSES, lambda t: t.replace("heading", "head")), "no column heading"),
        (rewrite(POSES, lambda t: t + t.splitlines()[1]), "line 6 is no later time"),
        (rewrite(POSES, lambda t: HEADER), "holds no poses"),
        (rewrite("calib/P_camera.txt", lambda t: t.replace("1400", "0")), "no projection"),
        (rewrite("calib/T_camera_lidar.txt", lambda t: t[:12]), "line 2 is not 4"),
        (rewrite("calib/T_applanix_lidar.txt", lambda t: "1 0 0 0\n"), "has 1 rows, not 4"),
        (rewrite("calib/T_applanix_lidar.txt", lambda t: t.replace("-1", "1")), "no rigid"),
    ],
)
def test_damaged_tables_are_named(src: Path, damage: Callable[[Path], None], told: str) -> None:
    damage(src)
    with pytest.raises(UserError, match=told):
        read(src)


def test_a_damaged_scan_is_named_when_it_is_read(src: Path, tmp_path: Path) -> None:
    path = src / RUN / "lidar" / f"{START_US}.bin"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(UserError, match=rf"{path.name} is cut short.* 24-byte points"):
        prepare(src, tmp_path / "out")
