# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Whether memory stays where it is while a recording grows, and how fast frames are prepared.

    python benchmarks/prepare.py [--scans 3000 30000] [--output docs/results/prepare.md]

A recording in NCLT's raw layout with a scan of 4,000 points every metre and no pictures: all its
scans are links to one file, so that 30,000 of them fit on any disk. Each is prepared in a process
of its own, whose peak memory and that of its workers the system reports. A second table has the
decoding alone, by one process, in frames a second.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import platform
import resource
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from adafusion.datasets.recording import Written
from adafusion.files import write_text
from adafusion.readers import prepare

POINTS = 4000
RUN = "2012-01-08"


class Row(NamedTuple):
    """What preparing one recording took."""

    scans: int
    workers: int
    frames_per_second: float
    decode_share: float
    peak_mb: float  # of the process that leads
    worker_mb: float  # of the largest worker


def make_recording(folder: Path, scans: int) -> Path:
    """Lay out a run along a straight line, a scan and a pose a metre."""
    rng = np.random.default_rng(0)
    records = np.empty(POINTS, np.dtype([("xyz", "<u2", 3), ("i", "u1"), ("laser", "u1")]))
    records["xyz"] = rng.integers(16_000, 24_000, (POINTS, 3))  # within 20 m
    records["i"], records["laser"] = 0, rng.integers(0, 32, POINTS)
    sync = folder / "velodyne_data" / RUN / "velodyne_sync"
    sync.mkdir(parents=True)
    scan = folder / "scan.bin"
    scan.write_bytes(records.tobytes())
    time_us = 1_326_000_000_000_000 + 100_000 * np.arange(scans)
    for t in time_us.tolist():
        os.link(scan, sync / f"{t}.bin")
    (folder / "ground_truth").mkdir()
    rows = [f"{t},{k},0,0,0,0,0" for k, t in enumerate(time_us.tolist())]
    (folder / "ground_truth" / f"groundtruth_{RUN}.csv").write_text("\n".join(rows) + "\n")
    return folder


def measure(scans: int, workers: int, scratch: Path) -> Row:
    """Prepare a recording of so many scans in a new process."""
    src = make_recording(scratch / f"src-{scans}-{workers}", scans)
    context = multiprocessing.get_context("spawn")
    with context.Pool(1, maxtasksperchild=1) as pool:
        written, peak, worker = pool.apply(
            _prepare, (src, scratch / f"out-{scans}-{workers}", workers)
        )
    return Row(scans, workers, *written, peak, worker)


def _prepare(src: Path, out: Path, workers: int) -> tuple[tuple[float, float], float, float]:
    multiprocessing.process.current_process()._config["daemon"] = False  # it has workers of its own
    written: Written = prepare(src, out, "nclt", workers=workers, every_m=0.0)
    own, children = (
        resource.getrusage(who).ru_maxrss / 1024
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    return (written.frames_per_second, written.decode_share), own, children


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scans", type=int, nargs="+", default=[3000, 30000])
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    start = time.perf_counter()
    rows = []
    for scans in options.scans:
        for workers in (1, 2):
            with tempfile.TemporaryDirectory() as scratch:
                rows.append(measure(scans, workers, Path(scratch)))
            print(rows[-1], flush=True)
    lines = [
        "# Preparing recordings",
        "",
        f"`python benchmarks/prepare.py`, {datetime.now(UTC):%Y-%m-%d}, {platform.machine()}, "
        f"{os.cpu_count()} cores, Python {platform.python_version()}, "
        f"load average {os.getloadavg()[0]:.1f}, {time.perf_counter() - start:.0f} s in all.",
        "",
        f"Runs in NCLT's raw layout without pictures, {POINTS:,} points a scan. Peak resident "
        "memory of the leading process (all of Python, tables of times and poses, the list of "
        "frames) and of its largest worker.",
        "",
        "| scans | processes | frames/s | share of decoding | leader, MB | worker, MB |",
        "|---|---|---|---|---|---|",
        *(
            f"| {r.scans:,} | {r.workers} | {r.frames_per_second:.0f} | {r.decode_share:.0%} | "
            f"{r.peak_mb:.0f} | {'' if r.workers == 1 else f'{r.worker_mb:.0f}'} |"
            for r in rows
        ),
        "",
    ]
    print("\n".join(lines))
    if options.output:
        write_text(options.output, "\n".join(lines))


if __name__ == "__main__":
    main()
