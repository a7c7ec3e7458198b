# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from adafusion.training.pairs import Pairs, epoch_rng, find_pairs, pair_batches
from adafusion.training.tuples import num_tuple_batches, tuple_batches, with_hard_pairs
from adafusion.types import UserError

RUNS, STOPS = 4, 20


@pytest.fixture
def street() -> Pairs:
    """Four runs along one street: a stop every 30 m, one frame a run at each, 1 m apart."""
    x = np.tile(np.arange(STOPS) * 30.0, RUNS)
    y = np.repeat(np.arange(RUNS, dtype=float), STOPS)
    return find_pairs(np.column_stack([x, y]), np.zeros(RUNS * STOPS, int))


def stop(row: np.ndarray) -> np.ndarray:
    return row % STOPS


def test_every_frame_with_enough_true_matches_is_a_query_once(street: Pairs) -> None:
    batches = list(tuple_batches(street, 3, 2, 5, epoch_rng(0, 0)))
    assert len(batches) == num_tuple_batches(street, 3, 2) == -(-RUNS * STOPS // 3)
    queries = np.concatenate([b.rows[b.tuples.query] for b in batches])
    assert sorted(queries) == list(range(RUNS * STOPS))


def test_a_tuple_holds_what_it_says(street: Pairs) -> None:
    for batch in tuple_batches(street, 2, 2, 5, epoch_rng(1, 0)):
        for q, p, n, o in zip(
            *(getattr(batch.tuples, part) for part in ("query", "positive", "negative", "other")),
            strict=True,
        ):
            query, positive, negative, other = (stop(batch.rows[i]) for i in (q, p, n, o))
            assert (positive == query).all()
            assert len(set(batch.rows[p])) == 2
            assert q not in p
            assert (np.abs(negative - query) * 30 > 50).all()
            assert (np.abs(np.append(negative, query) - other) * 30 > 50).all()
    wrong = ~batch.is_positive
    gap = np.abs(stop(batch.rows[batch.pair[:, 0]]) - stop(batch.rows[batch.pair[:, 1]])) * 30
    assert (gap[batch.is_positive] == 0).all()
    assert (gap[wrong] > 50).all()


def test_the_nearest_by_descriptor_come_first_once_frames_are_described(street: Pairs) -> None:
    n = len(street.positions)
    descriptors = stop(np.arange(n))[:, None].astype(np.float32)  # alike: the next stops along
    batch = next(
        tuple_batches(
            street,
            1,
            2,
            4,
            epoch_rng(0, 0),
            candidates=400,
            hardest=3,
            described=lambda: descriptors,
        )
    )
    query = stop(batch.rows[batch.tuples.query[0]])
    nearest = stop(batch.rows[batch.tuples.negative[0]])
    assert nearest.shape == (4,)
    assert (np.abs(nearest[:3] - query) == 2).all()  # two stops, 60 m: the nearest that are wrong


def test_an_epoch_entered_in_the_middle_goes_on_as_it_would_have(street: Pairs) -> None:
    n = len(street.positions)
    descriptors = np.random.default_rng(0).normal(size=(n, 3)).astype(np.float32)
    kinds = {"candidates": 50, "hardest": 3}
    whole = list(
        tuple_batches(street, 2, 2, 6, epoch_rng(3, 1), **kinds, described=lambda: descriptors)
    )
    shown = iter([*[None] * 7, *[descriptors] * 100])  # skipped batches were mined by others
    late = tuple_batches(street, 2, 2, 6, epoch_rng(3, 1), **kinds, described=lambda: next(shown))
    for a, b in zip(whole[7:], islice(late, 7, None), strict=True):
        assert np.array_equal(a.rows, b.rows)


def test_hard_pairs_join_once_frames_are_described(street: Pairs) -> None:
    n = len(street.positions)
    before = next(with_hard_pairs(
        pair_batches(street, 4, epoch_rng(0, 0)), street, 200, 8, epoch_rng(0, 1), lambda: None
    ))  # fmt: skip
    assert len(before.pair) == 8
    descriptors = stop(np.arange(n))[:, None].astype(np.float32)
    after = next(with_hard_pairs(
        pair_batches(street, 4, epoch_rng(0, 0)), street, 200, 8, epoch_rng(0, 1),
        lambda: descriptors,
    ))  # fmt: skip
    assert len(after.pair) == 16
    added = after.rows[after.pair[8:]]
    assert not after.is_positive[8:].any()
    assert (np.abs(stop(added[:, 0]) - stop(added[:, 1])) == 2).all()


def test_too_few_true_matches_are_told(street: Pairs) -> None:
    with pytest.raises(UserError, match=r"no frame has 9 true matches within 10 m"):
        next(tuple_batches(street, 2, 9, 5, epoch_rng(0, 0)))
