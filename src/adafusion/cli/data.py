# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Commands that make datasets: simulate a world, prepare recorded data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from adafusion.cli.common import bar, split_names


def simulate(
    out: Annotated[Path, typer.Argument(help="Folder of the new dataset; must not exist.")],
    seed: Annotated[int, typer.Option(help="Which world: another seed, another city.")] = 1,
    runs: Annotated[
        str, typer.Option(help="Conditions to drive in, by comma; a name may come twice.")
    ] = "day,night",
    profile: Annotated[
        str, typer.Option(help="tiny, small or full: image size, beams, frames a run.")
    ] = "small",
    places: Annotated[
        int | None, typer.Option(help="Frames a run; default: what the profile says.")
    ] = None,
    regions: Annotated[
        str,
        typer.Option(help="split (training, validation and test apart), all-train or all-test."),
    ] = "split",
    workers: Annotated[int, typer.Option(help="Processes that render.", min=1)] = 2,
) -> None:
    """Drive through the synthetic world and record camera, LiDAR and true pose.

    The dataset says `synthetic: true` and is never to be taken for real data. A killed simulation
    goes on where it was when the same command is given again.

    \b
    Example: adafusion simulate data/world-7 --seed 7 --runs day,dusk,night,fog --profile small
    """
    from adafusion.sim.simulate import simulate as run

    dataset = run(
        out,
        seed=seed,
        runs=split_names(runs),
        profile=profile,
        places=places,
        regions=regions,
        workers=workers,
        progress=bar,
    )
    print(f"{out}: {len(dataset.frames)} frames in {len(dataset.runs)} runs (synthetic)")


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
    from adafusion.types import UserError

    if kind not in READERS:
        raise UserError(f"unknown format {kind!r}: choose from {', '.join(READERS)}")
    chosen = None if sequences is None else split_names(sequences)
    dataset = READERS[kind](src, out, sequences=chosen, progress=bar)
    print(f"{out}: {len(dataset.frames)} frames in {len(dataset.runs)} runs")
