# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Verdicts on hand-made answers."""

from __future__ import annotations

import numpy as np
import pytest

from adafusion.experiments.convergence import half_width, still_rising, why_not_ranked
from adafusion.experiments.verdict import (
    Asked,
    by_seed,
    estimate,
    estimate_share,
    judge_difference,
    widening,
)

BLOCKS, SPLITS, EACH = 40, 6, 4


def asked(num_blocks: int = BLOCKS, world: int = 0) -> Asked:
    """Every split asks as often in every block."""
    block = np.repeat(np.arange(num_blocks), SPLITS * EACH)
    split = np.tile(np.repeat(np.arange(SPLITS), EACH), num_blocks)
    return Asked(split, block, np.full(len(block), world))


def answers(rate: float, seeds: int, of: int) -> np.ndarray:
    rng = np.random.default_rng(of)
    return (rng.random((seeds, BLOCKS * SPLITS * EACH)) < rate).astype(np.int64)


def test_equal_systems_are_undecided() -> None:
    same = answers(0.7, seeds=3, of=1)
    verdict = judge_difference(same, same, asked())
    assert verdict.word == "undecided"
    assert verdict.difference.value == 0.0
    assert verdict.difference.interval == (0.0, 0.0)
    assert verdict.by_seed == (0.0, 0.0, 0.0)


def test_a_clear_gain_is_above_and_the_same_loss_below() -> None:
    weak, strong = answers(0.6, seeds=3, of=1), answers(0.9, seeds=3, of=2)
    above, below = judge_difference(strong, weak, asked()), judge_difference(weak, strong, asked())
    assert (above.word, below.word) == ("above", "below")
    assert above.difference.value == pytest.approx(strong.mean() - weak.mean())
    assert above.num_queries == weak.shape[1]


def test_one_seed_decides_nothing() -> None:
    weak, strong = answers(0.6, seeds=1, of=1), answers(0.9, seeds=1, of=2)
    verdict = judge_difference(strong, weak, asked())
    assert verdict.word == "undecided"
    assert verdict.difference.interval is not None
    assert verdict.difference.interval[0] > 0  # over places alone it would be


def test_a_gain_that_one_seed_alone_brings_is_undecided() -> None:
    weak = answers(0.6, seeds=3, of=1)
    lucky = weak.copy()
    lucky[0] = 1
    assert judge_difference(lucky, weak, asked()).word == "undecided"


def test_a_gain_in_one_block_alone_is_undecided() -> None:
    weak = np.zeros((3, BLOCKS * SPLITS * EACH), np.int64)
    local = weak.copy()
    local[:, asked().block == 0] = 1
    verdict = judge_difference(local, weak, asked())
    assert verdict.word == "undecided"
    assert verdict.difference.value == pytest.approx(1 / BLOCKS)


def test_equal_systems_whose_seeds_spread_are_seldom_told_apart() -> None:
    at = asked(num_blocks=12)
    rng = np.random.default_rng(5)
    decided = 0
    for trial in range(100):
        rates = rng.normal(0.6, 0.08, (2, 3, 1)).clip(0, 1)  # of two systems, three seeds each
        ours, theirs = (rng.random((2, 3, len(at.split))) < rates).astype(np.int64)
        verdict = judge_difference(ours, theirs, at, seed=trial, num_draws=200)
        decided += verdict.word != "undecided"
    assert decided <= 10  # 5 of 100, give or take; without the widening it is about 17


def test_a_recall_is_the_mean_of_its_splits_whatever_their_size() -> None:
    at = Asked(np.array([0, 0, 0, 1]), np.array([0, 1, 2, 3]), np.zeros(4, np.int64))
    assert estimate(np.array([[1, 1, 1, 0]]), at).value == pytest.approx(0.5)


def test_places_are_drawn_within_worlds() -> None:
    """Two worlds, each wholly right or wholly wrong: no draw of places can move their mean."""
    one, two = asked(4, world=0), asked(4, world=1)
    both = Asked(
        np.concatenate([one.split, SPLITS + two.split]),
        np.concatenate([one.block, 4 + two.block]),
        np.concatenate([one.world, two.world]),
    )
    right = np.repeat([1, 0], len(one.split))[None]
    assert estimate(right, both).interval == (0.5, 0.5)


def test_where_a_world_is_one_block_its_interval_is_unknown() -> None:
    found = estimate(np.ones((3, SPLITS * EACH), np.int64), asked(num_blocks=1))
    assert (found.value, found.interval) == (1.0, None)


def test_a_share_stays_one_however_far_its_interval_is_widened() -> None:
    right = answers(0.9, seeds=3, of=1)
    right[0] = 0
    wide = estimate(right, asked()).interval
    assert wide is not None
    assert wide[0] < 0 < 1 < wide[1]
    assert estimate_share(right, asked()).interval == (0.0, 1.0)
    assert estimate_share(right, asked()).value == estimate(right, asked()).value


def test_the_value_is_the_mean_of_the_seeds_recalls_over_worlds_of_any_size() -> None:
    """One world of six splits, one of a single split: a split counts as much in either."""
    one, two = asked(4, world=0), asked(4, world=1)
    at = Asked(
        np.concatenate([one.split, np.full(len(two.split), SPLITS)]),
        np.concatenate([one.block, 4 + two.block]),
        np.concatenate([one.world, two.world]),
    )
    right = np.stack([np.repeat([a, b], len(one.split)) for a, b in ((1, 0), (0, 1))])
    assert by_seed(right, at) == pytest.approx([6 / 7, 1 / 7])
    assert estimate(right, at).value == pytest.approx(np.mean(by_seed(right, at)))


def test_few_seeds_are_widened_more() -> None:
    assert widening(3) == pytest.approx(np.sqrt(1.5) * 4.303 / 1.960, rel=1e-3)
    assert widening(2) > widening(3) > widening(5) > 1


@pytest.mark.parametrize(
    ("curve", "rising"),
    [
        ([0.1, 0.5, 0.7, 0.8, 0.80, 0.81, 0.80, 0.81], False),  # levelled off
        ([0.1, 0.2, 0.3, 0.4, 0.50, 0.60, 0.70, 0.80], True),
        ([0.1, 0.5, 0.8, 0.9, 0.90, 0.80, 0.70, 0.60], False),  # falling is no rising
        ([0.1, 0.5, 0.5], True),  # too few to tell
        ([0.8] * 6 + [0.8 + 0.9 * half_width(0.8, 1000)] * 2, False),
        ([0.8] * 6 + [0.8 + 1.1 * half_width(0.8, 1000)] * 2, True),
    ],
)
def test_a_rising_curve_is_told_from_one_that_levelled_off(
    curve: list[float], rising: bool
) -> None:
    assert still_rising(curve, num_answers=1000) is rising


@pytest.mark.parametrize(
    ("curve", "from_scratch", "why_not"),
    [
        ([0.1, 0.11, 0.1, 0.11, 0.105], True, "did not learn"),
        ([0.5, 0.51, 0.5, 0.51, 0.505], False, ""),  # begins with trained branches
        ([0.1, 0.3, 0.3, 0.3, 0.3], True, ""),
        ([0.1, 0.1, 0.1, 0.1, 0.3], True, "not converged"),
    ],
)
def test_a_row_is_not_ranked_while_it_rises_nor_if_it_never_did(
    curve: list[float], from_scratch: bool, why_not: str
) -> None:
    assert why_not_ranked(curve, 1000, scratch=[curve] * from_scratch) == why_not


def test_a_row_waits_for_the_branches_that_it_starts_from() -> None:
    flat, rising = [0.3, 0.3, 0.3, 0.3, 0.3], [0.1, 0.15, 0.2, 0.25, 0.4]
    assert why_not_ranked(flat, 1000, parts=[flat]) == ""
    assert why_not_ranked(flat, 1000, parts=[flat, rising]) == "not converged"
    # a branch that learnt nothing spoils what starts from it, however well that learns
    learnt = [0.1, 0.4, 0.5, 0.5, 0.5]
    assert why_not_ranked(learnt, 1000, parts=[flat], scratch=[flat]) == "did not learn"
