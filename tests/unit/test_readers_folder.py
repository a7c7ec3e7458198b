# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Plain folders made by hand: names that are times or rows, poses in all their tables."""

from __future__ import annotations

import os
import pickle
import struct
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest

from adafusion.datasets.recording import Recording, write_recording
from adafusion.geometry import rotation_from_rpy
from adafusion.readers.folder.reader import read, recognises
from adafusion.readers.pose_files import read_poses
from adafusion.readers.utm import to_utm, zone_of
from adafusion.types import UserError

T0_S = 1_700_000_000  # a day in 2023
CLOUD = [(1.0, -2.0, 0.5), (-3.0, 4.0, 0.25)]


def save_image(path: Path, level: int = 0, size: tuple[int, int] = (4, 6)) -> bytes:
    path.parent.mkdir(parents=True, exist_ok=True)
    blue_green_red = np.full((*size, 3), (level, 20, 200), np.uint8)
    path.write_bytes(cv2.imencode(path.suffix, blue_green_red)[1].tobytes())
    return path.read_bytes()


def save_cloud(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"".join(struct.pack("<4f", *point, 0.5) for point in CLOUD))


def save_run(folder: Path, names: Iterable[str], poses: str, called: str = "poses.txt") -> Path:
    for name in names:
        save_image(folder / "images" / f"{name}.png")
        save_cloud(folder / "clouds" / f"{name}.bin")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / called).write_text(poses)
    return folder


def tum(times: Iterable[object]) -> str:
    """One metre ahead a row, without a turn."""
    return "".join(f"{t} {x} 0 0 0 0 0 1\n" for x, t in enumerate(times))


def kitti(rows: int) -> str:
    return "".join(f"1 0 0 {x} 0 1 0 0 0 0 1 0\n" for x in range(rows))


def placed(recording: Recording) -> list[tuple[int, float]]:
    """Time and x of every frame."""
    return [(s.frame.timestamp_us, s.frame.position_m[0]) for s in recording.shots]


# ------------------------------------------------------------------------------------ whole folders


def test_it_becomes_a_dataset(tmp_path: Path) -> None:
    src = save_run(tmp_path / "yard", ["000000", "000001"], tum([T0_S, T0_S + 1]))
    assert recognises(src)
    recording = read(src, lidar_height_m=1.5)
    assert pickle.loads(pickle.dumps(recording.shots))
    dataset = write_recording(recording, tmp_path / "out").dataset
    assert [frame.key for frame in dataset.frames] == [
        "yard/1700000000000000",
        "yard/1700000001000000",
    ]
    seen = dataset.load(dataset.frames[1])
    np.testing.assert_array_equal(seen.points_body, np.add(CLOUD, (0, 0, 1.5)))
    assert seen.image is not None
    assert tuple(seen.image[0, 0]) == (200, 20, 0)
    assert dataset.info.name == "folder"
    assert not dataset.info.synthetic
    assert dataset.info.calibration["T_body_lidar"][2] == [0.0, 0.0, 1.0, 1.5]
    np.testing.assert_array_equal(dataset.frames[1].T_world_body[:, 3], (1, 0, 0, 1))
    assert recording.notes == []


def test_it_reads_runs_side_by_side(tmp_path: Path) -> None:
    for run in ("day", "night"):
        save_run(tmp_path / "src" / run, ["0", "1"], kitti(2))
    (tmp_path / "src" / "papers").mkdir()
    assert recognises(tmp_path / "src")
    frames = [shot.frame for shot in read(tmp_path / "src").shots]
    assert [f.key for f in frames] == ["day/0", "day/1000000", "night/0", "night/1000000"]
    assert {s.frame.run for s in read(tmp_path / "src", runs=["night"]).shots} == {"night"}
    with pytest.raises(UserError, match="'dusk': choose from day, night"):
        read(tmp_path / "src", runs=["dusk"])


@pytest.mark.parametrize("sensor", ["images", "clouds"])
def test_it_takes_one_sensor_alone(tmp_path: Path, sensor: str) -> None:
    src = save_run(tmp_path / "src", ["0", "1", "2"], kitti(3))
    other = {"images": "clouds", "clouds": "images"}[sensor]
    (src / other).rename(tmp_path / other)
    shots = list(read(src).shots)
    assert len(shots) == 3
    assert (shots[0].image is None, shots[0].cloud is None) == (
        sensor == "clouds",
        sensor == "images",
    )
    assert write_recording(read(src), tmp_path / "out").dataset.runs == ("src",)


def test_it_keeps_png_and_jpeg_byte_for_byte_and_makes_others_png(tmp_path: Path) -> None:
    src = tmp_path / "src"
    files = ["0.png", "1.jpg", "2.JPEG", "3.bmp", "4.tiff"]
    encoded = [save_image(src / "camera" / name, 10 * k) for k, name in enumerate(files)]
    (src / "poses.txt").write_text(kitti(5))
    dataset = write_recording(read(src), tmp_path / "out").dataset
    names = [str(frame.image) for frame in dataset.frames]
    assert [Path(name).suffix for name in names] == [".png", ".jpg", ".jpg", ".png", ".png"]
    for name, data in zip(names[:3], encoded[:3], strict=True):
        assert (dataset.root / name).read_bytes() == data
    seen = dataset.load(dataset.frames[4]).image
    assert seen is not None
    assert tuple(seen[0, 0]) == (200, 20, 40)


def test_it_moves_clouds_and_undistorts_images_by_a_calibration(tmp_path: Path) -> None:
    src = save_run(tmp_path / "src", ["0", "1"], kitti(2))
    calibration = tmp_path / "rig.yaml"
    calibration.write_text(
        "K: [[4, 0, 3], [0, 4, 2], [0, 0, 1]]\ndistortion: [-0.5, 0, 0, 0]\n"
        "T_body_lidar: [[0, -1, 0, 1], [1, 0, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]\n"
    )
    recording = read(src, calibration=calibration)
    [shot, _] = recording.shots
    assert shot.cloud is not None
    assert shot.image is not None
    # turned a quarter to the left: (1, -2) lies at (2, 1), then 1 m ahead and 2 m up
    np.testing.assert_allclose(shot.cloud(), [(3, 1, 2.5), (-3, -3, 2.25)])
    image = shot.image()
    assert isinstance(image, np.ndarray)
    assert image.shape == (4, 6, 3)
    assert recording.info.calibration["K"] == [[4, 0, 3], [0, 4, 2], [0, 0, 1]]
    with pytest.raises(UserError, match=r"rig\.yaml has T_body_lidar: leave the height"):
        read(src, calibration=calibration, lidar_height_m=1.0)


def test_it_keeps_a_frame_every_so_many_metres(tmp_path: Path) -> None:
    src = save_run(tmp_path / "src", [f"{k:03d}" for k in range(10)], kitti(10))
    assert [x for _, x in placed(read(src, every_m=4.0))] == [0, 4, 8]
    assert "every 4 m" in read(src, every_m=4.0).info.source


def test_it_says_when_a_world_is_synthetic(tmp_path: Path) -> None:
    src = save_run(tmp_path / "src", ["0", "1"], kitti(2))
    real = read(src, poses=src / "poses.txt").info
    assert str(src / "poses.txt") in real.source
    (src / "manifest.json").write_text('{"synthetic": true}')
    info = read(src, poses=src / "poses.txt").info
    assert info.synthetic
    assert info.name == "synthetic world in folder layout"
    assert info.source.endswith(real.source)  # with all its settings


# ------------------------------------------------------------------------------------------- names


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (f"{T0_S}", f"{T0_S + 2}"),
        (f"{T0_S}.0", f"{T0_S + 2}.000000000"),
        (f"{T0_S}000", f"{T0_S + 2}000"),
        (f"{T0_S}000000", f"{T0_S + 2}000000"),
        (f"{T0_S}000000000", f"{T0_S + 2}000000499"),
    ],
)
def test_it_tells_the_unit_of_names_since_1970(tmp_path: Path, first: str, second: str) -> None:
    src = save_run(tmp_path / "src", [first, second], tum(range(T0_S - 1, T0_S + 4)))
    assert placed(read(src)) == [(T0_S * 10**6, 1), ((T0_S + 2) * 10**6, 3)]


def test_it_interpolates_poses_and_joins_images_by_time(tmp_path: Path) -> None:
    src = tmp_path / "src"
    start = T0_S * 10**6
    for after in (100_000, 500_000, 900_000, 7_000_000):
        save_cloud(src / "lidar" / f"{start + after}.bin")
    for after in (90_000, 470_000, 540_000, 980_000, 7_000_000):
        save_image(src / "rgb" / f"{start + after}.png")
    # half a metre, then a metre, in a second
    rows = [(T0_S, 0.0), (T0_S + 0.5, 0.5), (T0_S + 1, 1.5), (T0_S + 9, 2.0)]
    (src / "poses.tum").write_text("".join(f"{t:.1f} {x} 0 0 0 0 0 1\n" for t, x in rows))
    recording = read(src)
    frames = [shot.frame for shot in recording.shots]
    assert [f.timestamp_us - start for f in frames] == [100_000, 500_000]
    assert [f.image_time_us for f in frames] == [start + 90_000, start + 470_000]
    np.testing.assert_allclose([f.position_m[0] for f in frames], [0.1, 0.5])
    assert recording.notes[-1].startswith("clouds are taken to be in the body frame")
    assert recording.notes[:-1] == [
        "1 of 4 clouds of src have no image within 50 ms: left out",
        "1 of 4 clouds of src lie outside the poses or in a gap of them: left out",
    ]
    assert len(list(read(src, slop_ms=80.0).shots)) == 3
    (src / "poses.tum").write_text(tum([T0_S + 50, T0_S + 51]))
    with pytest.raises(UserError, match="no frame of src is left: clouds from 1700000000100000"):
        read(src)
    (src / "poses.tum").write_text(tum([5, 6, 7]))
    with pytest.raises(UserError, match="to 1700000007000000 fit neither the 3 rows of"):
        read(src)


def test_it_gives_poses_without_times_those_of_their_files(tmp_path: Path) -> None:
    src = save_run(tmp_path / "src", [f"{T0_S}.25", f"{T0_S}.5"], kitti(2))
    assert placed(read(src)) == [(T0_S * 10**6 + 250_000, 0), (T0_S * 10**6 + 500_000, 1)]
    (src / "poses.txt").write_text(kitti(3))
    with pytest.raises(UserError, match="has 3 poses without times for 2 clouds"):
        read(src)


def test_it_takes_names_in_order_where_there_are_as_many_as_rows(tmp_path: Path) -> None:
    src = save_run(tmp_path / "src", ["9", "10", "11"], kitti(3))
    assert placed(read(src)) == [(0, 0), (1_000_000, 1), (2_000_000, 2)]
    assert "row i" in read(src).info.conventions["time"]
    named = save_run(tmp_path / "named", ["b_left", "c_left", "a_left"], kitti(3))
    assert [x for _, x in placed(read(named))] == [0, 1, 2]
    # a name that only one sensor has counts as well
    (src / "images" / "9.png").unlink()
    recording = read(src)
    assert placed(recording) == [(1_000_000, 1), (2_000_000, 2)]
    assert recording.notes[:-1] == ["1 of 3 clouds of src have no image within 50 ms: left out"]


def test_it_takes_names_as_row_numbers_where_there_are_fewer(tmp_path: Path) -> None:
    src = save_run(tmp_path / "src", ["000001", "000004"], kitti(6))
    assert placed(read(src)) == [(1_000_000, 1), (4_000_000, 4)]
    (src / "poses.txt").write_text(tum(T0_S + x / 10 for x in range(6)))
    at = [T0_S * 10**6 + 100_000, T0_S * 10**6 + 400_000]
    assert placed(read(src)) == list(zip(at, (1, 4), strict=True))
    (src / "poses.txt").write_text(kitti(4))
    with pytest.raises(UserError, match="000001 to 000004 fit neither the 4 rows of"):
        read(src)


def test_it_takes_small_whole_numbers_as_times_on_the_clock_of_the_poses(tmp_path: Path) -> None:
    for unit, scale in (("ms", 10**3), ("us", 10**6), ("ns", 10**9)):
        names = [str(round(t * scale)) for t in (0, 1.5, 3)]
        src = save_run(tmp_path / unit, names, tum([0.0, 1.0, 2.0, 3.0]))
        assert placed(read(src)) == [(0, 0), (1_500_000, 1.5), (3_000_000, 3)]


def test_it_refuses_names_that_may_be_rows_or_times(tmp_path: Path) -> None:
    # row 2 is at 1 s, but 2 may as well mean 2 s
    src = save_run(tmp_path / "src", ["0", "1", "2"], tum([0, 0.5, 1, 1.5, 2.0]))
    with pytest.raises(UserError, match=r"may be rows of .* or times on its clock: rename"):
        read(src)
    (src / "poses.txt").write_text(tum([0, 1, 2, 3]))  # both readings agree
    assert placed(read(src)) == [(0, 0), (1_000_000, 1), (2_000_000, 2)]


def test_it_refuses_times_beside_other_names(tmp_path: Path) -> None:
    src = save_run(tmp_path / "src", [f"{T0_S}", "000001"], kitti(2))
    with pytest.raises(UserError, match="named by times, as 1700000000, and others, as 000001"):
        read(src)


def test_it_refuses_two_files_of_one_time(tmp_path: Path) -> None:
    src = save_run(tmp_path / "src", [f"{T0_S}", f"{T0_S}.0"], tum([T0_S - 1, T0_S + 1]))
    with pytest.raises(UserError, match="have the same time: remove one"):
        read(src)
    twice = save_run(tmp_path / "twice", ["0", "1"], kitti(2))
    save_image(twice / "images" / "0.jpg")
    with pytest.raises(UserError, match=r"has 0\.jpg and 0\.png: remove one"):
        read(twice)


# -------------------------------------------------------------------------------------- bad layouts


def test_it_recognises_no_other_folder(tmp_path: Path) -> None:
    assert not recognises(tmp_path / "missing")
    assert not recognises(tmp_path)
    (tmp_path / "images").mkdir()
    assert not recognises(tmp_path), "empty"
    save_image(tmp_path / "images" / "0.png")
    assert recognises(tmp_path)
    assert not recognises(tmp_path / "images" / "0.png")
    (tmp_path / "dataset.yaml").touch()
    assert not recognises(tmp_path), "a dataset has images too"


@pytest.mark.parametrize(
    ("mend", "told"),
    [
        (lambda src: (src / "poses.txt").unlink(), "has no poses.txt, poses.csv or .tum"),
        (lambda src: (src / "poses.csv").touch(), "poses.csv and poses.txt: choose one by"),
        (lambda src: save_image(src / "rgb" / "0.png"), "images and rgb: choose one by the option"),
        (lambda src: save_cloud(src / "lidar" / "0.bin"), "clouds and lidar: choose one by"),
        (lambda src: (src / "poses.txt").write_text(""), "has rows of 0 numbers"),
    ],
)
def test_it_says_what_is_amiss_and_what_to_do(tmp_path: Path, mend, told: str) -> None:
    src = save_run(tmp_path / "src", ["0", "1"], kitti(2))
    mend(src)
    with pytest.raises(UserError, match=told):
        read(src)


def test_it_finds_what_the_options_name(tmp_path: Path) -> None:
    src = save_run(tmp_path / "src", ["0", "1"], kitti(2))
    save_image(src / "rgb" / "0.png", 7)
    (src / "rtk.txt").write_text(kitti(3))
    recording = read(src, camera="rgb", lidar="clouds", poses="rtk.txt")
    assert placed(recording) == [(0, 0)]
    assert placed(read(src, camera="rgb", poses=src / "rtk.txt")) == [(0, 0)]
    with pytest.raises(UserError, match=r"none\.txt is missing"):
        read(src, camera="images", poses="none.txt")
    for name in ("x" * 300, "a\0b"):  # no folder can be called that: the clouds are all there is
        assert next(iter(read(src, camera=name, poses="rtk.txt").shots)).image is None


@pytest.mark.parametrize(
    "options", [{"slop_ms": -1.0}, {"slop_ms": float("nan")}, {"every_m": float("nan")},
                {"lidar_height_m": float("inf")}, {"slop_ms": 1e300}],
)  # fmt: skip
def test_it_refuses_options_that_make_no_sense(tmp_path: Path, options: dict[str, float]) -> None:
    src = save_run(tmp_path / "src", ["0", "1"], kitti(2))
    with pytest.raises(UserError, match="give a slop"):
        read(src, **options)


def test_links_that_lead_nowhere_or_round_cost_their_frame_alone(tmp_path: Path) -> None:
    src = save_run(tmp_path / "src", ["0", "1", "2", "3", "4"], kitti(5))
    for link, target in ((src / "images" / "3.png", "no.png"), (src / "clouds" / "4.bin", "4.bin")):
        link.unlink()
        link.symlink_to(target)
    (src / "again").symlink_to(".")
    (src / "images" / "._0.png").write_bytes(b"left by another system")
    written = write_recording(read(src), tmp_path / "out", skip_bad=True)
    assert len(written.dataset.frames) == 3
    assert [one.reason.split(" ")[0] for one in written.skipped] == [
        str(src / "images" / "3.png"),
        str(src / "clouds" / "4.bin"),
    ]
    assert recognises(src)
    (tmp_path / "round").symlink_to("round")
    assert not recognises(tmp_path / "round")
    with pytest.raises(UserError, match="round is no folder"):
        read(tmp_path / "round")


@pytest.mark.parametrize("name", [b"a\nb", b"\xff\xfe"])
def test_it_names_names_that_cannot_be_printed(tmp_path: Path, name: bytes) -> None:
    src = save_run(tmp_path / "src", ["0", "1"], kitti(2))
    odd = os.fsencode(src / "images") + b"/" + name + b".png"
    try:
        Path(os.fsdecode(odd)).touch()
    except OSError:
        pytest.skip("this file system has no such names")
    with pytest.raises(UserError, match=r"images has a file '[ -~]+': rename or remove it"):
        read(src)
    runs = tmp_path / "runs"
    save_run(runs / os.fsdecode(name), ["0"], kitti(1))
    assert not recognises(runs)
    with pytest.raises(UserError, match=r"runs has a run '[ -~]+': rename it"):
        read(runs)


def test_it_notes_poses_in_other_axes(tmp_path: Path) -> None:
    """Those of a camera, which looks along its z."""
    rows = "".join(f"1 0 0 0 0 1 0 0 0 0 1 {z}\n" for z in range(8))
    src = save_run(tmp_path / "src", map(str, range(8)), rows)
    note, _ = read(src).notes
    assert note.startswith("src moves 90 degrees off its x axis")


# ------------------------------------------------------------------------------------------- poses


def poses_of(folder: Path, text: str, called: str = "poses.csv"):
    (folder / called).write_text(text)
    return read_poses(folder / called)


def test_it_reads_tum_rows(tmp_path: Path) -> None:
    turn = f"{np.sin(np.pi / 4)} {np.cos(np.pi / 4)}"  # a quarter to the left, about z
    text = f"# t x y z ...\n1.7e+09 1 2 3 0 0 {turn}\n\n1700000000.000001 1 2 4 0 0 0 1\n"
    table = poses_of(tmp_path, text, "drive.tum")
    assert table.time_us is not None
    assert table.time_us.tolist() == [T0_S * 10**6, T0_S * 10**6 + 1]
    np.testing.assert_allclose(
        table.T_world_body[0],
        [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]],
        atol=1e-12,
    )


@pytest.mark.parametrize(
    ("header", "times", "expected"),
    [
        ("timestamp", (f"{T0_S}000000123", f"{T0_S}000002500"), (0, 2)),
        ("time", (f"{T0_S}.5", f"{T0_S + 1}"), (500_000, 1_000_000)),
        ("t", (f"{T0_S}001", f"{T0_S}002"), (1000, 2000)),
        ("timestamp_us", ("5", "7"), (5 - T0_S * 10**6, 7 - T0_S * 10**6)),
        ("#timestamp [ns]", ("5000", "7000"), (5 - T0_S * 10**6, 7 - T0_S * 10**6)),
        ("time_s", ("0", "1"), (-T0_S * 10**6, 10**6 - T0_S * 10**6)),
        ("t", ("0.0", "1.0"), (-T0_S * 10**6, 10**6 - T0_S * 10**6)),
    ],
)
def test_it_reads_times_of_a_csv(
    tmp_path: Path, header: str, times: tuple[str, str], expected: tuple[int, int]
) -> None:
    table = poses_of(tmp_path, f"{header},x,y\n{times[0]},0,0\n{times[1]},1,0\n")
    assert table.time_us is not None
    assert (table.time_us - T0_S * 10**6).tolist() == list(expected)
    assert not table.has_rotation


@pytest.mark.parametrize(
    ("header", "row", "xyz"),
    [
        ("x,y", "1,2", (1, 2, 0)),
        ("z,note,Y,X", "3,fine,2,1", (1, 2, 3)),
        ("tx,ty,tz", "1,2,3", (1, 2, 3)),
        ("x [m],y [m],z [m]", "1,2,3", (1, 2, 3)),
        ("northing,easting", "2,1", (1, 2, 0)),
        ("northing,easting,altitude", "2,1,3", (1, 2, 3)),
        ("easting,northing,up", "1,2,3", (1, 2, 3)),
        ("position.x,position.y,position.z", "1,2,3", (1, 2, 3)),
    ],
)
def test_it_reads_positions_of_a_csv(
    tmp_path: Path, header: str, row: str, xyz: tuple[float, float, float]
) -> None:
    table = poses_of(tmp_path, f"\ufeff{header}\n{row}\n")
    assert table.time_us is None
    np.testing.assert_array_equal(table.T_world_body[0, :3, 3], xyz)


@pytest.mark.parametrize(
    ("header", "row", "rpy"),
    [
        ("qx,qy,qz,qw", f"0,0,{np.sin(0.2)},{np.cos(0.2)}", (0, 0, 0.4)),
        ("qw,qx,qy,qz", f"{-np.cos(0.2)},{-np.sin(0.2)},0,0", (0.4, 0, 0)),
        ("roll,pitch,yaw", "0.1,-0.2,3", (0.1, -0.2, 3)),
        ("yaw", "-1.5", (0, 0, -1.5)),
        ("yaw_deg", "90", (0, 0, np.pi / 2)),
        ("heading_deg", "90", (0, 0, 0)),  # to the east, along x
        ("heading", "0", (0, 0, np.pi / 2)),  # to the north
    ],
)
def test_it_reads_rotations_of_a_csv(
    tmp_path: Path, header: str, row: str, rpy: tuple[float, float, float]
) -> None:
    table = poses_of(tmp_path, f"x,y,{header}\n0,0,{row}\n")
    assert table.has_rotation
    np.testing.assert_allclose(
        table.T_world_body[0, :3, :3], rotation_from_rpy(*map(float, rpy)), atol=1e-12
    )


def test_positions_without_a_rotation_give_frames_without_a_pose(tmp_path: Path) -> None:
    src = save_run(tmp_path / "src", ["0", "1"], "x,y\n0,0\n3,4\n", "poses.csv")
    frames = [shot.frame for shot in read(src).shots]
    assert [f.T_world_body for f in frames] == [None, None]
    assert frames[1].position_m == (3, 4, 0)
    assert write_recording(read(src), tmp_path / "out").dataset.frames[1].T_world_body is None


@pytest.mark.parametrize(
    ("called", "text", "told"),
    [
        ("p.csv", "", "has no rows below a header"),
        ("p.csv", "x,y\n", "has no rows below a header"),
        ("p.csv", "x,z\n1,2\n", "the columns x, z, no position"),
        ("p.csv", "x,y\n1,2\n1,nan\n", "line 3 has 'nan' for a number"),
        ("p.csv", "x,y\n1,2\n1\n", "line 3 has 1 fields, its header 2"),
        ("p.csv", "x,y,x\n1,2,3\n", "two columns x"),
        ("p.csv", "t,x,y\n1,2,3\n", "its times, as 1, may be in any unit: name the column"),
        ("p.csv", "t,x,y\n-1.5,2,3\n", "line 2 has no time but '-1.5'"),
        ("p.csv", "t_s,x,y\n1,2,3\n1,2,3\n", "line 3 is no later than the line before"),
        ("p.csv", "t_s,x,y\n1e99,2,3\n", "is no time of a recording"),
        ("p.csv", "x,y,yaw\n1,2,90\n", "yaw is not in radians: name the column yaw_deg"),
        ("p.csv", "x,y,qx,qy,qz,qw\n1,2,0,0,0,0\n", "line 2 has a quaternion whose length"),
        ("p.csv", "lat,lon\n91,0\n", "is no latitude and longitude of UTM"),
        ("p.csv", "lat,lon\n51,0\n51,90\n", "51.0, 90.0 is no place near UTM zone 31N"),
        ("p.txt", "1 2 3\n", "has rows of 3 numbers: give TUM rows"),
        ("p.txt", "t,x,y\n1,2,3\n", "or a .csv with a header"),
        ("p.txt", "1 1 2 3 0 0 0 1\n2 1 2 3 0 0 1\n", "line 2 has 7 numbers, not 8"),
        ("p.txt", "1 1 2 3 0 0 0 1\n2 1 2 inf 0 0 0 1\n", "line 2 has 'inf' for a number"),
        ("p.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 2 0\n", "line 2 is no rigid"),
        ("p.txt", "\udcff", "cannot be read"),
    ],
)
def test_it_names_what_is_wrong_with_poses(
    tmp_path: Path, called: str, text: str, told: str
) -> None:
    (tmp_path / called).write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(UserError, match=told) as error:
        read_poses(tmp_path / called)
    assert called in str(error.value)


# --------------------------------------------------------------------------------------------- UTM


def test_it_puts_latitudes_into_one_utm_zone(tmp_path: Path) -> None:
    """The second run begins in the next zone, and is counted in that of the first."""
    for run, longitude in (("day", 5.9999), ("night", 6.0001)):
        rows = "".join(f"{k},49.0,{longitude},110.5\n" for k in range(2))
        text = "time_s,latitude,longitude,altitude\n" + rows
        save_run(tmp_path / "src" / run, ["0", "1"], text, "poses.csv")
    recording = read(tmp_path / "src")
    assert recording.info.world == "UTM zone 31N"
    x = [shot.frame.position_m[0] for shot in recording.shots]
    assert x[2] - x[0] == pytest.approx(14.6, abs=0.1)  # 0.0002 degrees of 73.2 km each
    assert next(iter(recording.shots)).frame.position_m[2] == 110.5
    save_run(tmp_path / "src" / "zoo", ["0", "1"], kitti(2))
    with pytest.raises(UserError, match="only some runs have latitudes"):
        read(tmp_path / "src")


@pytest.mark.parametrize(
    "rotation", ["yaw_deg", "heading", "qx,qy,qz,qw"], ids=["yaw", "heading", "quaternion"]
)
def test_headings_from_true_north_become_those_of_the_grid(tmp_path: Path, rotation: str) -> None:
    # at the edge of zone 32 the grid's north is 2.2 degrees from true north
    north = {"yaw_deg": "90", "heading": "0"}.get(rotation, f"0,0,{np.sqrt(0.5)},{np.sqrt(0.5)}")
    rows = [f"{49.0 + 1e-4 * k},11.9,{north}" for k in range(3)]
    T = poses_of(tmp_path, "\n".join([f"lat,lon,{rotation}", *rows, ""])).T_world_body
    way = T[2, :3, 3] - T[0, :3, 3]
    assert abs(way[0]) > 0.5
    np.testing.assert_allclose(T[1, :3, 0], way / np.linalg.norm(way), atol=1e-6)


def test_utm_has_its_false_origin_on_the_equator() -> None:
    assert zone_of(0.0, 3.0) == "31N"
    assert zone_of(-0.1, -180.0) == "1S"
    assert zone_of(50.0, 180.0) == "1N"
    there = to_utm(np.array([0.0]), np.array([3.0]), "31N")
    np.testing.assert_allclose(there, [(500_000, 0)], atol=1e-9)
    south = to_utm(np.array([0.0]), np.array([3.0]), "31S")
    np.testing.assert_allclose(south, [(500_000, 10_000_000)], atol=1e-6)


@pytest.mark.parametrize(
    ("zone", "latitude", "longitude", "expected"),
    [  # of PROJ 9
        ("31N", 51.5, 0.25, (309_131.4030, 5_709_015.1439)),
        ("17N", 42.293227, -83.709657, (276_617.8546, 4_685_889.6013)),
        ("56S", -33.86, 151.21, (334_416.3940, 6_251_925.3604)),
        ("30N", 51.76, -1.26, (620_085.3867, 5_735_777.6318)),
        ("32N", 49.0, 3.5, (97_802.2380, 5_442_045.7194)),  # from the zone beside
    ],
)
def test_utm_agrees_with_proj(
    zone: str, latitude: float, longitude: float, expected: tuple[float, float]
) -> None:
    [there] = to_utm(np.array([latitude]), np.array([longitude]), zone)
    np.testing.assert_allclose(there, expected, atol=1e-3)
