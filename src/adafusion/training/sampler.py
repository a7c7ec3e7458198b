# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The endless order of batches that a configuration asks for, entered at any batch."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

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


class Sampler:
    """A function of the seed and, where matches are mined, of what `described` was set to.

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
        self.batches_per_epoch = {
            "pairs": lambda: num_pair_batches(self.pairs, sampling.items),
            "batch": lambda: num_place_batches(self.pairs, sampling.places, sampling.views),
            "tuples": lambda: num_tuple_batches(self.pairs, sampling.tuples, sampling.positives),
        }[sampling.mode]()
        log.info(
            "%d frames, %d true pairs, %d wrong pairs, %d batches an epoch",
            len(rows), len(self.pairs.positive), self.pairs.num_negatives, self.batches_per_epoch,
        )  # fmt: skip

    def batches(self, first: int, count: int) -> Iterator[Batch]:
        """Yield `count` batches beginning with number `first`; their rows are those of the data."""
        if count <= 0:
            return
        epoch, skip = divmod(first, self.batches_per_epoch)
        while count > 0:
            for batch in islice(self._epoch(epoch), skip, skip + count):
                count -= 1
                yield replace(batch, rows=self.rows[batch.rows])
            epoch, skip = epoch + 1, 0

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
        return place_batches(self.pairs, s.places, s.views, rng, run=self.runs)

    def _described(self) -> Float[np.ndarray, "n d"] | None:
        return self.described
