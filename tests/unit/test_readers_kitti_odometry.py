# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The KITTI reader on a folder made by hand, byte by byte."""

from __future__ import annotations

import shutil
import struct
import zlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
import pytest

from adafusion.datasets import Dataset
from adafusion.datasets.recording import write_recording
from adafusion.readers import READERS
from adafusion.readers.kitti_odometry import read, recognises
from adafusion.types import UserError

# Camera 0 sits 0.27 m before the Velodyne and 0.08 m below it; camera 2 a further 0.06 m left.
CALIB = """\
P0: 700 0 6 0 0 700 4 0 0 0 1 0
P1: 700 0 6 -378 0 700 4 0 0 0 1 0
P2: 700 0 6 42 0 700 4 0 0 0 1 0
P3: 700 0 6 -336 0 700 4 0 0 0 1 0
Tr: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27
"""
POSES = """\
1 0 0 0 0 1 0 0 0 0 1 0
1 0 0 0 0 1 0 0 0 0 1 10
0 0 -1 0 0 1 0 0 1 0 0 20
"""  # at the start, 10 m ahead, 20 m ahead and turned left by a quarter
TIMES = "0.000000e+00\n1.041284e-01\n2.082536e-01\n"
POINTS = [(10.0, 0.0, -1.73, 0.3), (5.0, 2.0, 0.27, 0.9)]  # one on the ground, one 2 m above it


def chunk(kind: bytes, body: bytes) -> bytes:
    length, checksum = struct.pack(">I", len(body)), struct.pack(">I", zlib.crc32(kind + body))
    return length + kind + body + checksum


def png(rgb: tuple[int, int, int]) -> bytes:
    header = struct.pack(">IIBBBBB", 12, 8, 8, 2, 0, 0, 0)  # 12 wide, 8 high, 8 bits, RGB
    rows = (b"\0" + bytes(rgb) * 12) * 8  # each row begins with its filter: none
    pixels = chunk(b"IDAT", zlib.compress(rows))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + pixels + chunk(b"IEND", b"")


def scan(points: Iterable[tuple[float, float, float, float]] = POINTS) -> bytes:
    return b"".join(struct.pack("<4f", *point) for point in points)


def write_sequence(src: Path, name: str) -> None:
    folder = src / "sequences" / name
    for part in (src / "poses", folder / "image_2", folder / "velodyne"):
        part.mkdir(parents=True, exist_ok=True)
    (src / "poses" / f"{name}.txt").write_text(POSES)
    (folder / "calib.txt").write_text(CALIB)
    (folder / "times.txt").write_text(TIMES)
    for row in range(3):
        (folder / "image_2" / f"{row:06d}.png").write_bytes(png((200, 100, 10 * row)))
        (folder / "velodyne" / f"{row:06d}.bin").write_bytes(scan())


def prepare(src: Path, out: Path, runs: Sequence[str] | None = None) -> Dataset:
    return write_recording(read(src, runs=runs), out).dataset


@pytest.fixture
def src(tmp_path: Path) -> Path:
    write_sequence(tmp_path / "kitti", "04")
    return tmp_path / "kitti"


def test_poses_become_those_of_the_body(src: Path, tmp_path: Path) -> None:
    dataset = prepare(src, tmp_path / "out")
    assert [frame.key for frame in dataset.frames] == ["04/0", "04/104128", "04/208254"]
    # turning left about the camera, the point under the Velodyne, 0.27 m behind it, swings right
    expected = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [20.27, -0.27, 0.0]]
    np.testing.assert_allclose(dataset.positions_m, expected, atol=1e-12)
    turned = dataset.frames[2].T_world_body
    assert turned is not None
    np.testing.assert_allclose(
        turned[:3, :3], [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-12
    )


def test_points_stand_on_the_ground(src: Path, tmp_path: Path) -> None:
    dataset = prepare(src, tmp_path / "out")
    points = dataset.load(dataset.frames[0]).points_body
    assert points is not None
    assert points.dtype == np.float32
    np.testing.assert_allclose(points, [[10.0, 0.0, 0.0], [5.0, 2.0, 2.0]], atol=1e-6)


def test_images_are_kept_byte_for_byte_and_read_as_rgb(src: Path, tmp_path: Path) -> None:
    dataset = prepare(src, tmp_path / "out")
    frame = dataset.frames[2]
    image = dataset.load(frame).image
    assert frame.image == "04/images/208254.png"
    assert (dataset.root / frame.image).read_bytes() == png((200, 100, 20))
    assert image is not None
    assert image.shape == (8, 12, 3)
    assert (image == (200, 100, 20)).all()


def test_the_calibration_places_both_sensors_in_the_body(src: Path, tmp_path: Path) -> None:
    info = prepare(src, tmp_path / "out").info
    calibration = info.calibration["04"]
    assert calibration["K"] == [[700.0, 0.0, 6.0], [0.0, 700.0, 4.0], [0.0, 0.0, 1.0]]
    to_camera_axes = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    for name, R, t in (
        ("T_body_camera", to_camera_axes, (0.27, 0.06, 1.65)),
        ("T_body_lidar", np.eye(3), (0.0, 0.0, 1.73)),
    ):
        pose = np.array(calibration[name])
        np.testing.assert_allclose(pose[:3, :3], R, atol=1e-12)
        np.testing.assert_allclose(pose[:3, 3], t, atol=1e-12)
    assert (info.synthetic, info.licence) == (False, "CC BY-NC-SA 3.0")


def test_gaps_are_borne_and_either_sensor_may_be_missing(src: Path, tmp_path: Path) -> None:
    folder = src / "sequences/04"
    (folder / "image_2/000000.png").unlink()
    (folder / "image_2/000001.png").unlink()
    (folder / "velodyne/000001.bin").unlink()
    (folder / "velodyne/000002.bin").unlink()
    (folder / "velodyne/._000001.bin").write_bytes(b"what a file browser leaves")
    dataset = prepare(src, tmp_path / "out")
    first, last = (dataset.load(frame) for frame in dataset.frames)
    assert [frame.timestamp_us for frame in dataset.frames] == [0, 208254]
    assert (first.image is None, first.points_body is None) == (True, False)
    assert (last.image is None, last.points_body is None) == (False, True)


def test_sequences_can_be_chosen_and_never_seem_to_meet(src: Path, tmp_path: Path) -> None:
    write_sequence(src, "07")
    both = prepare(src, tmp_path / "both")
    one = prepare(src, tmp_path / "one", runs=["07"])
    assert (both.runs, one.runs) == (("04", "07"), ("07",))
    np.testing.assert_allclose(both.positions_m[3:] - both.positions_m[:3], [[0.0, 1e4, 0.0]] * 3)
    np.testing.assert_allclose(one.positions_m, both.positions_m[:3])


def test_another_choice_of_sequences_is_another_world(src: Path, tmp_path: Path) -> None:
    write_sequence(src, "07")
    worlds = [
        prepare(src, tmp_path / f"{row}", runs=names).world
        for row, names in enumerate([None, ["04", "07"], ["07", "04"], ["04"], ["07"]])
    ]
    assert worlds[0] == worlds[1]  # the same runs at the same places
    assert len(set(worlds)) == 4


def test_sequences_without_poses_or_files_are_left_out_unless_named(
    src: Path, tmp_path: Path
) -> None:
    for name in ("05", "11"):
        write_sequence(src, name)
    (src / "poses/11.txt").unlink()  # not public
    shutil.rmtree(src / "sequences/05/image_2")
    shutil.rmtree(src / "sequences/05/velodyne")
    recording = read(src)
    assert write_recording(recording, tmp_path / "out").dataset.runs == ("04",)
    assert "left out 05, 11" in recording.notes[0]
    for name, told in (("05", r"sequences/05 has no image_2"), ("11", r"poses/11\.txt is missing")):
        with pytest.raises(UserError, match=told):
            prepare(src, tmp_path / name, runs=["04", name])


def test_the_number_of_frames_is_known_beforehand(src: Path) -> None:
    assert read(src).total == 3


def test_frames_may_be_thinned_by_travel(src: Path, tmp_path: Path) -> None:
    dataset = write_recording(read(src, every_m=15.0), tmp_path / "out").dataset
    assert [frame.timestamp_us for frame in dataset.frames] == [0, 208254]
    assert "a frame every 15 m" in dataset.info.source


def test_the_layout_is_recognised(src: Path, tmp_path: Path) -> None:
    assert READERS["kitti-odometry"].read is read
    assert recognises(src)
    for other in (src / "sequences", src / "poses/04.txt", tmp_path / "nothing"):
        assert not recognises(other)


def rewrite(name: str, change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    def damage(src: Path) -> None:
        path = src / name
        path.write_bytes(change(path.read_bytes()))

    return damage


def remove(name: str) -> Callable[[Path], None]:
    return lambda src: (src / name).unlink()


CLOUD, IMAGE = "sequences/04/velodyne/000001.bin", "sequences/04/image_2/000001.png"
CALIB_FILE, TIMES_FILE, POSES_FILE = (
    "sequences/04/calib.txt",
    "sequences/04/times.txt",
    "poses/04.txt",
)
NAN = scan([(1.0, float("nan"), 0.0, 0.0), *POINTS])


@pytest.mark.parametrize(
    ("damage", "file", "told"),
    [
        (rewrite(CLOUD, lambda b: b[:-5]), CLOUD, "27 bytes are no whole number of 16-byte points"),
        (rewrite(CLOUD, lambda b: b""), CLOUD, "holds no points: replace"),
        (rewrite(CLOUD, lambda b: NAN), CLOUD, r"NaN or infinite points \(1\): replace"),
        (rewrite(IMAGE, lambda b: b[: len(b) // 2]), IMAGE, "damaged or cut short: replace"),
        (rewrite(IMAGE, lambda b: b""), IMAGE, "damaged or cut short: replace"),
        (remove(POSES_FILE), POSES_FILE, "missing: fetch it"),
        (remove(CALIB_FILE), CALIB_FILE, "missing: fetch it"),
        (remove(TIMES_FILE), TIMES_FILE, "missing: fetch it"),
        (rewrite(POSES_FILE, lambda b: b[:60]), POSES_FILE, "line 3 is not 12 finite numbers"),
        (
            rewrite(POSES_FILE, lambda b: b[:48]),
            POSES_FILE,
            r"2 poses, .*times\.txt 3 times: fetch",
        ),
        (rewrite(POSES_FILE, lambda b: b.replace(b"-1", b"1")), POSES_FILE, "row 3 is no rigid"),
        (rewrite(POSES_FILE, lambda b: b.replace(b"20", b"nan")), POSES_FILE, "line 3 is not 12"),
        (rewrite(POSES_FILE, lambda b: b"\xff\xfe"), POSES_FILE, "cannot be read .*: fetch it"),
        (rewrite(TIMES_FILE, lambda b: b"0\nx\n1\n"), TIMES_FILE, "line 2 is not 1 finite numbers"),
        (rewrite(TIMES_FILE, lambda b: b"0\n2\n2\n"), TIMES_FILE, "line 3 is no later time"),
        (rewrite(CALIB_FILE, lambda b: b[: b.index(b"Tr")]), CALIB_FILE, "no Tr with 12 numbers"),
        (rewrite(CALIB_FILE, lambda b: b.replace(b"P2: 700", b"P2:")), CALIB_FILE, "no P2 with 12"),
        (rewrite(CALIB_FILE, lambda b: b.replace(b"700", b"0")), CALIB_FILE, "P2 is no projection"),
        (
            rewrite(CALIB_FILE, lambda b: b.replace(b"Tr: 0 -1", b"Tr: 0 1")),
            CALIB_FILE,
            "Tr is no rigid motion",
        ),
    ],
)
def test_damage_is_named_and_leaves_no_dataset(
    src: Path, tmp_path: Path, damage: Callable[[Path], None], file: str, told: str
) -> None:
    out = tmp_path / "out"
    damage(src)
    with pytest.raises(UserError, match=told) as raised:
        prepare(src, out)
    assert str(src / file) in str(raised.value)
    assert not out.exists()


def test_after_a_repair_the_same_call_succeeds(src: Path, tmp_path: Path) -> None:
    rewrite(CLOUD, lambda data: data[:-5])(src)
    with pytest.raises(UserError):
        prepare(src, tmp_path / "out")
    rewrite(CLOUD, lambda data: scan())(src)
    dataset = prepare(src, tmp_path / "out")
    assert len(dataset.frames) == 3
    assert not (tmp_path / "out.partial").exists()


def test_more_files_than_poses_are_refused(src: Path, tmp_path: Path) -> None:
    (src / "sequences/04/velodyne/000003.bin").write_bytes(scan())
    with pytest.raises(UserError, match=r"frame 000003, .*04\.txt only 3 poses"):
        prepare(src, tmp_path / "out")


def test_a_wrong_folder_or_sequence_is_told_what_to_give(src: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(UserError, match="give the folder above `sequences`"):
        prepare(src / "sequences", out)
    with pytest.raises(UserError, match=r"sequences has no run '05': choose from 04"):
        prepare(src, out, runs=["05"])
    with pytest.raises(UserError, match=r"no run of .* is chosen"):
        prepare(src, out, runs=[])
    for path in [*src.rglob("*.png"), *src.rglob("*.bin")]:
        path.unlink()
    with pytest.raises(UserError, match=r"sequences/04 has no image_2/\*\.png and no velodyne"):
        prepare(src, out)
    assert not out.exists()
