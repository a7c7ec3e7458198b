# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""How long do save, open, append, compact and one query take on maps of 1,000 and 100,000 places?

    python benchmarks/map.py [--places 1000 100000] [--dim 256]

Descriptors are random: no step's cost depends on their values. Files lie in the system's
temporary folder, and were just written when they are opened, so they come from memory.
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
import time
from datetime import timedelta
from pathlib import Path

import numba
import numpy as np

from adafusion.mapping import MapHeader, PlaceMap, compact, info
from adafusion.search import rank
from adafusion.types import Descriptions

RUN = 1000  # places that an append adds
QUERIES = 50


def make_map(run: str, n: int, dim: int, seed: int) -> PlaceMap:
    """Make a run of n random places of the full two-sensor system."""
    rng = np.random.default_rng(seed)
    T_map_body = np.tile(np.eye(4), (n, 1, 1))
    T_map_body[:, :3, 3] = rng.random((n, 3))
    fused, image_half, lidar_half, alpha = (
        rng.random((n, d), np.float32) for d in (dim, dim // 2, dim // 2, 2)
    )
    return PlaceMap(
        header=MapHeader(
            model="random",
            model_fingerprint="",
            preprocess_fingerprint="",
            synthetic=True,
            world="random",
        ),
        keys=tuple(f"{run}/{i}" for i in range(n)),
        datasets=("random",) * n,
        zones=(None,) * n,
        positions_m=T_map_body[:, :3, 3],
        T_map_body=T_map_body,
        descriptions=Descriptions(fused, image_half, lidar_half, alpha),
    )


def measure(n: int, dim: int, path: Path) -> dict[str, float]:
    """Time each step in seconds; a query is the median of many."""
    seconds: dict[str, float] = {}
    clock = time.perf_counter
    place_map, run = make_map("day", n, dim, 0), make_map("night", RUN, dim, 1)

    start = clock()
    place_map.save(path)
    seconds["save"] = clock() - start
    start = clock()
    opened = PlaceMap.open(path)
    seconds["open"] = clock() - start
    start = clock()
    assert opened.fingerprint == place_map.fingerprint
    seconds["fingerprint twice"] = clock() - start
    start = clock()
    PlaceMap.append(path, run)
    seconds[f"append {RUN}"] = clock() - start
    start = clock()
    compact(path, keep=timedelta(milliseconds=1))
    seconds["compact"] = clock() - start

    assert opened.descriptions.fused is not None
    queries = np.random.default_rng(2).random((QUERIES, dim), np.float32)
    rank(queries[:1], opened.descriptions.fused, 5)  # compiles
    times = []
    for query in queries:
        start = clock()
        rank(query[None], opened.descriptions.fused, 5)
        times.append(clock() - start)
    seconds["query, L1"] = float(np.median(times))
    return seconds


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--places", type=int, nargs="+", default=[1000, 100_000])
    parser.add_argument("--dim", type=int, default=256)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measure(10, options.dim, Path(folder) / "warm.map")  # imports LanceDB
        table = {n: measure(n, options.dim, Path(folder) / f"{n}.map") for n in options.places}
        size = {n: info(Path(folder) / f"{n}.map").bytes_on_disk for n in options.places}
    print(
        f"{platform.processor() or platform.machine()}, {numba.get_num_threads()} threads, "
        f"load {os.getloadavg()[0]:.1f}, {options.dim} numbers a descriptor"
    )
    print("| step, ms | " + " | ".join(f"{n:,} places" for n in options.places) + " |")
    print("|---|" + "---:|" * len(options.places))
    for step in next(iter(table.values())):
        print(f"| {step} | " + " | ".join(f"{1e3 * table[n][step]:.2f}" for n in table) + " |")
    print("| MB on disk | " + " | ".join(f"{size[n] / 1e6:.1f}" for n in table) + " |")


if __name__ == "__main__":
    main()
