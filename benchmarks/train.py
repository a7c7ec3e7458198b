# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""How fast a training learns, and what that depends on.

    python benchmarks/train.py [world-v1-small/train] [--output docs/results/train.md]
    python benchmarks/train.py --quick                    does it run, and roughly how fast?
    python benchmarks/train.py --parts input precision    these questions alone
    python benchmarks/train.py --parts recall --target 0.6

Parts, of which all but the last are the default (half an hour on two cores):
    steps      frames and pairs a second of each model at each batch size
    memory     what each needs at its highest, in a process of its own
    sampling   the paper's pairs against batches in which every pair counts
    input      batches from the cache of preprocessed frames against raw files read each time
    precision  fp32 against bf16-mixed
    processes  one process of T threads, T processes of a thread that share each batch, and T
               trainings of a thread side by side
    recall     frame passes to a validation recall@1 with either sampling and precision: an hour

Ratios are what counts: times drift with the machine. Trainings that are compared take turns, batch
by batch in one process (those of `processes` by whole processes); a ratio is the median over the
rounds, with the 95 % interval of a bootstrap over them. All is timed in the training loop itself,
with untrained weights, on which speed does not depend.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import torch

from adafusion.cli.common import bar, cache_folder, open_data
from adafusion.evaluation import validation_recall
from adafusion.files import write_text
from adafusion.provenance import git_commit, software_versions
from adafusion.training import train
from adafusion.training.corpus import Corpus
from train_alone import WARM_UP, start, timed_config, told
from train_timing import Case, FromFiles, Timing, interleaved, table, with_interval

MODELS = ("image-s", "lidar-s", "concat-s", "adafusion-s")
SAMPLED = 48  # frames a batch where samplings are compared: both can make as many
PROCESS_ROUNDS = 3
PRECISIONS = ("32-true", "bf16-mixed")
RACED = {  # sampling and precision of trainings that race to a recall
    "pairs": ("pairs", "32-true"),
    "batch": ("batch", "32-true"),
    "batch, bf16-mixed": ("batch", "bf16-mixed"),
}
JUDGED = 20  # times, of a training to a recall


@dataclass(frozen=True, kw_only=True, eq=False)
class Bench:
    """What the questions are asked of."""

    arguments: argparse.Namespace
    corpus: Corpus
    cache: Path
    scratch: Path

    def case(self, model: str, frames: int, **sampling: Any) -> Case:
        """A packaged configuration to be timed, with batches of `frames`."""
        config = timed_config(model, frames, self.arguments.seed, **sampling)
        data = self.corpus.prepare(config.model.preprocess, self.cache, bar)
        return Case(config=config, data=data, rows=self.corpus.rows("train", config.model.sensors))

    def timed(self, cases: Mapping[str, Case]) -> dict[str, Timing]:
        """What the batches of trainings in turns took."""
        rounds, accelerator = self.arguments.rounds, self.arguments.accelerator
        with tempfile.TemporaryDirectory(dir=self.scratch) as scratch:
            return interleaved(cases, rounds, Path(scratch), accelerator)

    def alone(self, model: str, frames: int, **options: Any) -> Any:
        """Start a training in a process of its own, on all threads unless told otherwise."""
        a = self.arguments
        options = {"threads": a.threads, "seed": a.seed, "cache": self.cache} | options
        return start(a.dataset, model, frames, **options)


def ask_steps(bench: Bench) -> list[str]:
    """Every model at every batch size."""
    cases = {f"{m}, {n}": bench.case(m, n) for n in bench.arguments.frames for m in MODELS}
    return [
        "Forward, backward and optimiser; the ratio is against adafusion-s at the same batch. "
        "Waiting: while the batch is drawn, read from the cache and augmented, the network idles.",
        "",
        *table(bench.timed(cases), lambda name: f"adafusion-s, {name.split(', ')[1]}"),
    ]


def ask_memory(bench: Bench) -> list[str]:
    """Every model at every batch size, alone."""
    sizes = bench.arguments.frames
    lines = [
        "Peak resident MB of a process that trains, above what it held with everything built.",
        "",
        f"| | {' | '.join(f'{n} frames a batch' for n in sizes)} |",
        "|---" * (1 + len(sizes)) + "|",
    ]
    for model in MODELS:
        peaks = [told(bench.alone(model, n, batches=2))["peak_mb"] for n in sizes]
        lines.append(f"| {model} | {' | '.join(f'{peak:.0f}' for peak in peaks)} |")
    return lines


def ask_sampling(bench: Bench) -> list[str]:
    """Pairs against batches, as many frames in each."""
    cases = {
        "pairs": bench.case("lidar-s", SAMPLED, mode="pairs", items=SAMPLED // 3),
        "batch": bench.case("lidar-s", SAMPLED),
    }
    timings = bench.timed(cases)
    pairs, batch = (timing.pairs / timing.frames for timing in timings.values())
    return [
        "lidar-s. `pairs`: each true pair with one wrong one, three frame passes for two pairs. "
        "`batch`: places in two views each, and every true or wrong pair among them counts: "
        f"{batch.mean():.1f} pairs a frame pass against {pairs.mean():.2f}, "
        f"{batch.mean() / pairs.mean():.0f} times as many.",
        "",
        *table(timings, lambda name: "pairs"),
    ]


def ask_input(bench: Bench) -> list[str]:
    """The cache against raw files."""
    cases = {}
    for model in ("lidar-s", "adafusion-s"):
        case = bench.case(model, bench.arguments.frames[-1])
        raw = FromFiles(case.data.parts, bench.corpus.datasets[0])
        cases |= {f"{model}, cache": case, f"{model}, raw files": replace(case, data=raw)}
    return [
        "Raw files are decoded, resized and voxelised for every batch, by the thread that trains.",
        "",
        *table(bench.timed(cases), lambda name: f"{name.split(', ')[0]}, cache"),
    ]


def ask_precision(bench: Bench) -> list[str]:
    """All digits against half of them."""
    case = bench.case("adafusion-s", bench.arguments.frames[0])
    cases = {
        name: replace(case, config=replace(case.config, precision=name)) for name in PRECISIONS
    }
    return ["adafusion-s.", "", *table(bench.timed(cases), lambda name: "32-true")]


def ask_processes(bench: Bench) -> list[str]:
    """Ways to use all cores."""
    t, frames = bench.arguments.threads, bench.arguments.frames[-1]
    if t < 2:
        return ["Needs --threads 2 or more."]
    ways = {  # trainings at once, processes of each, threads of each process
        f"one process of {t} threads": (1, 1, t),
        f"{t} processes of a thread that share each batch (gloo)": (1, t, 1),
        f"{t} trainings of a thread side by side": (t, 1, 1),
    }
    rates = np.empty((min(PROCESS_ROUNDS, bench.arguments.rounds), len(ways)))
    for row in rates:
        for i, (trainings, ranks, threads) in enumerate(ways.values()):
            options = {"batches": bench.arguments.rounds, "threads": threads, "ranks": ranks}
            begun = [bench.alone("adafusion-s", frames, **options) for _ in range(trainings)]
            row[i] = sum(told(process)["frames_per_second"] for process in begun)
    return [
        f"adafusion-s, {frames} frames in each batch of each training; frames/s of all together, "
        f"median of {len(rates)} rounds of new processes, {bench.arguments.rounds} batches each.",
        "",
        "| | frames/s | frames/s, ratio |\n|---|---|---|",
        *(
            f"| {name} | {np.median(rate):.1f} | {with_interval(rate / rates[:, 0])} |"
            for name, rate in zip(ways, rates.T, strict=True)
        ),
    ]


def ask_recall(bench: Bench) -> list[str]:
    """Frame passes to a fixed validation recall."""
    a = bench.arguments
    batches = max(JUDGED, a.passes // SAMPLED)
    every = -(-batches // JUDGED)
    lines = [
        f"lidar-s, {SAMPLED} frames a batch, all else as its configuration has it; at most "
        f"{batches * SAMPLED:,} passes. One seed: exploratory.",
        "",
        f"| | passes to {a.target:.0%} | recall@1 in percent, every {every * SAMPLED:,} passes |",
        "|---|---|---|",
    ]
    for name, (mode, precision) in RACED.items():
        case = bench.case("lidar-s", SAMPLED, mode=mode, items=SAMPLED // 3)
        config = replace(case.config, batches=batches, evaluate_every=every, precision=precision)
        judge = validation_recall(case.data, bench.corpus.rows("validation", ["lidar"]))
        passes, recalls = 0, []
        for step in train(
            config, case.data, case.rows, judge, bench.scratch / name, accelerator=a.accelerator
        ):
            passes += step.frames
            recalls += [step.validation["recall@1"]] if step.validation else []
            if recalls[-1] >= a.target:
                break
        needed = f"{passes:,}" if recalls[-1] >= a.target else "not reached"
        lines.append(f"| {name} | {needed} | {' '.join(f'{100 * r:.1f}' for r in recalls)} |")
    return lines


PARTS: dict[str, tuple[str, Callable[[Bench], list[str]]]] = {
    "steps": ("Models and batch sizes", ask_steps),
    "memory": ("Memory", ask_memory),
    "sampling": ("Pairs against batches", ask_sampling),
    "input": ("The cache against raw files", ask_input),
    "precision": ("fp32 against bf16-mixed", ask_precision),
    "processes": ("Several processes", ask_processes),
    "recall": ("Frame passes to a recall", ask_recall),
}


def head(bench: Bench) -> list[str]:
    """Where and of what all this was measured."""
    a, dataset = bench.arguments, bench.corpus.datasets[0]
    return [
        f"# How fast a training learns, {datetime.now(UTC):%Y-%m-%d}",
        "",
        f"`python benchmarks/train.py {shlex.join(sys.argv[1:])}`, commit {git_commit()}.",
        "",
        f"{os.cpu_count()} cores, {a.threads} threads, {a.accelerator}, "
        f"{', '.join(f'{name} {version}' for name, version in software_versions().items())}. "
        f"Seed {a.seed}; {a.rounds} rounds after {WARM_UP} to warm up. Data: "
        f"{'SYNTHETIC, ' if dataset.info.synthetic else ''}{dataset.info.source}, fingerprint "
        f"{dataset.fingerprint}.",
    ]


def parse(words: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path, nargs="?", default=Path("world-v1-small/train"),
                        help="that teaches (default: world-v1-small/train)")  # fmt: skip
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS)[:-1])
    parser.add_argument("--frames", type=int, nargs="+", help="to a batch (default: 16 32 64)")
    parser.add_argument("--rounds", type=int, help="batches of each that count (default: 7)")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="(default: all cores)")
    parser.add_argument("--seed", type=int, default=0, help="of weights and batches")
    parser.add_argument("--accelerator", choices=("cpu", "cuda"), default="cpu",
                        help="of all parts but memory and processes")  # fmt: skip
    parser.add_argument("--target", type=float, default=0.6, help="recall@1 of part recall")
    parser.add_argument("--passes", type=int, default=20_000, help="its most frame passes")
    parser.add_argument("--quick", action="store_true", help="batches of 16, two rounds")
    parser.add_argument("--cache", type=Path, help="folder of preprocessed frames")
    parser.add_argument("--output", type=Path, help="Markdown file to write as well")
    arguments = parser.parse_args(words)
    arguments.frames = arguments.frames or ([16] if arguments.quick else [16, 32, 64])
    arguments.rounds = arguments.rounds or (2 if arguments.quick else 7)
    return arguments


def main() -> None:
    """Ask, and print a Markdown page."""
    arguments = parse()
    torch.set_num_threads(arguments.threads)
    cache = cache_folder(arguments.cache)
    corpus = Corpus((open_data(arguments.dataset, cache),))
    with tempfile.TemporaryDirectory() as scratch:
        bench = Bench(arguments=arguments, corpus=corpus, cache=cache, scratch=Path(scratch))
        lines = head(bench)
        print("\n".join(lines))
        for title, ask in (PARTS[part] for part in arguments.parts):
            began, load = time.perf_counter(), os.getloadavg()[0]
            answer = ["", f"## {title}", *ask(bench), ""]
            minutes = (time.perf_counter() - began) / 60
            answer.append(
                f"Load average {load:.1f} before and {os.getloadavg()[0]:.1f} after "
                f"{minutes:.1f} minutes."
            )
            print("\n".join(answer), flush=True)
            lines += answer
    if arguments.output:
        write_text(arguments.output, "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
