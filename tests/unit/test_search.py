# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import subprocess
import sys

import numba
import numpy as np
import pytest

from adafusion.search import pairwise_distances, rank

DATABASE = np.array([[0, 0], [3, 0], [2, 2], [3, 0]], np.float32)
QUERY = np.array([[3, 1]], np.float32)


def test_it_ranks_by_l1_with_the_lower_row_first_among_equals() -> None:
    rows, distances = rank(QUERY, DATABASE, 4)
    assert rows.tolist() == [[1, 3, 2, 0]]
    assert distances.tolist() == [[1, 1, 2, 4]]


def test_it_ranks_by_l2() -> None:
    rows, distances = rank(QUERY, DATABASE, 4, p=2)
    assert rows.tolist() == [[1, 3, 2, 0]]
    np.testing.assert_allclose(distances, [[1, 1, 2**0.5, 10**0.5]], rtol=1e-6)


def test_it_pads_with_minus_one_at_infinity_where_fewer_than_k_answer() -> None:
    rows, distances = rank(QUERY, DATABASE[:1], 3)
    assert rows.tolist() == [[0, -1, -1]]
    assert distances.tolist() == [[4, np.inf, np.inf]]


def test_it_gives_nothing_from_an_empty_database_and_nothing_to_no_query() -> None:
    assert rank(QUERY, DATABASE[:0], 2)[0].tolist() == [[-1, -1]]
    assert rank(QUERY[:0], DATABASE, 2)[0].shape == (0, 2)


def test_it_ranks_the_same_on_any_number_of_threads() -> None:
    rng = np.random.default_rng(0)
    queries = rng.normal(size=(20, 31)).astype(np.float32)
    database = rng.normal(size=(9000, 31)).astype(np.float32)
    many = rank(queries, database, 5)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        one = rank(queries, database, 5)
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(many[0], one[0])
    np.testing.assert_array_equal(many[1], one[1])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_it_refuses_vectors_that_are_not_finite(bad: float) -> None:
    broken = DATABASE.copy()
    broken[2, 1] = bad
    with pytest.raises(ValueError, match="finite"):
        rank(QUERY, broken, 1)
    with pytest.raises(ValueError, match="finite"):
        pairwise_distances(broken, QUERY)


def test_it_refuses_what_cannot_be_ranked() -> None:
    with pytest.raises(ValueError, match="k must be"):
        rank(QUERY, DATABASE, 0)
    with pytest.raises(ValueError, match="p must be"):
        rank(QUERY, DATABASE, 1, p=3)


def test_a_search_leaves_torch_its_number_of_threads() -> None:
    code = (
        "import numpy as np, torch; torch.set_num_threads(1);"
        "from adafusion.search import rank;"
        "rank(np.zeros((1, 4), np.float32), np.zeros((3, 4), np.float32), 1);"
        "assert torch.get_num_threads() == 1, torch.get_num_threads()"
    )
    subprocess.run([sys.executable, "-c", code], check=True)  # the pool starts once a process
