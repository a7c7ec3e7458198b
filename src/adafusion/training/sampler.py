# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The endless order of batches that a configuration asks for, entered at any batch."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from statistics import fmean

import numpy as np
from jaxtyping import Float, Int

from adafusion.preprocess.cache import PreparedSet
from adafusion.training.pairs import (
    Batch,
    Pairs,
    epoch_rng,
    find_pairs,
    num_pair_batches,
    num_place_batches,
    pair_batches,
    place_batches,
)
from adafusion.training.settings import Sampling
from adafusion.training.tuples import num_tuple_batches, tuple_batches, with_hard_pairs
from adafusion.types import UserError

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Course:
    """The epoch that a batch may grow after: with the seed, all that the batches to come need.

    Later epochs follow in the same size until the sampler is told otherwise.
    """

    epoch: int
    first: int  # batches before it
    frames: int  # asked of each of its batches
    active: tuple[float, ...] = ()  # what was told of its batches so far


class Sampler:
    """A function of the seed and, where matches are mined, of what `described` was set to.

    Where batches grow, also of what it is told of each batch; `course` is what that came to.

    described: (N, D) descriptors of all rows, as the network lately gave them; None before.
    """

    def __init__(
        self, sampling: Sampling, data: PreparedSet, rows: Int[np.ndarray, " n"], seed: int
    ) -> None:
        self.sampling, self.rows, self.seed = sampling, rows, seed
        self.runs = data.runs[rows]
        self.pairs: Pairs = find_pairs(
            data.positions[rows], data.worlds[rows], sampling.d_pos_m, sampling.d_neg_m
        )
        if not len(self.pairs.positive):
            raise UserError(
                f"no two of the {len(rows)} frames lie within {sampling.d_pos_m:g} m of each "
                "other: give more runs of the same places, or raise sampling.d_pos_m"
            )
        self.described: Float[np.ndarray, "n d"] | None = None
        self.go_on(Course(epoch=0, first=0, frames=sampling.places * sampling.views))
        self.room = self._room()
        log.info(
            "%d frames, %d true pairs, %d wrong pairs, %d batches an epoch",
            len(rows), len(self.pairs.positive), self.pairs.num_negatives, self.batches_per_epoch,
        )  # fmt: skip

    def batches(self, first: int, count: int | None = None) -> Iterator[Batch]:
        """Yield `count` batches, or no end of them, beginning with number `first`.

        Their rows are those of the data. Where batches grow, `first` is one of the course's epoch
        or later, and each batch is drawn after all before it were told of.
        """
        return islice(self._batches(first), count)

    def _batches(self, number: int) -> Iterator[Batch]:
        while True:
            ahead, skip = divmod(number - self.course.first, self.batches_per_epoch)
            for batch in islice(self._epoch(self.course.epoch + ahead), skip, None):
                number += 1
                yield replace(batch, rows=self.rows[batch.rows])

    def go_on(self, course: Course) -> None:
        """Draw the batches to come as this course has them."""
        s = self.sampling
        self.course = course
        self._places = -(-course.frames // s.views)
        self.batches_per_epoch = {
            "pairs": lambda: num_pair_batches(self.pairs, s.items),
            "batch": lambda: num_place_batches(self.pairs, self._places, s.views),
            "tuples": lambda: num_tuple_batches(self.pairs, s.tuples, s.positives),
        }[s.mode]()

    def tell(self, active: float) -> None:
        """Say what share of each batch still taught, in order; an easy epoch makes them grow."""
        growth, course = self.sampling.growth, self.course
        if growth is None:
            return
        told = (*course.active, active)
        if len(told) < self.batches_per_epoch:
            self.course = replace(course, active=told)
            return
        is_easy = fmean(told) < growth.below
        frames = growth.after(course.frames, self.room) if is_easy else course.frames
        self.go_on(Course(course.epoch + 1, course.first + len(told), frames))
        if frames > course.frames:
            log.info("batches grow from %d to %d frames", course.frames, frames)

    def _room(self) -> int:
        """Frames that a batch of the largest size really has: places must lie apart."""
        growth, views = self.sampling.growth, self.sampling.views
        if growth is None:
            return self.course.frames
        places = max(2, -(-growth.limit // views))
        return len(next(place_batches(self.pairs, places, views, epoch_rng(self.seed, 0))).rows)

    def _epoch(self, epoch: int) -> Iterator[Batch]:
        rng = epoch_rng(self.seed, epoch)
        s = self.sampling
        if s.mode == "tuples":
            return tuple_batches(
                self.pairs,
                s.tuples,
                s.positives,
                s.negatives,
                rng,
                candidates=0 if s.mining is None else s.mining.candidates,
                hardest=0 if s.mining is None else s.mining.hardest,
                described=self._described,
            )
        if s.mode == "pairs":
            batches = pair_batches(self.pairs, s.items, rng)
            if s.mining is None:
                return batches
            return with_hard_pairs(
                batches, self.pairs, s.mining.candidates, s.mining.hardest, rng, self._described
            )
        return place_batches(self.pairs, self._places, s.views, rng, run=self.runs)

    def _described(self) -> Float[np.ndarray, "n d"] | None:
        return self.described
