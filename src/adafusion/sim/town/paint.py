# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Flat identity: paint, doors and notices on walls that are otherwise the same everywhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from adafusion.sim.town.shapes import Material, SoupBuilder

FLAT_M = 0.004  # doors and notices stand off their wall: far less than the LiDAR's noise
_PAINTS = np.array(
    [(0.62, 0.60, 0.54), (0.62, 0.60, 0.54), (0.20, 0.34, 0.45), (0.55, 0.42, 0.16),
     (0.24, 0.40, 0.24), (0.50, 0.20, 0.16), (0.40, 0.40, 0.42)]
)  # fmt: skip

# puts a sheet on a wall: from a to b along it, from low to high, how far off, what, whose
Put = Callable[[float, float, float, float, float, Material, int], None]


def paint_wall(
    soup: SoupBuilder, rng: np.random.Generator, length: float, low: float, high: float, put: Put
) -> None:
    """Paint a wall of `length` metres in sections, and put doors and notices on it.

    `put` places each sheet; heights are above the floor at the wall's foot.
    """
    for start, end in _sections(rng, length):
        put(start, end, low, high, 0.0, Material.WALL, add_paint(soup, rng))
    at = float(rng.uniform(2.0, 6.0))
    while at < length - 4.0:
        if rng.random() < 0.62:
            tint = (0.34, 0.22, 0.12) if rng.random() < 0.6 else (0.42, 0.45, 0.48)
            door = soup.add_object("door", tint, style=int(rng.integers(3)))
            put(at, at + 0.95, 0.0, 2.1, FLAT_M, Material.DOOR, door)
        else:
            width, colour = float(rng.uniform(0.8, 2.2)), rng.uniform(0.15, 0.75, 3)
            notice = soup.add_object("notice", colour, seed=int(rng.integers(1 << 20)))
            put(at, at + width, 1.1, 1.95, FLAT_M, Material.NOTICE, notice)
        at += float(rng.uniform(3.0, 9.0))


def add_paint(soup: SoupBuilder, rng: np.random.Generator) -> int:
    """Open an object for a section of paint, of one of the common colours and patterns."""
    tint = _PAINTS[rng.integers(len(_PAINTS))] * rng.uniform(0.85, 1.1)
    return soup.add_object("paint", tint, style=int(rng.integers(4)))


def _sections(rng: np.random.Generator, length: float) -> Iterator[tuple[float, float]]:
    """Cut a length into pieces of 7 to 14 metres; the last is one of 5 to 19."""
    start = 0.0
    while start < length - 1e-6:
        end = start + float(rng.uniform(7.0, 14.0))
        end = length if length - end < 5.0 else end
        yield start, end
        start = end
