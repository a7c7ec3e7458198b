# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Losses and poolings compared, on a tiny world with tiny models."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import pytest

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
from adafusion.training.corpus import Corpus

TINY = (
    "model.width=0.125",
    "model.dim=16",
    "model.preprocess.image.size=[48,64]",
    "model.preprocess.voxels.shape=[16,16,12]",
)


@pytest.fixture
def run(tiny_world: Dataset, cache: Path, tmp_path: Path):
    """Train and judge some rows of an experiment; its results and its page."""

    def run(name: str, labels: list[str], budget: int) -> tuple[dict[str, Any], str]:
        recipe = partial(packaged_recipe, changes=TINY)
        experiment = build_experiment(name, recipe, budget).only(labels)
        corpus = Corpus((tiny_world,))
        rows = plan_jobs(experiment, [0], corpus, tmp_path)
        list(train_jobs(all_jobs(rows), corpus, cache))
        exams = [ExamData.of(tiny_world)]
        told = {"passes": budget, "seeds": [0], "command": ""}
        results = measure(experiment, rows, corpus, exams, cache, tmp_path, **told)
        assert experiment.study is not None
        if experiment.study.draw is not None:
            experiment.study.draw(results, tmp_path / "picture.png")
        return results, page(results, experiment.study.section(results["study"]))

    return run


@pytest.mark.slow
def test_losses_of_every_kind_of_batch_train_and_are_judged_often(run, tmp_path: Path) -> None:
    labels = ["margin on pairs", "margin", "batch-hard", "lazy-quadruplet"]
    results, words = run("ablation-loss", labels, 1200)
    assert list(results["study"]["curves"]) == labels
    for (curve,) in results["study"]["curves"].values():
        assert len(curve) > 9  # that before the first batch, and more than other trainings have
        assert curve[-1][0] == pytest.approx(540, rel=0.1)
    assert "Frame passes to a fixed recall" in words
    assert (tmp_path / "picture.png").stat().st_size > 10_000


@pytest.mark.slow
def test_poolings_train_and_are_tried_at_other_sizes(run) -> None:
    results, words = run("ablation-pooling", ["L GEM", "L FC", "V VLAD"], 160)
    for row in results["rows"]:
        smaller, own, larger = results["study"]["rows"][row["label"]]
        assert own["AR@1"]["value"] == pytest.approx(row["recall"]["cross-run"]["AR@1"]["value"])
        assert own["change"]["value"] == 0
        assert (smaller is None) == (larger is None) == row["label"].endswith("FC")
    assert "At another size" in words


def test_the_mean_is_the_headlines_own_branch(tiny_world: Dataset, tmp_path: Path) -> None:
    recipe = partial(packaged_recipe, changes=TINY)
    keys = {
        name: {
            job.key
            for job in all_jobs(
                plan_jobs(build_experiment(name, recipe, 160), [0], Corpus((tiny_world,)), tmp_path)
            )
        }
        for name in ("headline", "ablation-pooling")
    }
    assert len(keys["headline"] & keys["ablation-pooling"]) == 2
