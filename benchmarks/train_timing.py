# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Trainings that take turns in one process, and what each batch of them took.

Time is taken around the training loop itself and not in a copy of it: `Step` says how long a batch
waited for its frames to be drawn, read and augmented.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float32, Int, UInt8
from torch import Tensor

from adafusion.datasets import Dataset
from adafusion.evaluation.metrics import percentile_interval
from adafusion.preprocess.cache import PreparedSet
from adafusion.preprocess.image import resize
from adafusion.training import TrainConfig
from adafusion.training.sampler import Sampler
from train_alone import ENDLESS, WARM_UP, begin


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """A training to be timed, and what it reads its frames from."""

    config: TrainConfig
    data: PreparedSet
    rows: Int[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Timing:
    """What each batch of a training took, by round."""

    seconds: Float[np.ndarray, " rounds"]  # from asking for the batch to having learnt from it
    waited: Float[np.ndarray, " rounds"]  # of these until it was drawn, read and augmented
    frames: Float[np.ndarray, " rounds"]
    pairs: Float[np.ndarray, " rounds"]  # that count in the loss


@dataclass(frozen=True, eq=False)
class FromFiles(PreparedSet):
    """The frames of a dataset without the cache: decoded, resized and voxelised every time."""

    dataset: Dataset

    def images_u8(self, rows: Int[np.ndarray, " b"]) -> UInt8[Tensor, "b h w 3"]:
        """As the cache has them; every frame must have an image."""
        seen = [self.dataset.load(replace(self.dataset.frames[row], cloud=None)) for row in rows]
        images = [resize(s.image, self.settings.image) for s in seen if s.image is not None]
        return torch.from_numpy(np.stack(images))

    def lidar(self, rows: Int[np.ndarray, " b"]) -> Float32[Tensor, "b ..."]:
        """As the cache has them; every frame must have a cloud."""
        seen = [self.dataset.load(replace(self.dataset.frames[row], image=None)) for row in rows]
        clouds = [s.points_body for s in seen if s.points_body is not None]
        return torch.stack([self.settings.lidar_tensor(cloud) for cloud in clouds])


def interleaved(
    cases: Mapping[str, Case], rounds: int, scratch: Path, accelerator: str
) -> dict[str, Timing]:
    """Time trainings in turns, a batch of each a round, every second round backwards."""
    running = {
        name: timed_batches(case, scratch / str(number), accelerator)
        for number, (name, case) in enumerate(cases.items())
    }
    taken: dict[str, list[tuple[float, ...]]] = {name: [] for name in cases}
    for number in range(WARM_UP + rounds):
        for name in reversed(cases) if number % 2 else cases:
            taken[name].append(next(running[name]))
    return {name: Timing(*np.array(batches[WARM_UP:]).T) for name, batches in taken.items()}


def timed_batches(case: Case, out: Path, accelerator: str) -> Iterator[tuple[float, ...]]:
    """Seconds, seconds waited, frames and pairs of each batch."""
    config = case.config
    steps = begin(config, case.data, case.rows, out, accelerator=accelerator)
    sampler = Sampler(config.sampling, case.data, case.rows, config.seed)
    for batch in sampler.batches(0, ENDLESS):  # the same once more, for their pairs
        began = time.perf_counter()
        step = next(steps)
        seconds = time.perf_counter() - began
        yield seconds, step.waited, step.frames, len(batch.pair)


def table(timings: Mapping[str, Timing], base: Callable[[str], str]) -> list[str]:
    """A row a training, its time a frame divided by that of its `base`."""
    lines = [
        "| | frames | pairs | ms a frame | of these waiting | share | frames/s | pairs/s "
        "| time a frame, ratio |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, t in timings.items():
        other = timings[base(name)]
        ratio = (t.seconds / t.frames) / (other.seconds / other.frames)
        lines.append(
            f"| {name} | {t.frames.mean():.0f} | {t.pairs.mean():.0f} "
            f"| {1e3 * np.median(t.seconds / t.frames):.1f} "
            f"| {1e3 * np.median(t.waited / t.frames):.2f} | {np.median(t.waited / t.seconds):.1%} "
            f"| {np.median(t.frames / t.seconds):.1f} | {np.median(t.pairs / t.seconds):.0f} "
            f"| {1 if base(name) == name else with_interval(ratio)} |"
        )
    return lines


def with_interval(ratios: Float[np.ndarray, " rounds"]) -> str:
    """Median and its 95 % interval from a bootstrap over rounds."""
    draws = np.random.default_rng(0).choice(ratios, (2000, len(ratios)))
    low, high = percentile_interval(np.median(draws, axis=1))
    return f"{np.median(ratios):.2f} [{low:.2f}, {high:.2f}]"
