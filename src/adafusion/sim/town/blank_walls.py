# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Streets between two blank walls: the same shape all the way, told apart by flat paint alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from adafusion.sim.town.paint import paint_wall
from adafusion.sim.town.plan import (
    KERB_M,
    ROAD_HALF_M,
    WALK_HALF_M,
    Hills,
    Plan,
    Rect,
    Street,
    Zone,
    along,
    forward,
    leftward,
    overlaps,
)
from adafusion.sim.town.shapes import Material, SoupBuilder
from adafusion.types import UserError

HEIGHT_M = 3.6  # above the pavement
THICK_M = 0.3
FACE_M = WALK_HALF_M - 0.05  # from the middle of the street: on the edge of the pavement
BEHIND_M = 21.0  # from the middle of the street: no building shows over a wall
LEAST_M = 20.0
_CONCRETE = (0.42, 0.41, 0.39)


def build_blank_walls(plan: Plan) -> None:
    """Line the straight streets that have most room on both sides with walls instead of houses.

    Those beside parks come last: trees show over a wall. ValueError where fewer streets have room
    than the spec asks for.
    """
    parks = [_rect_of(zone) for zone in plan.zones if zone.kind == "park"]
    choices = []
    for e, street in enumerate(plan.streets):
        if street.kind == "street" and _is_straight(street):
            apart = WALK_HALF_M - ROAD_HALF_M + 0.6
            sides = [plan.clear_run(e, [side * FACE_M], apart, paths=True) for side in (-1, 1)]
            room = [end - start for start, end in sides]
            (x, y), half = street.line[[0, -1]].mean(axis=0).tolist(), along(street.line)[-1] / 2
            ground = (x, y, _heading(street.line), float(half) - WALK_HALF_M, BEHIND_M)
            if min(room) >= LEAST_M:
                choices.append((overlaps(ground, parks), -sum(room), e, sides, ground))
    for _, _, e, sides, ground in sorted(choices)[: plan.spec.blank_walls]:
        plan.taken.append(ground)
        plan.walled.add(e)
        _build_walls(plan, e, sides)
    if len(plan.walled) < plan.spec.blank_walls:
        raise UserError(
            f"world {plan.spec.seed}: only {len(plan.walled)} streets have room for the "
            f"{plan.spec.blank_walls} blank walls; take another seed"
        )


def _rect_of(zone: Zone) -> Rect:
    (x0, y0, _), (x1, y1, _) = zone.lower, zone.upper
    return (x0 + x1) / 2, (y0 + y1) / 2, 0.0, (x1 - x0) / 2, (y1 - y0) / 2


def _heading(line: Float64[np.ndarray, "n 2"]) -> float:
    d = line[-1] - line[0]
    return math.atan2(d[1], d[0])


def _is_straight(street: Street) -> bool:
    """Neither curved nor oblique: a box fits around it."""
    yaw = _heading(street.line)
    bulge = np.abs((street.line - street.line[0]) @ leftward(yaw)).max()
    return bool(bulge < 0.1 and abs(math.remainder(yaw, math.pi / 2)) < math.radians(20.0))


def _build_walls(plan: Plan, e: int, sides: Sequence[tuple[float, float]]) -> None:
    """A wall on either side of a street, from where to where each, and the zone between."""
    line = plan.streets[e].line
    yaw = _heading(line)
    concrete = plan.soup.add_object("wall", _CONCRETE)
    faces = []
    for side, (start, end) in zip((-1, 1), sides, strict=True):
        length = end - start
        foot = line[0] + start * forward(yaw) + side * FACE_M * leftward(yaw)
        wall = _Wall(plan.soup, plan.hills, foot, yaw, side * leftward(yaw))
        rng = plan.rng("blank wall", e, side, "paint")
        paint_wall(plan.soup, rng, length, -0.5, HEIGHT_M, wall.put)
        wall.put(0.0, length, -0.5, HEIGHT_M, -THICK_M, Material.PLAIN, concrete)
        wall.strip(0.0, length, (0.0, HEIGHT_M), (THICK_M, HEIGHT_M), Material.PLAIN, concrete)
        for s in (0.0, length):
            wall.close(s, concrete)
        x, y = (foot + length / 2 * forward(yaw) + THICK_M / 2 * wall.out).tolist()
        plan.solid.append((x, y, yaw, length / 2, THICK_M / 2))
        faces += [foot, foot + length * forward(yaw)]
    (x0, y0), (x1, y1) = np.min(faces, axis=0).tolist(), np.max(faces, axis=0).tolist()
    plan.zones.append(Zone((x0, y0, -5.0), (x1, y1, 30.0), "blank wall", False, 0.0))


@dataclass(frozen=True, eq=False)
class _Wall:
    """A straight wall being built; it follows the slope metre by metre."""

    soup: SoupBuilder
    hills: Hills
    foot: Float64[np.ndarray, " 2"]  # where its face begins
    yaw: float
    out: Float64[np.ndarray, " 2"]  # unit vector from the face into the wall

    def edge(
        self, s: Float64[np.ndarray, " n"], into: float, above: float
    ) -> Float64[np.ndarray, "n 3"]:
        """A line along the wall, `into` it from the face and `above` the pavement."""
        face = self.foot + s[:, None] * forward(self.yaw)
        return np.column_stack([face + into * self.out, self.hills(face) + KERB_M + above])

    def strip(
        self, a: float, b: float, lower: tuple[float, float], upper: tuple[float, float],
        material: Material, owner: int,
    ) -> None:  # fmt: skip
        """Fill from a to b between two edges, each (into the wall, above the pavement)."""
        s = np.unique([a, *range(math.ceil(a), math.ceil(b)), b])
        low, high = self.edge(s, *lower), self.edge(s, *upper)
        quads = np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
        bottom = max(lower[1], 0.0)  # a notice's v begins at its own edge, a wall's on the pavement
        uv = np.empty((len(quads), 4, 2))
        uv[:, 0, 0] = uv[:, 3, 0] = s[:-1] - a
        uv[:, 1, 0] = uv[:, 2, 0] = s[1:] - a
        uv[:, :2, 1] = lower[1] - bottom
        uv[:, 2:, 1] = upper[1] - bottom + upper[0] - lower[0]
        self.soup.quads(quads, material, owner, uv)

    def put(
        self,
        a: float,
        b: float,
        low: float,
        high: float,
        off: float,
        material: Material,
        owner: int,
    ) -> None:
        """Put an upright sheet on the wall, `off` its face; see `paint.Put`."""
        self.strip(a, b, (-off, low), (-off, high), material, owner)

    def close(self, s: float, owner: int) -> None:
        """Close the wall at one end."""
        ends = [
            self.edge(np.array([s]), into, above)
            for into, above in ((0.0, -0.5), (THICK_M, -0.5), (THICK_M, HEIGHT_M), (0.0, HEIGHT_M))
        ]
        self.soup.quads(np.stack(ends, axis=1), Material.PLAIN, owner)
