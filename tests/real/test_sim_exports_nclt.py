# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The synthetic NCLT export against a scan that the real robot took."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adafusion.sim.exports.nclt import BODY_VELODYNE_M, encode_scan, laser_ids, velodyne

RECORD = np.dtype([("xyz", "<u2", 3), ("intensity", "u1"), ("laser", "u1")])


@pytest.fixture(scope="module")
def data(real_data: Path) -> bytes:
    (path, *_) = sorted((real_data / "nclt" / "velodyne_sync").glob("*.bin"))
    return path.read_bytes()


def test_a_real_scan_comes_back_byte_for_byte(data: bytes) -> None:
    hits = np.frombuffer(data, RECORD)
    points = hits["xyz"] * 0.005 - 100.0
    assert encode_scan(points, hits["laser"], hits["intensity"]) == data


def test_lasers_look_where_the_real_ones_do(data: bytes) -> None:
    hits = np.frombuffer(data, RECORD)
    points = hits["xyz"] * 0.005 - 100.0 - BODY_VELODYNE_M
    up = np.degrees(np.arctan2(-points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    ours = np.degrees(velodyne(512).elevations_rad)[np.argsort(laser_ids())]
    real = [np.median(up[hits["laser"] == laser]) for laser in range(32)]
    np.testing.assert_allclose(ours, real, atol=1.0)  # the robot leans a little


def test_fans_follow_each_other_as_the_real_ones_do(data: bytes) -> None:
    """Against the clock seen from above, which is a falling angle where z is down."""
    hits = np.frombuffer(data, RECORD)
    top = hits["laser"] == 31
    x, y = (hits["xyz"][top, :2] * 0.005 - 100.0).T
    assert np.median(np.diff(np.unwrap(np.arctan2(y, x)))) < 0.0
