# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What shines on a scene: sun, sky with clouds, the nearest lamps, headlights."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64

from adafusion.sim.numeric import (
    Vector,
    blend,
    dot,
    inlined,
    keyed_seed,
    smooth,
    step,
    value_noise,
)
from adafusion.sim.run.conditions import Conditions
from adafusion.sim.sensing.scene import Scene, zone_of
from adafusion.sim.sensing.weather import rain_extinction

LAMPS = 16  # the lamps nearest to the camera light the picture
LAMP_RADIANCE = 0.12  # of the part of a lamp that shines
_FAINT = 0.12  # a sun that adds less than this to its sky is a part of it: no shadow to see


class Light(NamedTuple):
    """Light and weather of one picture, linear RGB, in a form that numba takes."""

    sun: Vector  # unit vector towards it
    sun_rgb: Vector  # irradiance at right angles
    zenith: Vector  # radiance of the sky
    horizon: Vector
    cloud: Vector
    cloud_cover: float
    cloud_seed: int
    above: Vector  # irradiance from the whole sky on level ground ...
    below: Vector  # ... and from the ground on what faces down
    fog: float  # extinction, per metre
    foliage: float
    autumn: float
    wetness: float
    snow: float
    lit_windows: float
    window: Vector
    window_seed: int
    street_lamps: float
    headlights: float


def light_of(c: Conditions, run_seed: int) -> Light:
    """Sum up the light of the conditions; seeds they do not give are those of the run."""
    level = math.cos(c.sun_elevation_rad)
    sun = (
        level * math.cos(c.sun_azimuth_rad),
        level * math.sin(c.sun_azimuth_rad),
        math.sin(c.sun_elevation_rad),
    )
    zenith, horizon, cloud = map(np.array, (c.zenith_rgb, c.horizon_rgb, c.cloud_rgb))
    clear = 0.6 * zenith + 0.4 * horizon
    above = np.pi * ((1 - 0.6 * c.cloud_cover) * clear + 0.6 * c.cloud_cover * cloud)
    sun_rgb, sunlight = c.sun_rgb, np.array(c.sun_rgb) * max(sun[2], 0.0)
    if max(c.sun_rgb) <= _FAINT * above.max():
        above, sunlight, sun_rgb = above + sunlight, 0.0 * sunlight, (0.0, 0.0, 0.0)
    # what a street throws back
    below = (0.16 + 0.5 * c.snow_cover) * (above + sunlight) * (1.0, 0.97, 0.9)
    return Light(
        sun=sun,
        sun_rgb=sun_rgb,
        zenith=c.zenith_rgb,
        horizon=c.horizon_rgb,
        cloud=c.cloud_rgb,
        cloud_cover=float(c.cloud_cover),
        cloud_seed=keyed_seed(c.seed_of("cloud_seed", run_seed), "clouds"),
        above=(float(above[0]), float(above[1]), float(above[2])),
        below=(float(below[0]), float(below[1]), float(below[2])),
        fog=float(c.fog_per_m) + rain_extinction(c.rain_mm_h),
        foliage=float(c.foliage),
        autumn=float(c.autumn),
        wetness=float(c.wetness),
        snow=float(c.snow_cover),
        lit_windows=float(c.lit_windows),
        window=c.window_rgb,
        window_seed=keyed_seed(c.seed_of("window_seed", run_seed), "windows"),
        street_lamps=float(c.street_lamps),
        headlights=float(c.headlights),
    )


def nearest_lamps(
    scene: Scene,
    lamps: Float64[np.ndarray, "m 8"],
    conditions: Conditions,
    T_world_camera: Float[np.ndarray, "4 4"],
) -> Float64[np.ndarray, "k 7"]:
    """The lamps that matter: xyz, RGB power, zone; most of them of the camera's own zone."""
    power = np.where(lamps[:, 7:8] > 0, 1.0, conditions.street_lamps)
    lit = np.concatenate([lamps[:, :3], lamps[:, 3:6] * power, lamps[:, 6:7]], axis=1)
    lit = lit[power[:, 0] > 0.0]
    x, y, z = T_world_camera[:3, 3].tolist()
    centre = T_world_camera[:3, 3] + 12.0 * T_world_camera[:3, 2]
    distance = np.linalg.norm(lit[:, :3] - centre, axis=1)
    own = lit[:, 6] == zone_of(scene.zones, (x, y, z))
    order = np.argsort(distance, kind="stable")
    rest = LAMPS // 4
    return np.concatenate([lit[order][own[order]][: LAMPS - rest], lit[order][~own[order]][:rest]])


@inlined
def sky_radiance(light: Light, d: Vector, clouds: bool) -> Vector:
    """Radiance of the sky in a direction; the sun's disc is a glow that no lens resolves."""
    rgb = blend(light.horizon, light.zenith, 1.0 - (1.0 - max(d[2], 0.0)) ** 4)
    facing = max(dot(d, light.sun), 0.0)
    glow = 0.10 * facing**6 + 0.25 * facing**40 + 6.0 * smooth(0.9990, 0.9997, facing)
    cover, seed = light.cloud_cover, light.cloud_seed
    if clouds and cover > 0.0 and d[2] > 0.015:
        scale = 1.1 / (d[2] + 0.10)
        x, y = d[0] * scale, d[1] * scale
        n = 0.52 * value_noise(x, y, seed) + 0.28 * value_noise(2.3 * x, 2.1 * y, seed + 1)
        n += 0.20 * value_noise(5.1 * x, 4.7 * y, seed + 2)
        dense = smooth(0.80 - 0.75 * cover, 1.10 - 0.75 * cover, n) * smooth(0.015, 0.12, d[2])
        rgb = blend(rgb, step((0.0, 0.0, 0.0), light.cloud, 1.12 - 0.35 * n), dense)
        glow *= 1.0 - 0.8 * dense
    return step(rgb, light.sun_rgb, glow)


@inlined
def add_lamps(
    rgb: Vector, lamps: Float64[np.ndarray, "k 7"], zone: int, q: Vector, n: Vector, leaf: bool
) -> Vector:
    """Add the irradiance of the lamps of the point's own zone; they shine down, without shadows."""
    for k in range(len(lamps)):
        if lamps[k, 6] != zone:
            continue
        x, y, z = lamps[k, 0] - q[0], lamps[k, 1] - q[1], lamps[k, 2] - q[2]
        d2 = x * x + y * y + z * z + 0.05
        inverse = 1.0 / math.sqrt(d2)
        lit = (n[0] * x + n[1] * y + n[2] * z) * inverse
        if leaf:
            lit = 0.4 + 0.6 * abs(lit)
        elif zone >= 0:
            lit = 0.2 + 0.8 * max(lit, 0.0)  # walls light each other
        if lit > 0.0:
            power = lit * (0.10 + 0.90 * smooth(0.10, 0.55, z * inverse)) / d2
            rgb = step(rgb, (lamps[k, 3], lamps[k, 4], lamps[k, 5]), power)
    return rgb


@inlined
def add_headlights(
    rgb: Vector, power: float, axis: float, t: float, cosine: float, above: float
) -> Vector:
    """Add the vehicle's own light on a surface t metres away, `above` metres over the lens.

    It comes from about the camera's place, so it needs no shadow ray; `axis` is the cosine of
    the ray to straight ahead.
    """
    lit = 5.0 * power * cosine * smooth(0.80, 0.99, axis) / (t * t + 30.0)
    return step(rgb, (1.0, 0.95, 0.85), lit * (1.0 - 0.85 * smooth(0.4, 2.2, above + 1.0)))


@inlined
def ambient_on(scene: Scene, light: Light, zone: int, n: Vector) -> Vector:
    """Irradiance from all around, before occlusion."""
    if zone >= 0:
        bounce = math.pi * scene.zones[zone, 6]
        return bounce, 0.97 * bounce, 0.88 * bounce
    return blend(light.below, light.above, 0.5 + 0.5 * n[2])
