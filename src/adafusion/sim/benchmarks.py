# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Named worlds that never change, so that two numbers measured on one of them can be compared.

A benchmark has two parts, each a world of a seed of its own: `train` (with a validation region,
apart in space) and `test`. A condition is a subset of the runs, a zone a subset of the frames;
neither is a benchmark of its own. Rendered when first asked for, into a folder that is named after
the hashes of its geometry and its runs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from adafusion.datasets.native import Dataset, open_dataset
from adafusion.files import fingerprint, write_text
from adafusion.sim.regions import REGIONS
from adafusion.sim.run.people import STRIDES, person
from adafusion.sim.run.traffic import Movers
from adafusion.sim.run.vehicles import VEHICLES, vehicle
from adafusion.sim.simulate import WORLD_VERSION, describe_world, render
from adafusion.sim.studio import Job, Studio, make_job
from adafusion.sim.town.world import geometry_hash
from adafusion.types import Progress, UserError, silent


@dataclass(frozen=True, kw_only=True)
class Part:
    """One world of a benchmark."""

    seed: int
    profile: str
    regions: str  # see `adafusion.sim.regions`
    geometry: str  # hash of everything that stands still
    settings: str  # hash of the runs: conditions, poses, what moves, sensors, version


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Worlds under one name, and what they are for."""

    words: str
    runs: tuple[str, ...]
    parts: Mapping[str, Part]


BENCHMARKS: dict[str, Benchmark] = {
    "world-v1-tiny": Benchmark(
        words="for tests: rendered in seconds, too small to tell systems apart",
        runs=("day", "dusk-reverse", "night"),
        parts={
            "train": Part(
                seed=1101,
                profile="tiny",
                regions="teach",
                geometry="2d23cea67c236219",
                settings="4ece3046554791bb",
            ),
            "test": Part(
                seed=1201,
                profile="tiny",
                regions="all-test",
                geometry="f3135dd43b083abc",
                settings="dec43e07103215b7",
            ),
        },
    ),
    "world-v1-small": Benchmark(
        words="for two cores: 6 runs through about 200 training, 80 validation and 300 test "
        "places, 150x200 images, 32 beams",
        runs=("day", "overcast-reverse", "autumn", "snow", "rain", "night"),
        parts={
            "train": Part(
                seed=2101,
                profile="small",
                regions="teach",
                geometry="c003523caefe8a41",
                settings="780a74e06df302c5",
            ),
            "test": Part(
                seed=2201,
                profile="small",
                regions="all-test",
                geometry="fd150cc648b57d17",
                settings="3b16eac3135cfbe6",
            ),
        },
    ),
    "world-v1": Benchmark(
        words="paper scale, for a GPU: 10 runs, about 4,800 training and 3,000 test frames, "
        "300x400 images, 64 beams",
        runs=(
            "day",
            "day-2",
            "overcast-reverse",
            "dusk",
            "night",
            "night-reverse-2",
            "autumn-reverse",
            "snow",
            "rain",
            "fog",
        ),
        parts={
            "train": Part(
                seed=3101,
                profile="full",
                regions="teach",
                geometry="6c0d283373d26fd7",
                settings="bcfcbb4149222837",
            ),
            "test": Part(
                seed=3201,
                profile="compact",
                regions="all-test",
                geometry="2909f4653e8d5eab",
                settings="b0fe034a54341eda",
            ),
        },
    ),
}


def names() -> list[str]:
    """Every part of every benchmark, as "world-v1-small/test"."""
    return [f"{name}/{part}" for name, known in BENCHMARKS.items() for part in known.parts]


def open_benchmark(
    name: str, cache_dir: str | Path, *, workers: int = 1, progress: Progress = silent
) -> Dataset:
    """Open a part of a benchmark, "world-v1-small/test", rendering it into the cache if need be.

    UserError for an unknown name, and where what this code builds or what lies in the cache is not
    what the name stands for, or is not as it was rendered (tables, and the sizes of all files).
    """
    part, job = _look_up(name)
    out = benchmark_folder(name, cache_dir)
    seal = out.with_name(f"{out.name}.fingerprint")
    if not out.exists():
        studio = Studio(job)
        found = _hashes(studio, part)
        if found != (part.geometry, part.settings):
            raise UserError(
                f"{name} stands for geometry {part.geometry} and settings {part.settings}, and "
                f"this adafusion builds {found[0]} and {found[1]}: numbers measured on it would "
                "not compare; install a release whose `adafusion world list` shows no mismatch"
            )
        info = describe_world(studio, part.regions, name, part.settings)
        seal.unlink(missing_ok=True)  # of a rendering that was removed
        render(studio, out, info, workers=workers, progress=progress)
    dataset = open_dataset(out)
    geometry, settings = (dataset.info.sensors.get(key) for key in ("geometry", "settings"))
    if (geometry, settings) != (part.geometry, part.settings):
        raise UserError(
            f"{out} holds geometry {geometry} and settings {settings}, and {name} stands for "
            f"{part.geometry} and {part.settings}: remove the folder, to render it again"
        )
    if not seal.exists():
        write_text(seal, dataset.fingerprint + "\n")
    if seal.read_text(encoding="utf-8").strip() != dataset.fingerprint:
        raise UserError(
            f"{out} is no longer as it was rendered (files of other sizes, or other tables): "
            f"remove it and {seal.name}, to render it again"
        )
    return dataset


def benchmark_folder(name: str, cache_dir: str | Path) -> Path:
    """Where a part of a benchmark lies, rendered or not."""
    part, _ = _look_up(name)
    address = fingerprint(part.geometry, part.settings)
    return Path(cache_dir) / "worlds" / f"{name.replace('/', '-')}-{address}"


def settings_hash(studio: Studio, regions: str) -> str:
    """Identity of what a dataset holds beside what stands still; how it is drawn is not in it.

    Conditions, sensors and regions; of each run the poses, times, zones, parked cars and traffic,
    rounded so that the last bit of a machine's arithmetic does not matter. That textures, light
    and noise stay as they were is held by a test on recorded frames.
    """
    values = {
        "version": WORLD_VERSION,
        "job": asdict(studio.job),
        "camera": asdict(studio.camera),
        "lidar": asdict(studio.lidar),
        "regions": REGIONS[regions](studio.world),
    }
    parts: list[bytes | str] = [json.dumps(values, sort_keys=True)]
    shapes = [vehicle(shape, lit=True) for shape in VEHICLES] + [person(k) for k in range(STRIDES)]
    parts += [np.round(shape.corners * 1e3).astype("<i8").tobytes() for shape in shapes]
    for run in studio.conditions:
        way, traffic = studio.drive(run), studio.traffic(run)
        parts.append(" ".join(way.zone))
        parked = studio.parked(run)
        for numbers in (
            way.T_world_body,
            way.T_world_ins,
            way.timestamp_us * 1e-6,
            parked.corners,
            parked.uv,
            parked.objects,
            *(getattr(traffic.vehicles, column.name) for column in fields(Movers)),
            *(getattr(traffic.people, column.name) for column in fields(Movers)),
        ):
            parts.append(np.round(np.asarray(numbers) * 1e3).astype("<i8").tobytes())
    return fingerprint(*parts)


def found_hashes(name: str) -> tuple[str, str]:
    """Geometry and settings that this code gives a part, whatever the benchmark says."""
    part, job = _look_up(name)
    return _hashes(Studio(job), part)


def _hashes(studio: Studio, part: Part) -> tuple[str, str]:
    return geometry_hash(studio.world), settings_hash(studio, part.regions)


def _look_up(name: str) -> tuple[Part, Job]:
    benchmark, _, part = name.partition("/")
    if benchmark not in BENCHMARKS or part not in BENCHMARKS[benchmark].parts:
        raise UserError(f"unknown benchmark {name!r}; choose from {', '.join(names())}")
    known = BENCHMARKS[benchmark]
    chosen = known.parts[part]
    return chosen, make_job(chosen.seed, known.runs, chosen.profile)
