# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The demonstration: the whole way on a synthetic world that no shipped model has seen."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from adafusion.cli.common import bar, choose_frames, say

if TYPE_CHECKING:
    from adafusion.datasets import Dataset
    from adafusion.evaluation import Judged
    from adafusion.mapping import PlaceMap

SYSTEMS = ("adafusion-s", "concat-s", "lidar-s", "image-s")


def demo(
    out: Annotated[Path, typer.Argument(help="Folder for everything the demo makes.")] = Path(
        "runs/demo"
    ),
    seed: Annotated[
        int, typer.Option(help="Which world; models were trained on 101 to 104 and 2101 to 2103.")
    ] = 7,
    places: Annotated[int, typer.Option(help="Frames a run.", min=1)] = 200,
    profile: Annotated[str, typer.Option(help="Size of the world: tiny, small or full.")] = "small",
    workers: Annotated[int, typer.Option(help="Processes that render.", min=1)] = 2,
) -> None:
    """Show the whole thing: drive a synthetic world by day and night, map the day, find the night.

    Prints how often each system finds the place, with intervals, and how far each sensor is trusted
    by day and by night. A second run reuses what the first one rendered.

    \b
    Example: adafusion demo runs/demo
    """
    say("1. Simulate a day and a night drive through a world that no shipped model has seen")
    import numpy as np

    from adafusion.cli.evaluation import EvaluateConfig, table, write_results
    from adafusion.datasets import open_dataset
    from adafusion.evaluation import alpha_by, dataset_splits, judge
    from adafusion.mapping import Localizer
    from adafusion.models import load_model
    from adafusion.sim.simulate import simulate

    start = time.perf_counter()
    models = [load_model(name) for name in SYSTEMS]  # what is missing is said before the work
    drive = f"{profile}-{seed}-{places}"  # another world never meets the files of this one
    world = out / f"world-{drive}"
    if world.exists():
        dataset = open_dataset(world)
    else:
        dataset = simulate(
            world, seed=seed, runs=["day", "night"], profile=profile, places=places,
            regions="all-test", workers=workers, progress=bar,
        )  # fmt: skip

    say("2. Describe every frame with each system, and search the other run under cross-run")
    splits = dataset_splits(dataset, "cross-run")
    judged = judge(models, dataset, splits, out / "cache", progress=bar)

    say("3. Map the day, and localise the night on it, one frame at a time as a robot would")
    first = judged[0]
    path = out / f"day-{drive}.map"
    localizer = Localizer(first.model, _saved(_map_of(first, dataset, "day"), path))
    night = choose_frames(dataset, "night")
    off_m = []
    for frame in bar(night, desc="locating"):
        seen = dataset.load(frame)
        best = localizer.locate(seen.image, seen.points_body).places[0]
        off_m.append(float(np.hypot(*np.subtract(best.position_m, frame.position_m)[:2])))

    say("4. Write the report")
    config = EvaluateConfig(
        dataset=str(world), models=SYSTEMS, protocol="cross-run", region="test",
        runs=dataset.runs, radius_m=splits[0].radius_m,
    )  # fmt: skip
    *files, report = write_results(judged, dataset, config, out)

    print(f"\nSYNTHETIC world {seed}, {len(dataset.frames)} frames; no real place")
    print(table(judged, config.seed))
    for run, alpha in alpha_by(first, dataset, "run").items():
        print(f"{first.name} by {run}: mean trust image {alpha.mean[0]:.3f}, "
              f"lidar {alpha.mean[1]:.3f}")  # fmt: skip
    print(f"night on the map of the day: {np.mean(np.array(off_m) <= 20.0):.1%} of {len(night)} "
          f"frames placed within 20 m, median {np.median(off_m):.1f} m off")  # fmt: skip
    print(f"took {time.perf_counter() - start:.0f} s")
    print("\n".join(map(str, [path, *files, report])))


def _saved(place_map: PlaceMap, path: Path) -> PlaceMap:
    """The map as it lies on disk, written anew unless this very one is there."""
    from adafusion.mapping import PlaceMap

    if path.exists() and PlaceMap.open(path).fingerprint != place_map.fingerprint:
        shutil.rmtree(path)
    if not path.exists():
        place_map.save(path)
    return PlaceMap.open(path)


def _map_of(judged: Judged, dataset: Dataset, run: str) -> PlaceMap:
    """The map of one run, from descriptions that are there already."""
    from adafusion.mapping import MapHeader, PlaceMap
    from adafusion.types import Descriptions

    rows = [i for i, frame in enumerate(dataset.frames) if frame.run == run]
    return PlaceMap.from_descriptions(
        [dataset.frames[i] for i in rows],
        Descriptions(*(None if part is None else part[rows] for part in judged.descriptions)),
        header=MapHeader.of(judged.model, dataset),
        dataset=dataset.info.name,
    )
