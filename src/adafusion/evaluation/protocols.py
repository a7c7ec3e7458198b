# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Evaluation protocols: who is the map, who the query, who may answer, and what is a true match.

Scores of different protocols cannot be compared, so each has a name, and words for the report.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
from jaxtyping import Int, Int64, Shaped

from adafusion.types import Frame, Split, UserError

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class EvaluationProtocol:
    """How two runs make a split."""

    radius_m: float  # a true match lies at most so far from the query, in the plane
    words: str
    pooled: bool = False  # both runs are one pool: each frame of it is a query and may answer
    whole_database: bool = False  # the other run answers with all its frames, not the region's only
    exclude_self: bool = False
    exclude_query_run: bool = False


PROTOCOLS: dict[str, EvaluationProtocol] = {
    "cross-run": EvaluationProtocol(
        radius_m=20.0,
        words="For every ordered pair of runs, the frames of one run in the {region} region are "
        "the queries and those of the other run in the same region are the database.",
    ),
    "union": EvaluationProtocol(
        radius_m=20.0,
        words="For every unordered pair of runs, the frames of both in the {region} region form "
        "one pool. Every frame of the pool is a query against all others. Neighbours from the "
        "query's own run count as true matches.",
        pooled=True,
        exclude_self=True,
    ),
    "union-strict": EvaluationProtocol(
        radius_m=20.0,
        words="For every unordered pair of runs, the frames of both in the {region} region form "
        "one pool. Every frame of the pool is a query, and no frame of its own run may answer. "
        "1 % is 1 % of the pool, half of which cannot answer.",
        pooled=True,
        exclude_self=True,
        exclude_query_run=True,
    ),
    "pointnetvlad": EvaluationProtocol(
        radius_m=25.0,
        words="For every ordered pair of runs, the frames of one run in the {region} region are "
        "the queries and all frames of the other run, whatever their region, are the database.",
        whole_database=True,
    ),
}


def protocol_named(name: str) -> EvaluationProtocol:
    """Look a protocol up; a name that is none raises UserError with the choices."""
    if name not in PROTOCOLS:
        raise UserError(f"unknown protocol {name!r}: choose from {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]


def describe_protocol(name: str, *, radius_m: float | None = None, region: str = "test") -> str:
    """Say in words what the protocol does, for reports and result files."""
    protocol = protocol_named(name)
    radius_m = protocol.radius_m if radius_m is None else radius_m
    return (
        f"{protocol.words.format(region=region)} A true match lies at most {radius_m:g} m from the "
        "query in the plane. Queries without a true match are left out and counted. Recall is "
        "averaged over the pairs, each with the same weight."
    )


def make_splits(
    protocol: str,
    frames: Sequence[Frame],
    region_names: Shaped[np.ndarray, " frames"],
    *,
    radius_m: float | None = None,
    runs: Sequence[str] | None = None,
    region: str = "test",
) -> list[Split]:
    """Write a protocol out for these frames: one split a pair of runs; rows index `frames`.

    `region_names` holds the region of each frame (see `adafusion.datasets.splits.region_of`);
    queries come from `region`. `radius_m` None is the protocol's own. `runs` chooses runs and their
    order; None takes all, in the order of their names. A split named "a->b" asks a's queries of b's
    database; "a+b" is a pool. Runs without a frame in the region ask nothing and are logged.

    Raises UserError on an unknown protocol or run, a radius that is no length, or where fewer than
    two runs remain.
    """
    rules = protocol_named(protocol)
    if radius_m is not None and not 0.0 < radius_m < np.inf:
        raise UserError(f"radius {radius_m:g} m: a true match needs a finite radius above 0")
    if len(region_names) != len(frames):
        raise ValueError(f"{len(region_names)} regions for {len(frames)} frames")
    run_of = np.array([frame.run for frame in frames], dtype=str)
    known, run_ids = np.unique(run_of, return_inverse=True)
    runs = known.tolist() if runs is None else list(dict.fromkeys(runs))
    if unknown := sorted(set(runs) - set(known.tolist())):
        raise UserError(f"no run {', '.join(unknown)} here: choose from {', '.join(known)}")

    in_region = region_names == region
    all_rows = {run: np.flatnonzero(run_of == run) for run in runs}
    region_rows = {run: rows[in_region[rows]] for run, rows in all_rows.items()}
    database_rows = all_rows if rules.whole_database else region_rows
    if silent := [run for run in runs if not len(region_rows[run])]:
        logger.warning("no frame in the %s region: %s", region, ", ".join(silent))

    def split(name: str, query: Int[np.ndarray, " q"], database: Int[np.ndarray, " n"]) -> Split:
        return Split(
            name=name,
            protocol=protocol,
            region=region,
            radius_m=rules.radius_m if radius_m is None else radius_m,
            query_rows=query,
            database_rows=database,
            exclude_self=rules.exclude_self,
            exclude_query_run=rules.exclude_query_run,
            run_ids=run_ids if rules.exclude_query_run else None,
        )

    if rules.pooled:
        with_frames = [run for run in runs if len(region_rows[run])]
        pools = {
            f"{a}+{b}": np.concatenate([region_rows[a], region_rows[b]])
            for a, b in combinations(with_frames, 2)
        }
        splits = [split(name, pool, pool) for name, pool in pools.items()]
    else:
        splits = [
            split(f"{a}->{b}", region_rows[a], database_rows[b])
            for a, b in permutations(runs, 2)
            if len(region_rows[a]) and len(database_rows[b])
        ]
    if not splits:
        raise UserError(
            f"protocol {protocol} compares runs, and fewer than two of {', '.join(runs)} have "
            f"frames in the {region} region: give more runs or other regions"
        )
    return splits


def answer_groups(
    split: Split, query_rows: Int[np.ndarray, " q"]
) -> tuple[Int64[np.ndarray, " q"], Int64[np.ndarray, " n"]]:
    """Number queries and database rows so that equal numbers may not answer each other."""
    query, database = query_rows.astype(np.int64), split.database_rows.astype(np.int64)
    if split.exclude_query_run:
        if split.run_ids is None:
            raise ValueError(f"split {split.name} excludes runs and does not say whose frames are")
        run_ids = split.run_ids.astype(np.int64)
        return run_ids[query], run_ids[database]
    if split.exclude_self:
        return query, database
    return np.full(len(query), -1), database
