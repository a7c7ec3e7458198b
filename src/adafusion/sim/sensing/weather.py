# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What weather does to the air and to surfaces; indoors there is none."""

from __future__ import annotations

import math

from adafusion.sim.numeric import inlined, smooth, uniform, value_noise
from adafusion.sim.town.shapes import Material

SNOW_RGB = (0.82, 0.83, 0.86)
SNOW_REFLECTIVITY = 0.8  # at 905 nm
_RAIN_PER_M = 3e-4  # extinction at 1 mm/h
_PLAIN, _ASPHALT, _PAVING = int(Material.PLAIN), int(Material.ASPHALT), int(Material.PAVING)
_STRIPES, _GRASS, _FACADE = int(Material.STRIPES), int(Material.GRASS), int(Material.FACADE)
_ROOF, _BARK, _LEAF = int(Material.ROOF), int(Material.BARK), int(Material.LEAF)
_HEDGE, _GLASS, _LAMP = int(Material.HEDGE), int(Material.GLASS), int(Material.LAMP)
_CAR_LIGHT = int(Material.CAR_LIGHT)


def rain_extinction(rain_mm_h: float) -> float:
    """Share of light that a metre of rain takes; drops are large, so a laser loses as much."""
    return float(_RAIN_PER_M * rain_mm_h**0.63)


@inlined
def snow_on(
    material: int, face: int, u: float, v: float, w: float, up: float, cover: float
) -> float:
    """Share of white at (u, v) of a face out of doors whose visible side looks `up`, a cosine."""
    if up < 0.25 or material in (_LAMP, _CAR_LIGHT):
        return 0.0
    share = cover * smooth(0.25, 0.75, up)
    if material == _LEAF:  # it slides off most leaves
        return share if uniform(face, 8, 5) < 0.4 * cover else 0.0
    # drifts, and holes in them; ground without coordinates of its own repeats every 32 m
    drift = 0.6 * value_noise(u * 0.25, v * 0.25, 15, 7) + 0.4 * value_noise(u, v, 16, 31)
    drift = 0.5 + (drift - 0.5) * (1.0 - smooth(1.0, 6.0, w))
    share *= smooth(0.75 - cover, 1.0 - cover, drift)
    lateral = abs(u)
    if material in (_ASPHALT, _STRIPES) and lateral < 5.0:
        lateral += 0.5 * value_noise(v * 0.07, 0.0, 17) - 0.25  # nobody steers straight
        track = math.exp(-((abs(lateral - 2.0) - 0.75) ** 2) / 0.12)
        share *= 0.85 - (0.45 + 0.4 * value_noise(u * 3.0, v * 0.5, 18)) * track
    elif material in (_GLASS, _HEDGE):
        share *= 0.6
    return share


@inlined
def soaked(material: int, wetness: float) -> float:
    """Share of its brightness that a surface keeps when it is wet: pores fill with water."""
    if material in (_ASPHALT, _PAVING, _STRIPES):
        return 1.0 - 0.5 * wetness
    if material in (_FACADE, _PLAIN, _ROOF, _BARK):
        return 1.0 - 0.3 * wetness
    if material in (_GRASS, _LEAF, _HEDGE):
        return 1.0 - 0.15 * wetness
    return 1.0


@inlined
def water_on(material: int, u: float, v: float, up: float, wetness: float) -> float:
    """Share of the ground that stands under a film of water, smooth enough to mirror."""
    if up < 0.9 or material not in (_ASPHALT, _PAVING, _STRIPES):
        return 0.0
    puddle = smooth(0.45, 0.75, value_noise(u * 0.5, v * 0.2, 21))
    return wetness * (0.2 + 0.7 * wetness * puddle)
