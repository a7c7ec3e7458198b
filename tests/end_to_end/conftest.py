# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A tiny simulated world and a tiny model, made once for all end-to-end tests."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from adafusion.cli import main
from adafusion.datasets import Dataset
from adafusion.models import ModelConfig
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid
from adafusion.sim.exports import export
from adafusion.sim.simulate import simulate
from adafusion.types import Progress


@pytest.fixture(scope="session")
def tiny_world(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two runs of a world nobody trains on elsewhere, cut into regions."""
    out = tmp_path_factory.mktemp("world") / "tiny"
    return simulate(out, seed=5, runs=["day", "night"], profile="tiny")


@pytest.fixture(scope="session")
def export_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Export a world, which nobody changes; the same wishes again give the same folder."""
    made: dict[str, Path] = {}

    def once(kind: str, **wishes: Any) -> Path:
        key = json.dumps([kind, wishes], sort_keys=True)
        if key not in made:
            made[key] = export(kind, tmp_path_factory.mktemp("export") / kind, **wishes)
        return made[key]

    return once


@pytest.fixture(scope="session")
def tiny_model() -> ModelConfig:
    """A network that describes a frame in a millisecond."""
    return ModelConfig(
        width=0.125,
        dim=16,
        preprocess=Preprocess(
            image=ImageSettings(size=(48, 64)), voxels=VoxelGrid(shape=(16, 16, 8))
        ),
    )


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where all end-to-end tests keep preprocessed frames."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def contents():
    """Every file below a folder, by its path there."""

    def read(folder: Path) -> dict[str, bytes]:
        paths = (path for path in folder.rglob("*") if path.is_file())
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}

    return read


@pytest.fixture
def cut_off():
    """A progress bar that stops a job after so many steps, as Ctrl-C would."""

    def after(steps: int) -> Progress:
        def stop(
            items: Iterable[object], *, total: int | None = None, desc: str = ""
        ) -> Iterator[object]:
            for k, item in enumerate(items):
                if k == steps:
                    raise KeyboardInterrupt
                yield item

        return stop

    return after


class Count:
    """A progress bar that keeps how many steps it was told of."""

    def __init__(self) -> None:
        self.totals: list[int | None] = []

    def __call__(
        self, items: Iterable[object], *, total: int | None = None, desc: str = ""
    ) -> Iterable[object]:
        self.totals.append(total)
        return items


@pytest.fixture
def count() -> Count:
    """A progress bar that counts."""
    return Count()


class Said:
    """What a command returned and printed."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err


@pytest.fixture
def type_in(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, cache: Path):
    """Run a command line in this process."""
    monkeypatch.setenv("ADAFUSION_CACHE", str(cache))

    def run(*words: object) -> Said:
        monkeypatch.setattr(sys, "argv", ["adafusion", *map(str, words)])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = int(stop.code or 0)
        return Said(code, *capfd.readouterr())

    return run
