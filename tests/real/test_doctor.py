# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The doctor on a real drive: what is sound is called sound, and the cloud falls onto the image."""

from __future__ import annotations

from pathlib import Path

import pytest

from adafusion.datasets import Dataset
from adafusion.doctor import examine
from adafusion.doctor.page import render
from adafusion.readers import prepare


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
