# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The doctor on a real drive: what is sound is called sound, and the cloud falls onto the image."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from adafusion.datasets import Dataset, open_dataset, read_cloud
from adafusion.doctor import examine
from adafusion.doctor.looks import ground_height_m
from adafusion.doctor.page import render
from adafusion.readers import prepare
from adafusion.readers.nclt.velodyne import read_scan


@pytest.fixture(scope="module")
def drive(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    out = tmp_path_factory.mktemp("kitti") / "drive"
    return prepare(real_data / "kitti_odometry", out, "kitti-odometry").dataset


def test_a_sound_drive_has_one_warning_that_it_is_alone(drive: Dataset) -> None:
    diagnosis = examine(drive)
    wrong = {f.check: f.what for f in diagnosis.findings if f.level in ("warn", "fail")}
    assert wrong == {"overlap of runs": "one run only"}
    judged = {f.check for f in diagnosis.findings if f.level == "ok"}
    assert {"ground", "heading", "clouds and poses", "projection", "camera pose"} <= judged
    in_view = [look.cloud.in_view for look in diagnosis.looks if look.cloud]
    assert all(0.1 < share < 0.25 for share in in_view if share is not None)
    page = render(diagnosis)
    assert page.count("The cloud projected onto the image of 04/") == 8
    assert "SYNTHETIC" not in page


def test_the_ground_of_kitti_is_at_zero(drive: Dataset) -> None:
    heights = [ground_height_m(read_cloud(drive.root / str(f.cloud))) for f in drive.frames]
    assert np.abs(heights).max() < 0.1


def test_the_ground_of_kitti_raw_is_at_zero(real_data: Path, tmp_path: Path) -> None:
    dataset = prepare(real_data / "kitti_raw", tmp_path / "raw", "kitti-raw").dataset
    heights = [ground_height_m(read_cloud(dataset.root / str(f.cloud))) for f in dataset.frames]
    assert len(heights) == 6
    assert np.abs(heights).max() < 0.1


def test_the_ground_of_nclt_is_at_zero(real_data: Path) -> None:
    (path,) = (real_data / "nclt" / "velodyne_sync").glob("*.bin")
    assert abs(ground_height_m(read_scan(path))) < 0.1


@pytest.mark.parametrize(
    ("wrong_m", "level", "remedy"),
    [(-0.6, "warn", "higher"), (0.6, "warn", "lower"), (-0.1, "ok", ""), (0.1, "ok", "")],
)
def test_a_wrong_height_of_the_lidar_is_told_either_way(
    drive: Dataset, tmp_path: Path, wrong_m: float, level: str, remedy: str
) -> None:
    spoilt = tmp_path / "spoilt"
    shutil.copytree(drive.root, spoilt)
    for path in spoilt.glob("*/clouds/*.npy"):
        np.save(path, np.load(path) + np.float32([0.0, 0.0, wrong_m]))
    findings = examine(open_dataset(spoilt), samples=8).findings
    (ground,) = (finding for finding in findings if finding.check == "ground")
    assert (ground.level, remedy in ground.remedy) == (level, True)
    height_m = float(ground.what.split()[3])
    assert height_m == pytest.approx(wrong_m, abs=0.1)
