# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Commands that make maps and find queries on them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from adafusion.cli.common import bar, check_unit, choose_frames, open_data, say

if TYPE_CHECKING:
    import numpy as np

    from adafusion.datasets import Dataset
    from adafusion.mapping import Answer, Localizer, PlaceMap
    from adafusion.models import PlaceModel
    from adafusion.types import Frame

app = typer.Typer(help="Make, extend and inspect maps of described places.", no_args_is_help=True)

MapPath = Annotated[Path, typer.Argument(help="The map, a folder.")]
DatasetPath = Annotated[Path, typer.Argument(help="A dataset in the package's own form.")]
ModelName = Annotated[str, typer.Option(help="A shipped model's name or a .safetensors file.")]
Runs = Annotated[str | None, typer.Option(help="Only these runs, by comma; default: all.")]
Frames = Annotated[str, typer.Option(help="Slice of each run's frames: ::2 is every second.")]


@app.command("build")
def build(
    dataset: DatasetPath,
    out: MapPath,
    model: ModelName = "adafusion-s",
    runs: Runs = None,
    frames: Frames = "::",
) -> None:
    """Describe the frames of a dataset and write them as a new map.

    \b
    Example: adafusion map build data/world-7 maps/campus.map --runs day
    """
    from adafusion.mapping import require_free
    from adafusion.models import load_model

    require_free(out)  # before the work, not after it
    place_map = _describe(open_data(dataset), load_model(model), runs, frames)
    place_map.save(out)
    print(f"{out}: {len(place_map)} places, fingerprint {place_map.fingerprint}")


@app.command("add")
def add(
    dataset: DatasetPath,
    out: MapPath,
    model: ModelName = "adafusion-s",
    runs: Runs = None,
    frames: Frames = "::",
) -> None:
    """Append frames to a map, all or none; model and world must be the map's own.

    \b
    Example: adafusion map add data/world-7 maps/campus.map --runs dusk
    """
    from adafusion.mapping import MapHeader, PlaceMap
    from adafusion.models import load_model

    opened, loaded = open_data(dataset), load_model(model)
    # what is no map, or not of this model and world, is refused before the work and not after it
    PlaceMap.open(out).header.require(MapHeader.of(loaded, opened), out)
    addition = _describe(opened, loaded, runs, frames)
    PlaceMap.append(out, addition)
    place_map = PlaceMap.open(out)
    print(f"{out}: {len(addition)} places more, {len(place_map)} in all, "
          f"fingerprint {place_map.fingerprint}")  # fmt: skip


@app.command("info")
def info(
    path: MapPath,
    as_json: Annotated[bool, typer.Option("--json", help="For machines.")] = False,
    compact: Annotated[
        bool, typer.Option(help="First join what appends left behind; the content stays.")
    ] = False,
) -> None:
    """Say what a map holds and which model made it.

    \b
    Example: adafusion map info maps/campus.map
    """
    from adafusion import mapping

    if compact:
        mapping.compact(path)
    facts = mapping.info(path)
    if as_json:
        print(json.dumps(facts.to_dict()))
        return
    runs = ", ".join(f"{run} ({count})" for run, count in facts.runs.items())
    box = " x ".join(
        f"{low:.0f}..{high:.0f}" for low, high in zip(facts.lower_m, facts.upper_m, strict=True)
    )
    dims = ", ".join(f"{name} {length}" for name, length in facts.dims.items())
    synthetic = "  SYNTHETIC: not a real place" if facts.header.synthetic else ""
    print(f"places       {facts.places}{synthetic}")
    print(f"runs         {runs}")
    print(f"datasets     {', '.join(facts.datasets)}; world {facts.header.world}")
    print(f"box (m)      {box}")
    print(f"model        {facts.header.model}, fingerprint {facts.header.model_fingerprint}")
    print(f"preprocess   fingerprint {facts.header.preprocess_fingerprint}")
    print(f"descriptions {dims}; ranked by L{facts.header.p}")
    print(f"content      fingerprint {facts.fingerprint}")
    print(f"on disk      {facts.bytes_on_disk / 1e3:,.0f} kB, {facts.versions} versions")


def locate(
    path: MapPath,
    image: Annotated[Path | None, typer.Option(help="Query image: PNG or JPEG.")] = None,
    cloud: Annotated[
        Path | None,
        typer.Option(help="Query cloud: .npy (N, 3) in the body frame, or .bin, .pcd, .ply, .las."),
    ] = None,
    lidar_height_m: Annotated[
        float | None,
        typer.Option(
            help="Height of the sensor above the ground, which all but a .npy must be told."
        ),
    ] = None,
    dataset: Annotated[
        Path | None, typer.Option(help="Instead of one query, all frames of a dataset.")
    ] = None,
    runs: Runs = None,
    frames: Frames = "::",
    model: ModelName = "adafusion-s",
    k: Annotated[int, typer.Option(help="Candidates a query.", min=1)] = 5,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON line a query.")] = False,
) -> None:
    """Say where on the map a query was taken, and how far each sensor is trusted.

    Give an image, a cloud, or both; what is missing is left out of the comparison. With --dataset
    every frame is a query, and its distance to the truth is printed where the frame's pose and the
    map share a world. A query never changes the map.

    \b
    Example: adafusion locate maps/campus.map --image now.png --cloud now.npy
    Example: adafusion locate maps/campus.map --dataset data/world-7 --runs night
    """
    from adafusion.mapping import Localizer, PlaceMap
    from adafusion.models import load_model
    from adafusion.types import UserError

    if (dataset is None) == (image is None and cloud is None):
        raise UserError("give --image, --cloud or both, or else --dataset")
    localizer = Localizer(load_model(model), PlaceMap.open(path), k=k)
    if dataset is not None:
        _locate_frames(localizer, dataset, runs, frames, as_json)
        return
    answer = localizer.locate(*_read_query(image, cloud, lidar_height_m))
    if as_json:
        print(json.dumps(answer.to_dict()))
        return
    print(_used(answer))
    for rank, place in enumerate(answer.places, start=1):
        x, y, z = place.position_m
        print(
            f"{rank}. {place.key}  distance {place.distance:.3f}  at ({x:.1f}, {y:.1f}, {z:.1f}) m"
        )


def _locate_frames(
    localizer: Localizer, path: Path, runs: str | None, frames: str, as_json: bool
) -> None:
    """Locate every chosen frame of a dataset; one line each, then what share was found."""
    import numpy as np

    dataset = open_data(path)
    check_unit(dataset, localizer.model.config, f"model {localizer.model.name!r}")
    chosen = choose_frames(dataset, runs, frames)
    world = localizer.place_map.header.world
    same_world = world == dataset.world
    if not same_world:
        say(
            f"the map lies in the world {world!r}, {path} in {dataset.world!r}: "
            "no distance to the truth"
        )
    offs: list[float] = []
    for frame in bar(chosen, desc="locating"):
        seen = dataset.load(frame)
        answer = localizer.locate(seen.image, seen.points_body)
        best = answer.places[0]
        off = float(np.hypot(*np.subtract(best.position_m, frame.position_m)[:2]))
        offs.append(off)
        if as_json:
            line: dict[str, Any] = {"query": frame.key, **answer.to_dict()}
            if same_world:
                line["off_m"] = off
            print(json.dumps(line))
        else:
            truth = f"  {off:7.1f} m off" if same_world else ""
            print(
                f"{frame.key} -> {best.key}  distance {best.distance:.3f}{truth}  {_used(answer)}"
            )
    if same_world and not as_json:
        nearest = _nearest_m(localizer.place_map, chosen)
        reachable = nearest <= 20.0
        found = int(np.sum(np.array(offs)[reachable] <= 20.0))
        print(
            f"{found} of {int(reachable.sum())} queries within 20 m of the truth, median "
            f"{np.median(offs):.1f} m off; {len(chosen) - int(reachable.sum())} have no place of "
            f"the map within 20 m; a map without error would be {np.median(nearest):.1f} m off"
        )


def _nearest_m(place_map: PlaceMap, frames: list[Frame]) -> np.ndarray:
    """Distance of each frame to the nearest place of the map: nobody can be nearer than that."""
    import numpy as np
    from scipy.spatial import cKDTree

    xy = np.array([frame.position_m[:2] for frame in frames])
    return np.asarray(cKDTree(place_map.positions_m[:, :2]).query(xy)[0])


def _used(answer: Answer) -> str:
    """On what an answer rests, in words."""
    if answer.alpha is None:
        return f"by {' and '.join(answer.used)}"
    return f"trust: image {answer.alpha[0]:.2f}, lidar {answer.alpha[1]:.2f}"


def _describe(dataset: Dataset, model: PlaceModel, runs: str | None, frames: str) -> PlaceMap:
    """Make an in-memory map of the chosen frames that have the sensors the model needs."""
    from adafusion.mapping import MapHeader, PlaceMap
    from adafusion.models import describe, frame_batches
    from adafusion.types import UserError, lacking

    check_unit(dataset, model.config, f"model {model.name!r}")
    chosen = choose_frames(dataset, runs, frames)
    usable = [frame for frame in chosen if not lacking(frame, model.sensors)]
    if not usable:
        raise UserError(
            f"{dataset.root}: no chosen frame has the sensors that model {model.name!r} needs; "
            "take a model of the sensor they have (image or lidar)"
        )
    if len(usable) < len(chosen):
        say(f"left out {len(chosen) - len(usable)} frames that lack a sensor")
    batch = 4
    batches = frame_batches(model, usable, dataset.load, batch)
    shown = bar(batches, total=-(-len(usable) // batch), desc=f"describing, {batch} frames each")
    return PlaceMap.from_descriptions(
        usable,
        describe(model, shown),
        header=MapHeader.of(model, dataset),
        dataset=dataset.info.name,
    )


def _read_query(
    image: Path | None, cloud: Path | None, lidar_height_m: float | None
) -> tuple[np.ndarray | None, np.ndarray | None]:
    import numpy as np

    from adafusion.datasets import read_cloud, read_image
    from adafusion.readers.clouds import read_points
    from adafusion.types import UserError

    in_sensor_frame = cloud is not None and cloud.suffix.lower() != ".npy"
    if in_sensor_frame and lidar_height_m is None:
        raise UserError(
            f"{cloud} is in the frame of the sensor: give --lidar-height-m, its height above the "
            "ground (KITTI: 1.73)"
        )
    if lidar_height_m is not None and not in_sensor_frame:
        raise UserError(
            "--lidar-height-m is for clouds in the frame of the sensor: a .npy is in the body "
            "frame, where z = 0 is the ground; leave the option out"
        )
    points = None
    if cloud is not None and in_sensor_frame:
        points = read_points(cloud) + np.array([0, 0, lidar_height_m], dtype=np.float32)
    elif cloud is not None:
        points = read_cloud(cloud)
    return None if image is None else read_image(image), points
