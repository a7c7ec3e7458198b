# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A name stands for bytes: rendered once, the same for everyone, and refused where it is not."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from adafusion.cli import main
from adafusion.datasets import Dataset
from adafusion.sim import benchmarks
from adafusion.sim.benchmarks import (
    BENCHMARKS,
    benchmark_folder,
    found_hashes,
    names,
    open_benchmark,
)
from adafusion.types import UserError

TINY = "world-v1-tiny/test"


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def tiny(cache: Path) -> Dataset:
    return open_benchmark(TINY, cache)


@pytest.mark.parametrize("name", names())
def test_this_code_builds_what_the_names_stand_for(name: str) -> None:
    benchmark, _, part = name.partition("/")
    frozen = BENCHMARKS[benchmark].parts[part]
    assert found_hashes(name) == (frozen.geometry, frozen.settings)


def test_no_world_is_in_two_parts() -> None:
    seeds = [part.seed for known in BENCHMARKS.values() for part in known.parts.values()]
    assert len(set(seeds)) == len(seeds)


def test_a_part_holds_its_runs_and_says_what_it_is(tiny: Dataset) -> None:
    assert tiny.runs == tuple(sorted(BENCHMARKS["world-v1-tiny"].runs))
    assert tiny.info.name == TINY
    assert tiny.info.synthetic
    assert all(frame.zone and frame.T_world_ins is not None for frame in tiny.frames)


def test_it_is_rendered_once(tiny: Dataset, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmarks, "render", None)
    assert open_benchmark(TINY, cache).fingerprint == tiny.fingerprint


def test_another_geometry_is_refused_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = BENCHMARKS["world-v1-tiny"]
    part = replace(known.parts["test"], geometry="0" * 16)
    monkeypatch.setitem(BENCHMARKS, "world-v1-tiny", replace(known, parts={"test": part}))
    with pytest.raises(UserError, match=f"stands for geometry {'0' * 16}"):
        open_benchmark(TINY, tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_cached_world_of_another_hash_is_refused_by_path(tiny: Dataset, cache: Path) -> None:
    file = tiny.root / "dataset.yaml"
    whole = file.read_text(encoding="utf-8")
    values = yaml.safe_load(whole)
    values["sensors"]["geometry"] = "f" * 16
    file.write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")
    try:
        with pytest.raises(UserError, match=r"world-v1-tiny-test-.*ffff.*remove the folder"):
            open_benchmark(TINY, cache)
    finally:
        file.write_text(whole, encoding="utf-8")


def test_its_folder_is_named_after_what_decides_its_bytes(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = benchmark_folder(TINY, cache)
    known = BENCHMARKS["world-v1-tiny"]
    part = replace(known.parts["test"], settings="0" * 16)
    monkeypatch.setitem(BENCHMARKS, "world-v1-tiny", replace(known, parts={"test": part}))
    assert benchmark_folder(TINY, cache) != before


def run(*arguments: str) -> int:
    """Exit code of a command."""
    before, sys.argv = sys.argv, ["adafusion", *arguments]
    try:
        main()
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        sys.argv = before
    return 0


def test_commands_take_the_name_for_the_dataset(
    tiny: Dataset, cache: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("evaluate", TINY, str(tmp_path / "out"), "--model", "lidar-s", "--cache", str(cache),
               "--no-report") == 0  # fmt: skip
    assert "lidar-s" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("world-v1-tiny", "has parts: choose from world-v1-tiny/train, world-v1-tiny/test"),
        ("world-v1-tiny/exam", "unknown benchmark 'world-v1-tiny/exam'"),
        ("world-v9/test", "is missing"),
    ],
)
def test_a_wrong_name_is_answered_with_the_choices(
    name: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("evaluate", name, str(tmp_path / "out")) == 2
    assert words in capsys.readouterr().err


def test_the_list_says_what_is_rendered(
    tiny: Dataset, cache: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("world", "list", "--cache", str(cache)) == 0
    out = capsys.readouterr().out
    assert str(tiny.root) in out
    assert "world-v1/train: world" in out
    assert "not rendered yet" in out
