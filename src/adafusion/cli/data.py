# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Commands that make datasets: simulate a world, prepare recorded data."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from adafusion.cli.common import (
    WORKERS,
    Places,
    Profile,
    Runs,
    Seed,
    Workers,
    bar,
    say,
    split_names,
)
from adafusion.types import UserError

if TYPE_CHECKING:
    from adafusion.sim.run.conditions import Conditions


def simulate(
    out: Annotated[Path, typer.Argument(help="Folder of the new dataset; must not exist.")],
    seed: Seed = 1,
    runs: Runs = "day,night",
    profile: Profile = "small",
    places: Places = None,
    regions: Annotated[
        str,
        typer.Option(
            help="split (training, validation and test apart), teach (no test), all-train or "
            "all-test."
        ),
    ] = "split",
    change: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="Change a factor of all runs, foliage=0.2, or of one, night.rain_mm_h=5."
        ),
    ] = None,
    workers: Workers = WORKERS,
) -> None:
    """Drive through the synthetic world and record camera, LiDAR, true pose and a GPS/INS pose.

    A run is named after a preset (day, overcast, dusk, night, fog, rain, snow, glare, winter,
    autumn), `-reverse` where it drives the other way, and a number where it is a repeat: day,
    night-reverse, day-2. `adafusion config show night` lists the factors of a preset.
    The dataset says `synthetic: true` and is never to be taken for real data. A killed simulation
    goes on where it was when the same command is given again.

    \b
    Example: adafusion simulate data/world-7 --seed 7 --runs day,dusk,night-reverse,fog
    Example: adafusion simulate data/haze --runs day,day-2 --set day-2.fog_per_m=0.02
    """
    from adafusion.datasets.splits import region_of
    from adafusion.sim.regions import GUARD
    from adafusion.sim.simulate import simulate as run

    dataset = run(
        out,
        seed=seed,
        runs=_changed_runs(seed, split_names(runs), change or []),
        profile=profile,
        places=places,
        regions=regions,
        workers=workers,
        progress=bar,
    )
    filled = set(region_of(dataset.positions_m[:, :2], dataset.info.regions))
    for region in sorted(set(dataset.info.regions) - {GUARD} - filled):
        say(
            f"warning: no frame lies in the {region} region: give more --places, or --regions "
            "all-test where nothing is to be trained"
        )
    print(f"{out}: {len(dataset.frames)} frames in {len(dataset.runs)} runs (synthetic)")


def _changed_runs(
    seed: int, runs: Sequence[str], changes: Sequence[str]
) -> Sequence[str] | dict[str, Conditions]:
    """The conditions of runs with some factors changed, of all of them or of one by its name."""
    from adafusion.config import change_config
    from adafusion.sim.studio import conditions_of

    if not changes:
        return runs
    own: dict[str, list[str]] = {run: [] for run in runs}
    for change in changes:
        run, dot, _ = change.partition("=")[0].partition(".")
        if dot and run not in own:
            raise UserError(f"--set {change}: no run {run!r}; choose from {', '.join(runs)}")
        for name in [run] if dot else runs:
            own[name].append(change.removeprefix(f"{run}.") if dot else change)
    return {run: change_config(conditions_of(seed, run), own[run]) for run in runs}


def prepare(
    kind: Annotated[str, typer.Argument(help="Format of SRC: kitti-odometry.")],
    src: Annotated[Path, typer.Argument(help="Folder as the dataset's site gave it.")],
    out: Annotated[Path, typer.Argument(help="Folder of the new dataset; must not exist.")],
    sequences: Annotated[
        str | None, typer.Option(help="Which, by comma; default: all that have files and poses.")
    ] = None,
) -> None:
    """Turn recorded data into the package's own form, checking every file on the way.

    \b
    Example: adafusion prepare kitti-odometry ~/kitti/dataset data/kitti-04 --sequences 04
    """
    from adafusion.datasets import READERS

    if kind not in READERS:
        raise UserError(f"unknown format {kind!r}: choose from {', '.join(READERS)}")
    chosen = None if sequences is None else split_names(sequences)
    dataset = READERS[kind](src, out, sequences=chosen, progress=bar)
    print(f"{out}: {len(dataset.frames)} frames in {len(dataset.runs)} runs")
