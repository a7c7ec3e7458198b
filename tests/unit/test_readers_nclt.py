# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The NCLT reader on a folder made by hand, byte by byte."""

from __future__ import annotations

import json
import math
import pickle
import shutil
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from adafusion.datasets.recording import Shot, write_recording
from adafusion.readers.nclt.camera import read_lens, read_picture
from adafusion.readers.nclt.reader import read, recognises
from adafusion.types import UserError

START_US = 1_325_867_000_000_000
SCANS_US = [START_US + 1_000_000 * second for second in range(1, 4)]
DAY, EVENING = "2012-01-08", "2012-02-12"

# a picture on its side, 6 wide and 4 high: red holds the column, green the row
WIDTH, HEIGHT = 6, 4
K_CAM5 = "399.433184,0.000000,826.361952\n0.000000,399.433184,621.668624\n0.000000,0.000000,1.0\n"
LB3_CAM5 = "0.041862,-0.001905,-0.000212,160.868615,89.914152,160.619894\n"


def turn(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """About x, then about y, then about z, all of them fixed."""
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def hits(points: Sequence[tuple[float, float, float]]) -> bytes:
    """Records of 8 bytes, of metres in the frame of the file."""
    codes = [[round((value + 100.0) / 0.005) for value in point] for point in points]
    return b"".join(struct.pack("<HHHBB", x, y, z, 40, 7) for x, y, z in codes)


def packet(utime: int, body: bytes) -> bytes:
    return struct.pack("<HHHHIQI", *[44444] * 4, len(body) // 8, utime, 0) + body


def tiff(column_row: list[list[tuple[int, int]]]) -> bytes:
    """A little-endian TIFF of 8-bit RGB in one strip, uncompressed."""
    rows, columns = len(column_row), len(column_row[0])
    pixels = b"".join(bytes((c, r, 200)) for row in column_row for c, r in row)
    bits = 8 + len(pixels)
    entries = [
        (256, 4, 1, columns),
        (257, 4, 1, rows),
        (258, 3, 3, bits),  # bits of each of the three channels lie there
        (259, 3, 1, 1),  # no compression
        (262, 3, 1, 2),  # RGB
        (273, 4, 1, 8),  # where the strip begins
        (277, 3, 1, 3),
        (278, 4, 1, rows),
        (279, 4, 1, len(pixels)),
    ]
    table = b"".join(struct.pack("<HHII", *entry) for entry in entries)
    head = struct.pack("<2sHI", b"II", 42, bits + 6)
    body = pixels + struct.pack("<3H", 8, 8, 8)
    return head + body + struct.pack("<H", len(entries)) + table + struct.pack("<I", 0)


def picture() -> bytes:
    return tiff([[(10 * c, 10 * r) for c in range(WIDTH)] for r in range(HEIGHT)])


def u2d(shift: int = 0) -> str:
    """The undistorted pixel (row, column) lies at (row, column + shift) in the raw picture."""
    lines = [f"width/cols = {WIDTH} , height/rows = {HEIGHT}"]
    lines += [f"{r} {c} {r:.3f} {c + shift:.3f}" for r in range(HEIGHT) for c in range(WIDTH)]
    return "\n".join(lines) + "\n"


def truth(seconds: float = 5.0, speed: float = 12.0) -> str:
    """100 poses a second, northwards from x north = 100, y east = 50; 3 m up. First, nothing."""
    lines = [f"{START_US - 10_000},nan,nan,nan,nan,nan,nan"]
    for k in range(round(100 * seconds) + 1):
        x = 100.0 + speed * k / 100
        lines.append(f"{START_US + 10_000 * k},{x:.6f},50.0,-3.0,0.01,0.02,0.0")
    return "\n".join(lines) + "\n"


def write(path: Path, content: bytes | str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)


def write_run(src: Path, run: str) -> None:
    write(src / f"ground_truth/groundtruth_{run}.csv", truth())
    for utime in SCANS_US:
        scan = hits([(10.0, 2.0, -0.5), (4.0, -3.0, 0.0)])
        write(src / f"velodyne_data/{run}/velodyne_sync/{utime}.bin", scan)
        write(src / f"images/{run}/lb3/Cam5/{utime + 4_000}.tiff", picture())


@pytest.fixture
def src(tmp_path: Path) -> Path:
    src = tmp_path / "nclt"
    write_run(src, DAY)
    write(src / "cam_params/K_cam5.csv", K_CAM5)
    write(src / "cam_params/x_lb3_c5.csv", LB3_CAM5)
    write(src / f"U2D_Cam5_{WIDTH}X{HEIGHT}.txt", u2d())
    return src


def shots_of(src: Path, **options: object) -> list[Shot]:
    recording = read(src, **options)  # type: ignore[arg-type]
    shots = list(recording.shots)
    assert recording.total == len(shots)
    return [pickle.loads(pickle.dumps(shot)) for shot in shots]  # they travel to other processes


def cloud(shot: Shot) -> np.ndarray:
    assert shot.cloud is not None
    return shot.cloud()


def test_a_folder_is_known_by_its_ground_truth(src: Path, tmp_path: Path) -> None:
    assert recognises(src)
    assert not recognises(tmp_path / "nothing")
    assert not recognises(src / "cam_params")


def test_points_turn_from_z_down_to_z_up(src: Path) -> None:
    points = cloud(shots_of(src)[0])
    np.testing.assert_allclose(points, [[10.0, -2.0, 0.5], [4.0, 3.0, 0.0]], atol=1e-5)
    assert points.dtype == np.float32


def test_shots_without_return_and_clamped_hits_are_no_points(src: Path) -> None:
    at_the_sensor = (0.0, 0.0, -0.955)
    beyond = (5.0, 1.0, -100.0)
    path = src / f"velodyne_data/{DAY}/velodyne_sync/{SCANS_US[0]}.bin"
    write(path, hits([at_the_sensor, beyond, (5.0, 1.0, 0.0)]))
    np.testing.assert_allclose(cloud(shots_of(src)[0]), [[5.0, -1.0, 0.0]], atol=1e-5)


def test_poses_are_east_north_up_and_those_of_the_scans(src: Path) -> None:
    frames = [shot.frame for shot in shots_of(src)]
    assert [frame.timestamp_us for frame in frames] == SCANS_US
    assert [frame.image_time_us for frame in frames] == [utime + 4_000 for utime in SCANS_US]
    expected = [[50.0, 112.0, 3.0], [50.0, 124.0, 3.0], [50.0, 136.0, 3.0]]
    np.testing.assert_allclose([frame.position_m for frame in frames], expected, atol=1e-6)
    T = frames[0].T_world_body
    assert T is not None
    # heads north, nose up by 0.02 rad; its left is west, lifted by 0.01 rad: it leans to the right
    np.testing.assert_allclose(T[:3, 0], [0.0, math.cos(0.02), math.sin(0.02)], atol=1e-9)
    np.testing.assert_allclose(T[2, 1], math.cos(0.02) * math.sin(0.01), atol=1e-9)
    assert T[2, 2] > 0.999


def test_heading_turns_clockwise_from_north(src: Path) -> None:
    write(src / f"ground_truth/groundtruth_{DAY}.csv", truth().replace(",0.0\n", ",1.570796327\n"))
    T = shots_of(src)[0].frame.T_world_body
    assert T is not None
    np.testing.assert_allclose(T[:2, 0], [math.cos(0.02), 0.0], atol=1e-6)  # east


def test_a_scan_between_two_poses_gets_one_between_them(src: Path) -> None:
    folder = src / f"velodyne_data/{DAY}/velodyne_sync"
    (folder / f"{SCANS_US[0]}.bin").rename(folder / f"{SCANS_US[0] + 2_500}.bin")
    frame = shots_of(src)[0].frame
    np.testing.assert_allclose(frame.position_m, [50.0, 112.03, 3.0], atol=1e-6)


def test_rows_without_a_pose_are_skipped_and_counted(src: Path) -> None:
    notes = read(src).notes
    assert any("1 of 502 rows hold no pose" in note for note in notes)


def test_frames_without_a_pose_near_are_left_out(src: Path) -> None:
    lines = truth().splitlines(keepends=True)
    write(
        src / f"ground_truth/groundtruth_{DAY}.csv", "".join(lines[:180] + lines[230:])
    )  # 1.78 to 2.29 s are lost
    recording = read(src)
    assert [shot.frame.timestamp_us for shot in recording.shots] == [SCANS_US[0], SCANS_US[2]]
    assert f"run {DAY}: 1 of 3 frames have no pose within 0.2 s: left out" in recording.notes


def test_scans_without_a_picture_near_are_left_out(src: Path) -> None:
    (src / f"images/{DAY}/lb3/Cam5/{SCANS_US[1] + 4_000}.tiff").unlink()
    recording = read(src)
    assert [shot.frame.timestamp_us for shot in recording.shots] == [SCANS_US[0], SCANS_US[2]]
    assert f"run {DAY}: 1 of 3 scans have no image within 10 ms: left out" in recording.notes
    assert len(shots_of(src, slop_ms=3.0)) == 0


def test_frames_lie_as_far_apart_as_is_wished(src: Path) -> None:
    assert len(shots_of(src, every_m=0.0)) == 3
    times = [shot.frame.timestamp_us for shot in shots_of(src, every_m=20.0)]
    assert times == [SCANS_US[0], SCANS_US[2]]


def test_the_runs_of_the_paper_come_first(src: Path) -> None:
    write_run(src, EVENING)
    write_run(src, "2013-04-05")
    recording = read(src)
    assert {shot.frame.run for shot in recording.shots} == {DAY, EVENING}
    assert any("2013-04-05" in note for note in recording.notes)
    assert {shot.frame.run for shot in read(src, runs=["2013-04-05"]).shots} == {"2013-04-05"}
    for run in (DAY, EVENING):
        (src / f"ground_truth/groundtruth_{run}.csv").unlink()
    assert {shot.frame.run for shot in read(src).shots} == {"2013-04-05"}


def test_ground_truth_of_days_that_are_not_there_is_no_run(src: Path) -> None:
    write(src / f"ground_truth/groundtruth_{EVENING}.csv", truth())
    assert {shot.frame.run for shot in read(src).shots} == {DAY}
    with pytest.raises(UserError, match=f"neither velodyne_sync nor pictures .* {EVENING}"):
        read(src, runs=[EVENING])
    with pytest.raises(UserError, match=f"choose from {DAY}"):
        read(src, runs=["2012-13-01"])


@pytest.mark.parametrize("named", [True, False])
def test_folders_may_lie_as_the_archives_have_them(src: Path, named: bool) -> None:
    expected = [shot.frame.key for shot in shots_of(src)]
    scans, images = (src / part / DAY for part in ("velodyne_data", "images"))
    if named:
        scans.rename(src / f"velodyne_data/{DAY}_vel")
        images.rename(src / f"images/{DAY}_lb3")
    else:
        scans.rename(src / DAY)
        (images / "lb3").rename(src / DAY / "lb3")
        truth_file = src / f"ground_truth/groundtruth_{DAY}.csv"
        truth_file.rename(src / DAY / truth_file.name)
    assert [shot.frame.key for shot in shots_of(src)] == expected


def test_a_run_of_one_sensor_gives_frames_of_that_alone(src: Path) -> None:
    write_run(src, EVENING)
    shutil.rmtree(src / f"images/{DAY}")
    shutil.rmtree(src / f"velodyne_data/{EVENING}")
    recording = read(src)
    for shot in recording.shots:
        assert (shot.image is None) == (shot.frame.run == DAY)
        assert (shot.cloud is None) == (shot.frame.run == EVENING)
    assert f"run {DAY} has no pictures: its frames are of the LiDAR alone" in recording.notes
    assert f"run {EVENING} has no scans: its frames are of the camera alone" in recording.notes
    shutil.rmtree(src / f"images/{EVENING}")
    shutil.rmtree(src / "cam_params")  # without a picture, nobody needs them
    assert "K" not in read(src, runs=[DAY]).info.calibration


# ------------------------------------------------------------------------------------------ camera


def test_pictures_are_turned_a_quarter_clockwise(src: Path) -> None:
    shot = shots_of(src)[0]
    assert shot.image is not None
    upright = shot.image()
    assert isinstance(upright, np.ndarray)
    assert upright.shape == (WIDTH, HEIGHT, 3)
    # the left column, read upwards, becomes the top row: (column, row, blue)
    assert upright[0].tolist() == [[0, 30, 200], [0, 20, 200], [0, 10, 200], [0, 0, 200]]
    assert upright[5, 0].tolist() == [50, 30, 200]


def test_pictures_are_undistorted(src: Path) -> None:
    write(src / f"U2D_Cam5_{WIDTH}X{HEIGHT}.txt", u2d(shift=2))
    shot = shots_of(src)[0]
    assert shot.image is not None
    upright = shot.image()
    assert isinstance(upright, np.ndarray)
    assert upright[0, 3].tolist() == [20, 0, 200]  # what was two columns further
    assert upright[4:].max() == 0  # and nothing was beyond


def test_points_fall_where_the_sample_scripts_project_them(src: Path) -> None:
    """Theirs: K inv(T_lb3_camera) inv(T_body_lb3) p of the picture on its side, z down."""
    rng = np.random.default_rng(4)
    points = rng.uniform((2.0, -8.0, -6.0), (30.0, 8.0, 1.0), (200, 3))

    def homogeneous(six: Sequence[float]) -> np.ndarray:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = turn(*np.radians(six[3:])), six[:3]
        return T

    T_body_lb3 = homogeneous([0.035, 0.002, -1.23, -179.93, -0.23, 0.50])
    T_lb3_c = homogeneous([float(word) for word in LB3_CAM5.split(",")])
    seen = np.linalg.inv(T_lb3_c) @ np.linalg.inv(T_body_lb3) @ np.c_[points, np.ones(200)].T
    K = np.array([[float(word) for word in line.split(",")] for line in K_CAM5.splitlines()])
    u, v = (K @ seen[:3])[:2] / seen[2]

    lens = read_lens(src, "Cam5")
    ours = np.linalg.inv(lens.T_body_camera) @ np.c_[points * [1, -1, -1], np.ones(200)].T
    u_upright, v_upright = (lens.K @ ours[:3])[:2] / ours[2]
    np.testing.assert_allclose(ours[2], seen[2], atol=1e-9)  # as far before the camera
    np.testing.assert_allclose(u_upright, HEIGHT - 1 - v, atol=1e-6)
    np.testing.assert_allclose(v_upright, u, atol=1e-6)


def test_the_front_camera_looks_ahead_and_stands_upright(src: Path) -> None:
    T = read_lens(src, "Cam5").T_body_camera
    right, down, ahead = T[:3, :3].T
    np.testing.assert_allclose(ahead, [1.0, 0.0, 0.0], atol=0.02)
    np.testing.assert_allclose(right, [0.0, -1.0, 0.0], atol=0.02)
    np.testing.assert_allclose(down, [0.0, 0.0, -1.0], atol=0.02)
    np.testing.assert_allclose(T[:3, 3], [0.077, 0.0, 1.23], atol=0.01)


def test_calibration_may_lie_elsewhere_and_must_be_there(src: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "calibration"
    elsewhere.mkdir()
    (src / "cam_params").rename(elsewhere / "cam_params")
    with pytest.raises(UserError, match=r"no K_cam5\.csv .*--calibration"):
        read(src)
    (src / f"U2D_Cam5_{WIDTH}X{HEIGHT}.txt").rename(elsewhere / "U2D_Cam5.txt")
    with pytest.raises(UserError, match=r"no U2D_Cam5_\*\.txt"):
        read(src, calibration=elsewhere)
    (elsewhere / "U2D_Cam5.txt").rename(elsewhere / f"U2D_Cam5_{WIDTH}X{HEIGHT}.txt")
    assert len(list(read(src, calibration=elsewhere).shots)) == 3


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        (f"U2D_Cam5_{WIDTH}X{HEIGHT}.txt", u2d().replace("\n1 3 ", "\n1 2 "), "each pixel"),
        (f"U2D_Cam5_{WIDTH}X{HEIGHT}.txt", u2d().replace("\n1 3 ", "\n1 9 "), "each pixel"),
        (f"U2D_Cam5_{WIDTH}X{HEIGHT}.txt", u2d().replace("\n1 3 ", "\n1 x "), "line 11"),
        (f"U2D_Cam5_{WIDTH}X{HEIGHT}.txt", u2d()[:100], "too short"),
        (f"U2D_Cam5_{WIDTH}X{HEIGHT}.txt", "no size\n", "line 1"),
        (f"U2D_Cam5_{WIDTH}X{HEIGHT}.txt", "30000,30000\n0 0 0 0\n", "too short"),
        ("cam_params/K_cam5.csv", "1,2,3\n", "3x3"),
        ("cam_params/K_cam5.csv", "1,2,3\n4,5,6\n7,8,9\n", "3x3"),
        ("cam_params/K_cam5.csv", "1,2\n", "line 1"),
        ("cam_params/x_lb3_c5.csv", "1,2,3\n", "3 numbers"),
        ("cam_params/x_lb3_c5.csv", "", "0 numbers"),
        ("U2D_Cam5_7X4.txt", "", "several"),
    ],
)
def test_damaged_calibration_is_refused_by_name(
    src: Path, name: str, content: str, says: str
) -> None:
    write(src / name, content)
    with pytest.raises(UserError, match=says) as error:
        [shot.image() for shot in read(src).shots if shot.image]
    assert Path(name).name in str(error.value)


def test_a_picture_of_another_size_than_the_map_is_refused(src: Path, tmp_path: Path) -> None:
    write(tmp_path / "odd.tiff", tiff([[(0, 0)] * 5] * 4))
    with pytest.raises(UserError, match=r"odd\.tiff is 5 x 4, .* 6 x 4"):
        read_picture(tmp_path / "odd.tiff", src / f"U2D_Cam5_{WIDTH}X{HEIGHT}.txt")


# ------------------------------------------------------------------------------- packets of a turn

POLE = np.array([60.0, 125.0, 4.0])  # in the world: east of the robot's way, and ahead


def stream(times: Sequence[int]) -> bytes:
    """A packet at each time, that shows a pole from where the robot of `truth` is then."""
    R_nclt_velodyne = turn(*np.radians([0.807, 0.166, -90.703]))
    R_ned_nclt = turn(0.01, 0.02, 0.0)  # it leans a little, and heads north
    packets = []
    for utime in times:
        robot_ned = np.array([100.0 + 12.0 * (utime - START_US) / 1e6, 50.0, -3.0])
        pole_nclt = R_ned_nclt.T @ (POLE[[1, 0, 2]] * (1, 1, -1) - robot_ned)
        pole_velodyne = R_nclt_velodyne.T @ (pole_nclt - (0.002, -0.004, -0.957))
        lost = struct.pack("<HHHBB", 20000, 20000, 20000, 0, 3)  # came back from nowhere
        packets.append(packet(utime, lost + hits([tuple(pole_velodyne.tolist())]) * 3))
    return b"".join(packets)


@pytest.fixture
def hits_file(src: Path) -> Path:
    """Five seconds of packets, 100 a second, each at an odd time."""
    path = src / f"velodyne_data/{DAY}/velodyne_hits.bin"
    write(path, stream([START_US + 10_000 * k + 1_234 for k in range(500)]))
    return path


def test_a_turn_is_freed_of_the_robots_motion(src: Path, hits_file: Path) -> None:
    shots = shots_of(src, lidar="velodyne_hits")
    assert [shot.frame.timestamp_us for shot in shots] == [t + 4_000 for t in SCANS_US]
    for shot in shots:
        points, T = cloud(shot), shot.frame.T_world_body
        assert T is not None
        assert len(points) == 30  # of ten packets; shots without return are left out
        world = points @ T[:3, :3].T + T[:3, 3]
        np.testing.assert_allclose(world, np.tile(POLE, (30, 1)), atol=0.006)  # 5 mm steps


def test_a_run_without_pictures_takes_a_turn_five_times_a_second(
    src: Path, hits_file: Path
) -> None:
    shutil.rmtree(src / f"images/{DAY}")
    recording = read(src, lidar="velodyne_hits", every_m=0.0)
    times = np.array([shot.frame.timestamp_us for shot in recording.shots])
    assert set(np.diff(times)) == {200_000}
    assert len(times) == 25  # of 26: the first has no turn before it
    assert f"run {DAY}: 1 of 26 frames have no pose within 0.2 s: left out" in recording.notes


def test_turns_with_a_gap_are_left_out(src: Path, hits_file: Path) -> None:
    gap = range(195, 198)  # around 1.96 s, just before the second picture
    times = [START_US + 10_000 * k + 1_234 for k in range(500) if k not in gap]
    write(hits_file, stream(times))
    recording = read(src, lidar="velodyne_hits")
    assert [shot.frame.timestamp_us for shot in recording.shots] == [
        SCANS_US[0] + 4_000,
        SCANS_US[2] + 4_000,
    ]
    assert f"run {DAY}: 1 of 3 frames have no whole turn of the LiDAR: left out" in recording.notes


def test_a_stream_that_was_cut_short_gives_what_it_has(src: Path, hits_file: Path) -> None:
    data = hits_file.read_bytes()
    write(hits_file, data[: len(data) // 2 + 5])
    assert len(shots_of(src, lidar="velodyne_hits")) == 2  # 2.5 of 5 seconds


def test_a_damaged_stream_is_refused_by_offset(src: Path, hits_file: Path) -> None:
    shots = shots_of(src, lidar="velodyne_hits")
    data = bytearray(hits_file.read_bytes())
    size = len(data) // 500
    data[95 * size : 95 * size + 2] = b"??"  # a packet of the first turn
    hits_file.write_bytes(data)
    with pytest.raises(UserError, match=rf"velodyne_hits\.bin: no packet .* byte {95 * size}"):
        cloud(shots[0])


def test_a_hole_in_a_stream_costs_the_frames_in_it_alone(
    src: Path, hits_file: Path, tmp_path: Path
) -> None:
    data = hits_file.read_bytes()
    size = len(data) // 500
    # 200 kB of zeros in place of 2.95 to 2.99 s, the turn of the third picture is from 2.904 on
    write(hits_file, data[: 295 * size] + bytes(200_000) + data[299 * size :])
    written = write_recording(read(src, lidar="velodyne_hits"), tmp_path / "out", skip_bad=True)
    assert [f.timestamp_us for f in written.dataset.frames] == [t + 4_000 for t in SCANS_US[:2]]


def test_a_hole_too_large_to_be_searched_is_named_by_the_frame(
    src: Path, hits_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("adafusion.readers.nclt.velodyne._LARGEST_HOLE", 100_000)
    data = hits_file.read_bytes()
    size = len(data) // 500
    write(hits_file, data[: 150 * size] + bytes(300_000) + data[320 * size :])
    [shot, *_] = shots_of(src, lidar="velodyne_hits")
    with pytest.raises(UserError, match=r"velodyne_hits\.bin: no packet begins within 100000"):
        cloud(shot)


# ------------------------------------------------------------------------------------ GPS and more


def test_gps_and_inertial_unit_are_kept_apart(src: Path) -> None:
    latitude = math.radians(42.293227) + 1e-5
    longitude = math.radians(-83.709657) - 2e-5
    fixes = [
        f"{SCANS_US[0] + 200_000 * k},3,7,{latitude:.12f},{longitude:.12f},272.0,0.5,0.1"
        for k in (-1, 1)
    ]
    lost = f"{SCANS_US[0]},0,0,nan,nan,nan,nan,nan"
    flat = f"{SCANS_US[0] + 1},2,3,0.7,0.7,0.0,0.0,0.0"  # of too few satellites for an altitude
    write(src / f"sensor_data/{DAY}/gps.csv", "\n".join([fixes[0], lost, flat, fixes[1]]))
    angles = [f"{SCANS_US[0] + 20_000 * k},0.0,0.0,{math.pi / 2}" for k in range(-5, 5)]
    write(src / f"sensor_data/{DAY}/ms25_euler.csv", "\n".join(angles))
    frames = [shot.frame for shot in shots_of(src)]
    T = frames[0].T_world_ins
    assert T is not None
    # at that latitude a radian of it is 6,364 km, of the parallel 6,388 km * cos(latitude)
    east, north = -2e-5 * 6_387_807 * math.cos(math.radians(42.293227)), 1e-5 * 6_364_373
    np.testing.assert_allclose(T[:3, 3], [east, north, 2.0], atol=0.01)
    np.testing.assert_allclose(T[:3, 0], [1.0, 0.0, 0.0], atol=1e-9)  # heads east
    assert frames[1].T_world_ins is None  # the unit had stopped by then


def test_a_synthetic_world_says_so(src: Path) -> None:
    manifest = {
        "synthetic": True,
        "generator": "adafusion synthetic world, version 7",
        "licence": "CC0-1.0",
        "seed": 5,
        "profile": "tiny",
    }
    assert read(src).info.name == "nclt"
    assert read(src).info.world == "NCLT local ENU"
    write(src / "manifest.json", json.dumps(manifest))
    info = read(src).info
    assert info.synthetic
    assert info.name == "synthetic world in nclt layout"
    assert info.world == "synthetic world 5 profile tiny version 7"
    assert info.source.startswith("adafusion synthetic world, version 7, seed 5, profile tiny; ")
    assert info.source.endswith("every 10 m, Cam5, velodyne_sync, at most 10 ms apart")
    write(src / "manifest.json", "{")
    with pytest.raises(UserError, match=r"manifest\.json is no JSON"):
        read(src)


def test_settings_that_decide_what_is_written_are_in_its_source(src: Path) -> None:
    source = read(src, every_m=5.0, slop_ms=20.0).info.source
    assert source.endswith("every 5 m, Cam5, velodyne_sync, at most 20 ms apart")
    source = read(src, calibration=src).info.source
    assert source.endswith(f"at most 10 ms apart, calibration {src}")


def test_it_writes_a_dataset(src: Path, tmp_path: Path) -> None:
    dataset = write_recording(read(src), tmp_path / "out").dataset
    assert [frame.key for frame in dataset.frames] == [f"{DAY}/{utime}" for utime in SCANS_US]
    observation = dataset.load(dataset.frames[0])
    assert observation.image is not None
    assert observation.image.shape == (WIDTH, HEIGHT, 3)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"camera": "Cam7"}, "choose from Cam0"),
        ({"lidar": "hokuyo"}, "choose from velodyne_sync"),
        ({"every_m": -1.0}, "0 or more"),
        ({"slop_ms": float("nan")}, "0 or more"),
        ({"runs": []}, "no run"),
        ({"camera": "Cam3", "lidar": "velodyne_hits"}, "neither velodyne_hits nor"),
    ],
)
def test_wrong_options_are_refused(src: Path, options: dict[str, object], says: str) -> None:
    with pytest.raises(UserError, match=says):
        read(src, **options)  # type: ignore[arg-type]


def test_a_folder_without_ground_truth_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="ground_truth"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("1,2,3\n", "line 1"),
        (truth().replace("0.02,0.0\n", "0.02,left\n", 1), "line 2"),
        ("nan,nan,nan,nan,nan,nan,nan\n", "no pose"),
        ("", "no pose"),
        ("-5,0,0,0,0,0,0\n", "microseconds"),
        ("1e300,0,0,0,0,0,0\n", "microseconds"),
    ],
)
def test_damaged_ground_truth_is_refused_by_line(src: Path, content: str, says: str) -> None:
    write(src / f"ground_truth/groundtruth_{DAY}.csv", content)
    with pytest.raises(UserError, match=says):
        read(src)


@pytest.mark.parametrize(
    ("content", "says"), [(b"", "no points"), (b"1234567", "cut short"), (b"\0" * 8, "no points")]
)
def test_damaged_scans_are_refused_by_name(src: Path, content: bytes, says: str) -> None:
    path = src / f"velodyne_data/{DAY}/velodyne_sync/{SCANS_US[0]}.bin"
    write(path, content)
    with pytest.raises(UserError, match=says) as error:
        cloud(shots_of(src)[0])
    assert path.name in str(error.value)
