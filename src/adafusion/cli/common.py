# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What all commands share: the progress bar, where caches lie, and choosing frames."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer
from tqdm import tqdm

from adafusion.types import Frame, UserError

if TYPE_CHECKING:
    from adafusion.datasets import Dataset
    from adafusion.models import ModelConfig

T = TypeVar("T")

WORKERS = 2  # processes that render, unless asked otherwise

# options of every command that drives through the synthetic world
Seed = Annotated[int, typer.Option(help="Which world: another seed, another town.")]
Runs = Annotated[str, typer.Option(help="Conditions to drive in, by comma.")]
Profile = Annotated[
    str, typer.Option(help="Size of the town and sensors: tiny, small, compact or full.")
]
Places = Annotated[
    int | None, typer.Option(help="Frames of each run; default: the whole route.", min=1)
]
Workers = Annotated[int, typer.Option(help="Processes that render.", min=1)]
Cache = Annotated[
    Path | None,
    typer.Option(
        help="Folder of preprocessed frames and rendered worlds; default: ADAFUSION_CACHE, else "
        "~/.cache/adafusion."
    ),
]


def bar(items: Iterable[T], *, total: int | None = None, desc: str = "") -> Iterable[T]:
    """Show a bar on stderr: redrawn on a terminal, a line every few seconds in a log."""
    interval = 0.1 if sys.stderr.isatty() else 5.0
    shown = tqdm(items, total=total, desc=desc, mininterval=interval, dynamic_ncols=True)
    return iter(shown)  # a plain iterator: tqdm looks like a container, that can be read twice


def say(message: str) -> None:
    """Tell the person at the terminal what happens; stdout is for results."""
    print(message, file=sys.stderr, flush=True)


def cache_folder(given: Path | None) -> Path:
    """Where frames and rendered worlds are kept: the option, ADAFUSION_CACHE, else ~/.cache."""
    if given is not None:
        return given
    named = os.environ.get("ADAFUSION_CACHE")  # empty is as good as not set, not this folder
    return Path(named) if named else Path.home() / ".cache" / "adafusion"


def open_data(path: Path, cache: Path | None = None) -> Dataset:
    """Open a dataset by its folder, or a named synthetic world: "world-v1-small/test".

    A named world is rendered into the cache when it is first asked for. A folder that is there
    wins over a name.
    """
    from adafusion.datasets import open_dataset

    if path.exists():
        return open_dataset(path)
    from adafusion.sim.benchmarks import BENCHMARKS, names, open_benchmark

    name = path.as_posix()
    if name.partition("/")[0] not in BENCHMARKS:
        return open_dataset(path)  # which says what is missing
    if name in BENCHMARKS:
        parts = [known for known in names() if known.startswith(f"{name}/")]
        raise UserError(f"{name} has parts: choose from {', '.join(parts)}")
    return open_benchmark(name, cache_folder(cache), workers=WORKERS, progress=bar)


def packaged_configs() -> dict[str, Path]:
    """Files of the trainings that come with the package, by name."""
    from adafusion.config import configs_folder

    return {path.stem: path for path in sorted(configs_folder().glob("*.yaml"))}


def named_config(name: str) -> Path:
    """File of a training that comes with the package; UserError lists them."""
    files = packaged_configs()
    if name not in files:
        raise UserError(f"no configuration {name!r}: choose from {', '.join(files)}")
    return files[name]


def check_unit(dataset: Dataset, config: ModelConfig, called: str) -> None:
    """UserError where the clouds are in no metres and the model looks at a box of many metres."""
    settings = config.preprocess
    box = {"voxels": settings.voxels.upper_m, "points": settings.points.upper_m}
    looks_at_metres = settings.lidar == "elevation" or max(box[settings.lidar]) > 2.0
    if not dataset.info.in_metres and "lidar" in config.sensors and looks_at_metres:
        unit = dataset.info.sensors["cloud_unit"]
        raise UserError(
            f"{dataset.root}: clouds are {unit}, and {called} looks at metres: train "
            "one on such clouds, as the configuration paper-oxford does"
        )


def choose_frames(dataset: Dataset, runs: str | None = None, frames: str = "::") -> list[Frame]:
    """Frames of the runs named (by comma; None: all), of each run those that a slice keeps.

    `frames` is a slice as Python writes it: "::2" every second, "1::2" the others, ":100".
    """
    names = list(dataset.runs) if runs is None else split_names(runs)
    if unknown := sorted(set(names) - set(dataset.runs)):
        raise UserError(
            f"{dataset.root} has no run {', '.join(unknown)}: choose from {', '.join(dataset.runs)}"
        )
    try:
        start, stop, step = (int(part) if part else None for part in f"{frames}::".split(":")[:3])
        kept = slice(start, stop, step)
        range(0)[kept]  # refuses a step of zero
        if ":" not in frames or frames.count(":") > 2:
            raise ValueError
    except ValueError:
        raise UserError(f"--frames {frames!r}: write START:STOP:STEP, as in ::2 or 1::2") from None
    chosen = [
        frame
        for name in names
        for frame in [frame for frame in dataset.frames if frame.run == name][kept]
    ]
    if not chosen:
        raise UserError(f"--frames {frames!r} keeps no frame of {dataset.root}")
    return chosen


def split_names(text: str) -> list[str]:
    """Names between commas."""
    return [name.strip() for name in text.split(",") if name.strip()]
