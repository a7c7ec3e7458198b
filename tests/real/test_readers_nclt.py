# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The NCLT reader on a scan that the real robot took, on 2012-01-15."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adafusion.readers.nclt.velodyne import read_scan


@pytest.fixture(scope="module")
def points(real_data: Path) -> np.ndarray:
    (path,) = sorted((real_data / "nclt" / "velodyne_sync").glob("*.bin"))
    return read_scan(path)


def test_every_hit_is_a_point(points: np.ndarray) -> None:
    assert points.shape == (23_546, 3)


def test_points_are_what_their_bytes_say(points: np.ndarray) -> None:
    """The file begins 475a 1342 1e4e ff13 0357 4f45 324e ff15, low bytes first."""
    counts = np.array([(0x5A47, 0x4213, 0x4E1E), (0x5703, 0x454F, 0x4E32)])
    x, y_right, z_down = (counts * 0.005 - 100.0).T
    np.testing.assert_allclose(points[:2], np.column_stack([x, -y_right, -z_down]), atol=1e-5)


def test_nothing_is_farther_than_the_sensor_sees(points: np.ndarray) -> None:
    assert np.abs(points).max() < 100.0


def test_the_ground_is_where_z_is_zero(points: np.ndarray) -> None:
    """The plane that fits most of what is low and near passes under the robot within 5 cm."""
    low = points[(np.hypot(*points[:, :2].T) < 10.0) & (np.abs(points[:, 2]) < 0.6)]
    plane = np.zeros(3)  # z = plane @ (x, y, 1)
    for _ in range(20):
        ground = low[np.abs(low[:, 2] - np.c_[low[:, :2], np.ones(len(low))] @ plane) < 0.1]
        plane = np.linalg.lstsq(np.c_[ground[:, :2], np.ones(len(ground))], ground[:, 2])[0]
    assert len(ground) > 4000
    assert abs(plane[2]) < 0.05
    assert np.abs(plane[:2]).max() < 0.05  # the robot leans by a few degrees at most


def test_up_is_up(points: np.ndarray) -> None:
    """Walls and trees stand above the ground, and little lies below it."""
    assert (points[:, 2] > 1.0).mean() > 0.3
    assert (points[:, 2] < -1.0).mean() < 0.05
