# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A tiny simulated world and a tiny model, made once for all end-to-end tests."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from adafusion.cli import main
from adafusion.datasets import Dataset
from adafusion.experiments import (
    ExamData,
    all_jobs,
    build_experiment,
    measure,
    packaged_recipe,
    page,
    plan_jobs,
    train_jobs,
)
from adafusion.models import ModelConfig
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid
from adafusion.sim.exports import export
from adafusion.sim.simulate import simulate
from adafusion.training.corpus import Corpus
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
def tiny_changes() -> tuple[str, ...]:
    """What makes every training of an experiment one of tiny models and batches."""
    return (
        "model.width=0.125",
        "model.dim=16",
        "model.preprocess.image.size=[48,64]",
        "model.preprocess.voxels.shape=[16,16,12]",
        "sampling.places=4",
    )


@pytest.fixture(scope="session")
def tiny_words(tiny_changes: tuple[str, ...]) -> list[str]:
    """The same for a command line."""
    return [word for change in tiny_changes for word in ("--set", change)]


@pytest.fixture
def run_experiment(
    tiny_world: Dataset, tiny_changes: tuple[str, ...], cache: Path, tmp_path: Path
) -> Callable[..., tuple[dict[str, Any], str]]:
    """Train and judge some rows of an experiment in `tmp_path`; its results and its page."""

    def run(
        name: str, labels: list[str], budget: int = 160, worlds: int = 1
    ) -> tuple[dict[str, Any], str]:
        recipe = partial(packaged_recipe, changes=tiny_changes)
        experiment = build_experiment(name, recipe, budget).only(labels)
        corpus = Corpus((tiny_world,))
        rows = plan_jobs(experiment, [0], corpus, tmp_path)
        list(train_jobs(all_jobs(rows), corpus, cache))
        exams = [ExamData.of(tiny_world)] * worlds
        told = {"passes": budget, "seeds": [0], "command": ""}
        results = measure(experiment, rows, corpus, exams, cache, tmp_path, **told)
        results = json.loads(json.dumps(results))  # as they are kept
        assert experiment.study is not None
        if experiment.study.draw is not None:
            experiment.study.draw(results, tmp_path / "picture.png")
        return results, page(results, experiment.study.section(results["study"]))

    return run


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
