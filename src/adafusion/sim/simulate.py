# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Several runs through one synthetic world, written as a dataset: never called real."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8

from adafusion.datasets.native import (
    Dataset,
    DatasetInfo,
    DatasetWriter,
    open_dataset,
    write_observation,
)
from adafusion.sim.bvh import Bvh
from adafusion.sim.camera import Camera, photograph
from adafusion.sim.conditions import Conditions, preset, vary
from adafusion.sim.lidar import HDL_32E, HDL_64E, VLP_16, Lidar, scan
from adafusion.sim.numeric import keyed_rng, keyed_seed
from adafusion.sim.plan import WorldSpec
from adafusion.sim.route import Drive, drive, plan_route
from adafusion.sim.scene import Scene, build_scene, build_static
from adafusion.sim.vehicles import build_vehicles
from adafusion.sim.world import World, build_world
from adafusion.types import Frame, Observation, Progress, UserError, silent

WORLD_VERSION = "2"  # changes whenever the same seed would give other bytes


@dataclass(frozen=True, kw_only=True)
class Profile:
    """How large a world is and how finely it is seen."""

    columns: int
    rows: int
    spacing_m: float
    corridor_m: float
    camera: Camera
    lidar: Lidar

    def spec(self, seed: int) -> WorldSpec:
        """The world of this size with this seed."""
        return WorldSpec(
            seed=seed,
            columns=self.columns,
            rows=self.rows,
            spacing_m=self.spacing_m,
            corridor_m=self.corridor_m,
        )


PROFILES: dict[str, Profile] = {
    "tiny": Profile(
        columns=2,
        rows=3,
        spacing_m=62.0,
        corridor_m=120.0,
        camera=Camera(size=(75, 100)),
        lidar=VLP_16,
    ),
    "small": Profile(
        columns=3,
        rows=5,
        spacing_m=80.0,
        corridor_m=140.0,
        camera=Camera(size=(150, 200)),
        lidar=HDL_32E,
    ),
    "full": Profile(
        columns=5,
        rows=6,
        spacing_m=84.0,
        corridor_m=140.0,
        camera=Camera(size=(300, 400)),
        lidar=HDL_64E,
    ),
}


def simulate(
    out: str | Path,
    *,
    seed: int,
    runs: Sequence[str],
    profile: str = "tiny",
    places: int | None = None,
    regions: str = "split",
    workers: int = 1,
    progress: Progress = silent,
) -> Dataset:
    """Drive `runs` through the world of `seed` and write what camera and LiDAR saw to `out`.

    A run is named after the preset of its conditions, a repeat with a number: "day", "day-2".
    `profile` is "tiny", "small" or "full"; `places` cuts each run short; `regions` is "split"
    (test, validation and the rest are disjoint in space), "all-train" (no regions: all of it
    teaches) or "all-test" (nobody trains here).
    Frames carry the true pose. The same arguments give the same bytes with any number of
    `workers` (processes); a job that was cut off goes on where it was. UserError for an unknown
    preset, profile or region, and where `out` exists.
    """
    if profile not in PROFILES:
        raise UserError(f"unknown profile {profile!r}; choose from {', '.join(PROFILES)}")
    if regions not in REGIONS:
        raise UserError(f"unknown regions {regions!r}; choose from {', '.join(REGIONS)}")
    if not runs or len(set(runs)) != len(runs):
        raise UserError(f"runs {list(runs)}: name one or more, each once, such as day night day-2")
    if places is not None and places < 1:
        raise UserError(f"places = {places}: a run needs one at least")
    if workers < 1:
        raise UserError(f"workers = {workers}: one process is the least")
    job = Job(seed=seed, runs=tuple(runs), profile=profile, places=places)
    studio = Studio(job)
    drives = {run: studio.drive(run) for run in runs}
    info = _describe(job, studio.world, regions)
    with DatasetWriter(out, info) as writer:
        todo = [
            (run, k)
            for run in runs
            for k, timestamp in enumerate(drives[run].timestamp_us)
            if not writer.has(run, int(timestamp))
        ]
        for _ in progress(
            _render(studio, writer.folder, todo, workers), total=len(todo), desc="rendering"
        ):
            pass
        for run in runs:
            for k in range(len(drives[run].zone)):
                writer.add_written(_frame(run, drives[run], k))
    return open_dataset(out)


def conditions_of(seed: int, run: str) -> Conditions:
    """Conditions of one run: those of the preset it is named after, varied by the run's own key."""
    base = re.fullmatch(r"(.+?)(-\d+)?", run)
    name = base[1] if base else run
    return vary(preset(name), keyed_rng(seed, "run", run, "conditions"))


@dataclass(frozen=True, kw_only=True)
class Job:
    """All that decides the bytes of a frame; small, so that it travels to other processes."""

    seed: int
    runs: tuple[str, ...]
    profile: str
    places: int | None


class Studio:
    """The world of a job, and the scene of the run that was seen last."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self.profile = PROFILES[job.profile]
        self.world: World = build_world(self.profile.spec(job.seed))
        self._static: Bvh | None = None
        self._run: tuple[str, Drive, Scene] | None = None

    def drive(self, run: str) -> Drive:
        """Where the frames of a run are."""
        conditions, run_seed = conditions_of(self.job.seed, run), self._run_seed(run)
        return drive(self.world, conditions, run_seed, places=self.job.places)

    def scene(self, run: str) -> tuple[Drive, Scene]:
        """The world as this run finds it, with the run's own vehicles."""
        if self._static is None:
            self._static = build_static(self.world)
        if self._run is None or self._run[0] != run:
            way, conditions = self.drive(run), conditions_of(self.job.seed, run)
            vehicles = build_vehicles(
                self.world,
                self._run_seed(run),
                conditions.parked_density,
                conditions.traffic_density,
                way.path,
            )
            self._run = run, way, build_scene(self.world, self._static, vehicles)
        return self._run[1:]

    def image(self, run: str, k: int) -> UInt8[np.ndarray, "h w 3"]:
        """What the camera saw at the k-th frame of a run."""
        way, scene = self.scene(run)
        return photograph(
            scene,
            self.world.lamps,
            self.profile.camera,
            conditions_of(self.job.seed, run),
            way.T_world_body[k],
            self._frame_seed(run, k),
            self._run_seed(run),
        )

    def points(self, run: str, k: int) -> Float32[np.ndarray, "n 3"]:
        """What the LiDAR saw at the k-th frame of a run, in the body frame."""
        way, scene = self.scene(run)
        conditions = conditions_of(self.job.seed, run)
        seed = self._frame_seed(run, k)
        return scan(scene, self.profile.lidar, conditions, way.T_world_body[k], seed)

    def observe(self, run: str, k: int) -> tuple[int, Observation]:
        """Timestamp in microseconds and observation of the k-th frame of a run."""
        way, _ = self.scene(run)
        return int(way.timestamp_us[k]), Observation(self.image(run, k), self.points(run, k))

    def _run_seed(self, run: str) -> int:
        return keyed_seed(self.job.seed, "run", run)

    def _frame_seed(self, run: str, k: int) -> int:
        return keyed_seed(self.job.seed, "run", run, "frame", k)


def _render(
    studio: Studio, folder: Path, todo: Sequence[tuple[str, int]], workers: int
) -> Iterable[tuple[str, int]]:
    """Render and write frames, yielding each that is done."""
    if workers == 1 or len(todo) < 2:
        for run, k in todo:
            write_observation(folder, run, *studio.observe(run, k))
            yield run, k
        return
    # the first frame here: it compiles the kernels once, before several processes ask for them
    write_observation(folder, todo[0][0], *studio.observe(*todo[0]))
    yield todo[0]
    context = get_context("spawn")
    with ProcessPoolExecutor(
        workers, mp_context=context, initializer=_start_worker, initargs=(studio.job, folder)
    ) as pool:
        try:
            yield from pool.map(_work, todo[1:], chunksize=8)
        except BrokenProcessPool as error:
            raise RuntimeError(
                f"a rendering process was killed (out of memory?): {folder} keeps whole frames, "
                f"repeat the command, with fewer workers if need be"
            ) from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


_worker: tuple[Studio, Path] | None = None  # of a rendering process


def _start_worker(job: Job, folder: Path) -> None:
    global _worker
    parent = parent_process()
    if parent is not None:  # a killed parent must not leave its workers rendering
        watch = [parent.sentinel]
        threading.Thread(target=lambda: (wait(watch), os._exit(1)), daemon=True).start()
    _worker = Studio(job), folder


def _work(task: tuple[str, int]) -> tuple[str, int]:
    if _worker is None:
        raise RuntimeError("a rendering process began without its world")
    studio, folder = _worker
    write_observation(folder, task[0], *studio.observe(*task))
    return task


def _frame(run: str, way: Drive, k: int) -> Frame:
    T, timestamp = way.T_world_body[k], int(way.timestamp_us[k])
    x, y, z = T[:3, 3].tolist()
    return Frame(
        run=run,
        timestamp_us=timestamp,
        position_m=(x, y, z),
        T_world_body=T,
        image=f"{run}/images/{timestamp}.png",
        cloud=f"{run}/clouds/{timestamp}.npy",
        zone=way.zone[k],
    )


def _describe(job: Job, world: World, regions: str) -> DatasetInfo:
    profile = PROFILES[job.profile]
    places = "all places" if job.places is None else f"{job.places} places a run"
    return DatasetInfo(
        name=f"world-{job.profile}-{job.seed}",
        version=WORLD_VERSION,
        world=f"synthetic world {job.seed} profile {job.profile} version {WORLD_VERSION}",
        source=f"synthetic world, seed {job.seed}, profile {job.profile}, {places}, "
        f"runs {' '.join(job.runs)}",
        licence="CC0-1.0",
        synthetic=True,
        sensors={
            "camera": _plain(asdict(profile.camera)),
            "lidar": _plain(asdict(profile.lidar)),
            "conditions": {run: _plain(asdict(conditions_of(job.seed, run))) for run in job.runs},
        },
        calibration={
            "K": profile.camera.K.tolist(),
            "T_body_camera": profile.camera.T_body_camera.tolist(),
            "T_body_lidar": profile.lidar.T_body_lidar.tolist(),
        },
        regions=REGIONS[regions](world),
    )


def _plain(values: dict[str, object]) -> dict[str, object]:
    """Tuples as lists: YAML knows no tuples."""
    return {key: list(v) if isinstance(v, tuple) else v for key, v in values.items()}


def choose_regions(world: World) -> dict[str, list[list[float]]]:
    """Cut a world in three: about 40 % of the way is test, 15 % validation, the rest training.

    Test is the east, with one corridor; validation the north of the rest.
    """
    way = plan_route(world)[0]
    (xmin, ymin), (xmax, ymax) = way.min(axis=0) - 60.0, way.max(axis=0) + 60.0
    cut_x = float(np.quantile(way[:, 0], 0.60))
    cut_y = float(np.quantile(way[way[:, 0] < cut_x, 1], 0.75))
    test, validation = [cut_x, ymin, xmax, ymax], [xmin, cut_y, cut_x, ymax]
    return {
        "test": [[round(float(v), 3) for v in test]],
        "validation": [[round(float(v), 3) for v in validation]],
    }


def _everything(world: World) -> dict[str, list[list[float]]]:
    nodes = world.nodes
    low, high = nodes.min(axis=0) - 100.0, nodes.max(axis=0) + 100.0
    return {"test": [[round(float(v), 3) for v in (*low, *high)]]}


REGIONS: dict[str, Callable[[World], dict[str, list[list[float]]]]] = {
    "split": choose_regions,
    "all-train": lambda world: {},
    "all-test": _everything,
}
