# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The readers of MulRan and HeLiPR on runs made by hand."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from adafusion.datasets import Dataset
from adafusion.datasets.recording import Recording, write_recording
from adafusion.readers.mulran import (
    read_helipr,
    read_mulran,
    recognises_helipr,
    recognises_mulran,
)
from adafusion.types import UserError

START_NS = 1_561_000_444_390_857_630
LATE_NS = 1_691_936_557_946_849_180  # the first scan of the Aeva with intensities
POINTS = [(4.0, 1.0, 0.5), (0.0, 0.0, 0.0), (-3.0, 2.0, -1.0)]  # the second never came back


def mulran_scan(points: Sequence[tuple[float, float, float]] = POINTS) -> bytes:
    return b"".join(struct.pack("<4f", *point, 9.0) for point in points)


@pytest.fixture
def mulran(tmp_path: Path) -> Path:
    """Poses 0.1 s and 1 m apart along east; scans 0.05 s, so half a metre, after each."""
    run = tmp_path / "mulran/KAIST01"
    (run / "Ouster").mkdir(parents=True)
    rows = []
    for i in range(11):
        rows.append(f"{START_NS + i * 100_000_000},1,0,0,{352_000 + i},0,1,0,4026000,0,0,1,30")
        if i < 10:
            (run / "Ouster" / f"{START_NS + i * 100_000_000 + 50_000_000}.bin").write_bytes(
                mulran_scan()
            )
    (run / "global_pose.csv").write_text("\n".join(rows) + "\n")
    return tmp_path / "mulran"


RECORDS = {
    "Ouster": lambda p: struct.pack("<4fI3H", *p, 9.0, 5, 6, 7, 8),
    "Velodyne": lambda p: struct.pack("<4fHf", *p, 9.0, 7, 0.05),
    "Avia": lambda p: struct.pack("<3f3BI", *p, 1, 2, 3, 4),
    "Aeva": lambda p: struct.pack("<5fiB", *p, 9.0, -1.0, 5, 6),
}


@pytest.fixture
def helipr(tmp_path: Path) -> Path:
    """Two scans 0.1 s and 10 m apart, the second turned left by a quarter, of four LiDARs."""
    run = tmp_path / "helipr/Roundabout01"
    (run / "LiDAR_GT").mkdir(parents=True)
    half = np.sqrt(0.5)
    for lidar, record in RECORDS.items():
        (run / "LiDAR" / lidar).mkdir(parents=True)
        rows = []
        for i, turn in enumerate(("0 0 0 1", f"0 0 {half} {half}")):
            ns = START_NS + i * 100_000_000
            rows.append(f"{ns} {10.0 * i} 5 2 {turn}")
            (run / "LiDAR" / lidar / f"{ns}.bin").write_bytes(b"".join(map(record, POINTS)))
        (run / f"LiDAR_GT/{lidar}_gt.txt").write_text("\n".join(rows) + "\n")
    return tmp_path / "helipr"


def prepare(recording: Recording, out: Path) -> Dataset:
    return write_recording(recording, out).dataset


def test_mulran_poses_are_interpolated_to_the_scans(mulran: Path, tmp_path: Path) -> None:
    dataset = prepare(read_mulran(mulran, every_m=0.0, lidar_height_m=1.6), tmp_path / "out")
    assert len(dataset.frames) == 10
    assert dataset.frames[0].timestamp_us == 1_561_000_444_440_857  # cut, not rounded
    # the base is 1.8047 m below the Ouster, the ground 1.6 m: 0.2047 m above the base
    expected = [[352_000.5 + i, 4_026_000.0, 30.2047] for i in range(10)]
    np.testing.assert_allclose(dataset.positions_m, expected, atol=1e-6)
    assert dataset.frames[0].image is None
    assert dataset.world == "UTM zone 52N"


def test_the_ouster_of_mulran_looks_backwards_and_lost_rays_are_dropped(
    mulran: Path, tmp_path: Path
) -> None:
    dataset = prepare(read_mulran(mulran, lidar_height_m=1.6), tmp_path / "out")
    points = dataset.load(dataset.frames[0]).points_body
    assert points is not None
    # turned by half a turn less a third of a degree, 1.70 m ahead of the base
    c, s = np.cos(np.deg2rad(179.6654)), np.sin(np.deg2rad(179.6654))
    expected = [
        [c * x - s * y + 1.7042, s * x + c * y - 0.021, z + 1.6]
        for x, y, z in (POINTS[0], POINTS[2])
    ]
    np.testing.assert_allclose(points, expected, atol=1e-4)


def test_frames_are_thinned_by_travel_unless_told_otherwise(mulran: Path) -> None:
    recording = read_mulran(mulran, lidar_height_m=1.6)
    times = [shot.frame.timestamp_us for shot in recording.shots]
    assert [t - times[0] for t in times] == [0, 500_000]
    assert "a frame every 5 m" in recording.info.source
    assert "clouds alone" in recording.notes[0]


def test_the_height_is_measured_where_it_is_not_given(mulran: Path) -> None:
    ground = [(x, y, -1.62) for x in np.linspace(-9, 9, 30) for y in np.linspace(-9, 9, 30)]
    for path in (mulran / "KAIST01/Ouster").iterdir():
        path.write_bytes(mulran_scan(ground))
    recording = read_mulran(mulran)
    assert "the Ouster OS1-64 is 1.62 m above the ground, by the clouds" in recording.notes
    for path in (mulran / "KAIST01/Ouster").iterdir():
        path.write_bytes(mulran_scan())
    with pytest.raises(UserError, match="give --lidar-height-m"):
        read_mulran(mulran)


def test_scans_may_lie_deeper_and_those_without_a_pose_are_told(mulran: Path) -> None:
    run = mulran / "KAIST01"
    (run / "sensor_data").mkdir()
    (run / "Ouster").rename(run / "sensor_data/Ouster")
    (run / "sensor_data/Ouster" / f"{START_NS - 50_000_000}.bin").write_bytes(mulran_scan())
    assert recognises_mulran(mulran)
    recording = read_mulran(mulran, every_m=0.0, lidar_height_m=1.6)
    assert recording.total == 10
    assert "1 of 11 scans of KAIST01 have no pose within 1 s: left out" in recording.notes


@pytest.mark.parametrize("lidar", RECORDS)
def test_each_lidar_of_helipr_has_its_record(helipr: Path, tmp_path: Path, lidar: str) -> None:
    recording = read_helipr(helipr, lidar=lidar, lidar_height_m=1.5)
    dataset = prepare(recording, tmp_path / "out")
    for frame in dataset.frames:
        points = dataset.load(frame).points_body
        np.testing.assert_allclose(points, [[4.0, 1.0, 2.0], [-3.0, 2.0, 0.5]], atol=1e-6)
    np.testing.assert_allclose(dataset.positions_m, [[0.0, 5.0, 0.5], [10.0, 5.0, 0.5]], atol=1e-9)
    T = dataset.frames[1].T_world_body
    assert T is not None
    np.testing.assert_allclose(T[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    assert lidar in recording.info.source


def test_late_scans_of_the_aeva_have_longer_records(helipr: Path, tmp_path: Path) -> None:
    run = helipr / "Roundabout01"
    for path in (run / "LiDAR/Aeva").iterdir():
        path.unlink()
    for ns, ending in ((LATE_NS - 1000, b""), (LATE_NS, struct.pack("<f", 3.0))):
        data = b"".join(RECORDS["Aeva"](point) + ending for point in POINTS)
        (run / f"LiDAR/Aeva/{ns}.bin").write_bytes(data)
    (run / "LiDAR_GT/Aeva_gt.txt").write_text(
        f"{LATE_NS - 9000} 0 0 0 0 0 0 1\n{LATE_NS + 1000} 0 0 0 0 0 0 1\n"
    )
    recording = read_helipr(helipr, lidar="Aeva", every_m=0.0, lidar_height_m=1.5)
    dataset = prepare(recording, tmp_path / "out")
    assert len(dataset.frames) == 2
    for frame in dataset.frames:
        points = dataset.load(frame).points_body
        np.testing.assert_allclose(points, [[4.0, 1.0, 2.0], [-3.0, 2.0, 0.5]], atol=1e-6)


def test_the_layouts_are_told_apart_and_runs_can_be_chosen(mulran: Path, helipr: Path) -> None:
    assert (recognises_mulran(mulran), recognises_helipr(mulran)) == (True, False)
    assert (recognises_mulran(helipr), recognises_helipr(helipr)) == (False, True)
    with pytest.raises(UserError, match="no run 'DCC01': choose from KAIST01"):
        read_mulran(mulran, runs=["DCC01"])
    with pytest.raises(UserError, match="'Livox' is none of Ouster, Velodyne, Avia, Aeva"):
        read_helipr(helipr, lidar="Livox")
    with pytest.raises(UserError, match="give the folder above the runs"):
        read_mulran(mulran / "KAIST01")
    with pytest.raises(UserError, match="give the folder above the runs"):
        read_helipr(helipr / "Roundabout01")


def rewrite(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text()))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda t: t[:-20], "line 11 is not nanoseconds and 12 finite numbers"),
        (lambda t: t.replace("352003", "x"), "line 4 is not nanoseconds"),
        (lambda t: t.replace("352003", "inf"), "line 4 is not nanoseconds"),
        (lambda t: t.replace("352003", "1e300"), "no rigid motion"),
        (lambda t: t.replace(",1,0,0,352003", ",2,0,0,352003"), "row 4 is no rigid motion"),
        (lambda t: "-" + t, "line 1 is not nanoseconds"),
        (lambda t: "", "holds no poses"),
        (lambda t: t.replace("15610004", "16610004"), "no scan in .* has a pose at its time"),
    ],
)
def test_damaged_poses_of_mulran_are_named(
    mulran: Path, change: Callable[[str], str], told: str
) -> None:
    rewrite(mulran / "KAIST01/global_pose.csv", change)
    with pytest.raises(UserError, match=told):
        read_mulran(mulran, lidar_height_m=1.6)


def test_damaged_poses_of_helipr_are_named(helipr: Path) -> None:
    gt = helipr / "Roundabout01/LiDAR_GT/Ouster_gt.txt"
    rewrite(gt, lambda t: t.replace("0 0 0 1\n", "0 0 0 2\n"))
    with pytest.raises(UserError, match=r"Ouster_gt\.txt: row 1 has no unit quaternion"):
        read_helipr(helipr)
    gt.unlink()
    with pytest.raises(UserError, match=r"Ouster_gt\.txt is missing: fetch Ouster_gt\.txt"):
        read_helipr(helipr)


def test_a_cloud_cut_short_is_named(mulran: Path, tmp_path: Path) -> None:
    for path in (mulran / "KAIST01/Ouster").iterdir():
        path.write_bytes(mulran_scan()[:-1])
    with pytest.raises(UserError, match=r"\.bin is cut short: 47 bytes .* 16-byte points"):
        prepare(read_mulran(mulran, lidar_height_m=1.6), tmp_path / "out")
