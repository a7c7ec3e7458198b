# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Several runs through one synthetic world, written as a dataset: never called real."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from adafusion.datasets.native import Dataset, DatasetInfo, open_dataset
from adafusion.datasets.sensor_files import write_observation
from adafusion.datasets.writer import DatasetWriter
from adafusion.sim.regions import REGIONS
from adafusion.sim.run.conditions import Conditions
from adafusion.sim.run.route import Drive
from adafusion.sim.studio import Job, Studio, make_job
from adafusion.sim.town.world import geometry_hash
from adafusion.types import Frame, Progress, UserError, silent
from adafusion.workers import map_in_processes

# of this generator: changes whenever the same seed would give other bytes. The "v1" of the named
# worlds counts apart: it stands for hashes, and a later version that still builds them keeps it
WORLD_VERSION = "3"


def simulate(
    out: str | Path,
    *,
    seed: int,
    runs: Sequence[str] | Mapping[str, Conditions],
    profile: str = "tiny",
    places: int | None = None,
    regions: str = "split",
    workers: int = 1,
    progress: Progress = silent,
) -> Dataset:
    """Drive `runs` through the world of `seed` and write what camera and LiDAR saw to `out`.

    A run is named after the preset of its conditions, `-reverse` for the other direction, and a
    number for a repeat: "day", "night-reverse", "day-2"; or a mapping gives each name its
    conditions. `profile` is "tiny", "small" or "full"; `places` cuts each run short; `regions` is
    "split" (test, validation and the rest are disjoint in space), "teach" (no test), "all-train"
    (no regions: all of it teaches) or "all-test" (nobody trains here).
    Frames carry the true pose and, apart from it, that of a GPS/INS unit. The same arguments give
    the same bytes with any number of `workers` (processes); a job that was cut off goes on where
    it was. UserError for an unknown preset, profile or region, and where `out` exists.
    """
    if regions not in REGIONS:
        raise UserError(f"unknown regions {regions!r}; choose from {', '.join(REGIONS)}")
    studio = Studio(make_job(seed, runs, profile, places))
    return render(studio, out, describe_world(studio, regions), workers=workers, progress=progress)


def describe_world(
    studio: Studio, regions: str, name: str | None = None, settings: str | None = None
) -> DatasetInfo:
    """What the dataset of a studio's job says of itself.

    `name` and `settings` are those of a named world: what it is called, and its settings' hash.
    """
    job = studio.job
    places = "all places" if job.places is None else f"{job.places} places a run"
    return DatasetInfo(
        name=f"world-{job.profile}-{job.seed}" if name is None else name,
        version=WORLD_VERSION,
        world=f"synthetic world {job.seed} profile {job.profile} version {WORLD_VERSION}",
        source=f"synthetic world, seed {job.seed}, profile {job.profile}, {places}, "
        f"runs {' '.join(studio.conditions)}",
        licence="CC0-1.0",
        synthetic=True,
        sensors={
            "camera": _plain(asdict(studio.camera)),
            "lidar": _plain(asdict(studio.lidar)),
            "conditions": {run: _plain(asdict(c)) for run, c in job.runs},
            "geometry": geometry_hash(studio.world),
            **({} if settings is None else {"settings": settings}),
        },
        calibration={
            "K": studio.camera.K.tolist(),
            "distortion": list(studio.camera.distortion),  # k1, k2, p1, p2, k3
            "T_body_camera": studio.camera.T_body_camera.tolist(),
            "T_body_lidar": studio.lidar.T_body_lidar.tolist(),
        },
        regions=REGIONS[regions](studio.world),
    )


def render(
    studio: Studio,
    out: str | Path,
    info: DatasetInfo,
    *,
    workers: int = 1,
    progress: Progress = silent,
) -> Dataset:
    """Film every frame of a studio's job into the dataset `out`; resumes what was cut off."""
    if workers < 1:
        raise UserError(f"workers = {workers}: one process is the least")
    drives = {run: studio.drive(run) for run in studio.conditions}
    with DatasetWriter(out, info) as writer:
        todo = [
            (run, k)
            for run, way in drives.items()
            for k, timestamp in enumerate(way.timestamp_us)
            if not writer.has(run, int(timestamp), cloud=not studio.conditions[run].lidar_dead)
        ]
        for _ in progress(
            _render(studio, writer.folder, todo, workers), total=len(todo), desc="rendering"
        ):
            pass
        for run, way in drives.items():
            for k in range(len(way.zone)):
                writer.add_written(_frame(writer.folder, run, way, k))
    return open_dataset(out)


def _render(
    studio: Studio, folder: Path, todo: Sequence[tuple[str, int]], workers: int
) -> Iterable[tuple[str, int]]:
    """Render and write frames, yielding each that is done."""
    if not todo:
        return
    # the first frame here: it compiles the kernels once, before several processes ask for them
    write_observation(folder, todo[0][0], *studio.observe(*todo[0]))
    yield todo[0]
    if workers == 1:
        for run, k in todo[1:]:
            write_observation(folder, run, *studio.observe(run, k))
            yield run, k
    else:
        yield from map_in_processes(
            _work, todo[1:], workers, start=_start_worker, arguments=(studio.job, folder)
        )


_worker: tuple[Studio, Path] | None = None  # of a rendering process


def _start_worker(job: Job, folder: Path) -> None:
    global _worker
    _worker = Studio(job), folder


def _work(task: tuple[str, int]) -> tuple[str, int]:
    if _worker is None:
        raise RuntimeError("a rendering process began without its world")
    studio, folder = _worker
    write_observation(folder, task[0], *studio.observe(*task))
    return task


def _frame(folder: Path, run: str, way: Drive, k: int) -> Frame:
    T, timestamp = way.T_world_body[k], int(way.timestamp_us[k])
    x, y, z = T[:3, 3].tolist()
    cloud = f"{run}/clouds/{timestamp}.npy"
    return Frame(
        run=run,
        timestamp_us=timestamp,
        position_m=(x, y, z),
        T_world_body=T,
        T_world_ins=way.T_world_ins[k],
        image=f"{run}/images/{timestamp}.png",
        cloud=cloud if (folder / cloud).exists() else None,  # a dead LiDAR gave none
        zone=way.zone[k],
    )


def _plain(values: dict[str, object]) -> dict[str, object]:
    """Tuples as lists: YAML knows no tuples."""
    return {key: list(v) if isinstance(v, tuple) else v for key, v in values.items()}
