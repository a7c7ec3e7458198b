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
from dataclasses import asdict, dataclass
from pathlib import Path

from adafusion.datasets.native import Dataset, open_dataset
from adafusion.files import fingerprint
from adafusion.sim.simulate import WORLD_VERSION, describe_world, render
from adafusion.sim.studio import PROFILES, Job, Studio, make_job
from adafusion.sim.town.world import geometry_hash
from adafusion.types import Progress, UserError, silent


@dataclass(frozen=True, kw_only=True)
class Part:
    """One world of a benchmark."""

    seed: int
    regions: str  # see `adafusion.sim.regions`
    geometry: str  # hash of everything that stands still
    settings: str  # hash of everything else: runs and their conditions, sensors, version
    places: int | None = None  # of each run, where not all


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Worlds under one name, and what they are for."""

    words: str
    profile: str
    runs: tuple[str, ...]
    parts: Mapping[str, Part]


BENCHMARKS: dict[str, Benchmark] = {
    "world-v1-tiny": Benchmark(
        words="for tests: rendered in seconds, too small to tell systems apart",
        profile="tiny",
        runs=("day", "dusk-reverse", "night"),
        parts={
            "train": Part(
                seed=1101,
                places=90,
                regions="teach",
                geometry="230cc539e779ff00",
                settings="8df8994c961a87b4",
            ),
            "test": Part(
                seed=1201,
                places=40,
                regions="all-test",
                geometry="94783b3474b87783",
                settings="ada9fa8191cdb3cb",
            ),
        },
    ),
    "world-v1-small": Benchmark(
        words="for two cores: 6 runs through about 190 training, 60 validation and 280 test "
        "places, 150x200 images, 32 beams",
        profile="small",
        runs=("day", "overcast-reverse", "autumn", "snow", "rain", "night"),
        parts={
            "train": Part(
                seed=2101, regions="teach", geometry="3dc8cad2c61cd269", settings="eddde046426b3b23"
            ),
            "test": Part(
                seed=2201,
                regions="all-test",
                geometry="f27ac42211ef2cc1",
                settings="50855d1c6367858e",
            ),
        },
    ),
    "world-v1": Benchmark(
        words="paper scale, for a GPU: 10 runs, about 5,000 training and 2,400 test frames, "
        "300x400 images, 64 beams",
        profile="full",
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
                places=620,
                regions="teach",
                geometry="c3eb142bd0de3767",
                settings="faeb07f32ecae0b2",
            ),
            "test": Part(
                seed=3201,
                places=240,
                regions="all-test",
                geometry="775f8ab0c601d811",
                settings="46d90a0f19f903c4",
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
        found = geometry_hash(studio.world), settings_hash(job, part.regions)
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


def settings_hash(job: Job, regions: str) -> str:
    """Identity of everything but the geometry that decides a dataset's bytes."""
    profile = PROFILES[job.profile]
    values = {
        "version": WORLD_VERSION,
        "job": asdict(job),
        "camera": asdict(profile.camera),
        "lidar": asdict(profile.lidar),
        "regions": regions,
    }
    return fingerprint(json.dumps(values, sort_keys=True))


def found_hashes(name: str) -> tuple[str, str]:
    """Geometry and settings that this code gives a part, whatever the benchmark says."""
    part, job = _look_up(name)
    return geometry_hash(Studio(job).world), settings_hash(job, part.regions)


def _look_up(name: str) -> tuple[Part, Job]:
    benchmark, _, part = name.partition("/")
    if benchmark not in BENCHMARKS or part not in BENCHMARKS[benchmark].parts:
        raise UserError(f"unknown benchmark {name!r}; choose from {', '.join(names())}")
    known = BENCHMARKS[benchmark]
    chosen = known.parts[part]
    return chosen, make_job(chosen.seed, known.runs, known.profile, chosen.places)
