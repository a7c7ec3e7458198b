# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Is one system better than another? Differences with intervals over places and seeds.

The statistic, of values v(s, q) for seed s and query q (whether it was answered rightly, or by how
much one system beats the other there, or any other number):

1. Recall of seed s: the mean over the queries of each split, averaged over the splits without
   weights. The value is the mean over the S seeds.
2. A draw takes S of the seeds with replacement. A system's seed starts from the same branches as
   the other's, so differences are paired by seed. The mean of the taken ones varies too little: few
   values spread less than what they were drawn from, and their own spread is barely known. So its
   distance from the mean over all S is widened by sqrt(S / (S - 1)) and by Student's quantile over
   the normal one, t(0.975, S - 1) / 1.96: 2.7 in all for three seeds, 1.6 for five, 9.2 for two.
3. It then takes, in each world, as many of its 50 m blocks as it has, with replacement, all queries
   of a block together, for all seeds and both systems alike. The draw is the mean recall over the S
   seeds there, moved by the widened distance.
4. The interval is the middle 95 % of the draws. Above: it lies above 0; below: below 0; else, and
   wherever fewer than two seeds were trained, undecided.

Without the widening, two equal systems of three seeds each whose trainings differ more than places
do would be told apart in one case of six and not of twenty; a test holds that. The price is that
few seeds decide little. With one seed the interval speaks of other places alone.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float64, Int64, Real
from scipy.stats import norm, t

from adafusion.evaluation.metrics import draw_blocks, mean_recall, percentile_interval
from adafusion.types import Estimate

Word = Literal["above", "below", "undecided"]

NOT_RANKED = "not ranked"  # in place of a word where a row had not converged
DRAWS = 2000


@dataclass(frozen=True, eq=False)
class Asked:
    """Where each query was asked: its split, its 50 m block and its world, numbered from 0.

    Blocks and splits of different worlds have different numbers.
    """

    split: Int64[np.ndarray, " q"]
    block: Int64[np.ndarray, " q"]
    world: Int64[np.ndarray, " q"]

    def where(self, chosen: Bool[np.ndarray, " q"]) -> Asked:
        """Some of the queries."""
        return Asked(self.split[chosen], self.block[chosen], self.world[chosen])


@dataclass(frozen=True)
class Verdict:
    """One system minus another, and what that says."""

    word: Word
    difference: Estimate
    by_seed: tuple[float, ...]
    num_queries: int


def estimate(
    values: Real[np.ndarray, "seed q"], asked: Asked, *, seed: int = 0, num_draws: int = DRAWS
) -> Estimate:
    """Mean over splits and seeds with its 95 % interval; see the module for the statistic.

    Where all queries of a world lie in one block its places say nothing of others: no interval.
    """
    recall, draws = _recalls(values, asked, seed, num_draws)
    value = float(recall.mean())
    if draws is None:
        return Estimate(value)
    num_seeds = len(values)
    if num_seeds > 1:
        rng = np.random.default_rng((seed, num_seeds))
        taken = recall[rng.integers(num_seeds, size=(num_draws, num_seeds))].mean(axis=1)
        draws = draws + widening(num_seeds) * (taken - value)
    return Estimate(value, percentile_interval(draws))


def within(found: Estimate, low: float, high: float) -> Estimate:
    """An estimate of what lies between two limits, which a widened interval might leave."""
    if found.interval is None:
        return found
    return Estimate(found.value, (max(found.interval[0], low), min(found.interval[1], high)))


def estimate_share(values: Real[np.ndarray, "seed q"], asked: Asked) -> Estimate:
    """As `estimate`, of values between 0 and 1."""
    return within(estimate(values, asked), 0.0, 1.0)


def by_seed(values: Real[np.ndarray, "seed q"], asked: Asked) -> list[float]:
    """What `estimate` takes the mean of: the mean over splits of each seed."""
    return _recalls(values, asked, 0, 0)[0].tolist()


def judge_difference(
    ours: Real[np.ndarray, "seed q"],
    theirs: Real[np.ndarray, "seed q"],
    asked: Asked,
    *,
    seed: int = 0,
    num_draws: int = DRAWS,
) -> Verdict:
    """Whether ours is above theirs on the same queries; see the module for the statistic."""
    gain = ours.astype(np.float64) - theirs
    difference = estimate(gain, asked, seed=seed, num_draws=num_draws)
    word: Word = "undecided"
    if difference.interval is not None and len(gain) > 1:
        low, high = difference.interval
        word = "above" if low > 0 else "below" if high < 0 else "undecided"
    return Verdict(word, difference, tuple(by_seed(gain, asked)), gain.shape[1])


def plain_verdict(verdict: Verdict, *, ranked: bool) -> dict[str, Any]:
    """The verdict as values that JSON can hold; rows that had not converged get no word."""
    return {
        "verdict": verdict.word if ranked else NOT_RANKED,
        "difference": asdict(verdict.difference),
        "by_seed": list(verdict.by_seed),
        "queries": verdict.num_queries,
    }


def widening(num_seeds: int) -> float:
    """By how much the bootstrap over so few seeds is too narrow."""
    student = t.ppf(0.975, num_seeds - 1) / norm.ppf(0.975)
    return float(np.sqrt(num_seeds / (num_seeds - 1)) * student)


def _recalls(
    values: Real[np.ndarray, "seed q"], asked: Asked, seed: int, num_draws: int
) -> tuple[Float64[np.ndarray, " seed"], Float64[np.ndarray, " draw"] | None]:
    """Recall of each seed on all blocks, and that of all seeds on each draw of blocks."""
    if not asked.split.size:
        raise ValueError("no query to judge by")
    split = np.unique(asked.split, return_inverse=True)[1]
    blocks, first, block = np.unique(asked.block, return_index=True, return_inverse=True)
    shape = (int(split.max()) + 1, len(blocks))
    cell = split * len(blocks) + block
    answerable = np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape)
    sums = np.zeros((*shape, len(values)))
    for s, of_seed in enumerate(values):
        np.add.at(sums[:, :, s], (split, block), of_seed)
    recall = mean_recall(sums, answerable, np.ones((1, len(blocks))))[0]
    world_of = asked.world[first]
    worlds, counts = np.unique(world_of, return_counts=True)
    if num_draws == 0 or counts.min() < 2:
        return recall, None
    weight = np.zeros((num_draws, len(blocks)))
    for world, count in zip(worlds.tolist(), counts.tolist(), strict=True):
        weight[:, world_of == world] = draw_blocks(count, num_draws, seed + 1000 * world)
    return recall, mean_recall(sums, answerable, weight).mean(axis=1)
