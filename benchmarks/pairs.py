# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""How long do finding pairs and drawing batches take, and how much memory?

    python benchmarks/pairs.py

Ten drives around one loop, a frame every 10 m: 5,150 frames (the size of the paper's training set)
and 50,000. Beside it the plain form: the N x N matrix of distances in NumPy. Each measurement runs
in a process of its own; its peak memory is what it needed above what it began with (Linux only).
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from itertools import islice
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import scipy
from jaxtyping import Float, Int

from adafusion.training.pairs import epoch_rng, find_pairs, pair_batches, place_batches

RUNS = 10


def drives(n: int) -> tuple[Float[np.ndarray, "n 2"], Int[np.ndarray, " n"]]:
    """Positions and runs of ten drives around a circle, 2 m off the line by chance."""
    turn = np.tile(np.arange(n // RUNS) / (n // RUNS), RUNS) * 2 * np.pi
    radius_m = n // RUNS * 10.0 / (2 * np.pi)
    positions = radius_m * np.column_stack([np.cos(turn), np.sin(turn)])
    positions += np.random.default_rng(0).normal(0.0, 2.0, positions.shape)
    return positions, np.repeat(np.arange(RUNS), n // RUNS)


def matrix(n: int) -> str:
    """Find pairs the plain way: every distance and two masks."""
    x, y = drives(n)[0].T
    distance = np.hypot(x[:, None] - x, y[:, None] - y)
    upper = np.triu(np.ones((n, n), np.bool_), k=1)
    positive = np.argwhere(upper & (distance <= 10.0))
    return f"{len(positive)} true, {np.count_nonzero(upper & (distance > 50.0))} wrong"


def tree(n: int) -> str:
    """Find pairs as training does."""
    positions, _ = drives(n)
    pairs = find_pairs(positions, np.zeros(n, np.int64))
    return f"{len(pairs.positive)} true, {pairs.num_negatives} wrong"


def batches(n: int) -> str:
    """Draw batches of both kinds; the first, which compiles and sorts, is told apart."""
    positions, run = drives(n)
    pairs = find_pairs(positions, np.zeros(n, np.int64))
    texts = []
    for name, drawn in (
        ("pairs of 16 items", pair_batches(pairs, 16, epoch_rng(0, 0))),
        ("places 16 x 4", place_batches(pairs, 16, 4, epoch_rng(0, 0), run=run)),
    ):
        clock = [time.perf_counter()]
        clock += [time.perf_counter() for _ in islice(drawn, 70)]
        first, *others = np.diff(clock) * 1e3
        texts.append(f"{name} {np.median(others):.3f} ms a batch (first {first:.0f})")
    return "; ".join(texts)


def measured(job: Callable[[int], str], n: int) -> str:
    """Run a job; give its result, time and peak memory."""
    status = Path("/proc/self/status")

    def memory_mb(field: str) -> float:
        line = next(line for line in status.read_text().splitlines() if line.startswith(field))
        return int(line.split()[1]) / 1024

    Path("/proc/self/clear_refs").write_text("5")  # the peak so far was that of the imports
    before = memory_mb("VmRSS")
    start = time.perf_counter()
    result = job(n)
    seconds = time.perf_counter() - start
    return f"{seconds:7.3f} s {memory_mb('VmHWM') - before:7.0f} MB  {result}"


def main() -> None:
    """Print one line a measurement."""
    print(
        f"{platform.processor() or platform.machine()}, numpy {np.__version__}, "
        f"scipy {scipy.__version__}"
    )
    for n, job in (
        (5150, matrix),
        (5150, tree),
        (5150, batches),
        (50_000, tree),
        (50_000, batches),
    ):
        with get_context("spawn").Pool(1) as pool:
            print(f"{n:6d} frames  {job.__name__:8s} {pool.apply(measured, (job, n))}")


if __name__ == "__main__":
    main()
