# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Trainings whose batches grow: measured in frame passes, and resumed as if never stopped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch

from adafusion.datasets import Dataset
from adafusion.experiments import all_jobs, build_experiment, packaged_recipe, plan_jobs, train_jobs
from adafusion.models import ModelConfig, PlaceModel
from adafusion.preprocess.cache import PreparedSet, prepare_cache
from adafusion.training import Step, TrainConfig, train
from adafusion.training.corpus import Corpus
from adafusion.training.objective import most_active, term_of
from adafusion.training.pairs import Batch
from adafusion.training.settings import Augment, Growth, Loss, Optimiser, Sampling
from adafusion.types import Description

PASSES = 200


@pytest.fixture
def config(tiny_model: ModelConfig) -> TrainConfig:
    """Batches that grow by half after every epoch."""
    return TrainConfig(
        model=replace(tiny_model, system="concat"),
        sampling=Sampling(places=2, growth=Growth(factor=1.5, below=1.0)),
        loss=Loss(kind="batch-hard", margin=1e-3),
        optimiser=Optimiser(schedule="cosine", warmup=5),
        augment=Augment(hue=0.1, erase=0.5),
        passes=PASSES,
        evaluate_every=50,
        checkpoint_every=3,
        schedule="joint",
    )


@pytest.fixture
def data(tiny_world: Dataset, tiny_model: ModelConfig, cache: Path) -> PreparedSet:
    return PreparedSet((prepare_cache(tiny_world, tiny_model.preprocess, cache),))


def steps(
    config: TrainConfig, data: PreparedSet, out: Path, *, resume: bool = False
) -> Iterator[Step]:
    def validate(model: PlaceModel) -> dict[str, float]:
        return {"recall@1": 0.5}

    torch.set_num_threads(1)
    return train(config, data, np.arange(0, len(data), 4), validate, out, resume=resume)


def seen(step: Step) -> tuple[int, float, int, float]:
    return step.batch, step.loss, step.frames, step.learning_rate


def test_a_stopped_training_whose_batches_grow_goes_on_as_if_it_had_not(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    whole = [seen(step) for step in steps(config, data, tmp_path / "whole")]
    frames = [step[2] for step in whole[1:]]
    assert max(frames) > 2 * frames[0], "the batches must grow for this to say anything"
    for stop in (4, len(whole) - 2):
        out = tmp_path / str(stop)
        list(islice(steps(config, data, out), stop))
        resumed = [seen(step) for step in steps(config, data, out, resume=True)]
        assert resumed == whole[-len(resumed) :]
        assert len(resumed) >= len(whole) - stop
    assert not list(steps(config, data, tmp_path / "whole", resume=True))


def test_a_length_in_passes_ends_with_the_batch_that_reaches_it(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    taken = list(steps(config, data, tmp_path))
    passes = np.cumsum([step.frames for step in taken])
    assert passes[-2] < PASSES <= passes[-1]
    judged = [int(count) for step, count in zip(taken, passes, strict=True) if step.validation]
    assert [count // 50 for count in judged] == [0, 1, 2, 3, 4]
    assert taken[-1].batches == taken[-1].batch
    assert taken[0].batches == PASSES // 4
    rates = [step.learning_rate for step in taken[6:]]
    assert rates == sorted(rates, reverse=True)
    share = 0.5 * (1 + np.cos(np.pi * passes[-2] / PASSES))
    assert rates[-1] == pytest.approx(share * config.optimiser.learning_rate)


def test_batches_of_one_size_may_be_measured_in_passes_too(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    one_size = replace(config, sampling=Sampling(places=2), passes=40, evaluate_every=20)
    in_batches = replace(one_size, passes=None, batches=10, evaluate_every=5)
    counted = [seen(step) for step in steps(one_size, data, tmp_path / "passes")]
    assert counted[1:] == [seen(step) for step in steps(in_batches, data, tmp_path / "batches")][1:]


def test_the_rate_falls_at_the_milestones(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    falling = Optimiser(
        schedule="step", milestones=(0.5, 0.8), factor=0.1, floor=0.05, learning_rate=1.0
    )
    short = replace(config, optimiser=falling, batches=10, sampling=Sampling(places=2))
    taken = [step.learning_rate for step in steps(short, data, tmp_path)]
    assert taken[1:] == pytest.approx([1.0] * 5 + [0.1] * 3 + [0.05] * 2)
    with pytest.raises(ValueError, match="milestones"):
        Optimiser(milestones=(1.5,))


def test_hue_and_erasing_change_what_is_learnt(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    def losses(name: str, **augment: float) -> list[float]:
        changed = replace(config, augment=Augment(**augment), batches=2)
        return [step.loss for step in steps(changed, data, tmp_path / name)][1:]

    plain, hue, erased = losses("a"), losses("b", hue=0.1), losses("c", erase=1.0)
    assert plain != hue
    assert plain != erased
    assert hue != erased


def test_the_most_active_head_decides() -> None:
    far, near = torch.tensor([[0.0], [0.0], [9.0], [9.0]]), torch.zeros(4, 1)
    a, b = np.triu_indices(4, k=1)
    is_positive = np.isin(np.arange(6), [0, 5])
    batch = Batch(np.arange(4), np.column_stack([a, b]), is_positive)
    loss = Loss(kind="batch-hard", margin=0.2)
    assert term_of(far, batch, loss)[1] == 0.0
    assert term_of(near, batch, loss)[1] == 1.0
    assert most_active(Description(far, far, far, None), batch, loss) == 0.0
    assert most_active(Description(far, near, far, None), batch, loss) == 1.0
    assert most_active(Description(far, None, None, None), batch, loss) == 0.0


def test_a_job_of_growing_batches_spends_its_budget(
    tiny_world: Dataset, cache: Path, tmp_path: Path
) -> None:
    changes = (
        "model.width=0.125",
        "model.preprocess.image.size=[48,64]",
        "model.preprocess.points={count: 64, quantum: 0.1}",
        "sampling.places=2",
        "sampling.growth={factor: 2, below: 1.0}",
        "loss.margin=1.0e-6",
    )
    corpus = Corpus((tiny_world,))

    def recipe(name: str) -> TrainConfig:
        return packaged_recipe(name, changes if name == "minkloc-s" else ())

    experiment = build_experiment("table-systems", recipe, 150).only(["MinkLoc++"])
    (job,) = all_jobs(plan_jobs(experiment, [0], corpus, tmp_path))
    assert (job.config.passes, job.config.batches) == (150, None)
    list(train_jobs([job], corpus, cache))
    record = job.record()
    assert 150 <= record["frame_passes"] < 160
    assert record["batches"] < 34, "the batches must grow for this to say anything"
    assert len(record["curve"]) == 9  # the first before any batch
