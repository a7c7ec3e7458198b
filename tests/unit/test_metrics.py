# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from adafusion.evaluation.metrics import (
    draw_blocks,
    first_hits,
    mean_recall,
    one_percent,
    percentile_interval,
    place_blocks,
    recall_at,
)

# database at 0, 10, 100 m; the query at 0 m, so rows 0 and 1 are true at a radius of 10 m
DATABASE = np.array([[0.0, 0.0], [10.0, 0.0], [100.0, 0.0]])
QUERY = np.zeros((1, 2))


def hits_of(distances: list[float], query_group: int = -1, radius_m: float = 10.0) -> list[int]:
    groups = np.arange(3)
    out = first_hits(
        np.array([distances], np.float32),
        QUERY,
        DATABASE,
        radius_m,
        np.array([query_group]),
        groups,
    )
    return [int(values[0]) for values in out]


def test_it_ranks_the_best_true_match_and_names_the_top() -> None:
    assert hits_of([2.0, 3.0, 1.0]) == [2, 2, 0]
    assert hits_of([3.0, 2.0, 1.0]) == [2, 2, 1]
    assert hits_of([1.0, 2.0, 3.0]) == [1, 0, 0]


def test_a_match_at_exactly_the_radius_is_true() -> None:
    assert hits_of([3.0, 2.0, 1.0], radius_m=9.999) == [3, 2, 0]


def test_equal_distances_rank_by_row() -> None:
    assert hits_of([1.0, 1.0, 1.0]) == [1, 0, 0]
    assert hits_of([2.0, 1.0, 1.0]) == [1, 1, 1]


def test_a_row_of_the_querys_group_neither_answers_nor_stands_ahead() -> None:
    assert hits_of([1.0, 2.0, 3.0], query_group=0) == [1, 1, 1]
    assert hits_of([2.0, 3.0, 1.0], query_group=2) == [1, 0, 0]


def test_a_query_without_a_true_match_has_rank_0() -> None:
    assert hits_of([1.0, 2.0, 3.0], query_group=0, radius_m=5.0) == [0, 1, -1]


def test_nobody_answers_from_an_empty_database() -> None:
    empty = np.empty(0, np.int64)
    out = first_hits(
        np.empty((1, 0), np.float32), QUERY, np.empty((0, 2)), 10.0, np.array([0]), empty
    )
    assert [int(values[0]) for values in out] == [0, -1, -1]


def test_recall_leaves_unanswerable_queries_out() -> None:
    assert recall_at(np.array([1, 0, 3, 2, 0, 40]), (1, 2, 25, 40)).tolist() == [0.25, 0.5, 0.75, 1]
    with pytest.raises(ValueError, match="no query"):
        recall_at(np.array([0, 0]), (1,))


def test_one_percent_is_rounded_and_at_least_one() -> None:
    assert [one_percent(n) for n in (1, 99, 149, 151, 240, 480)] == [1, 1, 1, 2, 2, 5]


def test_blocks_are_squares_of_50_m() -> None:
    positions = np.array([[0.0, 0.0], [49.9, 49.9], [50.0, 0.0], [-0.1, 0.0], [10.0, 10.0]])
    block = place_blocks(positions)
    assert len(set(block.tolist())) == 3
    assert block[0] == block[1] == block[4]
    assert block.max() == 2


def test_recall_is_averaged_over_splits_whatever_their_size() -> None:
    answerable = np.array([[4, 0], [1, 1]])
    hits = np.array([[[4], [0]], [[0], [1]]])
    weight = np.array([[1.0, 1.0], [0.0, 2.0], [1.0, 0.0]])
    # second draw: nobody of the first split is asked, so the second counts alone
    assert mean_recall(hits, answerable, weight)[:, 0].tolist() == [0.75, 1.0, 0.5]


def test_a_perfect_recall_is_1_and_not_a_rounding_more() -> None:
    answerable = np.random.default_rng(0).integers(1, 30, (45, 33))
    assert (mean_recall(answerable[:, :, None], answerable, np.ones((1, 33))) == 1.0).all()


def test_every_draw_has_as_many_blocks_as_there_are() -> None:
    weight = draw_blocks(7, 100, seed=3)
    assert (weight.sum(axis=1) == 7).all()
    np.testing.assert_array_equal(weight, draw_blocks(7, 100, seed=3))
    assert (weight != draw_blocks(7, 100, seed=4)).any()


def test_intervals_cover_the_truth_about_as_often_as_they_claim() -> None:
    """200 worlds of 60 places; all 20 queries at a place share its difficulty."""
    rng = np.random.default_rng(0)
    covered = clustered = 0
    asked = np.full((1, 60), 20)
    for world in range(200):
        difficulty = rng.beta(4, 1, 60)  # mean 0.8
        hits = rng.binomial(20, difficulty)[None, :, None]
        low, high = percentile_interval(
            mean_recall(hits, asked, draw_blocks(60, 500, seed=world))[:, 0]
        )
        covered += low <= 0.8 <= high
        # what one would get by drawing the 1200 queries one by one
        p = hits.mean() / 20
        clustered += abs(p - 0.8) <= 1.96 * np.sqrt(p * (1 - p) / 1200)
    assert 0.90 <= covered / 200 <= 0.98
    assert clustered / 200 < 0.85
