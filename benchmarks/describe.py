# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""How much faster is the path that `describe` takes than the network written plainly?

    python benchmarks/describe.py [--rounds 30] [--threads 2] [--output docs/results/describe.md]

Plain: eager, default memory layout, attention at every cell, channel attention in the order of its
formula. Describe: attention at surviving cells only, channel attention reordered, channels last.
Both run in turns in one process, on the same random weights (speed does not depend on them), and
the ratio of each pair is what counts: times drift with the machine, ratios do not. Peak memory is
of a process of its own that runs one path alone, above what it held before the first frame (Linux).
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import platform
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from adafusion.files import write_text
from adafusion.models import AdaFusion, ModelConfig, describe
from adafusion.models.plain import plain_forward
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid

SMALL = ModelConfig(
    width=0.5,
    preprocess=Preprocess(
        image=ImageSettings(size=(150, 200)), voxels=VoxelGrid(shape=(36, 36, 24))
    ),
)
SIZES = {"adafusion-s": SMALL, "adafusion": ModelConfig()}
OCCUPIED = 0.02  # share of cells that a scan fills


def build(config: ModelConfig) -> AdaFusion:
    """A network of the size, always with the same weights."""
    torch.manual_seed(0)
    return AdaFusion(config).eval()


def make_inputs(config: ModelConfig, batch: int) -> tuple[Tensor, Tensor]:
    """Random tensors of the model's sizes."""
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(batch, 3, *config.preprocess.image.size, generator=generator) * 2 - 1
    cells = torch.rand(batch, 1, *config.preprocess.voxels.shape, generator=generator)
    return image, (cells < OCCUPIED).float()


def paths(config: ModelConfig, batch: int) -> dict[str, Callable[[], np.ndarray]]:
    """The two ways to the same descriptors."""
    plain_model, model = build(config), build(config)
    inputs = make_inputs(config, batch)

    @torch.no_grad()
    def plain() -> np.ndarray:
        return plain_forward(plain_model, *inputs).fused.numpy()

    return {"plain": plain, "describe": lambda: describe(model, [inputs]).fused}


def measure(config: ModelConfig, batch: int, rounds: int) -> tuple[np.ndarray, float]:
    """Milliseconds a frame, (rounds, 2), plain first; and the largest difference of descriptors."""
    ways = paths(config, batch)
    first = {name: way() for name, way in ways.items()}  # also warms both up
    ms = np.empty((rounds, 2))
    for i in range(rounds):
        order = list(ways.items()) if i % 2 else list(ways.items())[::-1]
        for name, way in order:
            start = time.perf_counter()
            way()
            ms[i, list(ways).index(name)] = (time.perf_counter() - start) * 1e3 / batch
    return ms, float(np.abs(first["plain"] - first["describe"]).max())


def peak_mb(size: str, batch: int, name: str, threads: int) -> float:
    """Peak memory of one path in a process of its own, above the process with its model built."""
    context = multiprocessing.get_context("spawn")
    with context.Pool(1) as pool:
        return pool.apply(_peak_mb, (size, batch, name, threads))


def _peak_mb(size: str, batch: int, name: str, threads: int) -> float:
    torch.set_num_threads(threads)
    way = paths(SIZES[size], batch)[name]
    before = _status_kb("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the peak so far was that of the imports
    way()
    return (_status_kb("VmHWM") - before) / 1024


def _status_kb(field: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(f"{field}:"))


def median_interval(values: np.ndarray) -> tuple[float, float, float]:
    """Median with its 95 % bootstrap interval."""
    draws = np.random.default_rng(0).choice(values, (2000, len(values)))
    low, high = np.percentile(np.median(draws, axis=1), [2.5, 97.5])
    return float(np.median(values)), float(low), float(high)


def main() -> None:
    """Measure and print one Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--output", type=Path, help="Markdown file to write as well")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    lines = [
        f"# Describing a frame, {datetime.now(UTC):%Y-%m-%d}",
        "",
        f"`python benchmarks/describe.py --rounds {arguments.rounds} --threads "
        f"{arguments.threads}`",
        f"on {platform.machine()}, {os.cpu_count()} cores, torch {torch.__version__}, load average "
        f"{os.getloadavg()[0]:.1f}. Random weights; speed does not depend on them. Ratio: plain "
        "over describe, pair by pair, median with 95 % interval.",
        "",
        "| model | batch | plain ms | describe ms | ratio | largest difference | peak MB plain "
        "| peak MB describe |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for size, config in SIZES.items():
        for batch in (1, 8):
            ms, difference = measure(config, batch, arguments.rounds)
            ratio, low, high = median_interval(ms[:, 0] / ms[:, 1])
            peaks = [
                peak_mb(size, batch, name, arguments.threads) for name in ("plain", "describe")
            ]
            lines.append(
                f"| {size} | {batch} | {np.median(ms[:, 0]):.1f} | {np.median(ms[:, 1]):.1f} "
                f"| {ratio:.2f} [{low:.2f}, {high:.2f}] | {difference:.1e} "
                f"| {peaks[0]:.0f} | {peaks[1]:.0f} |"
            )
    text = "\n".join(lines) + "\n"
    print(text)
    if arguments.output:
        write_text(arguments.output, text)


if __name__ == "__main__":
    main()
