# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""From descriptors and splits to recall, its intervals, and what each query was answered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, Int64

from adafusion.evaluation.metrics import (
    Interval,
    draw_blocks,
    first_hits,
    mean_recall,
    one_percent,
    percentile_interval,
    place_blocks,
)
from adafusion.evaluation.protocols import answer_groups
from adafusion.search import pairwise_distances
from adafusion.types import Estimate, Split, UserError

BLOCK_M = 50.0
MAX_DISTANCES = 2**25  # held at a time: 128 MiB of float32


@dataclass(frozen=True, slots=True)
class SplitResult:
    """What the queries of one split were answered. Frames are rows as in the split; -1 is none."""

    split: Split
    first_hit: Int64[np.ndarray, " q"]  # rank of the best true match from 1; 0: none may answer
    top_row: Int64[np.ndarray, " q"]  # frame that came first
    hit_row: Int64[np.ndarray, " q"]  # true match that came before all other true ones
    one_percent: int  # N of recall@1%


@dataclass(frozen=True, slots=True)
class Evaluation:
    """One descriptor set under one protocol.

    Measures are named AR@1%, AR@1, AR@2, ...: recall@N of each split, averaged over the splits that
    have an answerable query, each with the same weight. AR@1% takes N from the split's database.
    """

    protocol: str
    region: str
    radius_m: float
    p: int  # 1: L1, 2: L2
    ks: tuple[int, ...]
    results: tuple[SplitResult, ...]
    # answerable queries, and those with a hit among the first N, by place; N = 1 %, then ks
    answerable: Int64[np.ndarray, "split block"]
    hits: Int64[np.ndarray, "split block measure"]

    @property
    def measures(self) -> tuple[str, ...]:
        """Names of the measures, in the order of the last axis of `hits`."""
        return ("AR@1%", *(f"AR@{k}" for k in self.ks))

    @property
    def recall(self) -> dict[str, float]:
        """Every measure: recall averaged over splits without weights, as published."""
        once = np.ones((1, self.answerable.shape[1]))
        values = mean_recall(self.hits, self.answerable, once)[0]
        return dict(zip(self.measures, values.tolist(), strict=True))

    @property
    def pooled_recall(self) -> dict[str, float]:
        """Every measure over all queries of all splits alike: large splits weigh more."""
        values = self.hits.sum(axis=(0, 1)) / self.answerable.sum()
        return dict(zip(self.measures, values.tolist(), strict=True))

    @property
    def num_queries(self) -> int:
        """Queries over all splits, with those that no true match can answer."""
        return sum(len(result.first_hit) for result in self.results)

    @property
    def num_unanswerable(self) -> int:
        """Queries without a true match, left out of every recall."""
        return self.num_queries - int(self.answerable.sum())

    @property
    def num_places(self) -> int:
        """50 m blocks of ground that hold answerable queries."""
        return self.answerable.shape[1]

    def estimates(self, *, seed: int, num_draws: int = 1000) -> dict[str, Estimate]:
        """Give every measure its 95 % interval by a bootstrap over places.

        Places are the 50 m blocks of ground that hold answerable queries. They are drawn with
        replacement; all queries in a block, of every run, move together. So the interval says how
        the score would vary with other places of this kind, not with other runs or trainings. Where
        all queries lie in one block nothing is known, and the interval is (0, 1).
        """
        draws = self._draws(seed, num_draws)
        return _estimates(self.recall, draws, None if self.num_places > 1 else (0.0, 1.0))

    def _draws(self, seed: int, num_draws: int) -> Float64[np.ndarray, "draw measure"]:
        return mean_recall(
            self.hits, self.answerable, draw_blocks(self.num_places, num_draws, seed)
        )


def evaluate_splits(
    descriptors: Float[np.ndarray, "n d"],
    positions: Float[np.ndarray, "n xy_or_xyz"],
    splits: Sequence[Split],
    ks: Sequence[int] = range(1, 26),
    p: int = 1,
) -> Evaluation:
    """Search every split exactly and count who finds a true match among the first N.

    `descriptors` and `positions` (metres) have one row for each frame that the splits speak of.
    Only x and y decide what a true match is, as in the published evaluations: a bridge above a
    street counts as the same place. Ranks are exact to any depth, so a database smaller than N is
    simply searched whole.

    Raises UserError where no query has a true match.
    """
    if not splits or len({(s.protocol, s.region, s.radius_m) for s in splits}) != 1:
        raise ValueError("an evaluation needs splits of one protocol, region and radius")
    if 1 not in ks or min(ks) < 1:
        raise ValueError(f"ks must hold 1 and nothing below it, not {list(ks)}")
    xy = np.ascontiguousarray(positions[:, :2], np.float64)
    results = _search(descriptors, xy, splits, p)

    answered = [result.first_hit > 0 for result in results]
    asked_at = np.concatenate(
        [xy[split.query_rows[ok]] for split, ok in zip(splits, answered, strict=True)]
    )
    if not len(asked_at):
        raise UserError(
            f"no query has a true match within {splits[0].radius_m:g} m: the runs may not overlap "
            f"in the {splits[0].region} region, or the radius is too small"
        )
    block_of = place_blocks(asked_at, BLOCK_M)
    num_blocks = int(block_of.max()) + 1
    answerable = np.zeros((len(splits), num_blocks), np.int64)
    hits = np.zeros((len(splits), num_blocks, 1 + len(ks)), np.int64)
    ends = np.cumsum([ok.sum() for ok in answered])[:-1]
    for s, (result, ok, block) in enumerate(
        zip(results, answered, np.split(block_of, ends), strict=True)
    ):
        answerable[s] = np.bincount(block, minlength=num_blocks)
        for i, k in enumerate((result.one_percent, *ks)):
            found = result.first_hit[ok] <= k
            hits[s, :, i] = np.bincount(block[found], minlength=num_blocks)
    return Evaluation(
        protocol=splits[0].protocol,
        region=splits[0].region,
        radius_m=splits[0].radius_m,
        p=p,
        ks=tuple(ks),
        results=tuple(results),
        answerable=answerable,
        hits=hits,
    )


def compare(
    a: Evaluation, b: Evaluation, *, seed: int, num_draws: int = 1000
) -> dict[str, Estimate]:
    """Estimate a - b for every measure, with paired 95 % intervals.

    Both are drawn at the same places (see `Evaluation.estimates`), so what makes a place hard for
    both cancels out: an interval that leaves 0 out speaks for a difference even where the intervals
    of a and b overlap. Raises ValueError unless both answered the same queries.
    """
    if a.measures != b.measures or [_question(r) for r in a.results] != [
        _question(r) for r in b.results
    ]:
        raise ValueError("only evaluations of the same queries and databases can be compared")
    difference = {name: value - b.recall[name] for name, value in a.recall.items()}
    draws = a._draws(seed, num_draws) - b._draws(seed, num_draws)
    return _estimates(difference, draws, None if a.num_places > 1 else (-1.0, 1.0))


def _search(
    descriptors: Float[np.ndarray, "n d"],
    xy: Float64[np.ndarray, "n 2"],
    splits: Sequence[Split],
    p: int,
) -> list[SplitResult]:
    """Rank every split. Splits share frames, so each distance is computed once for all of them."""
    asking = np.unique(np.concatenate([split.query_rows for split in splits]))
    answering = np.unique(np.concatenate([split.database_rows for split in splits]))
    database = np.ascontiguousarray(descriptors[answering], np.float32)
    results = [
        SplitResult(
            split=split,
            first_hit=np.zeros(len(split.query_rows), np.int64),
            top_row=np.full(len(split.query_rows), -1),
            hit_row=np.full(len(split.query_rows), -1),
            one_percent=one_percent(len(split.database_rows)),
        )
        for split in splits
    ]
    chunk = max(1, MAX_DISTANCES // max(1, len(answering)))
    for start in range(0, len(asking), chunk):
        rows = asking[start : start + chunk]
        distances = pairwise_distances(descriptors[rows], database, p=p)
        for result in results:
            split = result.split
            here = np.flatnonzero(np.isin(split.query_rows, rows))
            query = split.query_rows[here].astype(np.int64)
            columns = np.searchsorted(answering, split.database_rows)
            first_hit, top, hit = first_hits(
                distances[np.ix_(np.searchsorted(rows, query), columns)],
                xy[query],
                xy[split.database_rows],
                split.radius_m,
                *answer_groups(split, query),
            )
            result.first_hit[here] = first_hit
            frames = np.append(split.database_rows, -1)  # row -1, nobody, is frame -1
            result.top_row[here] = frames[top]
            result.hit_row[here] = frames[hit]
    return results


def _estimates(
    values: dict[str, float], draws: Float64[np.ndarray, "draw measure"], known: Interval | None
) -> dict[str, Estimate]:
    return {
        name: Estimate(value, known or percentile_interval(draws[:, i]))
        for i, (name, value) in enumerate(values.items())
    }


def _question(result: SplitResult) -> tuple[object, ...]:
    """Everything about a split that its recall depends on, beside the descriptors."""
    s = result.split
    rows = (s.query_rows.tobytes(), s.database_rows.tobytes(), (result.first_hit > 0).tobytes())
    return (s.protocol, s.region, s.radius_m, s.exclude_self, s.exclude_query_run, *rows)
