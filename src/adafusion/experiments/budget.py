# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Frame passes as batches, and how many answers a validation rests on."""

from __future__ import annotations

import numpy as np

from adafusion.evaluation import evaluate_splits, make_splits
from adafusion.training.corpus import Corpus
from adafusion.training.sampler import Sampler
from adafusion.training.settings import Sampling

SAMPLED = 50  # batches from which the frames of one are counted


def batches_of(corpus: Corpus, sampling: Sampling, passes: int) -> int:
    """How many batches make so many frame passes, on average over what the sampler draws.

    Batches differ in frames, and mining adds some once it has begun; what a training really
    spent is counted as it goes. Of batches that grow, so many would do if none did.
    """
    rows = corpus.rows("train")
    sampler = Sampler(sampling, corpus.unread, rows, seed=0)

    def frames() -> float:
        return float(np.mean([len(batch.rows) for batch in sampler.batches(0, SAMPLED)]))

    plain = frames()
    mining = sampling.mining
    if mining is None or passes <= mining.after * plain:
        return max(1, round(passes / plain))
    rng = np.random.default_rng(0)
    sampler.described = rng.standard_normal((len(rows), 2)).astype(np.float32)
    return mining.after + max(1, round((passes - mining.after * plain) / frames()))


def validation_answers(corpus: Corpus) -> int:
    """Queries of the validation region that have a true match, over all pairs of runs."""
    rows = corpus.rows("validation")
    data = corpus.unread
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
