# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch

from adafusion.config import save_config
from adafusion.datasets import Dataset
from adafusion.models import AdaFusion, ModelConfig, describe, load_model, read_header
from adafusion.preprocess.cache import PreparedSet, prepare_cache
from adafusion.training import TrainConfig, build_model, phases, train
from adafusion.training.checkpoint import STATE_FILE
from adafusion.training.pairs import find_pairs, place_batches
from adafusion.training.settings import Augment, Loss, Mining, Optimiser, Sampling
from adafusion.training.start import balance_branches
from adafusion.types import JobFailed, UserError

CHILD = """
import sys, torch
from pathlib import Path
from adafusion.config import load_config
from adafusion.datasets import open_dataset
from adafusion.preprocess.cache import PreparedSet, prepare_cache
from adafusion.training import TrainConfig, train
import numpy as np
torch.set_num_threads(1)
root, cache, out = map(Path, sys.argv[1:])
config = load_config(TrainConfig, out.parent / "config.yaml")
data = PreparedSet((prepare_cache(open_dataset(root), config.model.preprocess, cache),))
for step in train(config, data, np.arange(len(data)), lambda model: {"recall@1": 0.5}, out):
    print(step.batch, step.loss, flush=True)
"""


@pytest.fixture
def config(tiny_model: ModelConfig) -> TrainConfig:
    return TrainConfig(
        model=tiny_model,
        sampling=Sampling(places=4),
        loss=Loss(kind="softmax", half_weight=0.1),
        optimiser=Optimiser(schedule="cosine", warmup=5),
        batches=40,
        evaluate_every=16,
        checkpoint_every=4,
        initialisation="he",
        norms=True,
    )


@pytest.fixture
def data(tiny_world: Dataset, tiny_model: ModelConfig, cache: Path) -> PreparedSet:
    return PreparedSet((prepare_cache(tiny_world, tiny_model.preprocess, cache),))


def recall_of_nothing(model: AdaFusion) -> dict[str, float]:
    return {"recall@1": 0.5}


def run(config: TrainConfig, data: PreparedSet, out: Path, **options: object) -> list[float]:
    torch.set_num_threads(1)
    steps = train(config, data, np.arange(len(data)), recall_of_nothing, out, **options)
    return [step.loss for step in steps if step.batch]


@pytest.mark.parametrize("mode", ["batch", "pairs"])
@pytest.mark.parametrize("system", ["adafusion", "concat", "image", "lidar"])
def test_every_system_trains_by_either_sampling(
    config: TrainConfig, data: PreparedSet, tmp_path: Path, mode: str, system: str
) -> None:
    config = replace(
        config,
        batches=3,
        sampling=replace(config.sampling, mode=mode, items=4),
        model=replace(config.model, system=system),
    )
    losses = run(config, data, tmp_path / "out")
    assert len(losses) == 3
    assert np.isfinite(losses).all()
    model = load_model(tmp_path / "out" / "model.safetensors")
    assert model.config.system == system
    paper = sum(p.numel() for p in AdaFusion(config.model).parameters())
    assert sum(p.numel() for p in model.parameters()) == paper, "the norms must be folded away"


def test_the_card_counts_only_the_mining_that_was_done(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    mining = Mining(after=2, every=2, candidates=20, hardest=4)  # after two batches, not after all
    sampling = Sampling(mode="pairs", items=4, mining=mining)
    run(replace(config, sampling=sampling, batches=4, keep="last"), data, tmp_path)
    assert [path.name for path in tmp_path.glob("described-*")] == ["described-2.npy"]
    _, card = read_header(tmp_path / "model.safetensors")
    assert card["mining_passes"] == len(data)


@pytest.mark.slow
def test_a_killed_training_resumes_bit_for_bit(
    config: TrainConfig, data: PreparedSet, tiny_world: Dataset, cache: Path, tmp_path: Path
) -> None:
    whole = run(config, data, tmp_path / "whole")
    killed = tmp_path / "killed"
    save_config(config, tmp_path / "config.yaml")
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(tiny_world.root), str(cache), str(killed)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    for line in child.stdout:
        if int(line.split()[0]) >= 9:
            os.kill(child.pid, signal.SIGKILL)
            break
    child.stdout.close()
    child.wait()
    assert (killed / STATE_FILE).exists()
    resumed = run(config, data, killed, resume=True)
    assert len(resumed) >= 20
    assert resumed[:20] == whole[-len(resumed) :][:20]


def test_the_same_seed_trains_the_same_and_another_does_not(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    short = replace(config, batches=3)
    first, second = (run(short, data, tmp_path / name) for name in "ab")
    other = run(replace(short, seed=1), data, tmp_path / "c")
    assert first == second
    assert first != other


@pytest.mark.parametrize("loss", [Loss(), Loss(kind="margin"), Loss(kind="batch-hard", margin=0.2)])
def test_half_precision_learns_nearly_the_same_into_whole_weights(
    config: TrainConfig, data: PreparedSet, tmp_path: Path, loss: Loss
) -> None:
    # one step each: what rounding leaves grows with every further one
    single = replace(config, batches=1, loss=loss)
    half = replace(single, precision="bf16-mixed")
    (whole,), (rounded,) = (run(c, data, tmp_path / c.precision) for c in (single, half))
    assert rounded != whole
    assert rounded == pytest.approx(whole, rel=0.05)
    kept = load_model(tmp_path / "bf16-mixed" / "model.safetensors")
    assert {p.dtype for p in kept.parameters()} == {torch.float32}


def test_the_best_on_validation_is_kept(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    recalls = iter([0.1, 0.9, 0.3])
    steps = train(
        replace(config, batches=4, evaluate_every=2),
        data,
        np.arange(len(data)),
        lambda model: {"recall@1": next(recalls)},
        tmp_path,
    )
    assert [step.is_best for step in steps if step.validation] == [True, True, False]
    assert read_header(tmp_path / "model.safetensors")[1]["batches"] == 2


def test_the_last_is_kept_where_that_is_asked(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    scores = iter([0.9, 0.2, 0.1])
    config = replace(config, batches=8, evaluate_every=4, keep="last")
    *_, last = train(
        config, data, np.arange(len(data)), lambda model: {"recall@1": next(scores)}, tmp_path
    )
    assert last.best == 0.9
    _, card = read_header(tmp_path / "model.safetensors")
    assert card["batches"] == 8
    assert card["validation"] == {"recall@1": 0.1}


def test_blanked_sensors_change_what_is_learnt_and_resume_alike(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    config = replace(config, batches=3, model=replace(config.model, system="adafusion"))
    blank = replace(config, augment=Augment(blank=0.5))
    assert run(blank, data, tmp_path / "a") == run(blank, data, tmp_path / "b")
    assert run(blank, data, tmp_path / "c") != run(config, data, tmp_path / "d")


def test_a_loss_that_is_no_number_stops_the_job(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    wild = replace(config, optimiser=Optimiser(learning_rate=1e30, schedule="plateau"), norms=False)
    with pytest.raises(JobFailed, match="learning_rate"):
        run(wild, data, tmp_path / "out")


def test_a_folder_with_a_training_is_not_overwritten(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    run(replace(config, batches=2), data, tmp_path)
    with pytest.raises(UserError, match="--resume"):
        run(replace(config, batches=2), data, tmp_path)
    with pytest.raises(UserError, match="differs"):
        run(replace(config, batches=3), data, tmp_path, resume=True)
    with pytest.raises(UserError, match="without --resume"):
        run(config, data, tmp_path / "absent", resume=True)


def test_staged_training_joins_the_branches_it_trained(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    staged = replace(config, schedule="staged", batches=2)
    unfolded = phases(staged, tmp_path)
    assert [phase.name for phase in unfolded] == ["image", "lidar", "adafusion"]
    for phase in unfolded[:2]:
        run(phase.config, data, phase.out)
    joint = build_model(unfolded[2].config)
    image = load_model(tmp_path / "image" / "model.safetensors")
    assert joint.image_net is not None
    assert image.image_net is not None
    ours, theirs = joint.image_net.state_dict(), image.image_net.state_dict()
    assert all(torch.equal(ours[key], theirs[key]) for key in theirs)


def test_stage_weights_moves_the_weight_branch_alone(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    concat = replace(config, batches=2, model=replace(config.model, system="concat"))
    run(concat, data, tmp_path / "concat")
    source = tmp_path / "concat" / "model.safetensors"
    weights = replace(config, batches=3, stage="weights", init=(str(source),), norms=False)
    run(weights, data, tmp_path / "weights")
    before = load_model(source).state_dict()
    after = load_model(tmp_path / "weights" / "model.safetensors").state_dict()
    assert all(torch.equal(after[key], value) for key, value in before.items())


def test_jitter_reads_raw_clouds_and_changes_what_is_learnt(
    config: TrainConfig, data: PreparedSet, tiny_world: Dataset, tmp_path: Path
) -> None:
    def points(row: int) -> np.ndarray:
        cloud = tiny_world.load(data.frames[row]).points_body
        assert cloud is not None
        return cloud

    short = replace(config, batches=2)
    jittered = replace(short, augment=Augment(jitter_m=0.3, jitter_clip_m=1.0))
    still, moved = (
        run(short, data, tmp_path / "a"),
        run(jittered, data, tmp_path / "b", points=points),
    )
    assert still != moved
    with pytest.raises(ValueError, match="points"):
        run(jittered, data, tmp_path / "c")


def test_training_beats_chance_on_what_it_has_seen(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    losses = run(replace(config, loss=Loss(kind="softmax")), data, tmp_path)
    assert np.mean(losses[-8:]) < 0.8 * np.mean(losses[:8])
    assert not math.isnan(losses[-1])


def test_steps_can_be_taken_one_at_a_time(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    start = time.perf_counter()
    steps = list(islice(train(config, data, np.arange(len(data)), recall_of_nothing, tmp_path), 3))
    assert [step.batch for step in steps] == [0, 1, 2]
    assert 0 < steps[1].seconds < time.perf_counter() - start


@pytest.mark.parametrize(
    "changes",
    [
        {"optimiser": Optimiser(schedule="plateau", patience=0), "norms": False},
        {"sampling": Sampling(mode="pairs", items=4)},
        {"augment": Augment(color=0.5)},
    ],
    ids=["plateau", "pairs", "colour"],
)
def test_a_stopped_training_goes_on_as_if_it_had_not(
    config: TrainConfig, data: PreparedSet, tmp_path: Path, changes: dict[str, object]
) -> None:
    config = replace(config, batches=10, evaluate_every=2, checkpoint_every=3, **changes)
    torch.set_num_threads(1)

    def validate(model: AdaFusion) -> dict[str, float]:
        weight = next(model.parameters())
        return {"recall@1": float(weight.detach().abs().mean())}  # a number that moves

    def steps(out: Path, resume: bool = False):
        return train(config, data, np.arange(len(data)), validate, out, resume=resume)

    whole = [(s.batch, s.loss, s.learning_rate) for s in steps(tmp_path / "whole") if s.batch]
    stopped = list(islice(steps(tmp_path / "stopped"), 8))
    assert stopped[-1].batch == 7
    resumed = [(s.batch, s.loss, s.learning_rate) for s in steps(tmp_path / "stopped", True)]
    assert resumed == whole[-len(resumed) :]
    assert resumed[0][0] == 7


def test_a_resume_on_other_frames_is_refused(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    short = replace(config, batches=4)
    rows = np.arange(len(data))
    list(islice(train(short, data, rows, recall_of_nothing, tmp_path), 5))
    with pytest.raises(UserError, match="another data"):
        next(train(short, data, rows[:-1], recall_of_nothing, tmp_path, resume=True))


def test_frames_without_true_pairs_are_refused(
    config: TrainConfig, data: PreparedSet, tmp_path: Path
) -> None:
    far = np.argsort(data.positions[:, 0])[[0, -1]]
    for mode in ("batch", "pairs"):
        sampling = replace(config.sampling, mode=mode)
        with pytest.raises(UserError, match="d_pos_m"):
            next(train(replace(config, sampling=sampling), data, far, recall_of_nothing, tmp_path))


@pytest.mark.parametrize("system", ["adafusion", "concat", "image"])
def test_balanced_branches_lie_around_the_margin(
    config: TrainConfig, data: PreparedSet, system: str
) -> None:
    model = build_model(replace(config, norms=False, model=replace(config.model, system=system)))
    pairs = find_pairs(data.positions, data.worlds)
    batches = list(islice(place_batches(pairs, 4, 2, np.random.default_rng(0)), 4))
    loss = Loss(margin=25.0, slack=1.0)
    balance_branches(model, data, batches, loss)
    middles = {"image_half": [], "lidar_half": []}
    alphas = []
    for batch in batches:
        d = describe(model, [data.tensors(batch.rows)])
        alphas.append(np.ones(2) if d.alpha is None else d.alpha.mean(axis=0))
        for name, found in middles.items():
            half = getattr(d, name)
            if half is not None:
                distance = np.abs(half[batch.pair[:, 0]] - half[batch.pair[:, 1]]).sum(axis=1)
                is_true = batch.is_positive
                found.append(0.5 * (distance[is_true].mean() + distance[~is_true].mean()))
    margin, _ = loss.margins(config.model.dim // 2)
    for i, found in enumerate(middles.values()):
        if found:
            assert np.mean(found) == pytest.approx(margin / np.mean(alphas, axis=0)[i], rel=0.05)
