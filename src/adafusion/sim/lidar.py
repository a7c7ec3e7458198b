# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A spinning LiDAR: one ray a beam and azimuth step, with an intensity model, fog and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Float64

from adafusion.sim.bvh import new_stack
from adafusion.sim.conditions import Conditions
from adafusion.sim.numeric import kernel, normal, uniform
from adafusion.sim.scene import Scene, outdoor_length, trace_scene
from adafusion.sim.shapes import Material
from adafusion.sim.textures import REFLECTIVITY, window_at

_FACADE, _GLASS = int(Material.FACADE), int(Material.GLASS)


@dataclass(frozen=True, kw_only=True)
class Lidar:
    """Beam table and noise of one sensor; the defaults are those of a Velodyne HDL-32E.

    A pulse comes back with power rho cos(incidence) exp(-2 beta r) / r^2 and is detected with a
    probability that is logistic in the logarithm of that power.
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
) -> Float32[np.ndarray, "n 3"]:
    """One turn of the sensor: the points that came back, in the body frame, metres."""
    T = T_world_body @ lidar.T_body_lidar
    ranges = scan_ranges(scene, lidar, conditions, T, seed)
    directions = ray_directions(lidar)
    hit = ranges > 0.0
    points = directions[hit] * ranges[hit][:, None]
    points[:, 2] += lidar.height_m
    return points.astype(np.float32)


def ray_directions(lidar: Lidar) -> Float64[np.ndarray, "beams steps 3"]:
    """Unit direction of each ray in the sensor's frame; the first step looks backwards."""
    azimuth = np.pi - 2 * np.pi * np.arange(lidar.steps) / lidar.steps
    elevation = lidar.elevations_rad[:, None]
    return np.stack(
        np.broadcast_arrays(
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ),
        axis=-1,
    )


def scan_ranges(
    scene: Scene,
    lidar: Lidar,
    conditions: Conditions,
    T_world_lidar: Float[np.ndarray, "4 4"],
    seed: int,
) -> Float64[np.ndarray, "beams steps"]:
    """Range image in metres, 0 where no pulse was detected."""
    directions = ray_directions(lidar) @ T_world_lidar[:3, :3].T
    settings = np.array(
        [lidar.range_m, lidar.nearest_m, lidar.sigma_m, lidar.drop_out, lidar.power_half,
         lidar.glass_loss, conditions.lidar_fog_per_m, conditions.lidar_scatter_per_m,
         conditions.foliage]
    )  # fmt: skip
    ranges = np.zeros(directions.shape[:2])
    _scan(scene, T_world_lidar[:3, 3].copy(), directions.reshape(-1, 3), settings, seed,
          REFLECTIVITY, ranges.reshape(-1))  # fmt: skip
    return ranges


@kernel
def _scan(scene, origin, directions, settings, seed, reflectivity, ranges):  # type: ignore[no-untyped-def]
    range_m, nearest, sigma, drop_out, power_half = settings[:5]
    glass_loss, fog, scatter, foliage = settings[5:9]
    ox, oy, oz = origin
    stack = new_stack()
    for i in range(len(directions)):
        dx, dy, dz = directions[i]
        t, face, b1, b2 = trace_scene(scene, stack, ox, oy, oz, dx, dy, dz, range_m, foliage)
        open_air = 0.0
        if fog > 0.0 or scatter > 0.0:
            open_air = outdoor_length(scene.zones, ox, oy, oz, dx, dy, dz, t)
        if scatter > 0.0:
            # Beer and Lambert: the first droplet that answers, if it is before the wall
            s = -math.log(uniform(seed, i, 3)) / scatter
            if s < open_air and s > 0.3:
                # far droplets answer too weakly to be seen
                if uniform(seed, i, 4) < math.exp(-s / 12.0) and s > nearest:
                    ranges[i] = s
                    continue
        if face < 0 or t < nearest or uniform(seed, i, 1) < drop_out:
            continue
        cosine = abs(
            dx * scene.normal[face, 0] + dy * scene.normal[face, 1] + dz * scene.normal[face, 2]
        )
        material = scene.material[face]
        rho = reflectivity[material]
        pane = material == _GLASS
        if material == _FACADE:
            u, v = scene.uv[face, 0], scene.uv[face, 1]
            u += b1 * (scene.uv[face, 2] - u) + b2 * (scene.uv[face, 4] - u)
            v += b1 * (scene.uv[face, 3] - v) + b2 * (scene.uv[face, 5] - v)
            kind, _, _ = window_at(scene.objects[scene.object_id[face]], u, v)
            pane = kind == 1 or kind == 2
        if pane and uniform(seed, i, 2) < glass_loss:
            continue
        power = rho * max(cosine, 1e-3) * math.exp(-2.0 * fog * open_air) / (t * t)
        detected = 1.0 / (1.0 + (power_half / power) ** 3)
        if uniform(seed, i, 5) < detected:
            ranges[i] = t + sigma * normal(seed, i, 6)
