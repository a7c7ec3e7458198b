# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""From a seed to the raw layouts: whole, resumable, in step, and never called real.

The few lines of decoding here follow the published descriptions and share nothing with the writers.
"""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from adafusion.sim.exports import EXPORTS, export
from adafusion.sim.run.route import pose_along
from adafusion.sim.studio import Studio, make_job
from adafusion.types import UserError

WISHES = {"seed": 3, "runs": ["day"], "profile": "tiny", "places": 2}


@pytest.fixture(scope="module")
def exported(export_once) -> dict[str, Path]:
    return {kind: export_once(kind, **WISHES) for kind in EXPORTS}


@pytest.fixture(scope="module")
def studio() -> Studio:
    return Studio(make_job(**WISHES))


def stamps(folder: Path, suffix: str) -> list[int]:
    return sorted(int(path.stem) for path in folder.glob(f"*{suffix}"))


def poses(numbers: np.ndarray) -> np.ndarray:
    """4x4 from x, y, z, roll, pitch, yaw."""
    T = np.tile(np.eye(4), (len(numbers), 1, 1))
    T[:, :3, 3] = numbers[:, :3]
    T[:, :3, :3] = Rotation.from_euler("ZYX", numbers[:, :2:-1]).as_matrix()
    return T


def read_velodyne(path: Path) -> np.ndarray:
    record = np.dtype([("x", "<u2"), ("y", "<u2"), ("z", "<u2"), ("i", "u1"), ("l", "u1")])
    hits = np.fromfile(path, record)
    return np.column_stack([hits[axis] for axis in "xyz"]) * 0.005 - 100.0


def read_track(folder: Path) -> np.ndarray:
    track = np.loadtxt(folder / "ground_truth" / "groundtruth_day.csv", delimiter=",")
    return track[~np.isnan(track).any(axis=1)]


def read_poses(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Timestamps and poses of ins.csv or rtk.csv."""
    with path.open() as file:
        rows = list(csv.DictReader(file))
    names = ("northing", "easting", "down", "roll", "pitch", "yaw")
    numbers = np.array([[float(row[name]) for name in names] for row in rows])
    return np.array([int(row["timestamp"]) for row in rows]), poses(numbers)


def extrinsics(folder: Path, name: str) -> np.ndarray:
    return poses(np.loadtxt(folder / "extrinsics" / f"{name}.txt")[None])[0]


# ------------------------------------------------------------------------------------- all of them


@pytest.mark.parametrize("kind", EXPORTS)
def test_its_manifest_says_that_it_is_synthetic(exported: dict[str, Path], kind: str) -> None:
    manifest = json.loads((exported[kind] / "manifest.json").read_text())
    assert manifest["synthetic"] is True
    assert (manifest["layout"], manifest["seed"], manifest["runs"]) == (kind, 3, ["day"])
    assert manifest["conditions"]["day"]["street_lamps"] == 0.0
    assert manifest["calibration"]
    assert manifest["simplified"]
    assert not (exported[kind].parent / f"{kind}.partial").exists()


@pytest.mark.parametrize("kind", ["nclt", "pointnetvlad"])
def test_it_goes_on_where_it_was_cut_off(
    cut_off, count, contents, exported: dict[str, Path], kind: str, tmp_path: Path
) -> None:
    out = tmp_path / "cut"
    with pytest.raises(KeyboardInterrupt):
        export(kind, out, **WISHES, progress=cut_off(1))
    assert not out.exists()
    export(kind, out, **WISHES, progress=count)
    whole = contents(exported[kind])
    assert count.totals == [len(whole) - 2]  # without the file that was there, and the manifest
    assert contents(out) == whole


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"kind": "kitti"}, "nclt, robotcar, pointnetvlad"),
        ({"runs": ["noon"]}, "'noon'"),
        ({"profile": "huge"}, "tiny, small, compact, full"),
        ({"places": 0}, "places"),
    ],
)
def test_bad_wishes_are_answered_before_anything_is_written(
    wrong: dict[str, object], message: str, tmp_path: Path
) -> None:
    with pytest.raises(UserError, match=message):
        export(**{"kind": "nclt", "out": tmp_path / "none", **WISHES, **wrong})
    assert not list(tmp_path.iterdir())


def test_an_export_that_is_there_is_left_alone(exported: dict[str, Path]) -> None:
    with pytest.raises(UserError, match="exists"):
        export("nclt", exported["nclt"], **WISHES)


# -------------------------------------------------------------------------------------------- NCLT


def test_scans_and_pictures_of_nclt_miss_each_other_by_milliseconds(
    exported: dict[str, Path],
) -> None:
    scans = stamps(exported["nclt"] / "velodyne_data/day/velodyne_sync", ".bin")
    pictures = stamps(exported["nclt"] / "images/day/lb3/Cam5", ".tiff")
    assert len(scans) == len(pictures) == 2
    apart = np.abs(np.subtract(scans, pictures))
    assert (apart <= 10_000).all()
    assert apart.any()


def test_the_track_of_nclt_is_the_true_one(exported: dict[str, Path], studio: Studio) -> None:
    track = read_track(exported["nclt"])
    way = studio.drive("day")
    assert track[0, 0] <= way.timestamp_us[0]
    assert way.timestamp_us[-1] <= track[-1, 0]
    T_ned_body = poses(track[:, 1:])
    T = pose_along(studio.world, way, track[:, 0].astype(np.int64))
    np.testing.assert_allclose(T_ned_body[:, :3, 3], T[:, (1, 0, 2), 3] * (1, 1, -1), atol=1e-6)
    ahead, down = T_ned_body[:, :3, 0], T_ned_body[:, :3, 2]
    np.testing.assert_allclose(ahead, T[:, (1, 0, 2), 0] * (1, 1, -1), atol=1e-5)
    np.testing.assert_allclose(down, -T[:, (1, 0, 2), 2] * (1, 1, -1), atol=1e-5)


def test_the_gps_of_nclt_is_near_the_track(exported: dict[str, Path]) -> None:
    gps = np.loadtxt(exported["nclt"] / "sensor_data/day/gps.csv", delimiter=",")
    track = read_track(exported["nclt"])
    north = (gps[:, 3] - np.radians(42.293227)) * 6_378_137.0
    error = north - np.interp(gps[:, 0], track[:, 0], track[:, 1])
    assert 0.0 < np.abs(error).max() < 6.0
    euler = np.loadtxt(exported["nclt"] / "sensor_data/day/ms25_euler.csv", delimiter=",")
    turned = np.interp(track[:, 0], euler[:, 0], np.unwrap(euler[:, 3])) - np.unwrap(track[:, 6])
    assert 0.0 < np.abs(turned).max() < 0.1


def test_pictures_of_nclt_fit_their_calibration(exported: dict[str, Path]) -> None:
    root = exported["nclt"]
    (path,) = root.glob("U2D_Cam5_*.txt")
    header, *_ = path.read_text().splitlines()
    width, height = (int(x) for x in "".join(c for c in header if c in "0123456789,").split(","))
    assert path.name == f"U2D_Cam5_{width}X{height}.txt"
    u2d = np.loadtxt(path, skiprows=1)
    assert len(u2d) == width * height
    K = np.loadtxt(root / "cam_params/K_cam5.csv", delimiter=",")
    assert (width, height) == (101, 77)
    assert K[0, 0] == pytest.approx(399.433184 / 16)
    for picture in (root / "images/day/lb3/Cam5").iterdir():
        assert cv2.imread(str(picture)).shape == (height, width, 3)


# ---------------------------------------------------------------------------------------- RobotCar


def test_timestamps_of_robotcar_name_the_files(exported: dict[str, Path]) -> None:
    run = exported["robotcar"] / "day"
    for name, folder, suffix in (
        ("stereo", "stereo/centre", ".png"),
        ("lms_front", "lms_front", ".bin"),
    ):
        lines = (run / f"{name}.timestamps").read_text().splitlines()
        assert [int(line.split(" ")[0]) for line in lines] == stamps(run / folder, suffix)


def test_fans_of_robotcar_are_at_most_ten_centimetres_apart(exported: dict[str, Path]) -> None:
    run = exported["robotcar"] / "day"
    scans = stamps(run / "lms_front", ".bin")
    time_us, T = read_poses(run / "rtk.csv")
    at = np.column_stack([np.interp(scans, time_us, T[:, axis, 3]) for axis in range(3)])
    travel = np.linalg.norm(np.diff(at, axis=0), axis=1)
    assert travel.max() <= 0.1 + 1e-3  # the INS swings a little further than the wheels
    assert travel.sum() > 20.0
    assert np.diff(scans).max() <= 20_000


def test_the_ins_of_robotcar_is_off_by_metres_at_most(exported: dict[str, Path]) -> None:
    (t, true), (same, said) = (
        read_poses(exported["robotcar"] / "day" / name) for name in ("rtk.csv", "gps/ins.csv")
    )
    np.testing.assert_array_equal(t, same)
    off = np.linalg.norm(said[:, :3, 3] - true[:, :3, 3], axis=1)
    assert 0.05 < off.mean() < 10.0


def test_pictures_of_robotcar_are_raw_and_fit_their_model(exported: dict[str, Path]) -> None:
    root = exported["robotcar"]
    (path, *_) = sorted((root / "day/stereo/centre").iterdir())
    raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert raw.shape == (60, 80)
    lut = np.fromfile(root / "models/stereo_narrow_left_distortion_lut.bin", "<f8").reshape(2, -1)
    assert lut.shape[1] == raw.size
    focal = (root / "models/stereo_narrow_left.txt").read_text().split()[0]
    assert float(focal) == pytest.approx(964.829 / 16)
    middle = lut.reshape(2, *raw.shape)[:, 30, 40]
    np.testing.assert_allclose(middle, (40.0, 30.0), atol=0.05)


def test_fans_of_robotcar_meet_the_walls_that_nclt_meets(exported: dict[str, Path]) -> None:
    """Two sensors, two frames, two formats, one world: through each one's own true poses."""
    nclt, robotcar = exported["nclt"], exported["robotcar"]
    track = read_track(nclt)
    cloud = []
    for path in (nclt / "velodyne_data/day/velodyne_sync").iterdir():
        row = np.array([np.interp(int(path.stem), track[:, 0], x) for x in track[:, 1:].T])
        T = poses(row[None])[0]
        cloud.append(read_velodyne(path) @ T[:3, :3].T + T[:3, 3])
    walls = cKDTree(np.concatenate(cloud))

    T_ins_lms = np.linalg.inv(extrinsics(robotcar, "ins")) @ extrinsics(robotcar, "lms_front")
    time_us, T_ned_ins = read_poses(robotcar / "day/rtk.csv")
    apart = []
    for stamp in stamps(robotcar / "day/lms_front", ".bin")[::7]:
        scan = np.fromfile(robotcar / f"day/lms_front/{stamp}.bin", "<f8").reshape(-1, 3)
        scan[:, 2] = 0.0
        T = T_ned_ins[np.abs(time_us - stamp).argmin()] @ T_ins_lms
        points = scan @ T[:3, :3].T + T[:3, 3]
        high = points[:, 2] < T_ned_ins[0, 2, 3] - 0.8  # walls rather than the floor
        apart.append(walls.query(points[high])[0])
    assert np.median(np.concatenate(apart)) < 0.12


# ------------------------------------------------------------------------------------ PointNetVLAD


def test_submaps_are_listed_where_and_when_they_are(exported: dict[str, Path]) -> None:
    folder = exported["pointnetvlad"] / "oxford/day"
    with (folder / "pointcloud_locations_20m_10overlap.csv").open() as file:
        rows = list(csv.DictReader(file))
    listed = [int(row["timestamp"]) for row in rows]
    assert listed == stamps(folder / "pointcloud_20m_10overlap", ".bin")
    run = exported["robotcar"] / "day"
    assert set(listed) <= set(stamps(run / "lms_front", ".bin"))  # the time of the first scan
    time_us, T = read_poses(run / "gps/ins.csv")
    starts = T[np.searchsorted(time_us, listed)][:, :2, 3]
    places = np.array([[float(row["northing"]), float(row["easting"])] for row in rows])
    ahead = np.linalg.norm(places - starts, axis=1)
    assert (ahead < 30.0).all()
    assert ahead.max() > 3.0  # the centroid lies further on than the first scan
    assert np.linalg.norm(np.diff(starts, axis=0), axis=1) == pytest.approx(10.0, abs=0.5)


def test_submaps_have_the_benchmark_s_form(exported: dict[str, Path]) -> None:
    for path in (exported["pointnetvlad"] / "oxford/day/pointcloud_20m_10overlap").iterdir():
        assert path.stat().st_size == 98_304
        points = np.fromfile(path, "<f8").reshape(4096, 3)
        assert np.abs(points).max() <= 1.0
        assert 0.2 < np.linalg.norm(points, axis=1).mean() < 0.7


def test_a_run_without_lidar_has_no_submaps(tmp_path: Path, studio: Studio) -> None:
    dead = replace(studio.conditions["day"], lidar_dead=True)
    with pytest.raises(UserError, match="lidar_dead"):
        export("pointnetvlad", tmp_path / "none", **{**WISHES, "runs": {"dead": dead}})


def test_a_run_that_is_too_short_has_no_submaps_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("adafusion.sim.exports.pointnetvlad.LENGTH_M", 60.0)
    with pytest.raises(UserError, match="more places"):
        export("pointnetvlad", tmp_path / "none", **WISHES)
    assert not list(tmp_path.iterdir())


def test_a_submap_of_the_road_alone_is_named_by_run_and_time(
    tmp_path: Path, studio: Studio, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("adafusion.sim.exports.pointnetvlad.ROAD_M", 1e3)  # all of it is road
    first = studio.drive("day").path_time_us[0]
    with pytest.raises(UserError, match=rf"'day' .* at {first}: .*road alone; .*lidar_fog_per_m"):
        export("pointnetvlad", tmp_path / "none", **WISHES)
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("kind", ["nclt", "robotcar"])
def test_a_run_without_lidar_has_pictures_alone(kind: str, studio: Studio) -> None:
    dead = replace(studio.conditions["day"], lidar_dead=True)
    paths = [piece.path for piece in EXPORTS[kind](make_job(3, {"dead": dead}, places=1)).pieces]
    assert any("dead" in path and path.endswith((".tiff", ".png")) for path in paths)
    assert not any("velodyne" in path or path.startswith("dead/lms") for path in paths)
