# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The evaluation against the same protocol told as plain loops over queries and runs."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import pytest

from adafusion.evaluation import evaluate as evaluate_module
from adafusion.evaluation import evaluate_splits, make_splits
from adafusion.evaluation.metrics import draw_blocks
from adafusion.types import Frame

RUNS, PER_RUN = 4, 30
KS = (1, 2, 5, 25)


@pytest.fixture
def world() -> tuple:
    rng = np.random.default_rng(0)
    place = np.tile(np.arange(PER_RUN), RUNS)
    positions = np.column_stack([place * 12.0, np.zeros(len(place))])
    positions += rng.normal(0, 4, positions.shape)
    descriptors = rng.integers(0, 4, (PER_RUN, 6))[place] + rng.integers(0, 3, (len(place), 6))
    frames = [
        Frame(run=f"run{i // PER_RUN}", timestamp_us=i, position_m=(0.0, 0.0, 0.0))
        for i in range(len(place))
    ]
    regions = np.where((place >= 8) & (place < 25), "test", "train")
    return descriptors.astype(np.float32), positions, frames, regions


def slow_first_hits(protocol, descriptors, positions, frames, regions, radius_m, p):
    """One list a pair of runs: (query, rank of its first true match, 0 for none, pool size)."""
    rows = {
        run: [i for i, f in enumerate(frames) if f.run == run] for run in {f.run for f in frames}
    }
    test = {run: [i for i in rows[run] if regions[i] == "test"] for run in rows}
    pairs = combinations if protocol.startswith("union") else permutations
    answers = []
    for a, b in pairs(sorted(rows), 2):
        if protocol.startswith("union"):
            queries = database = test[a] + test[b]
        else:
            queries = test[a]
            database = rows[b] if protocol == "pointnetvlad" else test[b]
        answers.append([])
        for q in queries:
            candidates = []
            for order, i in enumerate(database):
                if protocol == "union" and i == q:
                    continue
                if protocol == "union-strict" and frames[i].run == frames[q].run:
                    continue
                difference = np.abs(descriptors[q].astype(float) - descriptors[i])
                candidates.append((np.sum(difference**p), order, i))
            rank = 0
            for position, (_, _, i) in enumerate(sorted(candidates), start=1):
                if np.hypot(*(positions[q] - positions[i])) <= radius_m:
                    rank = position
                    break
            answers[-1].append((q, rank, len(database)))
    return answers


@pytest.mark.parametrize("p", [1, 2])
@pytest.mark.parametrize("protocol", ["cross-run", "union", "union-strict", "pointnetvlad"])
@pytest.mark.parametrize("held", [2**25, 500])  # distances at a time: all, or a few queries'
def test_evaluation_equals_plain_loops(
    world: tuple, protocol: str, p: int, held: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluate_module, "MAX_DISTANCES", held)
    descriptors, positions, frames, regions = world
    radius_m = 10.0  # so small that some queries have no true match
    splits = make_splits(protocol, frames, regions, radius_m=radius_m)
    e = evaluate_splits(descriptors, positions, splits, ks=KS, p=p)
    slow = slow_first_hits(protocol, *world, radius_m, p)

    assert [r.first_hit.tolist() for r in e.results] == [[r for _, r, _ in a] for a in slow]
    assert e.num_unanswerable == sum(rank == 0 for a in slow for _, rank, _ in a)
    assert e.num_unanswerable > 0 or protocol == "union"
    for k in KS:
        recalls = [[rank <= k for _, rank, _ in a if rank] for a in slow]
        assert e.recall[f"AR@{k}"] == pytest.approx(np.mean([np.mean(r) for r in recalls]))
        assert e.pooled_recall[f"AR@{k}"] == pytest.approx(np.mean(np.concatenate(recalls)))
    at_1_percent = [
        np.mean([rank <= max(round(size / 100), 1) for _, rank, size in a if rank]) for a in slow
    ]
    assert e.recall["AR@1%"] == pytest.approx(np.mean(at_1_percent))


def test_the_bootstrap_equals_queries_repeated_block_by_block(world: tuple) -> None:
    descriptors, positions, frames, regions = world
    splits = make_splits("cross-run", frames, regions)
    e = evaluate_splits(descriptors, positions, splits, ks=(1,))
    slow = slow_first_hits("cross-run", *world, 20.0, 1)

    cells = [tuple(np.floor(positions[q] / 50.0)) for a in slow for q, rank, _ in a if rank]
    blocks = sorted(set(cells))
    assert e.num_places == len(blocks) > 5
    draws = []
    for weight in draw_blocks(len(blocks), 200, seed=5):
        recalls = []
        for answers in slow:
            hits = []
            for q, rank, _ in answers:
                times = (
                    int(weight[blocks.index(tuple(np.floor(positions[q] / 50.0)))]) if rank else 0
                )
                hits += [rank == 1] * times
            if hits:
                recalls.append(np.mean(hits))
        draws.append(np.mean(recalls))
    interval = e.estimates(seed=5, num_draws=200)["AR@1"].interval
    assert interval == pytest.approx(tuple(np.percentile(draws, [2.5, 97.5])))
