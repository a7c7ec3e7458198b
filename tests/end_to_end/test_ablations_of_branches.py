# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Losses and poolings compared, on a tiny world with tiny models."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from adafusion.datasets import Dataset
from adafusion.experiments import (
    all_jobs,
    build_experiment,
    packaged_recipe,
    plan_jobs,
    train_jobs,
)
from adafusion.models import load_model
from adafusion.training.corpus import Corpus


@pytest.mark.slow
def test_losses_of_every_kind_of_batch_train_and_are_judged_often(
    run_experiment, tmp_path: Path
) -> None:
    labels = ["margin on pairs", "margin", "batch-hard", "lazy-quadruplet"]
    results, words = run_experiment("ablation-loss", labels, 1200)
    assert list(results["study"]["curves"]) == labels
    for (curve,) in results["study"]["curves"].values():
        assert len(curve) > 9  # that before the first batch, and more than other trainings have
        assert curve[-1][0] == pytest.approx(540, rel=0.1)
    assert "Frame passes to a fixed recall" in words
    assert (tmp_path / "picture.png").stat().st_size > 10_000


@pytest.mark.slow
def test_poolings_train_and_are_tried_at_other_sizes(run_experiment) -> None:
    results, words = run_experiment("ablation-pooling", ["L GEM", "L FC", "V VLAD"])
    for row in results["rows"]:
        smaller, own, larger = results["study"]["rows"][row["label"]]
        assert own["AR@1"]["value"] == pytest.approx(row["recall"]["cross-run"]["AR@1"]["value"])
        assert own["change"]["value"] == 0
        assert (smaller is None) == (larger is None) == row["label"].endswith("FC")
    assert "At another size" in words


def test_the_mean_is_the_headlines_own_branch(
    tiny_world: Dataset, tiny_changes: tuple[str, ...], tmp_path: Path
) -> None:
    recipe = partial(packaged_recipe, changes=tiny_changes)
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


@pytest.mark.slow
def test_the_pilot_tells_of_validation_alone(run_experiment, tmp_path: Path) -> None:
    results, words = run_experiment("pilot", ["L x1", "L x2"])
    assert [one["passes"] for one in results["study"]["rows"]["L"]["tried"]] == [160, 320]
    assert "levels off at" in words
    assert "AR@1" not in words
    assert not (tmp_path / "evaluations").exists()


@pytest.mark.slow
def test_networks_learn_together_from_scratch_by_either_recipe(
    tiny_world: Dataset, tiny_changes: tuple[str, ...], cache: Path, tmp_path: Path
) -> None:
    recipe = partial(packaged_recipe, changes=tiny_changes)
    labels = ["VL", "AdaFusion", "AdaFusion MLP only", "AdaFusion as in the paper"]
    experiment = build_experiment("end-to-end", recipe, 100).only(labels)
    rows = plan_jobs(experiment, [0], corpus := Corpus((tiny_world,)), tmp_path)
    trained = list(train_jobs(all_jobs(rows), corpus, cache))
    assert [len(list(rows[label][0].chain())) for label in labels] == [1, 1, 1, 1]
    for job in trained:
        assert job.record()["frame_passes"] == pytest.approx(100, rel=0.3)
        model = load_model(job.model)
        assert model.config.system == ("concat" if "vl" in job.name else "adafusion")
