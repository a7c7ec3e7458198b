# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A world ready to be filmed: which runs, how large, how finely seen; any frame of any run."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from jaxtyping import Float, Float32, UInt8

from adafusion.datasets.writer import check_run_name
from adafusion.sim.numeric import keyed_rng, keyed_seed
from adafusion.sim.run.conditions import Conditions, SeedName, preset, vary
from adafusion.sim.run.parking import park_vehicles
from adafusion.sim.run.route import Drive, drive
from adafusion.sim.run.traffic import Traffic, plan_traffic, traffic_at
from adafusion.sim.sensing.bvh import Bvh
from adafusion.sim.sensing.camera import Camera, photograph
from adafusion.sim.sensing.lens import Motion
from adafusion.sim.sensing.lidar import HDL_32E, HDL_64E, VLP_16, Lidar, scan
from adafusion.sim.sensing.scene import Scene, build_scene, build_static, with_traffic
from adafusion.sim.town.plan import WorldSpec
from adafusion.sim.town.shapes import Soup
from adafusion.sim.town.world import World, build_world
from adafusion.types import Observation, UserError

FROZEN_FRAMES = 12  # a frozen camera shows one picture for so many frames


@dataclass(frozen=True, kw_only=True)
class Profile:
    """How large a world is and how finely it is seen."""

    world: WorldSpec  # of seed 0
    camera: Camera
    lidar: Lidar


_SMALL_TOWN = WorldSpec(seed=0, columns=3, rows=3, spacing_m=90.0, corridor_m=160.0)
PROFILES: dict[str, Profile] = {
    "tiny": Profile(
        world=WorldSpec(
            seed=0,
            columns=2,
            rows=3,
            spacing_m=62.0,
            corridors=2,
            halls=1,
            tunnels=1,
            blank_walls=1,
            corridor_m=120.0,
        ),
        camera=Camera(size=(75, 100)),
        lidar=VLP_16,
    ),
    "small": Profile(world=_SMALL_TOWN, camera=Camera(size=(150, 200)), lidar=HDL_32E),
    "compact": Profile(  # the small town, finely seen
        world=_SMALL_TOWN, camera=Camera(size=(300, 400)), lidar=HDL_64E
    ),
    "full": Profile(
        world=WorldSpec(seed=0, columns=5, rows=6, spacing_m=84.0, corridor_m=160.0),
        camera=Camera(size=(300, 400)),
        lidar=HDL_64E,
    ),
}


@dataclass(frozen=True, kw_only=True)
class Job:
    """All that decides the bytes of a frame; small, so that it travels to other processes."""

    seed: int
    runs: tuple[tuple[str, Conditions], ...]
    profile: str
    places: int | None

    @property
    def spec(self) -> WorldSpec:
        """The world that is driven through."""
        return replace(PROFILES[self.profile].world, seed=self.seed)


def make_job(
    seed: int,
    runs: Sequence[str] | Mapping[str, Conditions],
    profile: str = "tiny",
    places: int | None = None,
) -> Job:
    """Check what is wished for; UserError names what is wrong and the choices.

    A run that is only named has the conditions that `conditions_of` reads from its name.
    """
    if profile not in PROFILES:
        raise UserError(f"unknown profile {profile!r}; choose from {', '.join(PROFILES)}")
    if not runs or len(set(runs)) != len(runs):
        raise UserError(f"runs {list(runs)}: name one or more, each once, such as day night day-2")
    if places is not None and places < 1:
        raise UserError(f"places = {places}: a run needs one at least")
    for run in runs:
        check_run_name(run)
    known = runs if isinstance(runs, Mapping) else {run: conditions_of(seed, run) for run in runs}
    return Job(seed=seed, runs=tuple(known.items()), profile=profile, places=places)


def conditions_of(seed: int, run: str) -> Conditions:
    """Conditions of a run by its name: preset, then perhaps `-reverse`, then perhaps a number.

    "night-reverse-2" is the second drive by night the other way round. The run's own key varies
    the preset, so that two days are two days.
    """
    base = re.fullmatch(r"(.+?)(-reverse)?(-\d+)?", run)
    name, reverse = (base[1], base[2] is not None) if base else (run, False)
    conditions = vary(preset(name), keyed_rng(seed, "run", run, "conditions"))
    return replace(conditions, reverse=reverse)


class Studio:
    """The world of a job, and any frame of it."""

    def __init__(
        self, job: Job, *, camera: Camera | None = None, lidar: Lidar | None = None
    ) -> None:
        self.job = job
        self.camera = PROFILES[job.profile].camera if camera is None else camera
        self.lidar = PROFILES[job.profile].lidar if lidar is None else lidar
        self.conditions: dict[str, Conditions] = dict(job.runs)
        self._set: tuple[str, Scene, Traffic] | None = None  # of the run that was seen last
        self._last: tuple[str, int, Scene] | None = None  # and of the frame
        self.drive = cache(self._drive)  # where the frames of a run are

    @cached_property
    def world(self) -> World:
        """What stays the same from run to run."""
        return build_world(self.job.spec)

    @cached_property
    def _static(self) -> Bvh:
        return build_static(self.world)

    def parked(self, run: str) -> Soup:
        """The cars that stand at the kerbs during a run."""
        density, path = self.conditions[run].parked_density, self.drive(run).path
        return park_vehicles(self.world, self._seed(run, "parked_seed"), density, path)

    def traffic(self, run: str) -> Traffic:
        """Who is on the move during a run."""
        c = self.conditions[run]
        seed = self._seed(run, "traffic_seed")
        return plan_traffic(self.world, seed, c.traffic_density, c.people_density)

    def scene_at(self, run: str, time_us: int, T_world_body: Float[np.ndarray, "4 4"]) -> Scene:
        """The world as a run finds it: its parked cars, and what moves near a place at a time."""
        if self._set is None or self._set[0] != run:
            scene = build_scene(self.world, self._static, self.parked(run))
            self._set = run, scene, self.traffic(run)
        _, scene, traffic = self._set
        elapsed_s = (time_us - int(self.drive(run).path_time_us[0])) * 1e-6
        return with_traffic(scene, traffic_at(self.world, traffic, elapsed_s, T_world_body))

    def _scene_of(self, run: str, k: int) -> Scene:
        """The scene of a frame; camera and LiDAR ask for the same one after another."""
        if self._last is None or self._last[:2] != (run, k):
            way = self.drive(run)
            scene = self.scene_at(run, int(way.timestamp_us[k]), way.T_world_body[k])
            self._last = run, k, scene
        return self._last[2]

    def observe(self, run: str, k: int) -> tuple[int, Observation]:
        """Timestamp in microseconds and observation of the k-th frame of a run."""
        points = self.points(run, k)
        seen = Observation(self.image(run, k), points if len(points) else None)
        return int(self.drive(run).timestamp_us[k]), seen

    def image(self, run: str, k: int) -> UInt8[np.ndarray, "h w 3"]:
        """What the camera gives at the k-th frame of a run, its faults included."""
        c = self.conditions[run]
        if keyed_rng(self._seed(run, "way_seed"), "fault", k).random() >= c.camera_fault_share:
            c = replace(c, camera_fault="")
        if c.camera_fault == "frozen":
            k, c = k - k % FROZEN_FRAMES, replace(c, camera_fault="")
        way = self.drive(run)
        return photograph(
            self._scene_of(run, k),
            self.world.lamps,
            self.camera,
            c,
            self.lifted(run, way.T_world_body[k]),
            keyed_seed(self.job.seed, "run", run, "camera", k),
            self.run_seed(run),
            Motion(float(way.speed_m_s[k]), float(way.yaw_rate_rad_s[k])),
        )

    def points(self, run: str, k: int) -> Float32[np.ndarray, "n 3"]:
        """What the LiDAR gives at the k-th frame of a run, in the body frame; perhaps nothing."""
        return scan(
            self._scene_of(run, k),
            self.lidar,
            self.conditions[run],
            self.lifted(run, self.drive(run).T_world_body[k]),
            keyed_seed(self.job.seed, "run", run, "lidar", k),
            self.run_seed(run),
        )

    def lifted(self, run: str, T_world_body: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """Where a body with its sensors really is: `lift_m` above what any calibration knows."""
        T = T_world_body.copy()
        T[:3, 3] += self.conditions[run].lift_m * T[:3, 2]
        return T

    def run_seed(self, run: str) -> int:
        """The seed of everything that a run draws and its conditions do not fix."""
        return keyed_seed(self.job.seed, "run", run)

    def _drive(self, run: str) -> Drive:
        return drive(
            self.world, self.conditions[run], self._seed(run, "way_seed"), places=self.job.places
        )

    def _seed(self, run: str, name: SeedName) -> int:
        return self.conditions[run].seed_of(name, self.run_seed(run))
