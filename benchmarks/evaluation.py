# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""How long does an evaluation at the paper's scale take, and does a KD-tree find the same recalls?

    python benchmarks/evaluation.py [--rounds 5] [--runs 10] [--frames 240] [--dim 256]

One KD-tree a pair of runs, as the released code searches, against `evaluate_splits`, in turns in
one process: 45 pools of two runs (`union`), every frame a query, N up to 25. Descriptors are made:
places that change slowly along a route, plus a look of each run, plus noise.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Sequence

import numba
import numpy as np
import scipy
from jaxtyping import Float, Float32
from scipy.spatial import cKDTree

from adafusion.evaluation import evaluate_splits, make_splits
from adafusion.types import Frame, Split

KS = range(1, 26)


def make_world(
    runs: int, per_run: int, dim: int
) -> tuple[Float32[np.ndarray, "n dim"], Float[np.ndarray, "n 2"], list[Frame]]:
    """Drive one street `runs` times: descriptors, positions and frames."""
    rng = np.random.default_rng(0)
    place = np.tile(np.arange(per_run), runs)
    positions = np.column_stack([place * 10.0, np.zeros(len(place))])
    positions += rng.normal(0.0, 2.0, positions.shape)
    look = np.repeat(rng.normal(0.0, 1.0, (runs, dim)), per_run, axis=0)
    street = np.cumsum(rng.normal(0.0, 0.3, (per_run, dim)), axis=0)[place]
    descriptors = street + look + rng.normal(0.0, 1.5, (len(place), dim))
    frames = [
        Frame(run=f"run{i // per_run}", timestamp_us=i, position_m=(x, y, 0.0))
        for i, (x, y) in enumerate(positions.tolist())
    ]
    return descriptors.astype(np.float32), positions, frames


def kd_tree_recall(
    descriptors: Float32[np.ndarray, "n dim"],
    positions: Float[np.ndarray, "n 2"],
    splits: Sequence[Split],
    p: int,
) -> Float[np.ndarray, " k"]:
    """Recall@N of pools, averaged: one tree a split, the query itself taken out of its answers."""
    recalls = []
    for split in splits:
        rows = split.database_rows
        tree = cKDTree(descriptors[rows])
        true = cKDTree(positions[rows]).query_ball_point(positions[rows], split.radius_m)
        _, found = tree.query(descriptors[rows], k=len(KS) + 1, p=p)
        hits = []
        for q, answers in enumerate(np.asarray(found)):
            others = set(true[q]) - {q}
            if others:
                is_hit = [row in others for row in answers if row != q][: len(KS)]
                hits.append(np.cumsum(is_hit) > 0)
        recalls.append(np.mean(hits, axis=0))
    return np.asarray(np.mean(recalls, axis=0))


def main() -> None:
    """Print times, their ratio, and whether both find the same."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--frames", type=int, default=240)
    parser.add_argument("--dim", type=int, default=256)
    arguments = parser.parse_args()
    print(
        f"{platform.processor() or platform.machine()}, {numba.get_num_threads()} threads, "
        f"numpy {np.__version__}, scipy {scipy.__version__}, numba {numba.__version__}"
    )
    descriptors, positions, frames = make_world(arguments.runs, arguments.frames, arguments.dim)
    splits = make_splits("union", frames, np.full(len(frames), "test"))
    print(f"{len(splits)} pairs, {len(splits[0].query_rows)} in the pool, {arguments.dim}-d")
    evaluate_splits(descriptors, positions, splits)  # compiles
    clock = time.perf_counter
    for p in (1, 2):
        seconds = []
        for _ in range(arguments.rounds):
            start = clock()
            slow = kd_tree_recall(descriptors, positions, splits, p)
            middle = clock()
            evaluation = evaluate_splits(descriptors, positions, splits, KS, p)
            end = clock()
            seconds.append((middle - start, end - middle))
        tree, ours = np.array(seconds).T
        ratio = tree / ours
        start = clock()
        estimate = evaluation.estimates(seed=0)["AR@1"]
        bootstrap = clock() - start
        fast = [evaluation.recall[f"AR@{k}"] for k in KS]
        difference = np.abs(slow - fast).max()
        print(
            f"L{p}: KD-tree {np.median(tree):.2f} s, evaluate_splits {np.median(ours):.3f} s, "
            f"ratio {np.median(ratio):.1f} ({ratio.min():.1f} to {ratio.max():.1f}); "
            f"bootstrap of 1000 draws {bootstrap:.3f} s\n"
            f"    AR@1 {estimate.value:.4f} [{estimate.interval[0]:.4f}, "
            f"{estimate.interval[1]:.4f}]; largest difference of a recall {difference:.1e}"
        )


if __name__ == "__main__":
    main()
