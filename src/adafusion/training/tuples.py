# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Queries with their true and wrong matches, the hardest of them where descriptors are at hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float, Int, Int64

from adafusion.training.pairs import Batch, Pairs, Tuples, is_far, match_lists, sample_negatives
from adafusion.types import UserError

Described = Callable[[], Float[np.ndarray, "n d"] | None]  # every frame, as lately described


def num_tuple_batches(pairs: Pairs, tuples: int, positives: int) -> int:
    """How many batches `tuple_batches` yields."""
    return -(-len(_queries(pairs, positives)) // tuples)


def tuple_batches(
    pairs: Pairs,
    tuples: int,
    positives: int,
    negatives: int,
    rng: np.random.Generator,
    *,
    candidates: int = 0,
    hardest: int = 0,
    described: Described = lambda: None,
) -> Iterator[Batch]:
    """One epoch in which every frame with enough true matches is a query once.

    Wrong matches are drawn from `candidates` frames far from the query: the `hardest` nearest to it
    by L2 between descriptors, then others by chance. Before anything is described all are chance.
    What is drawn from `rng` does not depend on the descriptors, so an epoch entered in the middle
    goes on as it would have. UserError where no frame has so many true matches.
    """
    queries = _queries(pairs, positives)
    if not len(queries):
        raise UserError(
            f"no frame has {positives} true matches within {pairs.d_pos_m:g} m: give more runs of "
            "the same places, or lower sampling.positives"
        )
    first, matches = match_lists(pairs)
    order = rng.permutation(queries)
    drawn = max(candidates, negatives)
    for start in range(0, len(order), tuples):
        query = order[start : start + tuples]
        positive = np.stack(
            [rng.choice(matches[first[q] : first[q + 1]], positives, replace=False) for q in query]
        )
        pool = sample_negatives(pairs, np.repeat(query, drawn), rng).reshape(len(query), drawn)
        negative = _hardest(query, pool, negatives, hardest, described())
        other = _others(pairs, query, negative, rng)
        rows, places = _rows(query, positive, negative, other)
        a = np.repeat(places.query, positives + negatives)
        b = np.concatenate([places.positive, places.negative], axis=1).ravel()
        is_positive = np.tile(np.arange(positives + negatives) < positives, len(query))
        yield Batch(rows, np.column_stack([a, b]), is_positive, places)


def _queries(pairs: Pairs, positives: int) -> Int64[np.ndarray, " q"]:
    return np.flatnonzero(np.diff(match_lists(pairs)[0]) >= positives)


def _hardest(
    query: Int[np.ndarray, " t"],
    pool: Int[np.ndarray, "t c"],
    negatives: int,
    hardest: int,
    descriptors: Float[np.ndarray, "frames d"] | None,
) -> Int64[np.ndarray, "t n"]:
    """The nearest of each query's candidates, then the first drawn of the rest."""
    if descriptors is None or hardest == 0:
        return pool[:, :negatives].astype(np.int64)
    chosen = np.empty((len(query), negatives), np.int64)
    for row, (q, candidates) in enumerate(zip(query, pool, strict=True)):
        there, at = np.unique(candidates, return_index=True)
        gap = np.square(descriptors[there] - descriptors[q]).sum(axis=1)
        near = there[np.argsort(gap, kind="stable")[:hardest]]
        rest = candidates[np.sort(at)]  # in the order drawn, each once
        rest = rest[~np.isin(rest, near)]
        enough = np.resize(np.concatenate([near, rest]), negatives)  # few frames: some come twice
        chosen[row] = enough
    return chosen


def _others(
    pairs: Pairs,
    query: Int[np.ndarray, " t"],
    negative: Int[np.ndarray, "t n"],
    rng: np.random.Generator,
) -> Int64[np.ndarray, " t"]:
    """For each query a frame that is far from it and from all, else most, of its wrong matches."""
    order = rng.permutation(len(pairs.positions))
    other = np.empty(len(query), np.int64)
    for row, (q, wrong) in enumerate(zip(query, negative, strict=True)):
        fits = np.sum([is_far(pairs, frame, order) for frame in wrong], axis=0)
        other[row] = order[np.argmax(np.where(is_far(pairs, q, order), fits, -1))]
    return other


def _rows(
    query: Int[np.ndarray, " t"],
    positive: Int[np.ndarray, "t p"],
    negative: Int[np.ndarray, "t n"],
    other: Int[np.ndarray, " t"],
) -> tuple[Int64[np.ndarray, " b"], Tuples]:
    """The frames to describe, and where each part of the tuples is among them."""
    parts = [query[:, None], positive, negative, other[:, None]]
    rows = np.concatenate([part.ravel() for part in parts]).astype(np.int64)
    ends = np.cumsum([0, *(part.size for part in parts)])
    q, p, n, o = (
        np.arange(start, end).reshape(part.shape)
        for start, end, part in zip(ends[:-1], ends[1:], parts, strict=True)
    )
    return rows, Tuples(q[:, 0], p, n, o[:, 0])


def with_hard_pairs(
    batches: Iterator[Batch],
    pairs: Pairs,
    candidates: int,
    hardest: int,
    rng: np.random.Generator,
    described: Described,
) -> Iterator[Batch]:
    """Add to each batch of pairs the `hardest` of `candidates` wrong pairs drawn anew, by L1.

    Nothing is added before frames are described; what is drawn from `rng` is the same all along.
    """
    for batch in batches:
        a = rng.integers(len(pairs.positions), size=candidates)
        b = sample_negatives(pairs, a, rng)
        descriptors = described()
        if descriptors is None:
            yield batch
            continue
        gap = np.abs(descriptors[a] - descriptors[b]).sum(axis=1)
        near = np.argsort(gap, kind="stable")[:hardest]
        i = len(batch.rows) + np.arange(len(near))
        yield Batch(
            rows=np.concatenate([batch.rows, a[near], b[near]]),
            pair=np.concatenate([batch.pair, np.column_stack([i, i + len(near)])]),
            is_positive=np.concatenate([batch.is_positive, np.zeros(len(near), np.bool_)]),
        )
