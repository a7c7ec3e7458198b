# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Cloud files on true bytes: two scans of an Ouster OS1-64 as PCD, an HDL-64E's as .bin."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from adafusion.readers.clouds import count_columns, read_points
from adafusion.types import UserError


@pytest.mark.parametrize(("name", "points"), [("000000.pcd", 37_101), ("000001.pcd", 36_980)])
def test_it_reads_a_binary_pcd_of_an_ouster(real_data: Path, name: str, points: int) -> None:
    path = real_data / "pcd" / name
    cloud = read_points(path)
    assert cloud.shape == (points, 3)
    body = path.read_bytes().split(b"DATA binary\n", 1)[1]
    for row in (0, 12_345, points - 1):  # record by record, as its header says
        assert tuple(cloud[row].tolist()) == struct.unpack_from("<3f", body, 16 * row)
    # the ground lies below the roof of a car, and nothing is seen farther than the sensor sees
    assert -3.0 < np.median(cloud[cloud[:, 2] < 0, 2]) < -0.5
    assert np.linalg.norm(cloud, axis=1).max() < 250.0


def test_it_tells_the_columns_of_kitti_scans(real_data: Path, tmp_path: Path) -> None:
    scans = sorted((real_data / "kitti_odometry").rglob("velodyne/*.bin"))
    scans += sorted((real_data / "kitti_raw").rglob("velodyne_points/data/*.bin"))
    assert len(scans) == 27
    three = tmp_path / "three.bin"
    for path in scans:
        numbers = np.fromfile(path, "<f4")
        assert count_columns(numbers) == 4
        points = numbers.reshape(-1, 4)[:, :3]
        np.testing.assert_array_equal(read_points(path), points)
        three.write_bytes(points.tobytes())
        np.testing.assert_array_equal(read_points(three), points)


def test_it_finds_out_a_kitti_scan_that_is_cut_anywhere(real_data: Path, tmp_path: Path) -> None:
    """Unless the cut falls between two points: then a shorter scan is a scan."""
    data = next((real_data / "kitti_odometry").rglob("velodyne/000000.bin")).read_bytes()
    cut = tmp_path / "cut.bin"
    for length in range(len(data) - 48, len(data)):
        cut.write_bytes(data[:length])
        if length % 16 == 0:
            assert len(read_points(cut)) == length // 16
        else:
            with pytest.raises(UserError, match=r"cut\.bin"):
                read_points(cut)
