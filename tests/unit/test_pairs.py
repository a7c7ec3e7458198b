# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from adafusion.training.pairs import (
    Pairs,
    epoch_rng,
    find_pairs,
    num_pair_batches,
    num_place_batches,
    pair_batches,
    place_batches,
    sample_negatives,
)
from adafusion.types import UserError

RUNS, STOPS, SPACING_M = 5, 24, 30.0


@pytest.fixture
def street() -> Pairs:
    """Five runs along one street: a stop every 30 m, one frame a run at each, 1 m apart."""
    x = np.tile(np.arange(STOPS) * SPACING_M, RUNS)
    y = np.repeat(np.arange(RUNS, dtype=float), STOPS)
    return find_pairs(np.column_stack([x, y]), np.zeros(RUNS * STOPS, int))


@pytest.fixture
def run() -> np.ndarray:
    return np.repeat(np.arange(RUNS), STOPS)


def test_it_lists_true_matches_and_counts_wrong_ones() -> None:
    x = np.array([0.0, 10.0, 20.0, 60.0, 60.1])
    pairs = find_pairs(np.column_stack([x, np.zeros(5)]), np.zeros(5, int))
    assert pairs.positive.tolist() == [[0, 1], [1, 2], [3, 4]]  # 10 m counts
    assert pairs.num_negatives == 3  # (0, 3), (0, 4), (1, 4); (1, 3) is 50 m and no more


def test_it_never_matches_frames_of_two_worlds() -> None:
    pairs = find_pairs(np.zeros((4, 2)), np.array([3, 3, -7, -7]))
    assert pairs.positive.tolist() == [[0, 1], [2, 3]]
    assert pairs.num_negatives == 4
    negatives = sample_negatives(pairs, np.array([0, 1, 2, 3]), np.random.default_rng(0))
    assert (pairs.world[negatives] != pairs.world).all()


def test_it_refuses_distances_that_make_no_sense() -> None:
    with pytest.raises(ValueError, match="d_pos_m"):
        find_pairs(np.zeros((2, 2)), np.zeros(2, int), d_pos_m=20.0, d_neg_m=10.0)
    with pytest.raises(ValueError, match="finite"):
        find_pairs(np.full((2, 2), np.nan), np.zeros(2, int))


def test_it_draws_negatives_evenly_among_the_far_frames(street: Pairs) -> None:
    draws = sample_negatives(street, np.zeros(23_000, int), np.random.default_rng(0))
    drawn, counts = np.unique(draws, return_counts=True)
    expected = np.flatnonzero(np.hypot(*(street.positions - street.positions[0]).T) > 50.0)
    np.testing.assert_array_equal(drawn, expected)
    mean = len(draws) / len(expected)
    assert np.square(counts - mean).sum() / mean < 170  # chi-squared, 109 degrees of freedom


def test_it_finds_the_one_far_frame_that_blind_draws_miss() -> None:
    positions = np.zeros((4000, 2))
    positions[1234] = 1000.0
    pairs = Pairs(positions, np.zeros(4000, int), 10.0, 50.0, np.empty((0, 2), np.int32), 3999)
    assert sample_negatives(pairs, np.array([0, 7]), epoch_rng(0, 0)).tolist() == [1234, 1234]


def test_it_says_which_frame_has_no_negative() -> None:
    positions = np.array([[0.0, 0.0], [45.0, 0.0], [90.0, 0.0]])
    pairs = find_pairs(positions, np.zeros(3, int))
    assert sample_negatives(pairs, np.array([0, 2]), epoch_rng(0, 0)).tolist() == [2, 0]
    with pytest.raises(UserError, match="frame 1 has no frame farther than 50 m"):
        sample_negatives(pairs, np.array([0, 1]), epoch_rng(0, 0))


def test_it_meets_every_true_match_once_an_epoch(street: Pairs) -> None:
    batches = list(pair_batches(street, 16, epoch_rng(1, 0)))
    assert len(batches) == num_pair_batches(street, 16)
    met = np.concatenate([b.rows[b.pair[b.is_positive]] for b in batches])
    np.testing.assert_array_equal(np.unique(np.sort(met, axis=1), axis=0), street.positive)
    assert len(met) == len(street.positive)
    assert 0.3 < (met[:, 0] < met[:, 1]).mean() < 0.7  # either frame may be the anchor


def test_it_gives_each_anchor_one_wrong_match(street: Pairs) -> None:
    for batch in pair_batches(street, 16, epoch_rng(1, 0)):
        true = batch.rows[batch.pair[batch.is_positive]]
        wrong = batch.rows[batch.pair[~batch.is_positive]]
        np.testing.assert_array_equal(true[:, 0], wrong[:, 0])
        gap = street.positions[wrong[:, 0]] - street.positions[wrong[:, 1]]
        assert (np.hypot(*gap.T) > 50.0).all()


def test_it_says_when_there_is_nothing_to_learn_from() -> None:
    pairs = find_pairs(np.array([[0.0, 0.0], [30.0, 0.0]]), np.zeros(2, int))
    with pytest.raises(UserError, match="no two frames lie within 10 m"):
        next(pair_batches(pairs, 4, epoch_rng(0, 0)))


def test_it_shows_places_far_apart_each_in_as_many_runs_as_asked(
    street: Pairs, run: np.ndarray
) -> None:
    batches = list(place_batches(street, 6, RUNS, epoch_rng(2, 0), run=run))
    assert len(batches) == num_place_batches(street, 6, RUNS) == 4
    for batch in batches:
        stop = (street.positions[batch.rows, 0] / SPACING_M).astype(int).reshape(6, RUNS)
        assert (stop == stop[:, :1]).all()  # the views of a place are together
        assert np.diff(np.sort(stop[:, 0])).min() >= 2  # 60 m, more than d_neg
        assert (np.sort(run[batch.rows].reshape(6, RUNS), axis=1) == np.arange(RUNS)).all()
        assert batch.is_positive.sum() == 6 * RUNS * (RUNS - 1) / 2
        assert len(batch.pair) == 30 * 29 / 2


def test_it_takes_other_runs_before_a_second_view_of_the_same_run() -> None:
    positions = np.array([[0.0, i] for i in range(8)] + [[100.0, i] for i in range(8)])
    run = np.tile([0, 0, 0, 0, 0, 0, 1, 2], 2)
    pairs = find_pairs(positions, np.zeros(16, int))
    for epoch in range(20):
        for batch in place_batches(pairs, 2, 3, epoch_rng(0, epoch), run=run):
            for views in batch.rows.reshape(2, 3):
                assert sorted(run[views]) == [0, 1, 2]


def test_it_leaves_out_pairs_that_are_neither_true_nor_wrong() -> None:
    # views of a place 8 m on either side of the anchor are 16 m apart
    positions = np.array([[-8.0, 0], [0, 0], [8, 0], [92, 0], [100, 0], [108, 0]])
    pairs = find_pairs(positions, np.zeros(6, int))
    for epoch in range(10):
        for batch in place_batches(pairs, 2, 3, epoch_rng(0, epoch)):
            a, b = positions[batch.rows[batch.pair], 0].T
            gap = np.abs(a - b)
            assert ((gap <= 10) == batch.is_positive).all()
            assert ((gap > 50) == ~batch.is_positive).all()


def test_it_shrinks_a_batch_to_the_places_there_are() -> None:
    positions = np.array([[0.0, 0], [1, 0], [100, 0], [101, 0]])
    pairs = find_pairs(positions, np.zeros(4, int))
    (batch,) = place_batches(pairs, 16, 4, epoch_rng(0, 0))
    assert sorted(batch.rows) == [0, 1, 2, 3]
    assert batch.is_positive.sum() == 2


def test_it_says_when_no_two_places_fit() -> None:
    pairs = find_pairs(np.array([[0.0, 0], [1, 0]]), np.zeros(2, int))
    with pytest.raises(UserError, match="no two places"):
        next(place_batches(pairs, 2, 2, epoch_rng(0, 0)))


def test_it_goes_on_in_the_middle_of_an_epoch_where_it_stopped(
    street: Pairs, run: np.ndarray
) -> None:
    for draw in (
        lambda: pair_batches(street, 16, epoch_rng(3, 5)),
        lambda: place_batches(street, 4, 3, epoch_rng(3, 5), run=run),
    ):
        whole, rest = list(draw()), list(islice(draw(), 2, None))
        assert len(rest) == len(whole) - 2
        for expected, got in zip(whole[2:], rest, strict=True):
            np.testing.assert_array_equal(got.rows, expected.rows)
            np.testing.assert_array_equal(got.pair, expected.pair)


def test_it_draws_other_batches_in_another_epoch(street: Pairs) -> None:
    one = next(pair_batches(street, 16, epoch_rng(3, 0)))
    two = next(pair_batches(street, 16, epoch_rng(3, 1)))
    assert (one.rows != two.rows).any()
