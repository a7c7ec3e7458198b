# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a frame of the synthetic world costs.

    OMP_NUM_THREADS=1 python benchmarks/world.py [--frames 30] [--output docs/results/world.md]

CPU time of one process and one thread, over frames spread along a day, a night and a fog run of a
world of each profile, with what moves in its streets and the same frames without; then pairs of
image and scan a second through `simulate` with two processes, everything in: start of the
processes, world, pictures, files. Kernels are compiled before the clock starts. CPU time grows
when other jobs share caches and memory, so the load average stands beside it.
"""

from __future__ import annotations

import argparse
import os
import platform
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numba
import numpy as np

from adafusion.datasets import write_observation
from adafusion.files import write_text
from adafusion.sim.simulate import simulate
from adafusion.sim.studio import PROFILES, Studio, conditions_of, make_job

SEED = 3
RUNS = ("day", "night", "fog")
TARGET_MS = {"tiny": 30, "full": 250}


def cpu_ms(step: Callable[[], object]) -> float:
    """CPU milliseconds of one call."""
    start = time.process_time()
    step()
    return (time.process_time() - start) * 1e3


def measure(profile: str, frames: int, folder: Path, *, moving: bool) -> str:
    """One row of the table: mean CPU-ms of world, moving objects, image, scan and files."""
    runs = {run: conditions_of(SEED, run) for run in RUNS}
    if not moving:
        runs = {run: replace(c, traffic_density=0.0, people_density=0.0) for run, c in runs.items()}
    job = make_job(SEED, runs, profile)
    studio = Studio(job)
    studio.observe(RUNS[0], 0)
    world_ms = cpu_ms(lambda: Studio(job).points(RUNS[0], 0))
    cost = []
    for run in RUNS:
        way = studio.drive(run)
        places = len(way.zone)
        studio.points(run, 0)
        for k in np.linspace(0, places - 1, max(frames // len(RUNS), 1)).astype(int).tolist():
            t, T = int(way.timestamp_us[k]), way.T_world_body[k]
            moving_ms = cpu_ms(lambda run=run, t=t, T=T: studio.scene_at(run, t, T))
            image_ms = cpu_ms(lambda run=run, k=k: studio.image(run, k))
            scan_ms = cpu_ms(lambda run=run, k=k: studio.points(run, k))
            _, seen = studio.observe(run, k)
            files_ms = cpu_ms(
                lambda run=run, t=t, seen=seen: write_observation(folder, run, t, seen)
            )
            cost.append((moving_ms, image_ms, scan_ms, files_ms))
    moved, image, cloud, files = np.mean(cost, axis=0)
    h, w = studio.camera.size
    lidar, target = studio.lidar, TARGET_MS.get(profile)
    return (
        f"| {profile}{'' if moving else ', nothing moves'} | {h}x{w} + {lidar.beams}x{lidar.steps} "
        f"| {len(studio.world.soup.corners):,} | {world_ms:,.0f} | {moved:.1f} | {image:.1f} "
        f"| {cloud:.1f} | {files:.1f} | {image + cloud:.1f} | {'' if target is None else target} "
        f"| {places} |"
    )


def throughput(profile: str, places: int, folder: Path) -> str:
    """Pairs of image and scan a second through two processes."""
    start = time.perf_counter()
    dataset = simulate(folder / profile, seed=SEED, runs=RUNS, profile=profile, places=places,
                       workers=2)  # fmt: skip
    seconds = time.perf_counter() - start
    frames = len(dataset.frames)
    return f"| {profile} | {frames} | {seconds:.1f} | {frames / seconds:.1f} |"


def main() -> None:
    """Measure every profile and print Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--places", type=int, default=40, help="of each run through two processes")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    before = os.getloadavg()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        costs = [
            measure(profile, options.frames, folder / "files", moving=moving)
            for profile in PROFILES
            for moving in (True, False)
        ]
        rates = [throughput(profile, options.places, folder) for profile in PROFILES]
    after = os.getloadavg()
    own, children = (
        resource.getrusage(who).ru_maxrss / 1024
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    lines = [
        f"# The synthetic world, {datetime.now(UTC):%Y-%m-%d}",
        "",
        f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, numba {numba.__version__}; load average (1 min) "
        f"{before[0]:.1f} at the start, {after[0]:.1f} at the end.",
        f"Peak memory: {own:,.0f} MB this process, {children:,.0f} MB the largest worker.",
        "",
        f"Mean CPU-ms a frame, one thread, {options.frames} frames of {', '.join(RUNS)}; the "
        "image holds the assembly of the moving objects, which the scan finds made:",
        "",
        "| profile | image + beams | triangles | world | moving objects | image | scan | files "
        "| image + scan | target | places a run |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
        *costs,
        "",
        "Wall time of `simulate` with two processes:",
        "",
        "| profile | pairs | seconds | pairs a second |",
        "|---|---:|---:|---:|",
        *rates,
    ]
    text = "\n".join(lines) + "\n"
    print(text)
    if options.output is not None:
        write_text(options.output, text)


if __name__ == "__main__":
    main()
