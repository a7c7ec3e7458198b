# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""From a seed to a dataset on disk: whole, repeatable, resumable, and never called real."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import adafusion.sim.simulate
from adafusion.datasets import Dataset, open_dataset
from adafusion.sim.run.conditions import PRESETS
from adafusion.sim.simulate import simulate
from adafusion.sim.studio import conditions_of
from adafusion.types import UserError

RUNS = ["day", "night"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    out = tmp_path_factory.mktemp("sim") / "world"
    return simulate(out, seed=3, runs=RUNS, profile="tiny", places=3)


def test_it_writes_a_dataset_that_says_it_is_synthetic(dataset: Dataset) -> None:
    assert dataset.info.synthetic is True
    assert dataset.runs == ("day", "night")
    assert len(dataset.frames) == 6
    assert set(dataset.info.regions) == {"guard", "test", "validation"}
    assert set(dataset.info.sensors["conditions"]) == set(RUNS)
    for frame in dataset.frames:
        seen = dataset.load(frame)
        assert seen.image is not None
        assert seen.image.shape == (75, 100, 3)
        assert seen.points_body is not None
        assert len(seen.points_body) > 2000
        assert frame.zone in {"street", "park", "path", "corridor"}
        assert frame.T_world_body is not None
        assert frame.T_world_ins is not None
        assert 0.0 < np.linalg.norm((frame.T_world_ins - frame.T_world_body)[:2, 3]) < 6.0


def test_the_ground_is_near_zero_in_the_body_frame(dataset: Dataset) -> None:
    for frame in dataset.frames:
        points = dataset.load(frame).points_body
        assert points is not None
        low = points[(np.hypot(points[:, 0], points[:, 1]) < 9.0) & (points[:, 2] < 0.5)]
        assert abs(np.median(low[:, 2])) < 0.12


@pytest.mark.slow
def test_it_writes_the_same_bytes_with_two_workers(
    contents, dataset: Dataset, tmp_path: Path
) -> None:
    two = simulate(tmp_path / "two", seed=3, runs=RUNS, profile="tiny", places=3, workers=2)
    assert contents(two.root) == contents(dataset.root)


def test_another_seed_is_another_world(dataset: Dataset, tmp_path: Path) -> None:
    other = simulate(tmp_path / "other", seed=4, runs=["day"], profile="tiny", places=1)
    first = dataset.load(dataset.frames[0]).image
    assert not np.array_equal(other.load(other.frames[0]).image, first)


def test_a_repeat_draws_its_own_noise_and_traffic(tmp_path: Path) -> None:
    out = simulate(tmp_path / "twice", seed=3, runs=["day", "day-2"], profile="tiny", places=1)
    a, b = (out.load(frame).points_body for frame in out.frames)
    assert a is not None
    assert b is not None
    assert a.shape != b.shape or not np.array_equal(a, b)
    assert conditions_of(3, "day") != conditions_of(3, "day-2")


def test_a_dead_sensor_leaves_no_file(tmp_path: Path) -> None:
    dead = replace(PRESETS["day"], lidar_dead=True)
    out = simulate(tmp_path / "dead", seed=3, runs={"dead": dead}, profile="tiny", places=1)
    assert out.frames[0].cloud is None
    assert out.frames[0].image is not None


def test_a_full_disk_is_named_and_leaves_nothing_that_passes_for_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> tuple[None, None]:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(adafusion.sim.simulate, "write_observation", full)
    out = tmp_path / "world"
    with pytest.raises(UserError, match=r"world\.partial cannot be written.*free space"):
        simulate(out, seed=3, runs=["day"], profile="tiny", places=2)
    assert not out.exists()
    with pytest.raises(UserError, match="not finished: repeat the command"):
        open_dataset(out)


@pytest.mark.slow
def test_a_killed_rendering_goes_on_to_the_same_bytes(
    contents, dataset: Dataset, tmp_path: Path
) -> None:
    """kill -9 takes parent and workers in the middle; the same call then finishes."""
    out = tmp_path / "killed"
    script = (
        "from adafusion.sim.simulate import simulate\n"
        "if __name__ == '__main__':\n"
        f"    simulate({str(out)!r}, seed=3, runs={RUNS!r}, profile='tiny', places=3, workers=2)\n"
    )
    file = tmp_path / "job.py"
    file.write_text(script, encoding="utf-8")
    job = subprocess.Popen([sys.executable, str(file)])
    partial = tmp_path / "killed.partial"
    deadline = time.monotonic() + 200.0
    while len(list(partial.rglob("*.npy"))) < 1:
        assert time.monotonic() < deadline, "nothing was rendered"
        assert job.poll() is None, "the job ended before it could be killed"
        time.sleep(0.01)
    job.kill()
    job.wait()
    assert not out.exists()
    again = simulate(out, seed=3, runs=RUNS, profile="tiny", places=3, workers=2)
    assert contents(again.root) == contents(dataset.root)


def test_it_goes_on_where_it_was_cut_off(
    cut_off, count, contents, dataset: Dataset, tmp_path: Path
) -> None:
    out = tmp_path / "resumed"
    settings = {"seed": 3, "runs": RUNS, "profile": "tiny", "places": 3}
    with pytest.raises(KeyboardInterrupt):
        simulate(out, **settings, progress=cut_off(2))
    assert not out.exists()
    resumed = simulate(out, **settings, progress=count)
    assert count.totals == [3]
    assert contents(resumed.root) == contents(dataset.root)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"runs": ["noon"]}, "'noon'"),
        ({"runs": ["day", "day"]}, "each once"),
        ({"runs": []}, "one or more"),
        ({"profile": "huge"}, "tiny, small, compact, full"),
        ({"regions": "none"}, "all-test"),
        ({"places": 0}, "places"),
        ({"workers": 0}, "workers"),
        ({"runs": {"../day": PRESETS["day"]}}, "cannot name a folder"),
    ],
)
def test_bad_wishes_are_answered_before_anything_is_written(
    wrong: dict[str, object], message: str, tmp_path: Path
) -> None:
    wishes = {"seed": 3, "runs": ["day"], "profile": "tiny", "places": 1, **wrong}
    with pytest.raises(UserError, match=message):
        simulate(tmp_path / "none", **wishes)
    assert not list(tmp_path.iterdir())


def test_a_world_that_is_there_is_left_alone(dataset: Dataset) -> None:
    with pytest.raises(UserError, match="exists"):
        simulate(dataset.root, seed=3, runs=RUNS, profile="tiny", places=3)
