# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""`adafusion doctor` from the command line: what is printed, exit codes, the page."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np

from adafusion.datasets import Dataset


def test_a_simulated_set_is_clean_and_the_page_is_written(
    type_in, tiny_world: Dataset, contents, tmp_path: Path
) -> None:
    before = contents(tiny_world.root)
    page = tmp_path / "new" / "doctor.html"
    said = type_in("doctor", tiny_world.root, "--html", page, "--samples", 20)
    assert said.code == 0, said.out
    assert "0 fail, 0 warn" in said.out
    verdicts = [line for line in said.out.splitlines() if line[:6].rstrip() in ("ok", "-")]
    numbers = [int(word) for word in said.out.splitlines()[-1].split() if word.isdigit()]
    assert sum(numbers) == len(verdicts), "every line is counted"
    assert "(synthetic)" in said.out
    assert max(map(len, said.out.splitlines()[1:])) <= 100  # the first names the folder
    assert str(page) in said.err
    assert "<svg" in page.read_text()
    assert contents(tiny_world.root) == before


def test_a_failure_is_explained_and_the_exit_code_is_1(
    type_in, tiny_world: Dataset, tmp_path: Path
) -> None:
    spoilt = tmp_path / "spoilt"
    shutil.copytree(tiny_world.root, spoilt)
    for frame in tiny_world.frames:
        path = spoilt / str(frame.cloud)
        np.save(path, np.load(path) / np.float32(80))
    said = type_in("doctor", spoilt, "--samples", 10)
    assert said.code == 1
    assert "fail  cloud scale" in said.out
    assert "To do: Scaled into [-1, 1]: multiply" in " ".join(said.out.split())
    said = type_in("doctor", spoilt, "--samples", 10, "--json")
    answer = json.loads(said.out)
    assert (said.code, answer["level"], answer["synthetic"]) == (1, "fail", True)
    (failed,) = [f for f in answer["findings"] if f["level"] == "fail"]
    assert failed["check"] == "cloud scale"
    assert failed["frames"]


def test_submaps_without_a_scale_are_sound(type_in, export_once, tmp_path: Path) -> None:
    src = export_once("pointnetvlad", seed=3, runs=["day"], profile="tiny", places=2)
    assert type_in("prepare", "pointnetvlad", src, tmp_path / "out").code == 0
    said = type_in("doctor", tmp_path / "out", "--json")
    assert said.code == 0, said.out
    levels = {f["check"]: f["level"] for f in json.loads(said.out)["findings"]}
    assert "fail" not in levels.values()
    assert {levels[check] for check in ("cloud scale", "ground", "voxel grid")} == {"skip"}


def test_what_is_no_dataset_exits_with_2(type_in, tmp_path: Path) -> None:
    said = type_in("doctor", tmp_path / "absent", "--html", tmp_path / "page.html")
    assert (said.code, said.out) == (2, "")
    assert "absent" in said.err
    assert not list(tmp_path.iterdir())


def test_help_says_what_the_exit_codes_mean(type_in) -> None:
    said = type_in("doctor", "--help")
    assert "Example: adafusion doctor" in said.out
    assert "1 a check failed" in " ".join(said.out.split())
