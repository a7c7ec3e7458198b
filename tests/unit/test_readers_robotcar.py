# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""RobotCar's raw layout, written here by hand from its public description; worked numbers."""

from __future__ import annotations

import json
import pickle
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from adafusion.datasets.recording import Recording, Shot
from adafusion.readers.robotcar import reader as robotcar
from adafusion.readers.robotcar.files import read_picture, read_poses, read_scan
from adafusion.readers.robotcar.submaps import looks_down_rad, sweep
from adafusion.readers.sensors import T_ENU_NED
from adafusion.readers.track import Track
from adafusion.types import UserError

RUN = "2014-12-02-15-30-08"
START_US = 1_417_534_208_000_000
SPEED_M_S = 5.0
NORTH_M, EAST_M, UP_M = 5_735_000.0, 620_000.0, 100.0  # of the INS, as it starts
INS_HEADER = (
    "timestamp,ins_status,latitude,longitude,altitude,northing,easting,down,utm_zone,"
    "velocity_north,velocity_east,velocity_down,roll,pitch,yaw"
)
RTK_HEADER = INS_HEADER.replace("ins_status,", "")


def write(path: Path, content: bytes | str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())


def png(raw: np.ndarray) -> bytes:
    return cv2.imencode(".png", raw)[1].tobytes()


def ins_row(time_us: int, north_m: float, status: str | None = "INS_SOLUTION_GOOD") -> str:
    words = [str(time_us), *([status] if status else []), "51.76", "-1.26", str(UP_M)]
    words += [f"{north_m:.6f}", f"{EAST_M:.6f}", f"{-UP_M:.6f}", "30U", "5.0", "0.0", "0.0"]
    return ",".join([*words, "0.0", "0.0", "0.0"])


def fan(*points: tuple[float, float]) -> bytes:
    return b"".join(struct.pack("<3d", x, y, 77.0) for x, y in points)


def write_kit(folder: Path, height: int = 4, width: int = 6) -> None:
    """A camera and sensors that sit straight on the vehicle."""
    axes = "0 0 1 0\n1 0 0 0\n0 1 0 0\n0 0 0 1\n"  # optical z forward, x right, y down
    write(folder / "models/stereo_narrow_left.txt", f"5 5 2.5 1.5\n{axes}")
    columns = [float(c) for _ in range(height) for c in range(width)]
    rows = [float(r) for r in range(height) for _ in range(width)]
    lut = struct.pack(f"<{2 * height * width}d", *columns, *rows)
    write(folder / "models/stereo_narrow_left_distortion_lut.bin", lut)
    write(folder / "extrinsics/stereo.txt", "0 0 0 0 0 0\n")
    write(folder / "extrinsics/ins.txt", "-1.0 0.0 0.5 0.0 0.0 0.0")  # 1 m behind, 0.5 m below
    # 2 m ahead and 1 m below the camera, its x axis straight down
    write(folder / "extrinsics/lms_front.txt", f"2.0 0.0 1.0 0.0 {-np.pi / 2:.9f} 0.0\n")
    write(folder / "extrinsics/ldmrs.txt", "2.0 0.0 1.0 0.0 0.0 0.0\n")


def write_run(
    folder: Path, *, seconds: float = 8.0, waits_s: float = 0.0, status: str | None = None
) -> None:
    """Straight to the north: poses and fans 50 a second, 5 ms apart; a picture every 2 m."""

    def north_m(time_us: int) -> float:
        return NORTH_M + SPEED_M_S * max((time_us - START_US) * 1e-6 - waits_s, 0.0)

    end_us = START_US + round((seconds + waits_s) * 1e6)
    rows = [
        ins_row(t, north_m(t), status or "INS_SOLUTION_GOOD")
        for t in range(START_US, end_us + 1, 20_000)
    ]
    write(folder / "gps/ins.csv", "\n".join([INS_HEADER, *rows]) + "\n")
    for t in range(START_US + 5_000, end_us, 20_000):
        # the ground right below; what is 3 m to the right; a beam without an echo
        write(folder / f"lms_front/{t}.bin", fan((0.52, 0.0), (0.0, 3.0), (0.0, 0.0)))
    raw = np.tile(np.array([[100, 200], [50, 100]], np.uint8), (2, 3))  # G B / R G
    for t in range(START_US + 5_000, end_us, 400_000):
        write(folder / f"stereo/centre/{t}.png", png(raw))


@pytest.fixture
def src(tmp_path: Path) -> Path:
    write_kit(tmp_path)
    write_run(tmp_path / RUN)
    return tmp_path


def shots(recording: Recording) -> list[Shot]:
    return list(recording.shots)


def points_of(shot: Shot) -> np.ndarray:
    assert shot.cloud is not None
    return pickle.loads(pickle.dumps(shot.cloud))()  # as it travels to another process


def test_it_recognises_runs_with_poses(src: Path, tmp_path: Path) -> None:
    assert robotcar.recognises(src)
    assert not robotcar.recognises(src / RUN)
    (src / RUN / "gps/ins.csv").unlink()
    assert not robotcar.recognises(src)
    assert not robotcar.recognises(tmp_path / "nothing")


def test_a_frame_lies_on_the_ground_below_the_camera_at_the_pictures_instant(src: Path) -> None:
    first, second = shots(robotcar.read(src))
    # 5 ms after the start: 2.5 cm; the camera is 1 m before the INS and 0.5 m above
    assert first.frame.timestamp_us == START_US + 5_000
    np.testing.assert_allclose(
        first.frame.position_m, (EAST_M, NORTH_M + 1.025, UP_M + 0.5 - 1.52), atol=1e-5
    )
    np.testing.assert_allclose(  # x to the north, y to the west
        first.frame.T_world_body[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-6
    )
    assert second.frame.position_m[1] == pytest.approx(NORTH_M + 11.025, abs=1e-5)
    assert second.frame.timestamp_us == START_US + 2_005_000
    assert first.frame.T_world_ins is None


def test_a_submap_is_the_20_m_ahead_in_the_body_frame_of_its_beginning(src: Path) -> None:
    points = points_of(shots(robotcar.read(src))[0])
    assert points.dtype == np.float32
    ground, right = points[::2], points[1::2]
    # a fan every 10 cm, from the one at the instant itself to 20 m on; the laser 2 m ahead
    np.testing.assert_allclose(ground[:, 0], 2.0 + 0.1 * np.arange(len(ground)), atol=1e-5)
    assert len(ground) in (200, 201)  # whether 20 m are reached, the last bit decides
    np.testing.assert_allclose(ground[:, 1:], 0.0, atol=1e-6)
    np.testing.assert_allclose(right[:, 1:], np.tile([-3.0, 0.52], (len(right), 1)), atol=1e-6)


def test_frames_are_spaced_along_the_way(src: Path) -> None:
    assert robotcar.read(src).total == 2  # 40 m, of which the last 20 m begin no submap
    assert [s.frame.timestamp_us for s in shots(robotcar.read(src, every_m=0.0))] == [
        START_US + 5_000 + 400_000 * k for k in range(10)
    ]
    assert len(shots(robotcar.read(src, every_m=4.0))) == 5


def test_a_vehicle_that_waits_adds_nothing(tmp_path: Path) -> None:
    write_kit(tmp_path)
    write_run(tmp_path / RUN, waits_s=4.0)
    first, second = shots(robotcar.read(tmp_path))
    assert first.frame.timestamp_us == START_US + 5_000
    assert second.frame.position_m[1] - first.frame.position_m[1] >= 10.0 - 1e-6
    assert 398 <= len(points_of(first)) <= 404


def test_the_calibration_is_told(src: Path) -> None:
    info = robotcar.read(src).info
    assert info.name == "robotcar"
    assert not info.synthetic
    assert info.world == "UTM zone 30N"
    known = {name: np.array(value) for name, value in info.calibration.items()}
    np.testing.assert_allclose(known["K"], [[5, 0, 2.5], [0, 5, 1.5], [0, 0, 1]])
    np.testing.assert_allclose(
        known["T_body_camera"],
        [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1.52], [0, 0, 0, 1]],
        atol=1e-6,
    )
    np.testing.assert_allclose(
        known["T_body_lidar"],
        [[0, 0, -1, 2], [0, -1, 0, 0], [-1, 0, 0, 0.52], [0, 0, 0, 1]],
        atol=1e-6,
    )


def test_an_export_is_never_called_real(src: Path) -> None:
    manifest = {"synthetic": True, "licence": "CC0-1.0", "seed": 3, "profile": "tiny"}
    (src / "manifest.json").write_text(json.dumps(manifest))
    info = robotcar.read(src, calibration=src).info
    assert "submaps of 20 m of lms_front, every 10 m" in info.source
    assert info.source.endswith(f"calibration {src}")
    assert info.synthetic
    assert info.name == "synthetic world in robotcar layout"
    assert info.licence == "CC0-1.0"


# ------------------------------------------------------------------------------------------ camera


@pytest.mark.parametrize(
    ("code", "pattern"),
    [
        (cv2.COLOR_BayerGBRG2RGB, [["G", "B"], ["R", "G"]]),
        (cv2.COLOR_BayerRGGB2RGB, [["R", "G"], ["G", "B"]]),
    ],
)
def test_each_colour_comes_from_its_own_pixels(
    tmp_path: Path, code: int, pattern: list[list[str]]
) -> None:
    write_kit(tmp_path)
    value = {"R": 50, "G": 100, "B": 200}
    raw = np.tile(np.array([[value[c] for c in row] for row in pattern], np.uint8), (2, 3))
    write(tmp_path / "1.png", png(raw))
    lut = tmp_path / "models/stereo_narrow_left_distortion_lut.bin"
    image = read_picture(tmp_path / "1.png", lut, code)
    assert image.shape == (4, 6, 3)
    assert (image == (50, 100, 200)).all()
    assert robotcar.CAMERAS["stereo/centre"].demosaic == cv2.COLOR_BayerGBRG2RGB
    assert robotcar.CAMERAS["mono_rear"].demosaic == cv2.COLOR_BayerRGGB2RGB


def test_the_table_holds_all_columns_then_all_rows_of_the_raw_picture(tmp_path: Path) -> None:
    height, width = 8, 12
    raw = np.add.outer(np.arange(height) * 10, np.arange(width) * 3).astype(np.uint8)  # a ramp
    write(tmp_path / "1.png", png(raw))
    columns = [c + 0.5 for _ in range(height) for c in range(width)]  # half a column to the right
    rows = [float(r + 2) for r in range(height) for _ in range(width)]  # two rows down
    write(tmp_path / "lut.bin", struct.pack(f"<{2 * height * width}d", *columns, *rows))
    image = read_picture(tmp_path / "1.png", tmp_path / "lut.bin", cv2.COLOR_BayerGBRG2RGB)
    inside = image[1:4, 2:9].astype(int)  # away from the rim, where colours are copied
    expected = np.add.outer((np.arange(1, 4) + 2) * 10, (np.arange(2, 9) + 0.5) * 3)
    assert np.abs(inside - expected[..., None]).max() <= 1
    assert (image[-1] == 0).all()  # looked up beyond the last row


@pytest.mark.parametrize(
    ("camera", "model", "extrinsics"),
    [
        ("stereo/left", "stereo_wide_left", "stereo"),
        ("stereo/right", "stereo_wide_right", "stereo"),
        ("stereo/centre", "stereo_narrow_left", "stereo"),
        ("mono_left", "mono_left", "mono_left"),
        ("mono_right", "mono_right", "mono_right"),
        ("mono_rear", "mono_rear", "mono_rear"),
    ],
)
def test_each_folder_has_its_model(src: Path, camera: str, model: str, extrinsics: str) -> None:
    axes = "0 0 1 0\n1 0 0 0\n0 1 0 0\n0 0 0 1\n"
    for name in ("stereo_wide_left", "stereo_wide_right", "mono_left", "mono_right", "mono_rear"):
        write(src / f"models/{name}.txt", f"{len(name)} 9 1 1\n{axes}")
    write(src / "models/stereo_narrow_left.txt", f"{len('stereo_narrow_left')} 9 1 1\n{axes}")
    for name in ("mono_left", "mono_right", "mono_rear"):
        write(src / f"extrinsics/{name}.txt", "0 0 0 0 0 0")
    recording = robotcar.read(src, camera=camera)
    assert recording.info.calibration["K"][0][0] == len(model)
    assert robotcar.CAMERAS[camera].extrinsics == extrinsics


def test_a_cameras_extrinsics_are_the_stereo_camera_as_it_sees_it(src: Path) -> None:
    # the kit's numbers of the camera on the left of the roof, behind the stereo camera
    write(src / "extrinsics/mono_left.txt", "-0.0905 1.6375 0.2803 0.2079 -0.2339 1.2321\n")
    (src / "models/stereo_narrow_left.txt").rename(src / "models/mono_left.txt")
    T = np.array(robotcar.read(src, camera="mono_left").info.calibration["T_body_camera"])
    assert T[0, 3] < -1.0
    assert 0.3 < T[1, 3] < 1.0
    assert T[1, 2] > 0.8  # it looks to the left


def test_how_far_the_camera_looks_down_shows_in_the_way_it_goes() -> None:
    time_us = np.arange(0, 10_000_000, 20_000)
    slope, tilt = 0.1, 0.04  # uphill; the camera 0.04 below the road ahead
    T = np.tile(np.eye(4), (len(time_us), 1, 1))
    ahead = slope - tilt
    T[:, :3, 0] = np.cos(ahead), 0.0, np.sin(ahead)
    T[:, :3, 1] = 0.0, -1.0, 0.0  # y right, z down
    T[:, :3, 2] = np.sin(ahead), 0.0, -np.cos(ahead)
    T[:, 0, 3], T[:, 2, 3] = (time_us * 5e-6 * f(slope) for f in (np.cos, np.sin))
    angles = looks_down_rad(Track(time_us, T), chord_us=1_000_000, shortest_m=3.0, gap_us=200_000)
    assert len(angles) > 50
    np.testing.assert_allclose(angles, tilt, atol=1e-9)
    slow = looks_down_rad(Track(time_us, T), chord_us=1_000_000, shortest_m=6.0, gap_us=200_000)
    assert len(slow) == 0


# ------------------------------------------------------------------------------------------- poses


def test_poses_are_north_east_down(tmp_path: Path) -> None:
    row = "7,51.7,-1.2,3.0,10.0,20.0,-3.0,30U,0,0,0,0.0,0.0,1.5707963267948966"  # heads east
    write(tmp_path / "rtk.csv", f"{RTK_HEADER}\n{row}\n")
    poses = read_poses(tmp_path / "rtk.csv")
    T = T_ENU_NED @ poses.T_ned_ins[0]
    np.testing.assert_allclose(T[:3, 3], (20.0, 10.0, 3.0))
    np.testing.assert_allclose(T[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-12)


def test_bad_and_repeated_rows_are_left_out_and_told(tmp_path: Path) -> None:
    rows = [
        ins_row(30, 3.0),
        ins_row(10, 1.0),
        ins_row(20, 9.0, "INS_HIGH_VARIANCE"),
        ins_row(10, 8.0),  # the first of one time is kept
    ]
    write(tmp_path / "ins.csv", "\n".join([INS_HEADER, *rows]))
    poses = read_poses(tmp_path / "ins.csv")
    assert poses.time_us.tolist() == [10, 30]
    assert poses.T_ned_ins[:, 0, 3].tolist() == [1.0, 3.0]
    assert [note.split(": ", 1)[1] for note in poses.notes] == [
        "1 rows are not INS_SOLUTION_GOOD: left out",
        "1 rows repeat the time of an earlier one: left out",
    ]


@pytest.mark.parametrize("where", [f"{RUN}/rtk.csv", f"rtk/{RUN}/rtk.csv"])
def test_rtk_is_the_pose_where_there_is_one(src: Path, where: str) -> None:
    end_us = START_US + 8_000_000
    rows = [
        ins_row(t, NORTH_M + 0.5 + SPEED_M_S * (t - START_US) * 1e-6, None)
        for t in range(START_US, end_us + 1, 20_000)
    ]
    write(src / where, "\n".join([RTK_HEADER, *rows]))
    recording = robotcar.read(src)
    assert recording.info.sensors["poses"] == {RUN: "rtk.csv"}
    frame = shots(recording)[0].frame
    assert frame.position_m[1] == pytest.approx(NORTH_M + 1.525, abs=1e-5)
    assert frame.T_world_ins[1, 3] == pytest.approx(NORTH_M + 1.025, abs=1e-5)
    by_ins = shots(robotcar.read(src, poses="ins"))[0].frame
    assert by_ins.position_m[1] == pytest.approx(NORTH_M + 1.025, abs=1e-5)


def test_what_lies_in_a_gap_of_the_poses_is_left_out(src: Path) -> None:
    path = src / RUN / "gps/ins.csv"
    lines = path.read_text().splitlines()
    gap = slice(1 + 50, 1 + 75)  # half a second, 2.5 m, from the second on
    write(path, "\n".join(line for line in lines if line not in lines[gap]))
    recording = robotcar.read(src, every_m=0.0)
    frames = [shot.frame.timestamp_us for shot in recording.shots]
    # pictures from 1.605 s on see no gap
    assert frames == [START_US + 5_000 + 400_000 * k for k in range(4, 10)]
    assert f"{RUN}: 1 of 20 pictures lie in a gap of the poses: left out" in recording.notes
    assert any("13 of 19 pictures have no unbroken 20 m" in note for note in recording.notes)


def test_what_lacks_scans_is_left_out(src: Path) -> None:
    for t in range(START_US + 1_005_000, START_US + 1_500_000, 20_000):  # 2.5 m
        (src / RUN / f"lms_front/{t}.bin").unlink()
    frames = [s.frame.timestamp_us for s in shots(robotcar.read(src, every_m=0.0))]
    # the picture at 1.205 s is 1.5 m from the next scan: near enough
    assert frames == [START_US + 5_000 + 400_000 * k for k in range(3, 10)]


def test_a_submap_across_a_jump_of_the_poses_is_left_out(src: Path) -> None:
    rows = [
        ins_row(t, NORTH_M + SPEED_M_S * (t - START_US) * 1e-6 + (5.0 if t > middle else 0.0))
        for middle in (START_US + 2_000_000,)
        for t in range(START_US, START_US + 8_000_001, 20_000)
    ]
    write(src / RUN / "gps/ins.csv", "\n".join([INS_HEADER, *rows]))
    frames = [s.frame.timestamp_us for s in shots(robotcar.read(src, every_m=0.0))]
    assert frames == [START_US + 5_000 + 400_000 * k for k in range(6, 10)]  # 5: amid the jump


def test_a_run_without_scans_has_pictures_alone(src: Path) -> None:
    for path in (src / RUN / "lms_front").iterdir():
        path.unlink()
    recording = robotcar.read(src)
    found = shots(recording)
    assert [shot.cloud for shot in found] == [None] * 4
    assert all(shot.image is not None for shot in found)
    assert f"{RUN}: no files in lms_front: its frames go without" in recording.notes


def test_a_run_without_pictures_has_frames_at_scans(src: Path) -> None:
    for path in (src / RUN / "stereo/centre").iterdir():
        path.unlink()
    recording = robotcar.read(src)
    first, *_ = shots(recording)
    assert first.image is None
    assert first.frame.timestamp_us == START_US + 5_000
    assert len(points_of(first)) >= 400


def test_runs_of_the_papers_ten_come_first(src: Path) -> None:
    write_run(src / "2014-05-06-12-54-54")
    recording = robotcar.read(src)
    assert {shot.frame.run for shot in recording.shots} == {RUN}
    assert any("not of the paper's ten" in note for note in recording.notes)
    other = robotcar.read(src, runs=["2014-05-06-12-54-54"])
    assert {shot.frame.run for shot in other.shots} == {"2014-05-06-12-54-54"}
    assert len(robotcar.RUNS) == 10


def test_the_kit_is_found_beside_the_runs(src: Path, tmp_path: Path) -> None:
    for folder in (src / "robotcar-dataset-sdk", src.parent / "elsewhere"):
        folder.mkdir()
        for name in ("models", "extrinsics"):
            origin = next(
                p for p in (src / name, src / "robotcar-dataset-sdk" / name) if p.is_dir()
            )
            origin.rename(folder / name)
        chosen = None if folder.name == "robotcar-dataset-sdk" else folder
        assert robotcar.read(src, calibration=chosen).total == 2
    with pytest.raises(UserError, match="robotcar-dataset-sdk"):
        robotcar.read(src)


# ------------------------------------------------------------------------------------------ errors


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"camera": "stereo"}, "stereo/centre, stereo/left"),
        ({"lidar": "velodyne"}, "lms_front, ldmrs"),
        ({"poses": "vo"}, "rtk or ins"),
        ({"every_m": -1.0}, "every_m"),
        ({"runs": ["2015-01-01"]}, f"choose from {RUN}"),
        ({"runs": []}, f"choose from {RUN}"),
        ({"poses": "rtk"}, "rtk.csv is missing"),
        ({"calibration": "nowhere"}, "nowhere"),
    ],
)
def test_wrong_options_are_answered(src: Path, options: dict[str, object], message: str) -> None:
    with pytest.raises(UserError, match=message):
        robotcar.read(src, **options)


def test_a_run_in_place_of_its_folder_is_answered(src: Path) -> None:
    with pytest.raises(UserError, match="folder above"):
        robotcar.read(src / RUN)
    with pytest.raises(UserError, match="cannot be read"):
        robotcar.read(src / "nowhere")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("models/stereo_narrow_left.txt", "1 2 3 4\n", "stereo_narrow_left.txt is not 5 lines"),
        ("models/stereo_narrow_left.txt", "1 1 1 1\n" * 5, "no pinhole"),
        ("extrinsics/lms_front.txt", "1 2 3", "line 1"),
        ("extrinsics/lms_front.txt", "0 0 0 0 0 0\n0 0 0 0 0 0\n", "not one line"),
        (f"{RUN}/gps/ins.csv", "timestamp,northing\n", "no column easting"),
        (f"{RUN}/gps/ins.csv", f"{INS_HEADER}\n{ins_row(1, np.nan)}\n", "line 2"),
        (f"{RUN}/gps/ins.csv", f"{INS_HEADER}\n{ins_row(1, 1.0, 'INS_ALIGNING')}", "no good pose"),
        (f"{RUN}/gps/ins.csv", f"{INS_HEADER}\n{ins_row(1, 1.0)}", "gives no frame"),
    ],
)
def test_damaged_tables_are_named(src: Path, name: str, content: str, message: str) -> None:
    write(src / name, content)
    with pytest.raises(UserError, match=message):
        robotcar.read(src)


def test_damaged_sensor_files_are_named(src: Path) -> None:
    shot = shots(robotcar.read(src))[0]
    lut = src / "models/stereo_narrow_left_distortion_lut.bin"
    picture = src / RUN / f"stereo/centre/{START_US + 5_000}.png"
    write(picture, png(np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)))
    with pytest.raises(UserError, match="colour picture"):
        shot.image()
    write(picture, png(np.zeros((4, 8), np.uint8)))
    with pytest.raises(UserError, match="not the 512 of a 8 x 4 picture"):
        shot.image()
    write(src / "nan.bin", struct.pack("<48d", *([float("nan")] * 48)))
    write(picture, png(np.zeros((4, 6), np.uint8)))
    with pytest.raises(UserError, match="not finite"):
        read_picture(picture, src / "nan.bin", cv2.COLOR_BayerGBRG2RGB)
    lut.unlink()
    picture.unlink()
    with pytest.raises(UserError, match=picture.name):
        shot.image()
    scan = src / RUN / f"lms_front/{START_US + 5_000}.bin"
    write(scan, scan.read_bytes()[:-1])
    with pytest.raises(UserError, match=f"{scan.name} is cut short"):
        shot.cloud()


def test_a_picture_too_long_to_be_undistorted_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "long.png", png(np.zeros((4, 40_000), np.uint8)))
    write(tmp_path / "lut.bin", bytes(16 * 4 * 40_000))
    with pytest.raises(UserError, match=r"long\.png claims 40000 x 4 pixels, more than any camera"):
        read_picture(tmp_path / "long.png", tmp_path / "lut.bin", cv2.COLOR_BayerGBRG2RGB)


# -------------------------------------------------------------------------------------------- scans


def test_a_fan_is_flat_and_a_scan_of_the_ldmrs_is_not(tmp_path: Path) -> None:
    triples = [(1.0, 2.0, 3.0), (np.nan, 0.0, 0.0), (0.0, 0.0, 0.0), (1e300, 0.0, 0.0)]
    write(tmp_path / "5.bin", b"".join(struct.pack("<3d", *point) for point in triples))
    assert read_scan(tmp_path, True, 5).tolist() == [[1.0, 2.0, 0.0]]
    assert read_scan(tmp_path, False, 5).tolist() == [[1.0, 2.0, 3.0]]


def test_the_ldmrs_is_read_as_well(src: Path) -> None:
    for t in range(START_US + 5_000, START_US + 8_000_000, 80_000):
        write(src / RUN / f"ldmrs/{t}.bin", struct.pack("<3d", 4.0, 1.0, 0.52))
    points = points_of(shots(robotcar.read(src, lidar="ldmrs"))[0])
    np.testing.assert_allclose(points[0], (6.0, -1.0, 0.0), atol=1e-6)  # 2 m + 4 m, on the ground
    np.testing.assert_allclose(np.diff(points[:, 0]), 0.4, atol=1e-5)


def test_other_names_among_the_scans_are_passed_over(src: Path) -> None:
    for name in ("007.bin", "12a.bin", "9.txt", ".5.bin", "9" * 30 + ".bin", "٣.bin"):
        write(src / RUN / "lms_front" / name, b"x")
    assert robotcar.read(src).total == 2


def test_a_sweep_without_scans_is_empty() -> None:
    track = Track(np.array([0, 10]), np.tile(np.eye(4), (2, 1, 1)))
    scans = sweep(track, np.array([50, 60]), every_m=0.1, gap_us=20)
    assert len(scans.time_us) == len(scans.driven_m) == 0
