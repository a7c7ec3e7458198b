# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Named worlds that never change, so that two numbers measured on one of them can be compared.

A benchmark has two parts, each a world of a seed of its own: `train` (with a validation region,
apart in space) and `test`. A condition is a subset of the runs, a zone a subset of the frames;
neither is a benchmark of its own. Rendered when first asked for, into a folder that is named after
everything that decides its bytes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from adafusion.datasets.native import Dataset, open_dataset
from adafusion.files import fingerprint
from adafusion.sim.regions import REGIONS
from adafusion.sim.run.traffic import Movers
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
    settings: str  # hash of everything else: runs and their conditions, sensors, version


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
                geometry="230cc539e779ff00",
                settings="8e015e309b88709f",
            ),
            "test": Part(
                seed=1201,
                profile="tiny",
                regions="all-test",
                geometry="94783b3474b87783",
                settings="5b8a1ca3962fdac9",
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
                geometry="fd7085e19ead86e0",
                settings="98854890087cf4a6",
            ),
            "test": Part(
                seed=2201,
                profile="small",
                regions="all-test",
                geometry="ed0fa7e1485730d6",
                settings="301b64024102665f",
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
                geometry="4f7d1707caa188f5",
                settings="eef8f6445073bff8",
            ),
            "test": Part(
                seed=3201,
                profile="compact",
                regions="all-test",
                geometry="bc8ca2c8ee159583",
                settings="16b3d8582dff4d6d",
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
    what the name stands for.
    """
    part, job = _look_up(name)
    out = benchmark_folder(name, cache_dir)
    if not out.exists():
        studio = Studio(job)
        found = _hashes(studio, part)
        if found != (part.geometry, part.settings):
            raise UserError(
                f"{name} stands for geometry {part.geometry} and settings {part.settings}, and "
                f"this adafusion builds {found[0]} and {found[1]}: numbers measured on it would "
                "not compare; install a release whose `adafusion world list` shows no mismatch"
            )
        info = describe_world(studio, part.regions, name)
        info.sensors["settings"] = part.settings
        render(studio, out, info, workers=workers, progress=progress)
    dataset = open_dataset(out)
    geometry, settings = (dataset.info.sensors.get(key) for key in ("geometry", "settings"))
    if (geometry, settings) != (part.geometry, part.settings):
        raise UserError(
            f"{out} holds geometry {geometry} and settings {settings}, and {name} stands for "
            f"{part.geometry} and {part.settings}: remove the folder, to render it again"
        )
    return dataset


def benchmark_folder(name: str, cache_dir: str | Path) -> Path:
    """Where a part of a benchmark lies, rendered or not."""
    part, _ = _look_up(name)
    address = fingerprint(part.geometry, part.settings)
    return Path(cache_dir) / "worlds" / f"{name.replace('/', '-')}-{address}"


def settings_hash(studio: Studio, regions: str) -> str:
    """Identity of everything but what stands still that decides a dataset's bytes.

    Conditions, sensors and regions; of each run the poses, times, zones, parked cars and traffic,
    rounded so that the last bit of a machine's arithmetic does not matter.
    """
    values = {
        "version": WORLD_VERSION,
        "job": asdict(studio.job),
        "camera": asdict(studio.camera),
        "lidar": asdict(studio.lidar),
        "regions": REGIONS[regions](studio.world),
    }
    parts: list[bytes | str] = [json.dumps(values, sort_keys=True)]
    for run in studio.conditions:
        way, traffic = studio.drive(run), studio.traffic(run)
        parts.append(" ".join(way.zone))
        for numbers in (
            way.T_world_body,
            way.T_world_ins,
            way.timestamp_us * 1e-6,
            studio.parked(run).corners,
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
