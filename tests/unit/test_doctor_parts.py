# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The doctor's measures against numbers worked by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adafusion.datasets import Dataset, DatasetInfo
from adafusion.doctor import checks_motion
from adafusion.doctor.calibration import CameraModel, camera_of
from adafusion.doctor.checks_extrinsics import camera_pose
from adafusion.doctor.checks_files import same_files
from adafusion.doctor.checks_places import positives
from adafusion.doctor.looks import choose_rows, ground_height_m
from adafusion.doctor.page import bar_edges
from adafusion.doctor.table import Table
from adafusion.geometry import pose, rotation_from_rpy
from adafusion.types import Frame

INFO = DatasetInfo(name="x", version="1", source="x", licence="x", synthetic=True)


def table(*runs: list[tuple[float, float, float]], step_s: float = 1.0) -> Table:
    """Runs of positions, frame after frame, without orientation or files."""
    frames = tuple(
        Frame(
            run=f"run{k}",
            timestamp_us=round(i * step_s * 1e6),
            position_m=(float(xyz[0]), float(xyz[1]), float(xyz[2])),
        )
        for k, run in enumerate(runs)
        for i, xyz in enumerate(run)
    )
    return Table.of(Dataset(Path(), INFO, frames))


def line(n: int, step_m: float, y: float = 0.0) -> list[tuple[float, float, float]]:
    return [(step_m * i, y, 0.0) for i in range(n)]


def test_true_matches_are_counted_in_other_runs_alone() -> None:
    # 10 m apart along x; the runs lie 6 m beside each other, the third far away
    t = table(line(3, 10.0), line(2, 10.0, y=6.0), line(2, 10.0, y=900.0))
    assert positives(t, 12.0).tolist() == [2, 2, 1, 2, 3, 0, 0]


def test_speed_is_that_of_the_faster_step_beside_a_frame() -> None:
    t = table([(0, 0, 0), (1, 0, 0), (4, 0, 0)], [(0, 0, 0)], step_s=2.0)
    assert t.step_m.tolist() == [1, 3]
    assert t.speed_m_s.tolist() == [0.5, 1.5, 1.5, 0.0]
    assert t.step_after.tolist() == [1, 3, 0, 0]


@pytest.mark.parametrize(
    ("track", "level"),
    [
        pytest.param(line(30, 10.0), "ok", id="steady"),
        pytest.param(
            [*line(15, 10.0), *[(150.0 + 30 * i, 0, 0) for i in range(15)]], "ok", id="x3"
        ),
        pytest.param([(0.5 * i * i, 0, 0) for i in range(20)], "ok", id="from a standstill"),
        pytest.param([*[(0, 0, 0)] * 15, *[(i * i, 0, 0) for i in range(1, 9)]], "ok", id="lights"),
        pytest.param([*line(15, 10.0), (150, 40, 0), *line(30, 10.0)[16:]], "fail", id="one off"),
        pytest.param(
            [*line(15, 10.0), *line(30, 10.0, y=50.0)[15:]], "fail", id="a shift for good"
        ),
    ],
)
def test_a_jump_is_a_step_that_no_vehicle_makes(
    track: list[tuple[float, float, float]], level: str
) -> None:
    assert checks_motion.jumps(table(track)).level == level


def test_a_wrong_position_is_one_jump_and_named() -> None:
    t = table([*line(150, 10.0), (1500.0, 0, 80.0), *line(300, 10.0)[151:]])
    finding = checks_motion.jumps(t)
    assert (finding.level, finding.frames) == ("warn", ("run0/150000000",))
    assert finding.what.startswith("1 in 299 steps")


def test_a_run_of_one_frame_is_skipped_by_what_needs_two() -> None:
    t = table([(0, 0, 0)])
    checks = (checks_motion.speed, checks_motion.jumps, checks_motion.heading)
    assert [check(t).level for check in (*checks, checks_motion.standing)] == ["skip"] * 4


def road(z: float, slope: float = 0.0) -> np.ndarray:
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-15, 15, 61), np.linspace(-15, 15, 61)))
    return np.column_stack([x, y, z + slope * x])


WALL = np.column_stack([np.full(200, 8.0), np.linspace(-10, 10, 200), np.linspace(0, 6, 200)])


@pytest.mark.parametrize("z", [-1.5, -0.6, 0.0, 0.6, 1.5])
def test_the_ground_is_found_under_walls_and_not_where_nothing_is_seen(z: float) -> None:
    assert ground_height_m(np.concatenate([road(z), WALL])) == pytest.approx(z, abs=1e-3)
    assert np.isnan(ground_height_m(WALL[:3]))


def test_the_ground_is_that_under_the_vehicle_on_a_slope_over_noise_and_reflections() -> None:
    rng = np.random.default_rng(0)
    slope = road(0.0, slope=0.05) + rng.normal(0.0, 0.02, (61 * 61, 3))
    below = road(0.0)[::5] - np.column_stack([np.zeros((745, 2)), rng.uniform(0.2, 3.0, 745)])
    assert ground_height_m(np.concatenate([slope, below, WALL])) == pytest.approx(0.0, abs=0.03)


def test_a_cloud_whose_ground_is_a_small_part_still_shows_it() -> None:
    rng = np.random.default_rng(0)
    about = rng.uniform((-15, -15, 0), (15, 15, 6), (16_000, 3))
    assert ground_height_m(np.concatenate([road(0.0), about])) == pytest.approx(0.0, abs=0.02)


def test_a_cloud_without_ground_shows_none() -> None:
    about = np.random.default_rng(0).uniform((-15, -15, 0), (15, 15, 6), (16_000, 3))
    assert np.isnan(ground_height_m(about))


def test_the_largest_tilt_is_not_below_the_median() -> None:
    frames = tuple(
        Frame(
            run="r",
            timestamp_us=i,
            position_m=(0.0, 0.0, 0.0),
            T_world_body=pose(rotation_from_rpy(0.0, np.deg2rad(degrees), 0.0), (0.0, 0.0, 0.0)),
        )
        for i, degrees in enumerate((0.1, 0.3, 0.4))
    )
    finding = checks_motion.tilt(Table.of(Dataset(Path(), INFO, frames)))
    assert finding.what == "median 0.3 deg, at most 0.4 deg"


@pytest.mark.parametrize(
    ("yaw", "words"),
    [
        (-136.9, "looks 136.9 deg right of ahead, 0.0 deg up"),
        (90.0, "looks 90.0 deg left of ahead, 0.0 deg up"),
        (-0.04, "looks 0.0 deg left of ahead, 0.0 deg up"),
    ],
)
def test_where_the_camera_looks_is_said_by_its_side(yaw: float, words: str) -> None:
    ahead = np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])
    R = rotation_from_rpy(0.0, 0.0, np.deg2rad(yaw)) @ ahead
    camera = CameraModel(np.eye(3), pose(R, (0.0, 0.0, 1.0)), np.zeros(5))
    assert words in camera_pose({"r": camera}).what


@pytest.mark.parametrize("value", [0.0, 0.013, 23_546.0])
def test_values_that_are_all_the_same_make_a_narrow_bar(value: float) -> None:
    edges = bar_edges(np.full(6, value))
    (bar,) = np.flatnonzero(np.histogram(np.full(6, value), edges)[0])
    assert edges[bar + 1] - edges[bar] < 0.05 * (edges[-1] - edges[0])


def test_a_point_is_projected_as_the_pinhole_says() -> None:
    # the camera 1 m above the origin looks along body x: its x is -y, its y is -z
    R = np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])
    K = np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]])
    camera = CameraModel(K, pose(R, (0.0, 0.0, 1.0)), np.zeros(5))
    points = np.array([[10.0, -2, 0], [10, 2, 2], [-10, 0, 1], [10, 9, 1], [0.1, 0, 1]])
    seen, pixels, depth = camera.project(points, (80, 100))
    assert seen.tolist() == [True, True, False, False, False]
    assert pixels == pytest.approx(np.array([[70.0, 50], [30, 30]]))
    assert depth.tolist() == [10, 10]
    # k1 = 0.5: r^2 = 0.04 + 0.01, so both coordinates grow by 2.5 %
    bent = replace(camera, distortion=np.array([0.5, 0, 0, 0, 0])).project(points[:1], (80, 100))
    assert bent[1] == pytest.approx(np.array([[70.5, 50.25]]))


def test_points_far_outside_the_view_do_not_fold_back_into_it() -> None:
    R = np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])
    K = np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]])
    barrel = CameraModel(K, pose(R, (0.0, 0.0, 0.0)), np.array([-0.3, 0, 0, 0, 0]))
    # 1 - 0.3 * 1.83^2 is nearly 0: the polynomial puts it into the middle of the image
    seen, _, _ = barrel.project(np.array([[1.0, 1.83, 0.0], [1.0, 0.1, 0.0]]), (80, 100))
    assert seen.tolist() == [False, True]


@pytest.mark.parametrize(
    ("calibration", "told"),
    [
        ({}, "no K and T_body_camera"),
        ({"K": [[1, 2], [3, 4]], "T_body_camera": np.eye(4).tolist()}, "K is no 3x3"),
        ({"K": np.eye(3).tolist(), "T_body_camera": (2 * np.eye(4)).tolist()}, "no rigid motion"),
        ({"K": "x", "T_body_camera": None}, "no numbers"),
        ({"K": np.eye(3).tolist(), "T_body_camera": np.eye(4).tolist(), "distortion": [1]}, "k1"),
        ({"a": "none"}, "no K and T_body_camera"),
    ],
)
def test_a_calibration_that_is_none_is_told_apart(
    calibration: dict[str, object], told: str
) -> None:
    assert told in str(camera_of(replace(INFO, calibration=calibration), "a"))
    assert told in str(camera_of(replace(INFO, calibration={"a": calibration}), "a"))


def test_equal_files_are_grouped_and_files_of_equal_size_are_not(tmp_path: Path) -> None:
    contents = [b"a" * 9000, b"b" + b"a" * 8999, b"a" * 9000, b"c", b"c" * 2]
    frames = []
    for i, content in enumerate(contents):
        (tmp_path / f"{i}.png").write_bytes(content)
        frames.append(Frame(run="r", timestamp_us=i, position_m=(0.0, 0.0, 0.0), image=f"{i}.png"))
    same = same_files(Table.of(Dataset(tmp_path, INFO, tuple(frames))), tmp_path)
    assert same == {"image": [[0, 2]], "cloud": []}


def test_samples_are_pairs_of_neighbours_spread_along_each_run() -> None:
    t = table(line(1000, 1.0), line(7, 1.0))
    rows = choose_rows(t, 20, np.random.default_rng(0))
    long = rows[t.run[rows] == 0]
    assert rows[t.run[rows] == 1].tolist() == list(range(1000, 1007)), "a short run is taken whole"
    assert 11 <= len(long) <= 20
    assert (np.diff(long) == 1).sum() >= 9
    assert len(np.unique(long // 100)) >= 9
