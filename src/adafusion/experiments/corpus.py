# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The datasets that teach, as the trainings of an experiment need them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from adafusion.datasets import Dataset, open_dataset
from adafusion.datasets.splits import region_of
from adafusion.evaluation import evaluate_splits, make_splits
from adafusion.files import fingerprint
from adafusion.preprocess import Preprocess
from adafusion.preprocess.cache import PreparedFrames, PreparedSet, prepare_cache
from adafusion.training.sampler import Sampler
from adafusion.training.settings import Sampling
from adafusion.types import SENSORS, Progress, UserError, lacking, silent

SAMPLED = 50  # batches from which the frames of one are counted


@dataclass(frozen=True, eq=False)
class Corpus:
    """Opened training datasets; rows run through the frames of all of them."""

    datasets: tuple[Dataset, ...]

    @classmethod
    def open(cls, roots: Sequence[Path]) -> Corpus:
        """Open dataset folders."""
        return cls(tuple(open_dataset(root) for root in roots))

    @cached_property
    def fingerprint(self) -> str:
        """Identity of everything that could teach."""
        return fingerprint(*(dataset.fingerprint for dataset in self.datasets))

    def rows(self, region: str) -> Int[np.ndarray, " n"]:
        """Rows in the region that have both sensors; UserError where there are none."""
        frames = [frame for dataset in self.datasets for frame in dataset.frames]
        has_both = np.array([not lacking(frame, SENSORS) for frame in frames])
        names = [region_of(ds.positions_m[:, :2], ds.info.regions) for ds in self.datasets]
        rows = np.flatnonzero(has_both & (np.concatenate(names) == region))
        if not len(rows):
            raise UserError(
                f"{', '.join(str(ds.root) for ds in self.datasets)}: no frame with both sensors in "
                f"the {region} region: cut one with `adafusion split`"
            )
        return rows

    def prepare(
        self, settings: Preprocess, cache: Path, progress: Progress = silent
    ) -> PreparedSet:
        """Preprocess what the cache does not hold yet."""
        return PreparedSet(
            tuple(prepare_cache(ds, settings, cache, progress=progress) for ds in self.datasets)
        )

    def points(self, row: int) -> Float[np.ndarray, "n 3"]:
        """The raw cloud of a row, for jitter."""
        starts = np.cumsum([0, *(len(ds.frames) for ds in self.datasets)])
        world = int(np.searchsorted(starts, row, side="right")) - 1
        dataset = self.datasets[world]
        cloud = dataset.load(dataset.frames[row - int(starts[world])]).points_body
        assert cloud is not None  # `rows` gives only rows that have one
        return cloud

    def facts(self) -> list[dict[str, object]]:
        """What a model card says of the data."""
        return [
            {
                "name": dataset.info.name,
                "version": dataset.info.version,
                "fingerprint": dataset.fingerprint,
                "synthetic": dataset.info.synthetic,
            }
            for dataset in self.datasets
        ]

    def batches(self, sampling: Sampling, passes: int) -> int:
        """How many batches make so many frame passes, on average over what the sampler draws.

        Batches differ in frames, and mining adds some once it has begun; what a training really
        spent is counted as it goes.
        """
        rows = self.rows("train")
        sampler = Sampler(sampling, self._unread, rows, seed=0)

        def frames() -> float:
            return float(np.mean([len(batch.rows) for batch in sampler.batches(0, SAMPLED)]))

        plain = frames()
        mining = sampling.mining
        if mining is None or passes <= mining.after * plain:
            return max(1, round(passes / plain))
        rng = np.random.default_rng(0)
        sampler.described = rng.standard_normal((len(rows), 2)).astype(np.float32)
        return mining.after + max(1, round((passes - mining.after * plain) / frames()))

    def validation_answers(self) -> int:
        """Queries of the validation region that have a true match, over all pairs of runs."""
        rows = self.rows("validation")
        data = self._unread
        count = 0
        for world in np.unique(data.worlds[rows]):
            here = rows[data.worlds[rows] == world]
            region = np.full(len(here), "validation")
            splits = make_splits(
                "cross-run", [data.frames[row] for row in here], region, region="validation"
            )
            nothing = np.zeros((len(here), 1), np.float32)
            answered = evaluate_splits(nothing, data.positions[here], splits, ks=[1])
            count += int(answered.answerable.sum())
        return count

    @cached_property
    def _unread(self) -> PreparedSet:
        """Where and when frames were taken, without anything that the sensors saw."""
        return PreparedSet(
            tuple(
                PreparedFrames(Path(), ds.frames, Preprocess(), {}, np.zeros(0), {})
                for ds in self.datasets
            )
        )
