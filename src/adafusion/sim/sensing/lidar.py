# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A LiDAR: one ray a pulse, with an intensity model, weather, noise and faults."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from adafusion.sim.numeric import Vector, inlined, kernel, keyed_rng, normal, uniform
from adafusion.sim.run.conditions import Conditions
from adafusion.sim.sensing.bvh import new_stack
from adafusion.sim.sensing.scene import (
    Scene,
    outdoor_length,
    shelters,
    texture_uv,
    trace_scene,
    zone_of,
)
from adafusion.sim.sensing.textures import REFLECTIVITY, SHOP_WINDOW, WINDOW, window_at
from adafusion.sim.sensing.weather import (
    SNOW_REFLECTIVITY,
    rain_extinction,
    snow_on,
    soaked,
    water_on,
)
from adafusion.sim.town.shapes import Material

SCATTER_REACH_M = 12.0  # droplets farther than about this are too faint to be detected
_SCATTER_PER_EXTINCTION = 1.3  # returns from rain, 0.003 a metre where it is heavy (25 mm/h)
_FACADE, _GLASS = int(Material.FACADE), int(Material.GLASS)


@dataclass(frozen=True, kw_only=True)
class Lidar:
    """Beam table and noise of one sensor; the defaults are those of a Velodyne HDL-32E.

    A pulse comes back with power rho cos(incidence) exp(-2 beta r) / r^2 and is detected with a
    probability that is logistic in the logarithm of that power. Its range has a standard deviation
    of `sigma_m` at right angles that grows to three times as much at a glancing incidence.
    """

    beams: int = 32
    steps: int = 1024
    lowest_deg: float = -30.67
    highest_deg: float = 10.67
    height_m: float = 1.9
    range_m: float = 80.0
    nearest_m: float = 1.0
    sigma_m: float = 0.02
    drop_out: float = 0.01
    power_half: float = 6e-6  # power at which every second pulse is detected
    glass_loss: float = 0.85  # share of pulses that a window pane swallows or mirrors away

    def __post_init__(self) -> None:
        if self.beams < 1 or self.steps < 1:
            raise ValueError(f"{self.beams} beams x {self.steps} steps see nothing")
        if not -90.0 < self.lowest_deg <= self.highest_deg < 90.0:
            raise ValueError(f"beams from {self.lowest_deg} to {self.highest_deg} degrees")

    @property
    def elevations_rad(self) -> Float64[np.ndarray, " beams"]:
        """Elevation of each beam, lowest first."""
        return np.deg2rad(np.linspace(self.lowest_deg, self.highest_deg, self.beams))

    @property
    def T_body_lidar(self) -> Float64[np.ndarray, "4 4"]:
        """Pose of the sensor on the vehicle."""
        T = np.eye(4)
        T[2, 3] = self.height_m
        return T


HDL_32E = Lidar()
HDL_64E = Lidar(beams=64, lowest_deg=-24.8, highest_deg=2.0, power_half=3.5e-6)
VLP_16 = Lidar(beams=16, steps=512, lowest_deg=-15.0, highest_deg=15.0)


def scan(
    scene: Scene,
    lidar: Lidar,
    conditions: Conditions,
    T_world_body: Float[np.ndarray, "4 4"],
    seed: int,
    run_seed: int,
) -> Float32[np.ndarray, "n 3"]:
    """One turn of the sensor: the points that came back, in the body frame, metres.

    `seed` is the frame's noise, `run_seed` says which beams and which sector of the run's sensor
    are dead, where its conditions have any. None come back where the whole sensor is dead.
    """
    ranges = scan_ranges(
        scene, lidar, conditions, T_world_body @ lidar.T_body_lidar, seed, run_seed
    )
    hit = ranges > 0.0
    points = ray_directions(lidar)[hit] * ranges[hit][:, None]
    points[:, 2] += lidar.height_m
    return points.astype(np.float32)


def ray_directions(lidar: Lidar) -> Float64[np.ndarray, "beams steps 3"]:
    """Unit direction of each ray in the sensor's frame; the first step looks backwards."""
    azimuth = _azimuths_rad(lidar)
    elevation = lidar.elevations_rad[:, None]
    return np.stack(
        np.broadcast_arrays(
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ),
        axis=-1,
    )


def _azimuths_rad(lidar: Lidar) -> Float64[np.ndarray, " steps"]:
    """Clockwise from behind, as the sensor turns."""
    return np.pi - 2 * np.pi * np.arange(lidar.steps) / lidar.steps


def scan_ranges(
    scene: Scene,
    lidar: Lidar,
    conditions: Conditions,
    T_world_lidar: Float[np.ndarray, "4 4"],
    seed: int,
    run_seed: int,
) -> Float64[np.ndarray, "beams steps"]:
    """Range image in metres, 0 where no pulse was detected; seeds as for `scan`."""
    if conditions.lidar_dead:
        return np.zeros((lidar.beams, lidar.steps))
    directions = ray_directions(lidar) @ T_world_lidar[:3, :3].T
    x, y, z = T_world_lidar[:3, 3].tolist()
    ranges = measure(scene, (x, y, z), directions.reshape(-1, 3), lidar, conditions, seed)
    return ranges.reshape(lidar.beams, lidar.steps) * _alive(lidar, conditions, run_seed)


def _alive(lidar: Lidar, conditions: Conditions, run_seed: int) -> Bool[np.ndarray, "beams steps"]:
    """Which pulses the faults of a run leave."""
    alive = np.ones((lidar.beams, lidar.steps), bool)
    if conditions.lidar_dead_beams > 0.0:
        order = keyed_rng(run_seed, "lidar", "dead beams").permutation(lidar.beams)
        alive[order[: round(conditions.lidar_dead_beams * lidar.beams)]] = False
    if conditions.lidar_dead_sector_rad > 0.0:
        middle = keyed_rng(run_seed, "lidar", "dead sector").uniform(0.0, 2 * np.pi)
        apart = np.abs((_azimuths_rad(lidar) - middle + np.pi) % (2 * np.pi) - np.pi)
        alive[:, apart <= conditions.lidar_dead_sector_rad / 2] = False
    return alive


def measure(
    scene: Scene,
    origin: Vector,
    directions_world: Float64[np.ndarray, "n 3"],
    lidar: Lidar,
    conditions: Conditions,
    seed: int,
) -> Float64[np.ndarray, " n"]:
    """Range in metres of n pulses from one point in unit directions, 0 where none was detected.

    Any arrangement of pulses: of `lidar` only range, noise and power count.
    """
    rain = rain_extinction(conditions.rain_mm_h)
    sensor = _Sensor(
        range_m=lidar.range_m,
        nearest_m=lidar.nearest_m,
        sigma_m=lidar.sigma_m,
        drop_out=lidar.drop_out,
        power_half=lidar.power_half,
        glass_loss=lidar.glass_loss,
        fog=conditions.lidar_fog_per_m + rain,
        scatter=conditions.lidar_scatter_per_m + _SCATTER_PER_EXTINCTION * rain,
        foliage=float(conditions.foliage),
        wetness=float(conditions.wetness),
        snow=float(conditions.snow_cover),
    )
    ranges = np.zeros(len(directions_world))
    indoors = shelters(scene.zones, origin, lidar.range_m)
    _measure(scene, indoors, origin, directions_world, sensor, seed, REFLECTIVITY, ranges)
    return ranges


class _Sensor(NamedTuple):
    """What a pulse needs to know of sensor and weather, in a form that numba takes."""

    range_m: float
    nearest_m: float
    sigma_m: float
    drop_out: float
    power_half: float
    glass_loss: float
    fog: float  # extinction, per metre
    scatter: float  # returns from the air, per metre
    foliage: float
    wetness: float
    snow: float


@kernel
def _measure(
    scene: Scene,
    indoors: Float64[np.ndarray, "z 7"],
    o: Vector,
    directions: Float64[np.ndarray, "rays 3"],
    sensor: _Sensor,
    seed: int,
    reflectivity: Float64[np.ndarray, " materials"],
    ranges: Float64[np.ndarray, " rays"],
) -> None:
    """Fill `ranges`, one ray at a time; each random number is a hash of (seed, ray, purpose)."""
    stack = new_stack()
    inside = zone_of(indoors, o) >= 0
    for i in range(len(directions)):
        d = directions[i, 0], directions[i, 1], directions[i, 2]
        t, face, b1, b2 = trace_scene(scene, stack, o, d, sensor.range_m, sensor.foliage)
        open_air = 0.0
        if sensor.fog > 0.0 or sensor.scatter > 0.0:
            open_air = outdoor_length(indoors, o, d, t)
        if sensor.scatter > 0.0:
            # Beer and Lambert: the first droplet met; a far one answers too weakly to be seen
            wet = -math.log(uniform(seed, i, 3)) / sensor.scatter
            s = wet + (t - open_air if inside else 0.0)
            seen = uniform(seed, i, 4) < math.exp(-s / SCATTER_REACH_M)
            if seen and wet < open_air and s > sensor.nearest_m:
                ranges[i] = s
                continue
        if face < 0 or t < sensor.nearest_m or uniform(seed, i, 1) < sensor.drop_out:
            continue
        if _is_pane(scene, face, b1, b2) and uniform(seed, i, 2) < sensor.glass_loss:
            continue
        n = scene.normal
        cosine = d[0] * n[face, 0] + d[1] * n[face, 1] + d[2] * n[face, 2]
        rho = reflectivity[scene.material[face]]
        if sensor.wetness > 0.0 or sensor.snow > 0.0:
            up = -n[face, 2] if cosine > 0.0 else n[face, 2]  # of the side that is hit
            p = o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2] + 2e-3
            if zone_of(indoors, p) < 0:
                rho = _weathered(scene, sensor, face, b1, b2, up, rho)
        cosine = max(abs(cosine), 1e-3)
        power = rho * cosine * math.exp(-2.0 * sensor.fog * open_air) / (t * t)
        # logistic in log power
        if uniform(seed, i, 5) < 1.0 / (1.0 + (sensor.power_half / power) ** 3):
            # a slanted pulse is drawn out in time
            sigma = sensor.sigma_m * min(1.0 / math.sqrt(cosine), 3.0)
            ranges[i] = t + sigma * normal(seed, i, 6)


@inlined
def _weathered(
    scene: Scene, sensor: _Sensor, face: int, b1: float, b2: float, up: float, rho: float
) -> float:
    """Reflectivity of a face out of doors when it is wet or under snow."""
    material = scene.material[face]
    u, v = texture_uv(scene, face, b1, b2)
    white = 0.0
    if sensor.snow > 0.0:
        white = snow_on(material, face, u, v, 0.0, up, sensor.snow)
    if sensor.wetness > 0.0:  # a film throws the pulse forwards, away from the sensor
        rho *= soaked(material, sensor.wetness)
        rho *= 1.0 - 0.9 * water_on(material, u, v, up, sensor.wetness)
    return rho + (SNOW_REFLECTIVITY - rho) * white


@inlined
def _is_pane(scene: Scene, face: int, b1: float, b2: float) -> bool:
    """Whether a face is glass where the ray hits it."""
    material = scene.material[face]
    if material != _FACADE:
        return material == _GLASS
    u, v = texture_uv(scene, face, b1, b2)
    return window_at(scene.objects[scene.object_id[face]], u, v)[0] in (WINDOW, SHOP_WINDOW)
