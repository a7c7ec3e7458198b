# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Both prepared sets made by hand, with numbers worked out by hand."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from adafusion.datasets.recording import Recording, write_recording
from adafusion.datasets.splits import region_of
from adafusion.readers.opr import read, read_nclt_cloud, recognises
from adafusion.types import UserError

DAY, LATER = "2012-01-08", "2012-01-22"
RUN = "2014-11-18-13-20-12"
START = 1326030975726043
STORED = [(10.005, 2.0, -1.5), (-3.0, 4.255, 0.25), (0.0, -7.5, -100.0)]  # forward, right, down
SEEN = np.array([(10.005, -2.0, 1.5), (-3.0, -4.255, -0.25), (0.0, 7.5, 100.0)], np.float32)


def encode(points: list[tuple[float, float, float]], intensity: int | None = None) -> bytes:
    extra = () if intensity is None else (float(intensity),)
    return b"".join(struct.pack(f"<{3 + len(extra)}f", *point, *extra) for point in points)


def add_picture(path: Path, value: int = 7) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((4, 3, 3), value, np.uint8))


def add_cloud(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


@pytest.fixture
def nclt(tmp_path: Path) -> Path:
    """Two days of three frames, 6 m apart: north on one, east on the other."""
    root = tmp_path / "NCLT_preprocessed"
    for day, heading in ((DAY, 0.0), (LATER, math.pi / 2)):
        lines = [",timestamp,image,pointcloud,x,y,z,r,p,h"]
        for k in range(3):
            image, cloud = START + 10**6 * k, START + 10**6 * k + 4000
            north, east = -260.0 + 6 * k * math.cos(heading), -680.0 + 6 * k * math.sin(heading)
            lines.append(f"{k},{image},{image},{cloud},{north},{east},-2.5,0.0,0.0,{heading}")
            add_cloud(root / day / "velodyne_data" / f"{cloud}.bin", encode(STORED, 17 + k))
            add_picture(root / day / "lb3_small" / "Cam5" / f"{image}.png")
        (root / day / "track.csv").write_text("\n".join(lines) + "\n")
    return root


@pytest.fixture
def oxford(tmp_path: Path) -> Path:
    """One run of two submaps in each folder; one of the second folder is no query."""
    root = tmp_path / "pnvlad_oxford_robotcar"
    header = "track,pointcloud,stereo_centre,mono_left,mono_rear,mono_right,northing,easting"
    rows = {
        "train.csv": [(1, 5735000.25, 620100.5)],
        "val.csv": [(2, 5735700.0, 620100.5)],
        "test.csv": [(3, 5735700.0, 620100.5), (4, 5735000.0, 620100.5)],
    }
    for name, frames in rows.items():
        test = name == "test.csv"
        lines = [header + ",in_query" * test]
        for k, north, east in frames:
            times = [START + 10 * k + c for c in range(5)]
            line = ",".join(map(str, [RUN, *times, north, east]))
            lines.append(line + f",{5735562.0 < north < 5735863.0}" * test)
            folder = "pointcloud_20m" if test else "pointcloud_20m_10overlap"
            submap = struct.pack("<3d", 0.5, 0.25, -0.125) * 4096
            add_cloud(root / RUN / folder / f"{times[0]}.bin", submap)
            add_picture(root / RUN / "images_small" / "stereo_centre" / f"{times[1]}.png", k)
            add_picture(root / RUN / "images_small" / "mono_rear" / f"{times[3]}.png", 50 + k)
        (root / name).write_text("\n".join(lines) + "\n")
    return root


def keys(recording: Recording) -> list[str]:
    return [shot.frame.key for shot in recording.shots]


# ----------------------------------------------------------------------------------------- clouds


@pytest.mark.parametrize("intensity", [None, 0, 17, 255])
@pytest.mark.parametrize("count", [1, 3, 4, 12, 13])
def test_both_forms_of_a_cloud_are_told_apart(
    tmp_path: Path, intensity: int | None, count: int
) -> None:
    # 4 points of 12 bytes are 3 of 16, and 12 of either divide by both
    path = tmp_path / "1.bin"
    path.write_bytes(encode([STORED[k % 3] for k in range(count)], intensity))
    points = read_nclt_cloud(path)
    assert points.dtype == np.float32
    np.testing.assert_array_equal(points, [SEEN[k % 3] for k in range(count)])


@pytest.mark.parametrize("intensity", [None, 17])
@pytest.mark.parametrize("cut", [1, 4, 8])
def test_a_cut_cloud_is_refused_by_name(tmp_path: Path, intensity: int | None, cut: int) -> None:
    path = tmp_path / "1326030975730043.bin"
    path.write_bytes(encode(STORED * 4, intensity)[:-cut])
    with pytest.raises(UserError, match=r"1326030975730043\.bin is cut short: \d+ bytes"):
        read_nclt_cloud(path)


def test_an_empty_cloud_and_one_that_is_not_finite_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "1.bin"
    for data, message in ((b"", "no points"), (encode([(math.nan, 0.5, 0.5)] * 5), "NaN")):
        path.write_bytes(data)
        with pytest.raises(UserError, match=rf"1\.bin.*{message}"):
            read_nclt_cloud(path)


# ------------------------------------------------------------------------------------------- NCLT


def test_frames_of_nclt_have_poses_in_east_north_up(nclt: Path, tmp_path: Path) -> None:
    dataset = write_recording(read(nclt), tmp_path / "out").dataset
    assert dataset.runs == (DAY, LATER)
    north_bound, east_bound = dataset.frames[1], dataset.frames[4]
    assert north_bound.key == f"{DAY}/{START + 10**6 + 4000}"
    assert north_bound.image_time_us == START + 10**6
    assert north_bound.position_m == (-680.0, -254.0, 2.5)  # east, north, up
    # heading north, forward is +y and left is -x
    np.testing.assert_allclose(
        north_bound.T_world_body,
        [[0, -1, 0, -680], [1, 0, 0, -254], [0, 0, 1, 2.5], [0, 0, 0, 1]],
        atol=1e-12,
    )
    np.testing.assert_allclose(east_bound.T_world_body[:3, :3], np.eye(3), atol=1e-12)
    np.testing.assert_array_equal(dataset.load(north_bound).points_body, SEEN)
    assert dataset.load(north_bound).image.shape == (4, 3, 3)
    info = dataset.info
    assert (info.world, info.licence, info.version) == ("NCLT local ENU", "ODbL 1.0", "nclt")


def test_roll_and_pitch_tilt_the_body_as_they_do_in_nclt(nclt: Path) -> None:
    track = nclt / DAY / "track.csv"
    image, cloud = START, START + 4000
    # h = 90 degrees (east), nose up by 0.1 rad: of a body with z down that is p = +0.1
    track.write_text(
        f"timestamp,image,pointcloud,x,y,z,r,p,h\n0,{image},{cloud},1,2,3,0,0.1,{math.pi / 2}\n"
    )
    frame = next(iter(read(nclt, runs=[DAY]).shots)).frame
    forward = frame.T_world_body[:3, 0]
    np.testing.assert_allclose(forward, [math.cos(0.1), 0, math.sin(0.1)], atol=1e-12)
    assert frame.position_m == (2.0, 1.0, -3.0)


def test_poses_as_quaternions_say_the_same(nclt: Path) -> None:
    angles = [shot.frame.T_world_body for shot in read(nclt).shots]
    for day, half in ((DAY, 0.0), (LATER, math.pi / 4)):
        track = nclt / day / "track.csv"
        rows = [line.split(",") for line in track.read_text().splitlines()[1:]]
        lines = ["image,pointcloud,tx,ty,tz,qx,qy,qz,qw"]
        lines += [",".join([*row[2:7], f"0,0,{math.sin(half)},{math.cos(half)}"]) for row in rows]
        track.write_text("\n".join(lines))
    quaternions = [shot.frame.T_world_body for shot in read(nclt).shots]
    np.testing.assert_allclose(quaternions, angles, atol=1e-12)


def test_days_without_a_track_take_positions_of_the_tables(nclt: Path) -> None:
    (nclt / LATER / "track.csv").unlink()
    for name, k in (("train.csv", 0), ("test.csv", 1)):
        cloud = START + 10**6 * k + 4000
        (nclt / name).write_text(
            ",track,image,pointcloud,northing,easting\n"
            f"0,{LATER},{cloud - 4000},{cloud},-260.0,{-680.0 + 6 * k}\n"
        )
    frames = [shot.frame for shot in read(nclt).shots]
    assert [frame.run for frame in frames] == [DAY] * 3 + [LATER] * 2
    assert frames[4].position_m == (-674.0, -260.0, 0.0)
    assert frames[4].T_world_body is None


def test_tables_and_tracks_that_disagree_are_refused(nclt: Path) -> None:
    (nclt / "train.csv").write_text(
        f"track,image,pointcloud,northing,easting\n{DAY},{START},{START + 4000},-680.0,-260.0\n"
    )
    with pytest.raises(UserError, match=rf"track\.csv: cloud {START + 4000} lies at"):
        read(nclt)


def test_the_published_boxes_hold_the_rows_of_the_test_table(nclt: Path) -> None:
    # half-width 100 m about (north, east) = (-260, -680); here x is east and y north
    box = [-680.0 - 100, -260.0 - 100, -680.0 + 100, -260.0 + 100]
    track = nclt / DAY / "track.csv"
    norths = (-260.0, -360.5, -200.0)
    lines = ["timestamp,image,pointcloud,x,y,z,r,p,h"]
    table = ["track,image,pointcloud,northing,easting"]
    for k, north in enumerate(norths):
        image, cloud = START + 10**6 * k, START + 10**6 * k + 4000
        lines.append(f"{image},{image},{cloud},{north},-600.0,0,0,0,0")
        if abs(north + 260.0) < 100:
            table.append(f"{DAY},{image},{cloud},{north},-600.0")
    track.write_text("\n".join(lines))
    (nclt / "test.csv").write_text("\n".join(table))
    frames = [shot.frame for shot in read(nclt, runs=[DAY]).shots]
    regions = region_of(np.array([f.position_m[:2] for f in frames]), {"test": [box]})
    in_table = [f",{f.timestamp_us}," in (nclt / "test.csv").read_text() for f in frames]
    assert [region == "test" for region in regions] == in_table == [True, False, True]


def test_frames_can_be_spaced_and_runs_chosen(nclt: Path) -> None:
    times = [shot.frame.timestamp_us for shot in read(nclt, runs=[LATER], every_m=10.0).shots]
    assert times == [START + 4000, START + 2 * 10**6 + 4000]
    with pytest.raises(UserError, match=rf"no run 'noon': choose from {DAY}, {LATER}"):
        read(nclt, runs=["noon"])


@pytest.mark.parametrize("folder", ["lb3_small", "images_small", "images"])
def test_every_name_of_the_image_folder_will_do(nclt: Path, folder: str) -> None:
    for day in (DAY, LATER):
        (nclt / day / "lb3_small").rename(nclt / day / folder)
    assert all(shot.image is not None for shot in read(nclt).shots)


def test_frames_without_their_files_are_left_out_and_noted(nclt: Path) -> None:
    (nclt / DAY / "lb3_small" / "Cam5" / f"{START}.png").unlink()
    (nclt / LATER / "velodyne_data" / f"{START + 4000}.bin").unlink()
    recording = read(nclt)
    assert recording.total == 4
    assert recording.notes == [
        f"{day}: 1 of 3 frames lack a file: left out" for day in (DAY, LATER)
    ]


def test_a_set_without_images_gives_its_clouds(nclt: Path) -> None:
    for day in (DAY, LATER):
        (nclt / day / "lb3_small").rename(nclt / day / "elsewhere")
    recording = read(nclt)
    assert all(shot.image is None for shot in recording.shots)
    assert "no images" in recording.info.source
    with pytest.raises(UserError, match="has no <run>/lb3_small/Cam2"):
        read(nclt, camera="Cam2")


def test_a_cut_image_is_refused_by_name(nclt: Path, tmp_path: Path) -> None:
    path = nclt / DAY / "lb3_small" / "Cam5" / f"{START}.png"
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(UserError, match=rf"{START}\.png"):
        write_recording(read(nclt), tmp_path / "out")


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0,5,6,1,2,3,0,0,north", "line 2 has 'north' for a number"),
        ("0,5,../6,1,2,3,0,0,0", "line 2 has '../6' for a time"),
        ("0,5.5,6,1,2,3,0,0,0", "line 2 has '5.5' for a time"),
        ("0,5,6,1,2,3,0,0,inf", "line 2 has 'inf' for a number"),
        ("0,5,6,1,2,3", "line 2 has 6 fields"),
    ],
)
def test_a_bad_track_is_refused_by_line(nclt: Path, row: str, message: str) -> None:
    (nclt / DAY / "track.csv").write_text(f"timestamp,image,pointcloud,x,y,z,r,p,h\n{row}\n")
    with pytest.raises(UserError, match=rf"track\.csv: {message}"):
        read(nclt)


def test_a_quaternion_that_is_none_is_refused(nclt: Path) -> None:
    (nclt / DAY / "track.csv").write_text(
        "image,pointcloud,tx,ty,tz,qx,qy,qz,qw\n5,6,1,2,3,0,0,0,0\n"
    )
    with pytest.raises(UserError, match=r"track\.csv: line 2 has no quaternion"):
        read(nclt)


@pytest.mark.parametrize("track", ["../../outside", "/etc", "", "a/b", "..", ".hidden"])
def test_names_that_lead_elsewhere_are_refused(nclt: Path, track: str) -> None:
    (nclt / "train.csv").write_text(
        f"track,image,pointcloud,northing,easting\n{track},5,6,1.0,2.0\n"
    )
    with pytest.raises(UserError, match=r"names|run name"):
        read(nclt)


# ----------------------------------------------------------------------------------------- Oxford


def test_overlapping_submaps_of_oxford_come_from_two_tables(oxford: Path, tmp_path: Path) -> None:
    dataset = write_recording(read(oxford), tmp_path / "out").dataset
    assert [frame.timestamp_us for frame in dataset.frames] == [START + 10, START + 20]
    first = dataset.frames[0]
    assert first.position_m == (620100.5, 5735000.25, 0.0)
    assert (first.T_world_body, first.image_time_us) == (None, START + 11)
    np.testing.assert_array_equal(dataset.load(first).points_body[7], (-0.5, 0.25, -0.125))
    assert (dataset.load(first).image == 1).all()
    assert dataset.world == "UTM zone 30N"
    assert dataset.info.sensors["cloud_unit"].startswith("normalised: 1 is not a metre")


def test_disjoint_submaps_of_oxford_say_how_many_are_queries(oxford: Path) -> None:
    recording = read(oxford, lidar="20m", camera="mono_rear")
    assert keys(recording) == [f"{RUN}/{START + 30}", f"{RUN}/{START + 40}"]
    assert recording.notes == [f"1 of 2 rows of {oxford / 'test.csv'} are queries (in_query)"]
    assert next(iter(read(oxford, lidar="20m", camera="mono_rear").shots)).image is not None


def test_boxes_of_the_benchmark_hold_the_queries_of_oxford(oxford: Path) -> None:
    north, east = 5735712.768124, 620084.402381  # P1
    box = [east - 150, north - 150, east + 150, north + 150]
    positions = np.array([s.frame.position_m for s in read(oxford, lidar="20m").shots])
    assert region_of(positions[:, :2], {"test": [box]}).tolist() == ["test", "train"]


def test_options_that_do_not_fit_are_refused(oxford: Path, nclt: Path) -> None:
    for options, message in (
        ({"lidar": "25m_10"}, "unknown lidar '25m_10': choose from 20m_10overlap, 20m"),
        ({"camera": "Cam5"}, "unknown camera 'Cam5': choose from stereo_centre"),
    ):
        with pytest.raises(UserError, match=message):
            read(oxford, **options)
    with pytest.raises(UserError, match="unknown lidar '20m': choose from velodyne"):
        read(nclt, lidar="20m")
    (oxford / "test.csv").unlink()
    with pytest.raises(UserError, match="the tables of 20m are missing or name no frame"):
        read(oxford, lidar="20m")


# ------------------------------------------------------------------------------------- what it is


def test_it_recognises_both_sets_and_nothing_else(oxford: Path, nclt: Path, tmp_path: Path) -> None:
    assert recognises(oxford)
    assert recognises(nclt)
    assert not recognises(tmp_path)
    assert not recognises(tmp_path / "none")
    (tmp_path / "train.csv").write_bytes(b"\xff\xfe\x00pointcloud,track\n")
    assert not recognises(tmp_path)
    with pytest.raises(UserError, match=r"has no train\.csv"):
        read(tmp_path)
