# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Fusions that learn on the outputs of frozen branches, on a tiny world with tiny models."""

from __future__ import annotations

import json
from collections import deque
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch

from adafusion.datasets import Dataset
from adafusion.evaluation import validation_recall
from adafusion.models import ModelConfig, describe, load_model, prepared_batches, save_model
from adafusion.models.frozen import describe_frozen
from adafusion.models.systems import build_system
from adafusion.preprocess.cache import PreparedSet
from adafusion.training import TrainConfig, train
from adafusion.training.corpus import Corpus
from adafusion.training.settings import Augment, Optimiser, Sampling

BUDGET = 160


@pytest.fixture(scope="module")
def corpus(tiny_world: Dataset) -> Corpus:
    return Corpus((tiny_world,))


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def data(corpus: Corpus, tiny_model: ModelConfig, cache: Path) -> PreparedSet:
    return corpus.prepare(tiny_model.preprocess, cache)


@pytest.fixture(scope="module")
def frozen(tiny_model: ModelConfig, tmp_path_factory: pytest.TempPathFactory) -> TrainConfig:
    """Four batches of a weight branch on branches that nobody trained."""
    torch.manual_seed(3)
    file = tmp_path_factory.mktemp("branches") / "both.safetensors"
    save_model(build_system(replace(tiny_model, system="concat")), file)
    return TrainConfig(
        model=tiny_model,
        sampling=Sampling(places=4),
        optimiser=Optimiser(learning_rate=1e-2),
        augment=Augment(color=0.0),
        batches=4,
        evaluate_every=4,
        checkpoint_every=2,
        norms=False,
        init=(str(file),),
        stage="weights",
        cache_branches=True,
        balance=True,
        keep="last",
        schedule="joint",
    )


def run(config: TrainConfig, corpus: Corpus, data: PreparedSet, cache: Path, out: Path):
    rows, judges = corpus.rows("train"), corpus.rows("validation")
    deque(train(config, data, rows, validation_recall(data, judges), out, cache=cache), maxlen=0)
    return load_model(out / "model.safetensors")


@pytest.mark.parametrize(
    "changes",
    [{}, {"fusion": "linear"}, {"attend_features": True}, {"fusion": "one-stage-weights"}],
)
def test_what_learnt_by_the_cache_describes_the_same_without_it(
    changes: dict[str, object],
    frozen: TrainConfig,
    corpus: Corpus,
    data: PreparedSet,
    cache: Path,
    tmp_path: Path,
) -> None:
    config = replace(frozen, model=replace(frozen.model, **changes))
    model = run(config, corpus, data, cache, tmp_path)
    rows = corpus.rows("validation")
    by_cache = describe_frozen(model, data, rows, cache)
    through = describe(model, prepared_batches(data, rows))
    assert by_cache.fused is not None
    assert through.fused is not None
    assert np.allclose(by_cache.fused, through.fused, atol=1e-4)
    folders = [path for path in cache.iterdir() if (path / "outputs.f32").exists()]
    assert len(folders) == 1  # all fusions balance the branches alike


def test_it_learns_the_same_as_without_the_cache(
    frozen: TrainConfig, corpus: Corpus, data: PreparedSet, cache: Path, tmp_path: Path
) -> None:
    # Adam would make a step of what rounding gives a parameter without a gradient
    plain = replace(frozen, balance=False, optimiser=Optimiser(kind="sgd", learning_rate=0.1))
    by_cache = run(plain, corpus, data, cache, tmp_path / "by-cache")
    through = run(replace(plain, cache_branches=False), corpus, data, cache, tmp_path / "through")
    others = through.state_dict()
    for name, value in by_cache.state_dict().items():
        assert torch.allclose(value, others[name], atol=1e-4), name


def test_a_resumed_one_does_what_it_would_have_done(
    frozen: TrainConfig, corpus: Corpus, data: PreparedSet, cache: Path, tmp_path: Path
) -> None:
    whole = run(frozen, corpus, data, cache, tmp_path / "whole")
    rows, judges = corpus.rows("train"), corpus.rows("validation")
    validate, out = validation_recall(data, judges), tmp_path / "killed"
    killed = train(frozen, data, rows, validate, out, cache=cache)
    deque(islice(killed, 4), maxlen=0)  # the start and three batches; the checkpoint is of two
    killed.close()
    deque(train(frozen, data, rows, validate, out, cache=cache, resume=True), maxlen=0)
    again = load_model(out / "model.safetensors").state_dict()
    for name, value in whole.state_dict().items():
        assert torch.equal(value, again[name]), name


@pytest.mark.parametrize(
    "changes",
    [
        {"stage": "end-to-end"},
        {"augment": Augment(color=0.1)},
        {"augment": Augment(color=0.0, blank=0.1)},
    ],
)
def test_a_cache_for_what_changes_is_refused(
    frozen: TrainConfig, changes: dict[str, object]
) -> None:
    with pytest.raises(ValueError, match="cache_branches"):
        replace(frozen, **changes)


@pytest.mark.slow
def test_the_ablation_of_weights_is_one_command(
    type_in, tiny_world: Dataset, tiny_words: list[str], tmp_path: Path
) -> None:
    words = ["--train", tiny_world.root, "--test", tiny_world.root, "--out", tmp_path, *tiny_words]
    words += ["--budget", BUDGET, "--seeds", "0,1"]
    words += ["--rows", "MLP only,linear,attended features,AdaFusion"]
    said = type_in("experiment", "ablation-weights", *words)
    assert said.code == 0, said.err
    results = json.loads((tmp_path / "ablation-weights.json").read_text())
    assert (tmp_path / "ablation-weights.png").stat().st_size > 10_000
    page = (tmp_path / "ablation-weights.md").read_text()
    assert "## What fixed weights give" in page
    assert "| attended features | " in page

    study = results["study"]
    recall = {name: one["recall"]["value"] for name, one in study["unlearnt"].items()}
    assert study["recall_by_share"][0] == recall["LiDAR alone"]
    assert study["recall_by_share"][10] == recall["equal weights"]
    assert study["recall_by_share"][20] == recall["image alone"]
    assert recall["oracle"] >= max(study["recall_by_share"])
    assert study["unlearnt"]["equal weights"]["over equal"]["difference"]["value"] == 0.0
    assert study["rows"]["linear"]["alpha"] is None
    assert 0.0 < study["rows"]["MLP only"]["alpha"]["mean"][0] < 1.0
    for row in results["rows"]:
        gain = study["rows"][row["label"]]["over equal"]["difference"]["value"]
        measured = row["recall"]["cross-run"]["AR@1"]["value"] - recall["equal weights"]
        assert gain == pytest.approx(measured, abs=1e-9)

    passes = {row["label"]: row["frame_passes"]["lidar"] for row in results["rows"]}
    assert passes["MLP only"] == passes["linear"] < passes["AdaFusion"]
