# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The poses of two true runs of Boreas, a month apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from adafusion.readers.boreas import read_poses, recognises

RUNS = ("boreas-2021-08-05-13-34", "boreas-2021-09-02-11-42")


@pytest.fixture(scope="module")
def runs(real_data: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    return [read_poses(real_data / "boreas" / run / "applanix/lidar_poses.csv") for run in RUNS]


def test_the_layout_is_recognised(real_data: Path) -> None:
    assert recognises(real_data / "boreas")


def test_all_rows_are_read_with_exact_times(runs: list[tuple[np.ndarray, np.ndarray]]) -> None:
    assert sum(len(times_us) for times_us, _ in runs) == 20_757
    assert runs[0][0][0] == 1_628_184_886_518_266


def test_the_second_run_follows_the_first(runs: list[tuple[np.ndarray, np.ndarray]]) -> None:
    first, second = (T[:, :3, 3] for _, T in runs)
    near = cKDTree(first).query(second)[0] < 5.0
    assert near.mean() == pytest.approx(0.996, abs=5e-4)


def test_the_lidar_travels_one_way_of_its_own(runs: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Heading is that of the LiDAR, which is turned by 46.8 degrees on the roof, and clockwise."""
    for _, T_world_lidar in runs:
        step = np.diff(T_world_lidar[:, :3, 3], axis=0)
        length = np.linalg.norm(step, axis=1)
        moving = length > 0.5
        R = T_world_lidar[:-1, :3, :3][moving]
        ahead = np.einsum("nij,ni->nj", R, step[moving]) / length[moving, None]
        bearing = np.rad2deg(np.arctan2(ahead[:, 1], ahead[:, 0]))
        assert np.median(bearing) == pytest.approx(46.9, abs=0.2)
        assert bearing.std() < 1.0
        # the tilts of this table are only roughly those of its own convention
        assert np.abs(ahead[:, 2]).mean() < 0.03
