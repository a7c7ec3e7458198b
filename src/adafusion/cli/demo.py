# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The demonstration: the whole way on a synthetic world that no shipped model has seen."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from adafusion.cli.common import bar, choose_frames, say

if TYPE_CHECKING:
    from adafusion.cli.evaluation import Judged
    from adafusion.datasets import Dataset
    from adafusion.mapping import PlaceMap

SYSTEMS = ("adafusion-s", "concat-s", "lidar-s", "image-s")


def demo(
    out: Annotated[Path, typer.Argument(help="Folder for everything the demo makes.")] = Path(
        "runs/demo"
    ),
    seed: Annotated[int, typer.Option(help="Which world; models were trained on 101 to 104.")] = 7,
    places: Annotated[int, typer.Option(help="Frames a run.")] = 200,
    workers: Annotated[int, typer.Option(help="Processes that render.", min=1)] = 2,
) -> None:
    """Show the whole thing: drive a synthetic world by day and night, map the day, find the night.

    Prints how often each system finds the place, with intervals, and how far each sensor is trusted
    by day and by night. A second run reuses what the first one rendered.

    \b
    Example: adafusion demo runs/demo
    """
    import numpy as np

    from adafusion.cli.evaluation import alpha_by, judge, make_splits, table, write_results
    from adafusion.datasets import open_dataset
    from adafusion.mapping import Localizer, PlaceMap
    from adafusion.models import load_model
    from adafusion.sim.simulate import simulate

    start = time.perf_counter()
    world = out / f"world-{seed}"
    say("1. Simulate a day and a night drive through a world that no shipped model has seen")
    if world.exists():
        dataset = open_dataset(world)
    else:
        dataset = simulate(
            world, seed=seed, runs=["day", "night"], profile="small", places=places,
            regions="all-test",
            workers=workers, progress=bar,
        )  # fmt: skip

    say("2. Describe every frame with each system, and search the other run under cross-run")
    models = [load_model(name) for name in SYSTEMS]
    splits = make_splits(dataset, "cross-run")
    judged = judge(models, dataset, splits, out / "cache")

    say("3. Map the day, and localise the night on it, one frame at a time as a robot would")
    first = judged[0]
    place_map = _map_of(first, dataset, "day")
    path = out / "day.map"
    if not path.exists():
        place_map.save(path)
    localizer = Localizer(first.model, PlaceMap.open(path))
    night = choose_frames(dataset, "night")
    off_m = []
    for frame in bar(night, desc="locating"):
        seen = dataset.load(frame)
        best = localizer.locate(seen.image, seen.points_body).places[0]
        off_m.append(float(np.hypot(*np.subtract(best.position_m, frame.position_m)[:2])))

    say("4. Write the report")
    files = write_results(judged, dataset, out)

    print(f"\nSYNTHETIC world {seed}, {len(dataset.frames)} frames; no real place")
    print(table(judged))
    for run, alpha in alpha_by(first, dataset, "run").items():
        print(f"{first.name} by {run}: mean trust image {alpha.mean[0]:.3f}, "
              f"lidar {alpha.mean[1]:.3f}")  # fmt: skip
    print(f"night on the map of the day: {np.mean(np.array(off_m) <= 20.0):.1%} of {len(night)} "
          f"frames placed within 20 m, median {np.median(off_m):.1f} m off")  # fmt: skip
    print(f"map {path}, results {files[0]}")
    print(f"report {files[1]}")
    print(f"took {time.perf_counter() - start:.0f} s")


def _map_of(judged: Judged, dataset: Dataset, run: str) -> PlaceMap:
    """The map of one run, from descriptions that are there already."""
    from adafusion.mapping import PlaceMap
    from adafusion.types import Descriptions

    rows = [i for i, frame in enumerate(dataset.frames) if frame.run == run]
    return PlaceMap.from_descriptions(
        [dataset.frames[i] for i in rows],
        Descriptions(*(None if part is None else part[rows] for part in judged.descriptions)),
        model_name=judged.name,
        model_fingerprint=judged.model.fingerprint,
        preprocess_fingerprint=judged.model.preprocess_fingerprint,
        dataset=dataset.info.name,
        synthetic=dataset.info.synthetic,
    )
