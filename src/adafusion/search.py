# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Exact nearest neighbours among descriptors, by L1 (p = 1) or L2 (p = 2).

Every distance is computed, none is estimated. Where two rows are equally near, the lower row comes
first, so the same input gives the same ranking on any number of threads.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from jaxtyping import Float, Float32, Int64
from numba import njit, prange

from adafusion.threads import torch_threads_kept

QUERY_BLOCK = 16  # queries that share one pass over a tile of the database
TILE_ROWS = 64  # 64 rows of 256 float32 fill 64 KiB: a tile stays in the core's own cache
PART_ROWS = 4096  # a few queries against a large database share the work by parts of it
MIN_TASKS = 64
NOT_FINITE = "descriptors must be finite numbers"


def rank(
    queries: Float[np.ndarray, "q d"], database: Float[np.ndarray, "n d"], k: int, *, p: int = 1
) -> tuple[Int64[np.ndarray, "q k"], Float32[np.ndarray, "q k"]]:
    """Find the k nearest database rows of each query, nearest first: (rows, distances).

    Where the database has fewer than k rows, the rest is row -1 at distance inf. Distances are
    float32; equal ones rank by row. Raises ValueError on vectors that are not finite or do not fit
    each other.
    """
    if k < 1:
        raise ValueError(f"k must be at least 1, not {k}")
    a, b = _checked(queries, database, p)
    blocks = max(1, -(-len(a) // QUERY_BLOCK))
    parts = max(1, min(-(-len(b) // PART_ROWS), MIN_TASKS // blocks))
    rows = np.full((parts, len(a), k), -1, np.int64)
    distances = np.full((parts, len(a), k), np.inf, np.float32)
    with torch_threads_kept():
        is_finite = _rank(a, b, p, rows, distances)
    if not is_finite:
        raise ValueError(NOT_FINITE)
    return rows[0], distances[0]


def pairwise_distances(
    a: Float[np.ndarray, "m d"], b: Float[np.ndarray, "n d"], *, p: int = 1
) -> Float32[np.ndarray, "m n"]:
    """Compute the distance of every row of `a` to every row of `b`.

    They are those of `rank` but for the rounding of sums taken in another order.
    """
    a, b = _checked(a, b, p)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError(NOT_FINITE)
    out = np.empty((len(a), len(b)), np.float32)
    with torch_threads_kept():
        _pairwise(a, b, p, out)
    return out


def _checked(
    a: Float[np.ndarray, "m d"], b: Float[np.ndarray, "n d"], p: int
) -> tuple[Float32[np.ndarray, "m d"], Float32[np.ndarray, "n d"]]:
    if p not in (1, 2):
        raise ValueError(f"p must be 1 or 2, not {p}")
    if a.shape[1] != b.shape[1]:
        raise ValueError(f"vectors of {a.shape[1]} and of {b.shape[1]} numbers cannot be compared")
    return np.ascontiguousarray(a, np.float32), np.ascontiguousarray(b, np.float32)


# `no_type_check`: a run-time type checker that wrapped these would hide them from the compiler.
# "reassoc" lets the sum run in vector lanes; its order depends on d alone, so equal rows tie.
@njit(cache=True, fastmath={"reassoc", "nsz", "contract"})
@no_type_check
def _distance(a, b, p):
    total = np.float32(0.0)
    if p == 1:
        for i in range(a.shape[0]):
            total += abs(a[i] - b[i])
        return total
    for i in range(a.shape[0]):
        difference = a[i] - b[i]
        total += difference * difference
    return np.sqrt(total)


@njit(cache=True)
@no_type_check
def _insert(rows, distances, row, distance):
    """Put a row into a list kept in order; a later row goes behind an equal one."""
    i = len(rows) - 1
    while i > 0 and distances[i - 1] > distance:
        distances[i] = distances[i - 1]
        rows[i] = rows[i - 1]
        i -= 1
    distances[i] = distance
    rows[i] = row


@njit(cache=True, parallel=True)
@no_type_check
def _rank(queries, database, p, rows, distances):
    """Fill rows and distances, both (parts, q, k); part 0 ends as the ranking of the whole.

    Says whether every distance was finite: far cheaper here than a pass over the database before.
    """
    parts, q_count, k = rows.shape
    blocks = (q_count + QUERY_BLOCK - 1) // QUERY_BLOCK
    part_rows = (len(database) + parts - 1) // parts
    is_finite = np.ones(blocks * parts, np.bool_)
    for task in prange(blocks * parts):
        part = task % parts
        first = task // parts * QUERY_BLOCK
        stop = min((part + 1) * part_rows, len(database))
        for tile in range(part * part_rows, stop, TILE_ROWS):
            for q in range(first, min(first + QUERY_BLOCK, q_count)):
                for row in range(tile, min(tile + TILE_ROWS, stop)):
                    distance = _distance(queries[q], database[row], p)
                    if not distance < np.inf:
                        is_finite[task] = False
                    if distance < distances[part, q, k - 1]:
                        _insert(rows[part, q], distances[part, q], row, distance)
    for q in prange(q_count):
        for part in range(1, parts):
            for i in range(k):
                if distances[part, q, i] < distances[0, q, k - 1]:
                    _insert(rows[0, q], distances[0, q], rows[part, q, i], distances[part, q, i])
    return is_finite.all()


@njit(cache=True, parallel=True)
@no_type_check
def _pairwise(a, b, p, out):
    blocks = (len(a) + QUERY_BLOCK - 1) // QUERY_BLOCK
    for block in prange(blocks):
        first = block * QUERY_BLOCK
        for tile in range(0, len(b), TILE_ROWS):
            for i in range(first, min(first + QUERY_BLOCK, len(a))):
                for j in range(tile, min(tile + TILE_ROWS, len(b))):
                    out[i, j] = _distance(a[i], b[j], p)
