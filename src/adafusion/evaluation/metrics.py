# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Recall and its intervals, as functions of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Float32, Float64, Int, Int64, Real
from numba import njit

Interval = tuple[float, float]


def one_percent(database_size: int) -> int:
    """N of recall@1%: 1 % of the database, rounded as the published evaluations do, at least 1."""
    return max(round(database_size / 100), 1)


def first_hits(
    distances: Float32[np.ndarray, "q n"],
    query_xy: Float64[np.ndarray, "q 2"],
    database_xy: Float64[np.ndarray, "n 2"],
    radius_m: float,
    query_group: Int64[np.ndarray, " q"],
    database_group: Int64[np.ndarray, " n"],
) -> tuple[Int64[np.ndarray, " q"], Int64[np.ndarray, " q"], Int64[np.ndarray, " q"]]:
    """Find where each query's best true match stands: (first_hit, top, hit).

    `first_hit` is its exact rank from 1, or 0 where no true match may answer; `top` is the nearest
    database row and `hit` that of the best true match, -1 where there is none. A row of the query's
    own group may not answer. Equal distances rank by row.

    The rank is one more than the number of rows ahead of the best true match, so nothing need be
    sorted, and recall@N follows for every N.
    """
    out = np.empty((3, len(distances)), np.int64)
    _first_hits(distances, query_xy, database_xy, radius_m**2, query_group, database_group, *out)
    return out[0], out[1], out[2]


def recall_at(first_hit: Int[np.ndarray, " q"], ks: Sequence[int]) -> Float64[np.ndarray, " k"]:
    """Share of answerable queries (first_hit > 0) whose best true match is among the first k."""
    answerable = first_hit[first_hit > 0]
    if not len(answerable):
        raise ValueError("no query has a true match")
    return (answerable[:, None] <= np.array(ks)).mean(axis=0)


def place_blocks(
    positions: Float[np.ndarray, "q 2"], size_m: float = 50.0
) -> Int64[np.ndarray, " q"]:
    """Number the square blocks of the ground that positions fall into, from 0 without gaps."""
    cell = np.floor(positions / size_m).astype(np.int64)
    return np.unique(cell, axis=0, return_inverse=True)[1].reshape(-1)


def mean_recall(
    hits: Real[np.ndarray, "split block k"],
    answerable: Int64[np.ndarray, "split block"],
    weight: Float[np.ndarray, "draw block"],
) -> Float64[np.ndarray, "draw k"]:
    """Recall of each split with every block counted `weight` times, averaged over the splits.

    A split in which a draw leaves no answerable query is left out of that draw's mean.
    """
    asked = weight @ answerable.T  # (draw, split)
    is_asked = asked > 0
    divisor = np.where(is_asked, asked, 1.0)
    # one small product a column: all at once would hold draws x splits x columns
    columns = hits.astype(np.float64).transpose(2, 1, 0)
    sums = [np.sum((weight @ column) / divisor, axis=1) for column in columns]
    return np.stack(sums, axis=1) / is_asked.sum(axis=1, keepdims=True)


def draw_blocks(num_blocks: int, num_draws: int, seed: int) -> Float64[np.ndarray, "draw block"]:
    """Draw `num_blocks` blocks with replacement, `num_draws` times; count how often each came."""
    rng = np.random.default_rng(seed)
    return rng.multinomial(num_blocks, np.full(num_blocks, 1 / num_blocks), num_draws).astype(float)


def percentile_interval(draws: Float[np.ndarray, " draw"], confidence: float = 0.95) -> Interval:
    """Take the middle `confidence` of the draws."""
    tail = 50 * (1 - confidence)
    low, high = np.percentile(draws, [tail, 100 - tail])
    return float(low), float(high)


@njit(cache=True)
@no_type_check
def _first_hits(
    distances,
    query_xy,
    database_xy,
    radius_squared,
    query_group,
    database_group,
    first_hit,
    top,
    hit,
):
    for q in range(len(query_xy)):
        nearest = best = -1
        nearest_distance = best_distance = np.float32(np.inf)
        for row in range(len(database_xy)):
            distance = distances[q, row]
            if distance >= best_distance or query_group[q] == database_group[row]:
                continue
            if distance < nearest_distance:
                nearest_distance = distance
                nearest = row
            x = query_xy[q, 0] - database_xy[row, 0]
            y = query_xy[q, 1] - database_xy[row, 1]
            if x * x + y * y <= radius_squared:
                best_distance = distance
                best = row
        top[q] = nearest
        hit[q] = best
        rank = 0
        if best >= 0:
            for row in range(len(database_xy)):
                distance = distances[q, row]
                if distance < best_distance or (distance == best_distance and row <= best):
                    rank += query_group[q] != database_group[row]
        first_hit[q] = rank
