# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The KITTI raw reader on true bytes: the first six frames of drive 0009."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from adafusion.datasets import Dataset
from adafusion.datasets.recording import write_recording
from adafusion.geometry import transform
from adafusion.readers.kitti_raw import read, recognises


@pytest.fixture(scope="module")
def dataset(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    recording = read(real_data / "kitti_raw")
    assert recording.notes == []
    return write_recording(recording, tmp_path_factory.mktemp("raw") / "out").dataset


def test_the_layout_is_recognised(real_data: Path) -> None:
    assert recognises(real_data / "kitti_raw")


def test_the_files_there_are_taken_and_the_gap_is_borne(dataset: Dataset) -> None:
    assert len(dataset.frames) == 6  # of 447 in the tables
    assert [frame.timestamp_us for frame in dataset.frames[:2]] == [
        1_317_042_504_957_314,  # 13:08:24.957314930
        1_317_042_505_060_776,
    ]
    assert all(frame.image and frame.cloud for frame in dataset.frames)


def test_it_drives_the_way_it_looks_at_the_speed_that_it_measured(dataset: Dataset) -> None:
    steps = np.diff(dataset.positions_m, axis=0)
    seconds = np.diff([frame.timestamp_us for frame in dataset.frames]) * 1e-6
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1) / seconds, 10.70, atol=0.05)
    for frame, step in zip(dataset.frames, steps, strict=False):
        assert frame.T_world_body is not None
        forward, left, up = frame.T_world_body[:3, :3].T @ step
        assert abs(left) < 0.02 * forward
        assert abs(up) < 0.02 * forward


def test_the_ground_lies_at_zero(dataset: Dataset) -> None:
    for frame in dataset.frames:
        points = dataset.load(frame).points_body
        assert points is not None
        ahead = points[(points[:, 0] > 5) & (points[:, 0] < 15) & (np.abs(points[:, 1]) < 3)]
        assert abs(np.median(ahead[:, 2])) < 0.15


def test_clouds_agree_in_the_world(dataset: Dataset) -> None:
    """What stands beside the street lies on itself half a second later, and 1 m off it does not."""
    standing = []
    for frame in (dataset.frames[0], dataset.frames[5]):
        points = dataset.load(frame).points_body
        assert points is not None
        assert frame.T_world_body is not None
        points = points[(np.linalg.norm(points[:, :2], axis=1) < 25) & (points[:, 2] > 0.5)]
        standing.append(transform(frame.T_world_body, points.astype(np.float64)))
    tree = cKDTree(standing[0])

    def gap(ahead_m: float) -> float:
        return float(np.median(tree.query(standing[1] + [ahead_m, 0.0, 0.0])[0]))

    assert gap(0.0) < 0.15
    assert min(gap(-1.0), gap(1.0)) > 1.5 * gap(0.0)
