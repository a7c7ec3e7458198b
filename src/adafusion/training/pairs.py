# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Who is a true match and who is a wrong one, and the order in which training meets them.

True matches are few and listed; wrong matches are nearly all pairs, so they are counted and drawn,
never stored. An epoch's batches follow from (seed, epoch) alone: to resume inside one, draw it
again from `epoch_rng(seed, epoch)` and skip the batches already done with `itertools.islice`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float64, Int, Int32, Int64
from numba import njit
from scipy.spatial import cKDTree

from adafusion.types import UserError

DRAWS = 16  # blind draws before an anchor's far frames are listed instead


@dataclass(frozen=True, slots=True)
class Pairs:
    """The true matches among n frames, and what it takes to draw wrong ones.

    Frames of different worlds are never true matches and always wrong ones.
    """

    positions: Float64[np.ndarray, "n 2"]  # metres
    world: Int64[np.ndarray, " n"]
    d_pos_m: float
    d_neg_m: float
    positive: Int32[np.ndarray, "pairs 2"]  # i < j, at most d_pos_m apart, in lexical order
    num_negatives: int  # unordered pairs more than d_neg_m apart


@dataclass(frozen=True, slots=True)
class Tuples:
    """Indices into a batch's rows: each query, its true matches, wrong ones, and one more frame."""

    query: Int64[np.ndarray, " t"]
    positive: Int64[np.ndarray, "t p"]
    negative: Int64[np.ndarray, "t n"]
    other: Int64[np.ndarray, " t"]  # far from the query and, where it can be, from all wrong ones


@dataclass(frozen=True, slots=True)
class Batch:
    """Frames to describe together, and which of their pairs the loss looks at."""

    rows: Int64[np.ndarray, " b"]  # frames
    pair: Int64[np.ndarray, "m 2"]  # indices into `rows`
    is_positive: Bool[np.ndarray, " m"]
    tuples: Tuples | None = None  # of losses that compare a query's matches with each other


def find_pairs(
    positions: Float[np.ndarray, "n 2"],
    world: Int[np.ndarray, " n"],
    d_pos_m: float = 10.0,
    d_neg_m: float = 50.0,
) -> Pairs:
    """List the pairs of frames within d_pos_m of each other; count those farther than d_neg_m.

    `positions` are planar, in metres; `world` numbers the world (city, site) of each frame.
    """
    if not 0 < d_pos_m <= d_neg_m:
        raise ValueError(f"need 0 < d_pos_m <= d_neg_m, not {d_pos_m} and {d_neg_m}")
    if not np.isfinite(positions).all():
        raise ValueError("positions must be finite numbers")
    positions = np.ascontiguousarray(positions, np.float64)
    # one tree for all worlds: a third coordinate keeps them out of each other's reach
    level = np.unique(world, return_inverse=True)[1] * (4.0 * d_neg_m)
    tree = cKDTree(np.column_stack([positions, level]))
    positive = tree.query_pairs(d_pos_m, output_type="ndarray").astype(np.int32)
    positive = positive[np.lexsort((positive[:, 1], positive[:, 0]))]
    n = len(positions)
    within_d_neg = (int(tree.count_neighbors(tree, d_neg_m)) - n) // 2
    return Pairs(
        positions=positions,
        world=world.astype(np.int64),
        d_pos_m=float(d_pos_m),
        d_neg_m=float(d_neg_m),
        positive=positive,
        num_negatives=n * (n - 1) // 2 - within_d_neg,
    )


def sample_negatives(
    pairs: Pairs, anchors: Int[np.ndarray, " m"], rng: np.random.Generator
) -> Int64[np.ndarray, " m"]:
    """Draw for each anchor one frame, uniformly among those farther than d_neg_m from it.

    Raises UserError where an anchor has no such frame.
    """
    n = len(pairs.positions)
    negatives = rng.integers(n, size=len(anchors))
    for _ in range(DRAWS):
        again = np.flatnonzero(~is_far(pairs, anchors, negatives))
        if not len(again):
            return negatives
        negatives[again] = rng.integers(n, size=len(again))
    for i in np.flatnonzero(~is_far(pairs, anchors, negatives)):
        far = np.flatnonzero(is_far(pairs, anchors[i], np.arange(n)))
        if not len(far):
            raise UserError(
                f"frame {anchors[i]} has no frame farther than {pairs.d_neg_m:g} m to be its wrong "
                "match: train on a larger area or lower d_neg_m"
            )
        negatives[i] = rng.choice(far)
    return negatives


def epoch_rng(seed: int, epoch: int) -> np.random.Generator:
    """Give the generator of one epoch, a function of (seed, epoch) alone."""
    return np.random.default_rng((seed, epoch))


def num_pair_batches(pairs: Pairs, batch_size: int) -> int:
    """How many batches `pair_batches` yields."""
    return -(-len(pairs.positive) // batch_size)


def pair_batches(pairs: Pairs, batch_size: int, rng: np.random.Generator) -> Iterator[Batch]:
    """One epoch as the paper has it: every true match once, each with one wrong match.

    The wrong match shares the true match's anchor, which is either of its two frames by chance.
    A batch of b items has 3 b rows (anchors, positives, negatives) and 2 b pairs.
    """
    if not len(pairs.positive):
        raise UserError(
            f"no two frames lie within {pairs.d_pos_m:g} m of each other: give more runs of the "
            "same places or raise d_pos_m"
        )
    order = rng.permutation(len(pairs.positive))
    for start in range(0, len(order), batch_size):
        items = rng.permuted(pairs.positive[order[start : start + batch_size]], axis=1)
        anchor, positive = items.astype(np.int64).T
        negative = sample_negatives(pairs, anchor, rng)
        i = np.arange(len(items))
        yield Batch(
            rows=np.concatenate([anchor, positive, negative]),
            pair=np.concatenate(
                [np.column_stack([i, i + len(i)]), np.column_stack([i, i + 2 * len(i)])]
            ),
            is_positive=np.repeat([True, False], len(i)),
        )


def num_place_batches(pairs: Pairs, places: int, views: int) -> int:
    """How many batches `place_batches` yields: enough to show as many frames as there are."""
    return -(-len(np.unique(pairs.positive)) // (places * views))


def place_batches(
    pairs: Pairs,
    places: int,
    views: int,
    rng: np.random.Generator,
    *,
    run: Int[np.ndarray, " n"] | None = None,
) -> Iterator[Batch]:
    """One epoch of batches in which every pair counts.

    A batch shows `places` anchors, all farther than d_neg_m from each other, each with views - 1 of
    its true matches: first one of every other run, then the rest. Frames not yet shown in this
    epoch are taken first as anchors. The batch is smaller where the world has no room for so many
    places or a place has fewer true matches. Pairs that are neither true nor wrong are left out.

    `run` numbers the run of each frame. Raises UserError where not even two places fit.
    """
    if places < 2 or views < 2:
        raise ValueError(f"need at least 2 places and 2 views, not {places} and {views}")
    n = len(pairs.positions)
    run = np.zeros(n, np.int64) if run is None else run
    first, matches = match_lists(pairs)
    order = rng.permutation(np.flatnonzero(np.diff(first)))
    shown = np.zeros(n, np.bool_)
    for _ in range(num_place_batches(pairs, places, views)):
        anchors = _far_apart(order, shown, pairs.positions, pairs.world, pairs.d_neg_m, places)
        if len(anchors) < 2:
            raise UserError(
                f"no two places lie farther than {pairs.d_neg_m:g} m from each other: train on a "
                "larger area or lower d_neg_m"
            )
        rows = _with_views(anchors, first, matches, run, views, rng)
        shown[rows] = True
        a, b = np.triu_indices(len(rows), k=1)
        gap_squared = _gap_squared(pairs, rows[a], rows[b])
        # places closer than 2 d_pos_m may share a frame, which is no match of itself
        is_positive = (gap_squared <= pairs.d_pos_m**2) & (rows[a] != rows[b])
        counts = is_positive | (gap_squared > pairs.d_neg_m**2)
        yield Batch(
            rows=rows,
            pair=np.column_stack([a[counts], b[counts]]),
            is_positive=is_positive[counts],
        )


def match_lists(pairs: Pairs) -> tuple[Int64[np.ndarray, " offsets"], Int64[np.ndarray, " both"]]:
    """True matches of frame i: matches[first[i]:first[i + 1]]."""
    one, other = np.concatenate([pairs.positive, pairs.positive[:, ::-1]]).astype(np.int64).T
    first = np.searchsorted(np.sort(one), np.arange(len(pairs.positions) + 1))
    return first, other[np.argsort(one, kind="stable")]


def _with_views(
    anchors: Int64[np.ndarray, " a"],
    first: Int64[np.ndarray, " offsets"],
    matches: Int64[np.ndarray, " both"],
    run: Int[np.ndarray, " n"],
    views: int,
    rng: np.random.Generator,
) -> Int64[np.ndarray, " b"]:
    """Give each anchor and, behind it, up to views - 1 of its matches, other runs first."""
    counts = first[anchors + 1] - first[anchors]
    listed = np.arange(counts.sum()) + np.repeat(
        first[anchors] - np.cumsum(counts) + counts, counts
    )
    rows = np.concatenate([anchors, matches[listed]])
    place = np.concatenate([np.arange(len(anchors)), np.repeat(np.arange(len(anchors)), counts)])
    chance = rng.random(len(rows))
    chance[: len(anchors)] = -1.0  # the anchor is the first of its place and of its run
    by_run = np.lexsort((chance, run[rows], place))
    turn = np.empty(len(rows), np.int64)  # 0: the first of its run at this place to be taken
    turn[by_run] = _position_in_group(place[by_run], run[rows][by_run])
    by_turn = np.lexsort((chance, turn, place))
    return rows[by_turn][_position_in_group(place[by_turn]) < views]


def _position_in_group(*keys: Int[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Number the elements of each stretch of equal keys from 0."""
    index = np.arange(len(keys[0]))
    is_start = np.ones(len(index), np.bool_)
    is_start[1:] = np.any([key[1:] != key[:-1] for key in keys], axis=0)
    return index - np.maximum.accumulate(np.where(is_start, index, 0))


def _gap_squared(
    pairs: Pairs, a: Int[np.ndarray, " m"] | np.integer, b: Int[np.ndarray, " m"]
) -> Float64[np.ndarray, " m"]:
    """Squared metres between frames a and b, inf between worlds."""
    difference = pairs.positions[a] - pairs.positions[b]
    squared = difference[:, 0] ** 2 + difference[:, 1] ** 2
    return np.where(pairs.world[a] == pairs.world[b], squared, np.inf)


def is_far(
    pairs: Pairs, a: Int[np.ndarray, " m"] | np.integer, b: Int[np.ndarray, " m"]
) -> Bool[np.ndarray, " m"]:
    """Whether frames a and b are a wrong match."""
    return _gap_squared(pairs, a, b) > pairs.d_neg_m**2


@njit(cache=True)
@no_type_check
def _far_apart(order, shown, positions, world, d_neg_m, count):
    """Take frames that are far from all taken, those not shown yet first, up to `count`."""
    taken = np.empty(count, np.int64)
    found = 0
    for is_second_round in (False, True):
        for row in order:
            if found == count:
                break
            fits = shown[row] == is_second_round
            for i in range(found):
                x = positions[row, 0] - positions[taken[i], 0]
                y = positions[row, 1] - positions[taken[i], 1]
                is_far = world[row] != world[taken[i]] or x * x + y * y > d_neg_m * d_neg_m
                fits = fits and is_far
            if fits:
                taken[found] = row
                found += 1
    return taken[:found]
