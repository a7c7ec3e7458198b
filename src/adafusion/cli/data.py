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
    from adafusion.datasets.splits import GUARD, region_of
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
    paths: Annotated[
        list[str],
        typer.Argument(
            metavar="[KIND] SRC OUT",
            help="Format of SRC, guessed where that is clear; the data as their source gave them; "
            "folder of the new dataset, which must not exist.",
        ),
    ],
    runs: Annotated[
        str | None,
        typer.Option(
            help="Which runs (dates, drives, sequences, scenes, bags), by comma; default: all, of "
            "robotcar and nclt those of the paper."
        ),
    ] = None,
    every_m: Annotated[
        float | None,
        typer.Option(help="A frame every so many metres of travel; 0: every one.", min=0),
    ] = None,
    camera: Annotated[
        str | None, typer.Option(help="Which camera: stereo/centre, Cam5, image_02, CAM_FRONT ...")
    ] = None,
    lidar: Annotated[
        str | None, typer.Option(help="Which LiDAR or scans: lms_front, velodyne_hits, Ouster ...")
    ] = None,
    slop_ms: Annotated[
        float | None, typer.Option(help="Image and cloud are at most so far apart.", min=0)
    ] = None,
    poses: Annotated[
        str | None, typer.Option(help="File of poses (folder, bag), or which: rtk, ins (robotcar).")
    ] = None,
    images: Annotated[
        Path | None, typer.Option(help="Folder of the images that join submaps (pointnetvlad).")
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(help="File or folder of intrinsics and extrinsics, where SRC has none."),
    ] = None,
    lidar_height_m: Annotated[
        float | None, typer.Option(help="Of the LiDAR above the ground, where nothing says it.")
    ] = None,
    image_topic: Annotated[str | None, typer.Option(help="bag: topic of the images.")] = None,
    cloud_topic: Annotated[str | None, typer.Option(help="bag: topic of the clouds.")] = None,
    pose_topic: Annotated[str | None, typer.Option(help="bag: topic of the poses.")] = None,
    list_topics: Annotated[
        bool, typer.Option("--list", help="bag: list the topics of SRC and stop.")
    ] = False,
    skip_bad: Annotated[
        bool, typer.Option("--skip-bad", help="Leave damaged frames out and list them.")
    ] = False,
    workers: Annotated[int, typer.Option(help="Processes that decode.", min=1)] = WORKERS,
) -> None:
    """Turn recorded data into the package's own form, checking every file on the way.

    Kinds: robotcar, pointnetvlad, nclt, opr, kitti-odometry, kitti-raw, boreas, mulran, helipr,
    nuscenes, bag (ROS 1, ROS 2, mcap; no ROS needed), folder (images + clouds + poses). Each takes
    those of the options that mean something to it and names them if it is given another. A killed
    job goes on where it was when the same command is given again. Look at the result with
    `adafusion doctor OUT`.

    \b
    Example: adafusion prepare ~/kitti/dataset data/kitti-04 --runs 04
    Example: adafusion prepare nclt ~/nclt data/nclt --every-m 10 --workers 8
    Example: adafusion prepare drive.mcap data/drive --lidar-height-m 1.2
    """
    from adafusion.datasets.recording import SKIPPED_FILE
    from adafusion.readers import prepare as run

    if list_topics:
        from adafusion.readers import READERS
        from adafusion.readers.bag.reader import describe_topics

        print(describe_topics(paths[1] if paths[0] in READERS and len(paths) > 1 else paths[0]))
        return
    if len(paths) not in (2, 3):
        raise UserError("give [KIND] SRC OUT: the data, and the folder of the new dataset")
    *kind, src, out = paths
    chosen = None if runs is None else split_names(runs)
    given = {
        "runs": chosen,
        "every_m": every_m,
        "camera": camera,
        "lidar": lidar,
        "slop_ms": slop_ms,
        "poses": poses,
        "images": images,
        "calibration": calibration,
        "lidar_height_m": lidar_height_m,
        "image_topic": image_topic,
        "cloud_topic": cloud_topic,
        "pose_topic": pose_topic,
    }
    written = run(
        src,
        out,
        kind[0] if kind else None,
        workers=workers,
        skip_bad=skip_bad,
        progress=bar,
        note=say,
        **{name: value for name, value in given.items() if value is not None},
    )
    dataset, skipped = written.dataset, written.skipped
    if skipped:
        say(f"left out, {len(skipped)} damaged, all listed in {Path(out) / SKIPPED_FILE}:")
        for one in skipped[:10]:
            say(f"  {one.reason}")
    if written.resumed < len(dataset.frames):
        say(
            f"{written.frames_per_second:.1f} frames/s; of the work "
            f"{100 * written.decode_share:.0f} % was decoding"
        )
    else:
        say("all frames were there already")
    if missing := sorted(set(chosen or []) - set(dataset.runs)):
        say(f"warning: no frame of {', '.join(missing)} is left, see above")
    runs_there = f"{len(dataset.runs)} run{'s' if len(dataset.runs) > 1 else ''}"
    print(f"{out}: {len(dataset.frames)} frames in {runs_there}")
