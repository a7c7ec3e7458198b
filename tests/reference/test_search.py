# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Search against distances written out in float64 and a plain sort."""

from __future__ import annotations

import numpy as np
import pytest

from adafusion.search import pairwise_distances, rank


def slow_rank(queries, database, k, p):
    """Rows and distances of each query, by one Python sort a query."""
    rows = np.full((len(queries), k), -1)
    distances = np.full((len(queries), k), np.inf)
    for q, query in enumerate(queries):
        difference = np.abs(database.astype(np.float64) - query)
        d = difference.sum(axis=1) if p == 1 else np.sqrt((difference**2).sum(axis=1))
        order = sorted((d[row], row) for row in range(len(database)))[:k]
        rows[q, : len(order)] = [row for _, row in order]
        distances[q, : len(order)] = [distance for distance, _ in order]
    return rows, distances


@pytest.mark.parametrize("p", [1, 2])
@pytest.mark.parametrize(
    ("num_queries", "num_rows", "width", "k"),
    [(1, 1, 1, 1), (3, 10, 7, 4), (40, 130, 33, 25), (2, 9000, 16, 6), (5, 3, 8, 7)],
)
def test_rank_equals_a_plain_sort(p: int, num_queries: int, num_rows: int, width: int, k: int):
    rng = np.random.default_rng(num_rows)
    # small integers: many ties, and sums that float32 holds exactly
    queries = rng.integers(-3, 4, (num_queries, width)).astype(np.float32)
    database = rng.integers(-3, 4, (num_rows, width)).astype(np.float32)
    rows, distances = rank(queries, database, k, p=p)
    slow_rows, slow_distances = slow_rank(queries, database, k, p)
    np.testing.assert_array_equal(rows, slow_rows)
    np.testing.assert_allclose(distances, slow_distances, rtol=1e-6)


@pytest.mark.parametrize("p", [1, 2])
def test_pairwise_distances_are_those_of_rank_and_symmetric(p: int) -> None:
    vectors = np.random.default_rng(1).normal(size=(300, 67)).astype(np.float32)
    d = pairwise_distances(vectors[:100], vectors, p=p)
    rows, distances = rank(vectors[:100], vectors, 300, p=p)
    np.testing.assert_allclose(np.take_along_axis(d, rows, axis=1), distances, rtol=1e-6)
    np.testing.assert_array_equal(d[:, :100], d[:, :100].T)
    _, slow = slow_rank(vectors[:100], vectors, 300, p)
    np.testing.assert_allclose(distances, slow, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("p", [1, 2])
@pytest.mark.parametrize("width", [1, 7, 67, 256])
def test_equal_rows_tie_to_the_last_bit_wherever_they_lie(p: int, width: int) -> None:
    rng = np.random.default_rng(2)
    queries = rng.normal(size=(19, width)).astype(np.float32)
    database = np.tile(rng.normal(size=(150, width)).astype(np.float32), (2, 1))
    rows, distances = rank(queries, database, 300, p=p)
    of_row = np.empty_like(distances)
    np.put_along_axis(of_row, rows, distances, axis=1)
    np.testing.assert_array_equal(of_row[:, :150], of_row[:, 150:])
    np.testing.assert_array_equal(rank(queries[7:8], database, 300, p=p)[1], distances[7:8])
    d = pairwise_distances(queries, database, p=p)
    np.testing.assert_array_equal(d[:, :150], d[:, 150:])
