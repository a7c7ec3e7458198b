# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What differs between two runs through the same world: light, weather, season, traffic, faults."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, get_args

import numpy as np

from adafusion.types import UserError

Rgb = tuple[float, float, float]

CAMERA_FAULTS = ("", "black", "frozen", "occluded", "over-exposed")

# the factors that are one number within a range; every other one says its own rule below
RANGES: dict[str, tuple[float, float]] = {
    "sun_elevation_rad": (-math.pi / 2, math.pi / 2),
    "cloud_cover": (0.0, 1.0),
    "street_lamps": (0.0, 10.0),
    "headlights": (0.0, 10.0),
    "lit_windows": (0.0, 1.0),
    "fog_per_m": (0.0, 1.0),
    "lidar_fog_per_m": (0.0, 1.0),
    "lidar_scatter_per_m": (0.0, 1.0),
    "rain_mm_h": (0.0, 100.0),
    "wetness": (0.0, 1.0),
    "snow_cover": (0.0, 1.0),
    "foliage": (0.0, 1.0),
    "autumn": (0.0, 1.0),
    "parked_density": (0.0, 1.0),
    "traffic_density": (0.0, 1.0),
    "people_density": (0.0, 1.0),
    "path_offset_m": (0.0, 3.0),
    "other_lane": (0.0, 1.0),
    "heading_noise_rad": (0.0, math.radians(20.0)),
    "lift_m": (-0.3, 0.5),
    "camera_fault_share": (0.0, 1.0),
    "lidar_dead_sector_rad": (0.0, 2 * math.pi),
    "lidar_dead_beams": (0.0, 1.0),
}
_COLOURS = ("sun_rgb", "zenith_rgb", "horizon_rgb", "cloud_rgb", "window_rgb")
SeedName = Literal["parked_seed", "traffic_seed", "window_seed", "cloud_seed", "way_seed"]
_SEEDS: tuple[SeedName, ...] = get_args(SeedName)


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Independent factors of one run; noise is drawn anew for every run.

    Light is linear RGB in units in which the noon sun gives an irradiance of about 3. A seed that
    is None is the run's own; a given one shows what that factor alone does. Raises ValueError, by
    name, where a factor is out of its range.
    """

    # light
    sun_azimuth_rad: float = 2.4  # from world x towards y
    sun_elevation_rad: float = 0.75
    sun_rgb: Rgb = (3.0, 2.75, 2.4)  # irradiance at right angles to the sun
    zenith_rgb: Rgb = (0.16, 0.29, 0.56)  # radiance of the sky
    horizon_rgb: Rgb = (0.50, 0.58, 0.66)
    cloud_cover: float = 0.35
    cloud_rgb: Rgb = (0.85, 0.86, 0.88)
    cloud_seed: int | None = None
    street_lamps: float = 0.0  # power of the street lamps, 0 off to 1 on
    headlights: float = 0.0  # of the vehicle itself
    lit_windows: float = 0.0  # share of windows with the light on ...
    window_seed: int | None = None  # ... and which ones
    window_rgb: Rgb = (0.010, 0.0075, 0.0045)  # radiance of a lit window
    # air
    fog_per_m: float = 0.0004  # extinction of visible light
    lidar_fog_per_m: float = 0.0  # extinction of the laser: not the same for other drop sizes
    lidar_scatter_per_m: float = 0.0  # rate of returns from the air itself
    rain_mm_h: float = 0.0  # falling now: veils, returns from drops, drops on the lens
    # ground and season
    wetness: float = 0.0  # of roads and walls: dark, and roads mirror
    snow_cover: float = 0.0  # share of what faces up that is white
    foliage: float = 1.0  # share of leaves on the trees
    autumn: float = 0.0  # how far the leaves have turned
    # what moves or is moved
    parked_density: float = 0.35  # share of parking places taken ...
    parked_seed: int | None = None  # ... and by which cars
    traffic_density: float = 0.25  # vehicles on the road, per 40 m
    people_density: float = 0.35  # people on the pavements, per 10 m
    traffic_seed: int | None = None  # of both
    # the way of the vehicle
    path_offset_m: float = 1.5  # largest lateral offset of a run from the lane's middle
    other_lane: float = 0.0  # share of the way driven in the other lane
    heading_noise_rad: float = math.radians(2.5)
    way_seed: int | None = None  # of offset, heading, speed and keyframes
    reverse: bool = False  # the whole route the other way round
    lift_m: float = 0.0  # of the sensors above where their calibration has them
    # faults
    camera_fault: str = ""  # one of CAMERA_FAULTS
    camera_fault_share: float = 1.0  # share of frames that have it
    lidar_dead_sector_rad: float = 0.0  # part of the turn that gives nothing
    lidar_dead_beams: float = 0.0  # share of beams that give nothing
    lidar_dead: bool = False

    def __post_init__(self) -> None:
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:  # NaN is in no range
                raise ValueError(f"{name} = {value} is not in [{low:g}, {high:g}]")
        if not math.isfinite(self.sun_azimuth_rad):
            raise ValueError(f"sun_azimuth_rad = {self.sun_azimuth_rad} is not finite")
        for name in _COLOURS:
            if not all(0.0 <= channel <= 100.0 for channel in getattr(self, name)):
                raise ValueError(f"{name} = {getattr(self, name)} is not in [0, 100]")
        for name in _SEEDS:
            seed = getattr(self, name)
            if seed is not None and not 0 <= seed < 2**31:
                raise ValueError(f"{name} = {seed} is not in [0, 2**31)")
        if self.camera_fault not in CAMERA_FAULTS:
            raise ValueError(
                f"camera_fault = {self.camera_fault!r} is none of {', '.join(CAMERA_FAULTS[1:])}"
            )

    def seed_of(self, name: SeedName, run_seed: int) -> int:
        """The seed of one factor: as given, else the run's own."""
        given: int | None = getattr(self, name)
        return run_seed if given is None else given


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
    "night": Conditions(  # street lighting of about 10 lux, where noon has 100,000
        sun_rgb=(0.0, 0.0, 0.0),
        zenith_rgb=(1.2e-6, 1.4e-6, 2.0e-6),
        horizon_rgb=(4.4e-6, 4.0e-6, 3.6e-6),
        cloud_cover=0.5,
        cloud_rgb=(4.4e-6, 3.8e-6, 3.2e-6),
        street_lamps=0.025,
        headlights=0.15,
        lit_windows=0.06,
        window_rgb=(0.0025, 0.0019, 0.0011),
        parked_density=0.5,
        traffic_density=0.08,
        people_density=0.06,
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
        lidar_fog_per_m=0.035,
        lidar_scatter_per_m=0.006,
    ),
    "rain": replace(
        _OVERCAST,
        zenith_rgb=(0.34, 0.36, 0.39),
        horizon_rgb=(0.30, 0.31, 0.33),
        cloud_rgb=(0.34, 0.35, 0.37),
        lit_windows=0.15,
        window_rgb=(0.10, 0.075, 0.045),
        headlights=0.5,
        fog_per_m=0.004,
        rain_mm_h=8.0,
        wetness=0.9,
        people_density=0.15,
    ),
    "snow": replace(
        _OVERCAST,
        snow_cover=0.8,
        foliage=0.08,
        autumn=0.6,
        fog_per_m=0.004,
        lidar_fog_per_m=0.002,
        lidar_scatter_per_m=0.002,
        wetness=0.2,
        people_density=0.06,
    ),
    "glare": Conditions(
        sun_elevation_rad=0.16,
        sun_rgb=(2.4, 1.9, 1.3),
        zenith_rgb=(0.15, 0.24, 0.42),
        horizon_rgb=(0.62, 0.56, 0.48),
        cloud_cover=0.15,
        wetness=0.5,
    ),
    "winter": Conditions(
        sun_elevation_rad=0.28,
        sun_rgb=(2.2, 1.95, 1.6),
        zenith_rgb=(0.18, 0.28, 0.48),
        cloud_cover=0.5,
        foliage=0.06,
        autumn=0.7,
        snow_cover=0.12,
        wetness=0.3,
    ),
    "autumn": Conditions(
        sun_elevation_rad=0.45,
        sun_rgb=(2.6, 2.3, 1.9),
        cloud_cover=0.6,
        foliage=0.6,
        autumn=0.9,
        wetness=0.3,
    ),
}


def preset(name: str) -> Conditions:
    """Conditions of that name; UserError lists the choices."""
    if name not in PRESETS:
        raise UserError(f"unknown conditions {name!r}; choose from {', '.join(sorted(PRESETS))}")
    return PRESETS[name]


def with_seeds(conditions: Conditions, seed: int) -> Conditions:
    """The conditions with the seeds of all factors given: runs that share them differ in noise."""
    seeds: dict[str, Any] = dict.fromkeys(_SEEDS, seed)
    return replace(conditions, **seeds)


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
        other_lane=min(c.other_lane + float(rng.uniform(0.0, 0.2)), 1.0),
        parked_density=share(c.parked_density, 0.6, 1.4),
        traffic_density=share(c.traffic_density, 0.5, 1.5),
        people_density=share(c.people_density, 0.5, 1.5),
    )


def between(a: Conditions, b: Conditions, t: float) -> Conditions:
    """Conditions a share t of the way from a to b: colours of light geometrically, else straight.

    Light spans five orders of magnitude from noon to night; in a straight mean everything but the
    last step would be day. What is no number (seeds, faults, direction) is a's.
    """
    if not 0.0 <= t <= 1.0:
        raise ValueError(f"t = {t} is not in [0, 1]")
    floor = 1e-7  # darker than any night; a zero has no logarithm

    def geometric(x: float, y: float) -> float:
        if t in (0.0, 1.0):
            return y if t else x
        return float((x + floor) ** (1.0 - t) * (y + floor) ** t - floor)

    changes: dict[str, Any] = {}
    for name in (f.name for f in fields(Conditions)):
        x, y = getattr(a, name), getattr(b, name)
        if name in _COLOURS:
            changes[name] = tuple(max(geometric(*pair), 0.0) for pair in zip(x, y, strict=True))
        elif name in RANGES or name == "sun_azimuth_rad":
            changes[name] = (1.0 - t) * x + t * y
    return replace(a, **changes)
