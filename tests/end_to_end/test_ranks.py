# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Two processes train as one does, on the CPU."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from adafusion.config import load_config, save_config
from adafusion.datasets import Dataset, open_dataset
from adafusion.models import ModelConfig, read_header
from adafusion.preprocess.augment import augment_points, blank_sensors, color_jitter
from adafusion.preprocess.cache import PreparedSet, prepare_cache
from adafusion.training import TrainConfig, build_model, train
from adafusion.training.objective import batch_loss
from adafusion.training.pairs import Batch
from adafusion.training.ranks import ALONE, SYNCED, Ranks, joined
from adafusion.training.settings import Augment, Loss, Mining, Optimiser, Sampling
from adafusion.types import UserError

FRAMES = 7  # for two processes three and four
LOSSES = {
    "margin": Loss(kind="margin"),
    "softmax": Loss(kind="softmax"),
    "halves": Loss(kind="softmax", half_weight=0.3, lidar_half_weight=0.1),
}
Learnt = dict[str, dict[str, Tensor]]


def batch() -> tuple[Batch, Tensor, Tensor]:
    """Seven frames of three places, and what was seen of them."""
    place = torch.tensor([0, 0, 0, 1, 1, 2, 2])
    pair = torch.combinations(torch.arange(FRAMES))
    is_positive = place[pair[:, 0]] == place[pair[:, 1]]
    generator = torch.Generator().manual_seed(3)
    image = torch.rand(FRAMES, 3, 48, 64, generator=generator) * 2 - 1
    voxels = (torch.rand(FRAMES, 1, 16, 16, 8, generator=generator) < 0.2).float()
    return Batch(np.arange(FRAMES), pair.numpy(), is_positive.numpy()), image, voxels


def learn(config: TrainConfig, ranks: Ranks) -> Learnt:
    """Gradients by each loss of an own part of the batch, and the running statistics after all."""
    whole, image, voxels = batch()
    part = ranks.part(FRAMES)
    model = build_model(config).double()  # so that what differs is no rounding
    if not ranks.is_first:
        with torch.no_grad():
            next(model.parameters()).add_(1.0)  # the first process's weights count
    ranks.unite(model)
    learnt: Learnt = {}
    for name, loss in LOSSES.items():
        model.zero_grad()
        description = ranks.gather(
            model.train()(image[part].double(), voxels[part].double()), FRAMES
        )
        value, _ = batch_loss(description, whole, loss)
        value.backward()
        ranks.sum_gradients(model)
        learnt[name] = {
            n: p.grad.clone() for n, p in model.named_parameters() if p.grad is not None
        }
    learnt["statistics"] = dict(model.named_buffers())
    return learnt


def few_batches(config: TrainConfig, data: PreparedSet, out: Path, ranks: Ranks) -> None:
    """Train, stop on the way and go on, in double: rounding grows from batch to batch."""
    config = replace(config, precision="64-true")
    arguments = (config, data, np.arange(len(data)), lambda model: {"recall@1": 0.5}, out)
    for resume, steps in ((False, 3), (True, None)):
        begun = train(*arguments, resume=resume, accelerator="cpu", ranks=ranks)
        list(islice(begun, steps))


def open_prepared(config: TrainConfig, root: Path, cache: Path) -> PreparedSet:
    return PreparedSet((prepare_cache(open_dataset(root), config.model.preprocess, cache),))


@pytest.fixture
def config(tiny_model: ModelConfig) -> TrainConfig:
    return TrainConfig(
        model=tiny_model,
        sampling=Sampling(mode="pairs", items=3),
        loss=Loss(kind="softmax", half_weight=0.1),
        # Adam would make whole steps of what rounding leaves where there is no slope
        optimiser=Optimiser(kind="sgd", schedule="plateau", learning_rate=0.01),
        augment=Augment(blank=0.3),
        batches=4,
        evaluate_every=2,
        checkpoint_every=1,
        keep="last",
        schedule="joint",
    )


def environment(rank: int, port: int) -> dict[str, str]:
    """What torchrun tells one of two processes."""
    return {
        "RANK": str(rank),
        "LOCAL_RANK": str(rank),
        "WORLD_SIZE": "2",
        "LOCAL_WORLD_SIZE": "2",
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": str(port),
        "OMP_NUM_THREADS": "1",
    }


@pytest.mark.slow
def test_two_processes_learn_what_one_does(
    config: TrainConfig, tiny_world: Dataset, cache: Path, tmp_path: Path
) -> None:
    torch.set_num_threads(1)
    save_config(config, tmp_path / "config.yaml")
    alone = learn(config, ALONE)
    few_batches(config, open_prepared(config, tiny_world.root, cache), tmp_path / "one", ALONE)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    words = [sys.executable, __file__, *map(str, (tmp_path, tiny_world.root, cache))]
    started = [
        subprocess.Popen(words, env=os.environ | environment(rank, port), stderr=subprocess.PIPE)
        for rank in (0, 1)
    ]
    said = [process.communicate(timeout=240)[1] for process in started]
    assert [process.returncode for process in started] == [0, 0], said

    first, second = (torch.load(tmp_path / f"{rank}.pt", weights_only=True) for rank in (0, 1))
    for part, values in alone.items():
        assert values.keys() == first[part].keys()
        for name, value in values.items():
            assert torch.equal(first[part][name], second[part][name]), (part, name)
            # a bias before a batch norm has no slope but what rounding gives it
            gap = (first[part][name] - value).abs().max()
            assert gap <= 1e-5 * value.abs().max() + 1e-12, (part, name)

    one, two = (load_file(tmp_path / name / "weights-4.safetensors") for name in ("one", "two"))
    assert one.keys() == two.keys()
    for name, value in one.items():
        torch.testing.assert_close(two[name], value, rtol=1e-4, atol=1e-8, msg=name)
    cards = [read_header(tmp_path / name / "model.safetensors")[1] for name in ("one", "two")]
    assert cards[0] == cards[1]


@pytest.mark.slow
def test_torchrun_trains_and_one_process_speaks(
    config: TrainConfig, tiny_world: Dataset, cache: Path, tmp_path: Path
) -> None:
    mined = Sampling(mode="pairs", items=3, mining=Mining(after=1, every=2, candidates=20))
    model = replace(config.model, system="lidar")
    save_config(replace(config, sampling=mined, model=model), tmp_path / "config.yaml")

    def torchrun() -> subprocess.CompletedProcess[str]:
        launch = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
        command = ["-m", "adafusion", "train", str(tmp_path / "out"), str(tiny_world.root)]
        options = ["--config", str(tmp_path / "config.yaml"), "--accelerator", "cpu"]
        return subprocess.run(
            [sys.executable, *launch, *command, *options],
            env={**os.environ, "ADAFUSION_CACHE": str(cache), "OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            timeout=240,
        )

    said = torchrun()
    assert said.returncode == 0, said.stderr
    assert said.stdout.count("validation recall@1") == 1
    assert said.stderr.count("frames, choosing on") == 1
    _, card = read_header(tmp_path / "out" / "model.safetensors")
    assert card["batches"] == 4
    assert card["mining_passes"] > 0

    again = torchrun()  # one process says why, and the other, which waits for it, ends as well
    assert again.returncode != 0
    assert again.stderr.count("give --resume") == 1


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        ({"RANK": None}, "WORLD_SIZE is 2, but RANK is not set: start them with `torchrun"),
        ({"WORLD_SIZE": "two"}, "WORLD_SIZE='two' is no number"),
    ],
)
def test_an_environment_that_torchrun_did_not_make_is_refused(
    monkeypatch: pytest.MonkeyPatch, changes: dict[str, str | None], remedy: str
) -> None:
    for name, value in (environment(0, 1) | changes).items():
        if value is None:
            monkeypatch.delenv(name, raising=False)
        else:
            monkeypatch.setenv(name, value)
    with pytest.raises(UserError, match=remedy), joined("cpu"):
        pass


def test_more_processes_than_gpus_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in environment(0, 1).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with (
        pytest.raises(UserError, match=r"2 processes for 1 GPU: .* --accelerator cpu"),
        joined("cuda"),
    ):
        pass


def test_a_command_that_processes_cannot_share_says_so(
    type_in, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "none")
    monkeypatch.setenv("WORLD_SIZE", "2")
    said = type_in("experiment", "headline")
    assert said.code == 2
    assert "without torchrun" in said.err
    assert "--workers" in said.err


@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_parts_make_up_the_batch_and_are_alike_in_length(count: int) -> None:
    frames = np.arange(33)
    parts = [frames[Ranks(rank, count).part(33)] for rank in range(count)]
    assert np.array_equal(np.concatenate(parts), frames)
    assert np.ptp([len(part) for part in parts]) <= 1
    with pytest.raises(UserError, match="start fewer"):
        Ranks(0, 34).part(33)


def test_a_part_of_a_batch_is_augmented_as_it_is_among_the_whole() -> None:
    _, image, voxels = batch()
    points = torch.rand(FRAMES, 20, 3, generator=torch.Generator().manual_seed(1))

    def changed(part: slice, among: tuple[int, slice] | None) -> list[Tensor]:
        images, lidar = color_jitter(image[part], seeded(), among=among), voxels[part].clone()
        blank_sensors(images, lidar, 0.5, np.random.default_rng(2), among)
        return [images, lidar, augment_points(points[part], seeded(), among)]

    def seeded() -> torch.Generator:
        return torch.Generator().manual_seed(4)

    whole = changed(slice(None), None)
    for part in (Ranks(rank, 2).part(FRAMES) for rank in (0, 1)):
        for some, every in zip(changed(part, (FRAMES, part)), whole, strict=True):
            assert torch.equal(some, every[part])


def test_norms_keep_their_data_and_their_names_when_they_are_united() -> None:
    for kind, synced in SYNCED.items():
        assert issubclass(synced, kind)
        assert list(synced(3).state_dict()) == list(kind(3).state_dict())


if __name__ == "__main__":  # one of two processes
    folder, root, prepared = map(Path, sys.argv[1:])
    given = load_config(TrainConfig, folder / "config.yaml")
    with joined("cpu") as ranks:
        torch.save(learn(given, ranks), folder / f"{ranks.rank}.pt")
        few_batches(given, open_prepared(given, root, prepared), folder / "two", ranks)
