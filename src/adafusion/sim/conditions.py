# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What differs between two runs through the same world: light, weather, season, traffic."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from adafusion.types import UserError

Rgb = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Independent factors of one run; seeds and noise are drawn anew for every run.

    Light is linear RGB in units in which the noon sun gives an irradiance of about 3. Raises
    ValueError where a factor is out of its range.
    """

    sun_azimuth_rad: float = 2.4  # from world x towards y
    sun_elevation_rad: float = 0.75
    sun_rgb: Rgb = (3.0, 2.75, 2.4)  # irradiance at right angles to the sun
    zenith_rgb: Rgb = (0.16, 0.29, 0.56)  # radiance of the sky
    horizon_rgb: Rgb = (0.50, 0.58, 0.66)
    cloud_cover: float = 0.35
    cloud_rgb: Rgb = (0.85, 0.86, 0.88)
    street_lamps: float = 0.0  # power of the street lamps, 0 off to 1 on
    headlights: float = 0.0  # of the vehicle itself
    lit_windows: float = 0.0  # share of windows with the light on
    window_rgb: Rgb = (0.010, 0.0075, 0.0045)  # radiance of a lit window
    fog_per_m: float = 0.0004  # extinction of visible light
    lidar_fog_per_m: float = 0.0  # extinction of the laser: not the same for other drop sizes
    lidar_scatter_per_m: float = 0.0  # rate of returns from the air itself
    foliage: float = 1.0  # share of leaves on the trees
    parked_density: float = 0.35  # share of parking places taken
    traffic_density: float = 0.25  # vehicles in the other lane, per 40 m
    path_offset_m: float = 1.5  # largest lateral offset of a run from the lane's middle
    heading_noise_rad: float = math.radians(2.5)

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self)):
            value = getattr(self, name)
            if not all(map(math.isfinite, value if isinstance(value, tuple) else (value,))):
                raise ValueError(f"{name} = {value!r} is not finite")
        for name in ("cloud_cover", "lit_windows", "foliage", "parked_density", "traffic_density"):
            _check(name, getattr(self, name), 0.0, 1.0)
        for name in ("street_lamps", "headlights"):
            _check(name, getattr(self, name), 0.0, 10.0)
        for name in ("fog_per_m", "lidar_fog_per_m", "lidar_scatter_per_m"):
            _check(name, getattr(self, name), 0.0, 1.0)
        for name in ("sun_rgb", "zenith_rgb", "horizon_rgb", "cloud_rgb", "window_rgb"):
            for channel in getattr(self, name):
                _check(name, channel, 0.0, 100.0)
        _check("sun_elevation_rad", self.sun_elevation_rad, -math.pi / 2, math.pi / 2)
        _check("path_offset_m", self.path_offset_m, 0.0, 3.0)
        _check("heading_noise_rad", self.heading_noise_rad, 0.0, math.radians(20.0))


def _check(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ValueError(f"{name} = {value} is not in [{low:g}, {high:g}]")


_OVERCAST = Conditions(
    sun_rgb=(0.12, 0.12, 0.12),
    zenith_rgb=(0.62, 0.65, 0.69),
    horizon_rgb=(0.52, 0.54, 0.57),
    cloud_cover=1.0,
    cloud_rgb=(0.60, 0.62, 0.65),
    fog_per_m=0.0012,
)

PRESETS: dict[str, Conditions] = {
    "day": Conditions(),
    "overcast": _OVERCAST,
    "dusk": Conditions(
        sun_azimuth_rad=3.6,
        sun_elevation_rad=0.10,
        sun_rgb=(0.30, 0.17, 0.075),
        zenith_rgb=(0.030, 0.045, 0.085),
        horizon_rgb=(0.125, 0.108, 0.092),
        cloud_cover=0.5,
        cloud_rgb=(0.125, 0.108, 0.096),
        street_lamps=1.0,
        headlights=0.4,
        lit_windows=0.3,
        window_rgb=(0.10, 0.075, 0.045),
        fog_per_m=0.001,
    ),
    "night": Conditions(
        sun_rgb=(0.0, 0.0, 0.0),
        zenith_rgb=(0.00006, 0.00007, 0.00010),
        horizon_rgb=(0.00022, 0.00020, 0.00018),
        cloud_cover=0.5,
        cloud_rgb=(0.00022, 0.00019, 0.00016),
        street_lamps=1.0,
        headlights=1.0,
        lit_windows=0.22,
        parked_density=0.5,
        traffic_density=0.08,
        fog_per_m=0.001,
    ),
    "fog": Conditions(
        sun_rgb=(0.05, 0.05, 0.05),
        zenith_rgb=(0.50, 0.52, 0.54),
        horizon_rgb=(0.44, 0.45, 0.47),
        cloud_cover=1.0,
        cloud_rgb=(0.48, 0.49, 0.51),
        street_lamps=0.0,
        headlights=1.0,
        lit_windows=0.15,
        fog_per_m=0.035,
        lidar_fog_per_m=0.02,
        lidar_scatter_per_m=0.003,
    ),
}


def preset(name: str) -> Conditions:
    """Conditions of that name; UserError lists the choices."""
    if name not in PRESETS:
        raise UserError(f"unknown conditions {name!r}; choose from {', '.join(sorted(PRESETS))}")
    return PRESETS[name]


def vary(conditions: Conditions, rng: np.random.Generator) -> Conditions:
    """Another run under like conditions: another hour, other clouds, fuller or emptier streets."""
    c = conditions

    def share(value: float, low: float, high: float) -> float:
        return min(value * float(rng.uniform(low, high)), 1.0)

    return replace(
        c,
        sun_azimuth_rad=c.sun_azimuth_rad + float(rng.uniform(-0.9, 0.9)),
        sun_elevation_rad=c.sun_elevation_rad * float(rng.uniform(0.7, 1.3)),
        cloud_cover=share(c.cloud_cover, 0.6, 1.6),
        lit_windows=share(c.lit_windows, 0.7, 1.3),
        fog_per_m=share(c.fog_per_m, 0.75, 1.25),
        parked_density=share(c.parked_density, 0.6, 1.4),
        traffic_density=share(c.traffic_density, 0.5, 1.5),
    )
