# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Remedies as one command, and what they keep of each other, on a tiny world."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from adafusion.datasets import Dataset
from adafusion.experiments import (
    ExamData,
)
from adafusion.experiments.describing import describe_frames
from adafusion.experiments.judging import answers, ask, evaluate_model
from adafusion.experiments.studies.remedy_facts import (
    gradients,
    nearest_matches,
    under_fixed_weights,
)
from adafusion.models import ModelConfig, describe, load_model, save_model
from adafusion.models.adafusion import unit_scale
from adafusion.preprocess.cache import PreparedSet, prepare_cache
from adafusion.training import TrainConfig, build_model
from adafusion.training.objective import batch_loss
from adafusion.training.sampler import Sampler
from adafusion.training.settings import Loss, Sampling
from adafusion.training.start import balance_branches


@pytest.fixture
def config(tiny_model: ModelConfig) -> TrainConfig:
    return TrainConfig(
        model=tiny_model, sampling=Sampling(places=4), loss=Loss(half_weight=0.25), norms=False
    )


@pytest.fixture
def data(tiny_world: Dataset, tiny_model: ModelConfig, cache: Path) -> PreparedSet:
    return PreparedSet((prepare_cache(tiny_world, tiny_model.preprocess, cache),))


@pytest.mark.slow
def test_the_remedies_are_measured(run_experiment, tmp_path: Path) -> None:
    labels = ["VL", "AdaFusion", "weights first", "pair margin"]
    results, words = run_experiment("remedies", labels)
    assert "What keeps the weights from gaining" in words
    assert (tmp_path / "picture.png").stat().st_size > 10_000

    study = results["study"]["rows"]
    assert list(study) == ["VL", "AdaFusion", "pair margin", "weights first"]
    by_label = {row["label"]: row for row in results["rows"]}
    for label, row in study.items():
        everything = row["recall"]["all pairs"]
        assert everything["learnt"] == pytest.approx(
            by_label[label]["recall"]["cross-run"]["AR@1"]["value"]
        )
        (facts,) = row["seeds"]
        assert all(0.0 < facts["image_share"][kind] < 1.0 for kind in ("true", "wrong"))
        assert 0.0 <= facts["kept"] <= 1.0
        assert facts["gradient"] == {}  # the validation region of a tiny world holds one place
        if label == "VL":
            assert facts["alpha"] is None
            assert everything["gain"]["difference"]["value"] == 0.0
        else:
            assert facts["alpha"]["mean"] == pytest.approx(
                by_label[label]["alpha"][0]["all"]["mean"], rel=1e-5
            )
    pairs = {(verdict["row"], verdict["against"]) for verdict in results["verdicts"]}
    assert ("weights first", "AdaFusion") in pairs
    assert ("pair margin", "VL") in pairs


@pytest.mark.parametrize("normalise", [False, True])
def test_balancing_measures_the_halves_before_they_are_normalised(
    config: TrainConfig, data: PreparedSet, normalise: bool
) -> None:
    plain = build_model(config)
    model = build_model(replace(config, model=replace(config.model, normalise_halves=normalise)))
    batches = list(Sampler(config.sampling, data, np.arange(len(data)), 0).batches(0, 2))
    for one in (plain, model):
        balance_branches(one, data, batches, config.loss)
    for key, value in plain.state_dict().items():
        assert torch.equal(value, model.state_dict()[key]), key
    assert model.config.normalise_halves is normalise
    rows = np.arange(3)
    one, other = (describe(m, [data.tensors(rows)]) for m in (plain, model))
    np.testing.assert_array_equal(one.alpha, other.alpha)
    expected = unit_scale(torch.from_numpy(one.image_half)).numpy() if normalise else one.image_half
    np.testing.assert_allclose(other.image_half, expected, rtol=1e-5)


def test_the_gradient_of_each_part_is_that_of_a_plain_loop(
    config: TrainConfig, data: PreparedSet
) -> None:
    rows = np.arange(len(data))
    model = build_model(config).eval().requires_grad_(False)
    found = gradients(model, config, data, rows)
    model.requires_grad_(True)
    norms = {"image": [], "lidar": [], "weights": []}
    nets = {"image": model.image_net, "lidar": model.voxel_net, "weights": model.weight_net}
    for batch in Sampler(config.sampling, data, rows, 0).batches(0, 4):
        model.zero_grad()
        batch_loss(model(*data.tensors(batch.rows)), batch, config.loss)[0].backward()
        for part, net in nets.items():
            squares = sum(p.grad.square().sum().item() for p in net.parameters())
            norms[part].append(squares**0.5)
    for part, values in norms.items():
        assert found[part]["norm"] == pytest.approx(np.mean(values), rel=1e-4)
        assert 0.0 < found[part]["agreement"] <= 1.0 + 1e-6


@pytest.mark.parametrize("unit_length", [False, True])
def test_nearest_matches_are_those_of_the_evaluation(
    config: TrainConfig, tiny_world: Dataset, cache: Path, tmp_path: Path, unit_length: bool
) -> None:
    file = tmp_path / "model.safetensors"
    concat = replace(config.model, system="concat", unit_length=unit_length)
    save_model(build_model(replace(config, model=concat)), file)
    model = load_model(file)
    exam = ExamData.of(tiny_world)
    described = describe_frames(model, exam.dataset, cache, tmp_path)
    records = evaluate_model("concat", file, [exam], ["cross-run"], cache, tmp_path)["cross-run"]
    world = (exam.dataset.positions_m, exam.splits("cross-run"))
    # a model without weights answers under fixed weights what it answers
    ranks = under_fixed_weights([described], [world], model.config)
    np.testing.assert_array_equal(ranks, answers(records).first_hit)
    # a query is answered rightly where its true match is nearer than the wrong one
    right = []
    for split in world[1]:
        query, true, wrong = nearest_matches(described.fused, world[0], split, model.config.p)
        to_true, to_wrong = (
            np.linalg.norm(described.fused[query] - described.fused[match], model.config.p, axis=1)
            for match in (true, wrong)
        )
        right.append(to_true < to_wrong)
    questions = ask([exam], "cross-run")
    answerable = ranks > 0
    assert len(questions.zone) == len(ranks)
    np.testing.assert_array_equal(np.concatenate(right), ranks[answerable] == 1)
