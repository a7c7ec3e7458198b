# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A name stands for bytes: rendered once, the same for everyone, and refused where it is not."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from adafusion.datasets import Dataset, open_dataset
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


def test_files_that_are_not_as_rendered_are_refused(tiny: Dataset, cache: Path) -> None:
    picture = tiny.root / str(tiny.frames[0].image)
    whole = picture.read_bytes()
    picture.write_bytes(whole + b"0")
    try:
        with pytest.raises(UserError, match=r"no longer as it was rendered.*remove it"):
            open_benchmark(TINY, cache)
    finally:
        picture.write_bytes(whole)
    assert open_benchmark(TINY, cache).fingerprint == tiny.fingerprint


def test_a_world_rendered_again_is_not_held_to_the_rendering_before(
    tiny: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another encoder may give files of other sizes."""
    out = benchmark_folder(TINY, tmp_path)
    out.parent.mkdir()
    out.with_name(f"{out.name}.fingerprint").write_text("of a removed folder\n", encoding="utf-8")
    monkeypatch.setattr(
        benchmarks, "render", lambda studio, out, info, **_: shutil.copytree(tiny.root, out)
    )
    assert open_benchmark(TINY, tmp_path).fingerprint == tiny.fingerprint


def test_its_folder_is_named_after_what_decides_its_bytes(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = benchmark_folder(TINY, cache)
    known = BENCHMARKS["world-v1-tiny"]
    part = replace(known.parts["test"], settings="0" * 16)
    monkeypatch.setitem(BENCHMARKS, "world-v1-tiny", replace(known, parts={"test": part}))
    assert benchmark_folder(TINY, cache) != before


def test_commands_take_the_name_for_the_dataset(
    type_in, tiny: Dataset, cache: Path, tmp_path: Path
) -> None:
    said = type_in(
        "evaluate", TINY, tmp_path / "out", "--model", "lidar-s", "--cache", cache, "--no-report"
    )
    assert said.code == 0, said.err
    assert "lidar-s" in said.out


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("world-v1-tiny", "has parts: choose from world-v1-tiny/train, world-v1-tiny/test"),
        ("world-v1-tiny/exam", "unknown benchmark 'world-v1-tiny/exam'"),
        ("world-v9/test", "is missing"),
    ],
)
def test_a_wrong_name_is_answered_with_the_choices(
    type_in, name: str, words: str, tmp_path: Path
) -> None:
    said = type_in("evaluate", name, tmp_path / "out")
    assert said.code == 2
    assert words in said.err


def test_the_list_says_what_is_rendered(type_in, tiny: Dataset, cache: Path) -> None:
    said = type_in("world", "list", "--cache", cache)
    assert said.code == 0
    assert str(tiny.root) in said.out
    assert "world-v1/train: world" in said.out
    assert "not rendered yet" in said.out


def test_the_list_checks_what_this_installation_builds(
    type_in, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = BENCHMARKS["world-v1-tiny"]
    part = replace(known.parts["test"], geometry="0" * 16)
    wrong = replace(known, parts={"train": known.parts["train"], "test": part})
    monkeypatch.setattr(benchmarks, "BENCHMARKS", {"world-v1-tiny": wrong})
    said = type_in("world", "list", "--check")
    assert said.code == 2
    assert "world-v1-tiny/train: world 1101" in said.out
    assert "this installation builds it" in said.out
    assert "MISMATCH" in said.out
    assert "world-v1-tiny/test" in said.err


def test_a_whole_benchmark_is_rendered_by_its_name(type_in, tiny: Dataset, cache: Path) -> None:
    said = type_in("world", "render", TINY, "--cache", cache)
    assert said.code == 0
    assert f"{len(tiny.frames)} frames (synthetic)" in said.out
    said = type_in("world", "render", "world-v0", "--cache", cache)
    assert said.code == 2
    assert "world-v1-small/test" in said.err


def test_a_sheet_shows_places_under_conditions(type_in, tmp_path: Path) -> None:
    out = tmp_path / "sheet.html"
    said = type_in(
        "world", "sheet", out, "--profile", "tiny", "--conditions", "day,night", "--places", "3"
    )
    assert said.code == 0, said.err
    assert "synthetic" in out.read_text(encoding="utf-8")
    said = type_in("world", "sheet", tmp_path / "sheet.pdf", "--profile", "tiny")
    assert said.code == 2
    assert "ends in .png or .html" in said.err


def test_a_drive_is_exported_by_name(type_in, tmp_path: Path) -> None:
    words = ["--profile", "tiny", "--places", "2", "--runs", "day"]
    said = type_in("world", "export", "nclt", tmp_path / "nclt", *words)
    assert said.code == 0, said.err
    assert "SYNTHETIC" in said.err
    assert (tmp_path / "nclt" / "manifest.json").exists()
    said = type_in("world", "export", "kitti", tmp_path / "kitti", *words)
    assert said.code == 2
    assert "choose from nclt, robotcar, pointnetvlad" in said.err


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("fog_per_m=5", "fog_per_m = 5.0 is not in [0, 1]"),
        ("fog_m=0.1", "did you mean fog_per_m?"),
        ("dusk.fog_per_m=0.1", "no run 'dusk'; choose from day, night"),
    ],
)
def test_a_factor_that_is_wrong_is_named(type_in, change: str, words: str, tmp_path: Path) -> None:
    said = type_in("simulate", tmp_path / "none", "--profile", "tiny", "--set", change)
    assert said.code == 2
    assert words in said.err
    assert "@" not in said.err
    assert not list(tmp_path.iterdir())


def test_factors_are_set_for_all_runs_or_for_one(type_in, tmp_path: Path) -> None:
    said = type_in(
        "simulate", tmp_path / "hazy", "--profile", "tiny", "--places", "1", "--runs", "day,night",
        "--set", "foliage=0.25", "--set", "night.fog_per_m=0.5", "--workers", "1",
    )  # fmt: skip
    assert said.code == 0, said.err
    assert "warning: no frame lies in the test region: give more --places" in said.err
    conditions = open_dataset(tmp_path / "hazy").info.sensors["conditions"]
    assert conditions["day"]["foliage"] == conditions["night"]["foliage"] == 0.25
    assert conditions["night"]["fog_per_m"] == 0.5 != conditions["day"]["fog_per_m"]


def test_a_preset_shows_its_factors(type_in) -> None:
    said = type_in("config", "show", "night", "fog_per_m=0.25")
    assert said.code == 0
    assert "fog_per_m: 0.25" in said.out
    assert type_in("config", "show", "noon").code == 2
