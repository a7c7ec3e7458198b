# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Train a few batches in this process alone and print, as JSON, how fast and in what memory.

    python benchmarks/train_alone.py world-v1-small/train adafusion-s --frames 64 --threads 2
    python -m torch.distributed.run --standalone --nproc-per-node 2 \
        benchmarks/train_alone.py world-v1-small/train adafusion-s --frames 64 --threads 1

`benchmarks/train.py` starts it for what one process cannot tell by itself: peak memory above what
the process held with everything built (Linux), and how several processes share a machine.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Int

from adafusion.cli.common import cache_folder, named_config, open_data
from adafusion.config import load_config
from adafusion.preprocess.cache import PreparedSet
from adafusion.training import Step, TrainConfig, train
from adafusion.training.corpus import Corpus
from adafusion.training.ranks import joined

WARM_UP = 1  # batches that are not counted: the first one also compiles and allocates
PLACES = 16  # of a batch at most: as many as a small world has room for; the rest is views
ENDLESS = 1_000_000  # batches: a timed training is left before it ends, judges or saves


def timed_config(model: str, frames: int, seed: int, **sampling: Any) -> TrainConfig:
    """The packaged configuration, untrained, with batches of `frames`; it never comes to an end."""
    config = load_config(TrainConfig, named_config(model))
    places = min(PLACES, frames // 2)
    chosen = {"mode": "batch", "places": places, "views": frames // places} | sampling
    return replace(
        config,
        sampling=replace(config.sampling, **chosen),
        seed=seed,
        balance=False,  # scales trained branches, and there are none
        batches=ENDLESS,
        evaluate_every=ENDLESS,
        checkpoint_every=ENDLESS,
    )


def begin(
    config: TrainConfig,
    data: PreparedSet,
    rows: Int[np.ndarray, " n"],
    out: Path,
    **options: Any,
) -> Iterator[Step]:
    """Begin a training that nobody judges, and give its batches from the first on."""
    steps = train(config, data, rows, lambda model: {"recall@1": 0.0}, out, **options)
    next(steps)  # the network as it was built
    return steps


def start(
    dataset: Path, model: str, frames: int, threads: int, ranks: int = 1, **options: object
) -> subprocess.Popen[str]:
    """Start this script in a process of its own, or in several that share each batch."""
    torchrun = ["-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={ranks}"]
    command = [
        *(sys.executable, *(torchrun if ranks > 1 else []), __file__, str(dataset), model),
        *(f"--frames={frames}", f"--threads={threads}"),
        *(f"--{name}={value}" for name, value in options.items()),
    ]
    environment = os.environ | {"OMP_NUM_THREADS": str(threads)}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def told(process: subprocess.Popen[str]) -> dict[str, float]:
    """Wait for what a process found; RuntimeError where it failed."""
    said, _ = process.communicate()
    if process.returncode:
        raise RuntimeError(f"{process.args} ended with {process.returncode}")
    return json.loads(said.splitlines()[-1])


def memory_mb(field: str) -> float:
    """Resident memory of this process, now (VmRSS) or at its highest (VmHWM)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(f"{field}:"))


def main() -> None:
    """Train and print one line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path)
    parser.add_argument("model", help="a configuration that comes with the package, by name")
    parser.add_argument("--frames", type=int, default=64, help="to a batch (of all processes)")
    parser.add_argument("--batches", type=int, default=5, help="that count")
    parser.add_argument("--threads", type=int, default=1, help="of each process")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cache", type=Path, help="folder of preprocessed frames")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    cache = cache_folder(arguments.cache)
    corpus = Corpus((open_data(arguments.dataset, cache),))
    config = timed_config(arguments.model, arguments.frames, arguments.seed)
    data = corpus.prepare(config.model.preprocess, cache)
    with tempfile.TemporaryDirectory() as scratch, joined("cpu") as ranks:
        rows = corpus.rows("train", config.model.sensors)
        steps = begin(config, data, rows, Path(scratch), accelerator="cpu", ranks=ranks)
        before = memory_mb("VmRSS")
        Path("/proc/self/clear_refs").write_text("5")  # the peak so far was that of the imports
        clock, passes = [time.perf_counter()], []
        for step in islice(steps, WARM_UP + arguments.batches):
            clock.append(time.perf_counter())
            passes.append(step.frames)
        peak = memory_mb("VmHWM") - before
        rate = np.median((np.array(passes) / np.diff(clock))[WARM_UP:])
        if ranks.is_first:
            print(json.dumps({"frames_per_second": float(rate), "peak_mb": peak}))


if __name__ == "__main__":
    main()
