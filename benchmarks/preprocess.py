# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What preparing a frame costs, against plain forms of the same steps.

    OMP_NUM_THREADS=1 python benchmarks/preprocess.py [--repeats 30]

Each pair runs alternately in one process on one thread; medians in milliseconds, and the median
of the ratios of neighbouring runs. Prints Markdown.
"""

from __future__ import annotations

import argparse
import platform
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numba
import numpy as np
import torch

from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid
from adafusion.preprocess.augment import GREY, color_jitter
from adafusion.preprocess.cache import prepare_cache
from adafusion.preprocess.image import resize, to_unit
from adafusion.preprocess.voxels import pack, to_float, unpack, voxelize
from adafusion.types import Frame, Observation

Step = Callable[[], object]


def interleaved(ours: Step, plain: Step, repeats: int) -> tuple[float, float, float]:
    """Median ms of both and the median ratio plain / ours."""
    ours(), plain()  # compiled and in the caches
    seconds = np.empty((repeats, 2))
    for row in seconds:
        for i, step in enumerate((ours, plain)):
            start = time.perf_counter()
            step()
            row[i] = time.perf_counter() - start
    fast, slow = np.median(seconds, axis=0) * 1e3
    return float(fast), float(slow), float(np.median(seconds[:, 1] / seconds[:, 0]))


def numpy_voxels(points: np.ndarray, grid: VoxelGrid) -> np.ndarray:
    """Binary occupancy in plain numpy, as the released code has it."""
    lower, upper = np.array(grid.lower_m), np.array(grid.upper_m)
    u = (points - lower) * np.array(grid.shape) / (upper - lower)
    cells = (np.round(u) if grid.index == "round" else np.floor(u)).astype(np.int64)
    cells = cells[((cells >= 0) & (cells < grid.shape)).all(axis=1)]
    occupied = np.zeros(grid.shape, dtype=np.float32)
    occupied[cells[:, 0], cells[:, 1], cells[:, 2]] = 1.0
    return occupied


def jitter_one_by_one(images: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Colour jitter image by image and change by change."""
    changed = []
    for image, draw in zip(images, torch.rand(len(images), 6, generator=generator), strict=True):
        x = (image + 1) / 2
        for change in draw[3:].argsort().tolist():
            f = 1 + 0.2 * (2 * draw[change] - 1)
            grey = (x * torch.tensor(GREY)[:, None, None]).sum(0)
            x = f * x + (1 - f) * (torch.zeros(()), grey.mean(), grey)[change]
        changed.append((2 * x - 1).clamp_(-1, 1))
    return torch.stack(changed)


class Memory:
    """A dataset that shows the same raw frame again and again."""

    root = Path("memory")
    fingerprint = "memory"

    def __init__(self, n: int, seen: Observation) -> None:
        self.frames = tuple(
            Frame(run="run", timestamp_us=i, position_m=(0.0, 0.0, 0.0)) for i in range(n)
        )
        self.seen = seen

    def load(self, frame: Frame) -> Observation:
        """The one frame, whatever is asked."""
        return self.seen


def main() -> None:
    """Run everything and print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=30)
    repeats = parser.parse_args().repeats
    torch.set_num_threads(1)
    cv2.setNumThreads(1)

    rng = np.random.default_rng(0)
    # a scan thins out with the distance and lies between the road and the roofs
    around = rng.normal(0.0, 12.0, (100_000, 2))
    points = np.column_stack([around, rng.uniform(-0.2, 6.0, 100_000)]).astype(np.float32)
    photo = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)
    photo = np.asarray(cv2.resize(photo, (1280, 960), interpolation=cv2.INTER_CUBIC))
    settings = Preprocess()
    grid, size = settings.voxels, settings.image.size
    nearest = VoxelGrid(index="round")
    occupied = voxelize(points, grid)
    packed = pack(occupied)
    small = torch.from_numpy(resize(photo, settings.image))
    batch = to_unit(small.expand(16, -1, -1, -1))
    generator = torch.Generator().manual_seed(0)

    rows = [
        (
            "voxelise 100k points, floor | plain numpy",
            lambda: to_float(voxelize(points, grid), grid),
            lambda: numpy_voxels(points, grid),
        ),
        (
            "voxelise 100k points, round | plain numpy",
            lambda: to_float(voxelize(points, nearest), nearest),
            lambda: numpy_voxels(points, nearest),
        ),
        *(
            (
                f"voxelise 100k points, {other.occupancy} | binary in plain numpy",
                lambda other=other: to_float(voxelize(points, other), other),
                lambda: numpy_voxels(points, grid),
            )
            for other in (VoxelGrid(occupancy=name) for name in ("count", "soft", "tdf"))
        ),
        (
            "packed voxels to float32 | voxelise again",
            lambda: to_float(unpack(packed, grid.shape), grid),
            lambda: to_float(voxelize(points, grid), grid),
        ),
        (
            f"resize 960 x 1280 to {size[0]} x {size[1]} | OpenCV's area filter",
            lambda: resize(photo, ImageSettings()),
            lambda: cv2.resize(photo, size[::-1], interpolation=cv2.INTER_AREA),
        ),
        (
            "bytes to [-1, 1] | in numpy",
            lambda: to_unit(small),
            lambda: (small.numpy().astype(np.float32) / 127.5 - 1).transpose(2, 0, 1).copy(),
        ),
        (
            "colour jitter of 16 images | one by one",
            lambda: color_jitter(batch, generator),
            lambda: jitter_one_by_one(batch, generator),
        ),
    ]
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}, ")
    print(f"torch {torch.__version__}, numpy {np.__version__}, numba {numba.__version__}, ")
    print(f"opencv {cv2.__version__}; one thread, {repeats} interleaved pairs\n")
    print("| step | against | ours ms | other ms | ratio |\n|---|---|---|---|---|")
    for name, ours, plain in rows:
        fast, slow, ratio = interleaved(ours, plain, repeats)
        ours_name, plain_name = name.split(" | ")
        print(f"| {ours_name} | {plain_name} | {fast:.3f} | {slow:.3f} | {ratio:.2f} |")

    n = 256
    with tempfile.TemporaryDirectory() as folder:
        dataset = Memory(n, Observation(image=photo, points_body=points))
        start = time.perf_counter()
        prepared = prepare_cache(dataset, settings, folder, workers=2)
        build = (time.perf_counter() - start) / n * 1e3
        one = np.arange(n)[:, None]
        first = np.median([_ms(lambda row=row: prepared.tensors(row)) for row in one])
        again = np.median([_ms(lambda row=row: prepared.tensors(row)) for row in one])
        size_kb = sum(file.stat().st_size for file in prepared.folder.glob("*.npy")) / n / 1e3
        direct = np.median([_ms(lambda: settings(photo, points)) for _ in range(repeats)])
    print(
        f"\nCache: {size_kb:.0f} kB a frame; built at {build:.1f} ms a frame (2 threads); ", end=""
    )
    print(f"a frame read in {first:.2f} ms the first time (checked), {again:.2f} ms afterwards, ")
    print(f"against {direct:.2f} ms from the decoded image and points.")


def _ms(step: Step) -> float:
    start = time.perf_counter()
    step()
    return (time.perf_counter() - start) * 1e3


if __name__ == "__main__":
    main()
