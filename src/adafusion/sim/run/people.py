# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""People on foot: one body of about sixty triangles, built once for each phase of a stride."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from jaxtyping import Float64

from adafusion.sim.town.shapes import Material, Soup, SoupBuilder

STRIDES = 8  # phases of a stride
STRIDE_M = 1.4  # two steps of a person of full size
_SWING_RAD = 0.42
_HIP_M, _SHOULDER_M = 0.88, 1.42
_CLOTHES = (
    (0.03, 0.03, 0.035), (0.05, 0.06, 0.12), (0.20, 0.20, 0.21), (0.45, 0.42, 0.38),
    (0.35, 0.04, 0.04), (0.06, 0.15, 0.30), (0.10, 0.14, 0.06), (0.55, 0.45, 0.08),
    (0.60, 0.60, 0.58), (0.22, 0.13, 0.07),
)  # fmt: skip
_TROUSERS = ((0.03, 0.035, 0.06), (0.02, 0.02, 0.022), (0.16, 0.15, 0.13), (0.08, 0.10, 0.16))
_SKIN = ((0.52, 0.34, 0.25), (0.38, 0.22, 0.14), (0.16, 0.085, 0.05), (0.60, 0.42, 0.33))
_HAIR = ((0.02, 0.016, 0.012), (0.08, 0.045, 0.02), (0.30, 0.20, 0.09), (0.35, 0.34, 0.33))


def clothes_of(rng: np.random.Generator) -> Float64[np.ndarray, "4 3"]:
    """Draw the tints of one person: jacket, trousers, skin, hair."""
    return np.array(
        [choice[int(rng.integers(len(choice)))] for choice in (_CLOTHES, _TROUSERS, _SKIN, _HAIR)]
    )


@cache
def person(stride: int) -> Soup:
    """Triangles of a person of 1.75 m at one of `STRIDES` phases, facing x, feet on z = 0.

    Its objects are jacket, trousers, skin and hair.
    """
    soup = SoupBuilder()
    jacket, trousers, skin, hair = (soup.add_object("person") for _ in range(4))
    swing = _SWING_RAD * math.sin(2 * math.pi * stride / STRIDES)
    for side in (1.0, -1.0):
        leg = _limb(_HIP_M, 0.03, side * swing, (0.095, 0.085), (0.115, 0.05), forward=0.05)
        _add_limb(soup, leg + np.array((0.0, side * 0.095, 0.0)), trousers)
        arm = _limb(_SHOULDER_M - 0.02, 0.78, -0.9 * side * swing, (0.06, 0.055), (0.045, 0.04))
        _add_limb(soup, arm + np.array((0.0, side * 0.235, 0.0)), jacket)
    torso = np.stack([_ring(0.105, 0.165, _HIP_M - 0.06), _ring(0.12, 0.215, _SHOULDER_M)])
    _add_limb(soup, torso, jacket, lid=True)
    angle = 2 * np.pi * (np.arange(6) + 0.5) / 6
    rim = np.column_stack([0.095 * np.cos(angle), 0.075 * np.sin(angle)])
    soup.walls(rim * 0.6, _SHOULDER_M, 1.50, Material.PLAIN, skin)
    soup.walls(rim + np.array((0.02, 0.0)), 1.50, 1.66, Material.PLAIN, skin)
    soup.block(rim * 1.1, 1.62, 1.75, Material.PLAIN, hair)
    return soup.build()


def _ring(half_x: float, half_y: float, z: float) -> Float64[np.ndarray, "4 3"]:
    xy = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (half_x, half_y)
    return np.column_stack([xy, np.full(4, z)])


def _limb(
    top: float,
    bottom: float,
    swing: float,
    upper: tuple[float, float],
    lower: tuple[float, float],
    *,
    forward: float = 0.0,
) -> Float64[np.ndarray, "2 4 3"]:
    """Lower and upper end of a limb that hangs from z = `top` and swings forward about there."""
    ends = np.stack(
        [_ring(*lower, bottom - top) + np.array((forward, 0.0, 0.0)), _ring(*upper, 0.0)]
    )
    c, s = math.cos(swing), math.sin(swing)
    # turned about the y axis: what hangs down moves forward
    turned = np.stack(
        [c * ends[..., 0] - s * ends[..., 2], ends[..., 1], s * ends[..., 0] + c * ends[..., 2]], -1
    )
    return turned + np.array((0.0, 0.0, top))


def _add_limb(
    soup: SoupBuilder, ends: Float64[np.ndarray, "2 4 3"], owner: int, *, lid: bool = False
) -> None:
    low, high = ends
    sides = np.stack([low, np.roll(low, -1, axis=0), np.roll(high, -1, axis=0), high], axis=1)
    soup.quads(sides, Material.PLAIN, owner)
    if lid:
        soup.quads(high[None], Material.PLAIN, owner)
