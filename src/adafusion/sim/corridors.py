# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Identical indoor corridors: the same box each time, told apart by flat paint alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from adafusion.sim.buildings import BUILDING_TYPES, PLAIN
from adafusion.sim.plan import Plan, Street, Zone, arc
from adafusion.sim.shapes import Material, rectangle

WIDTH_M = 2.6
HEIGHT_M = 2.8
AWAY_M = 48.0  # from the town's edge
LAMP_PITCH_M = 8.0
_LIGHT = 0.006  # ambient radiance: the lamps, bounced off the walls
_PAINTS = np.array(
    [(0.62, 0.60, 0.54), (0.62, 0.60, 0.54), (0.20, 0.34, 0.45), (0.55, 0.42, 0.16),
     (0.24, 0.40, 0.24), (0.50, 0.20, 0.16), (0.40, 0.40, 0.42)]
)  # fmt: skip


def lay_out_corridor(plan: Plan, nodes: Sequence[int], *, west: bool) -> None:
    """A straight passage north beside the town's outer `nodes`, with a footpath to each end."""
    spec = plan.spec
    sign = -1.0 if west else 1.0
    x = sign * max(sign * plan.nodes[n][0] for n in nodes) + sign * AWAY_M
    span = spec.corridor_m + 30.0
    # the pair of crossings whose distance suits the corridor best
    pairs = [(a, b) for k, a in enumerate(nodes) for b in nodes[k + 1 :]]
    low, high = min(pairs, key=lambda p: abs(plan.nodes[p[1]][1] - plan.nodes[p[0]][1] - span))
    middle = (plan.nodes[low][1] + plan.nodes[high][1]) / 2
    y0, y1 = middle - spec.corridor_m / 2, middle + spec.corridor_m / 2
    half = WIDTH_M / 2
    plan.zones.append(
        Zone((x - half, y0, -0.5), (x + half, y1, HEIGHT_M + 0.05), "corridor", True, _LIGHT)
    )
    plan.taken.append((x, middle, math.pi / 2, spec.corridor_m / 2 + 2.0, 8.0))
    inner = []
    for y in (y0 - 9.0, y1 + 9.0):
        inner.append(len(plan.nodes))
        plan.nodes.append((x, y))
    for outer, near in ((low, inner[0]), (high, inner[1])):
        line = arc(np.array(plan.nodes[outer]), np.array(plan.nodes[near]))
        plan.streets.append(Street((outer, near), line, "path"))
    line = arc(np.array(plan.nodes[inner[0]]), np.array(plan.nodes[inner[1]]))
    plan.streets.append(Street((inner[0], inner[1]), line, "corridor"))


def build_corridors(plan: Plan) -> None:
    """Build every corridor laid out."""
    for index, zone in enumerate(plan.zones):
        if zone.kind == "corridor":
            (x0, y0, _), (x1, y1, _) = zone.lower, zone.upper
            _build_inside(plan, index, (x0 + x1) / 2, y0, y1)
            _build_hull(plan, index, (x0 + x1) / 2, y0, y1)


Corner = tuple[float, float, float]


def _sheet(
    plan: Plan, corners: tuple[Corner, Corner, Corner, Corner], material: Material, owner: int
) -> None:
    plan.soup.quads(np.array([corners], float), material, owner)


def _on_wall(
    wall: float, y0: float, y1: float, z0: float, z1: float
) -> tuple[Corner, Corner, Corner, Corner]:
    return (wall, y0, z0), (wall, y1, z0), (wall, y1, z1), (wall, y0, z1)


def _level(
    x: float, half: float, y0: float, y1: float, z: float
) -> tuple[Corner, Corner, Corner, Corner]:
    return (x - half, y0, z), (x - half, y1, z), (x + half, y1, z), (x + half, y0, z)


def _build_inside(plan: Plan, index: int, x: float, y0: float, y1: float) -> None:
    """Floor, ceiling, lamps, and walls in painted sections with doors and notices on them."""
    soup, h = plan.soup, HEIGHT_M
    paint = plan.rng("corridor", index, "paint")
    floor = soup.add_object("corridor", (0.30, 0.29, 0.27))
    ceiling = soup.add_object("corridor", (0.66, 0.66, 0.64))
    lap = WIDTH_M / 2 + 0.05  # under the walls: no ray slips out along an edge
    _sheet(plan, _level(x, lap, y0, y1, 0.0), Material.FLOOR, floor)
    _sheet(plan, _level(x, lap, y0, y1, h), Material.CEILING, ceiling)
    for side in (-1.0, 1.0):
        wall, y = x + side * WIDTH_M / 2, y0
        while y < y1 - 1e-6:
            end = min(y + float(paint.uniform(7.0, 14.0)), y1)
            end = y1 if y1 - end < 5.0 else end
            tint = _PAINTS[paint.integers(len(_PAINTS))] * paint.uniform(0.85, 1.1)
            section = soup.add_object("corridor", tint, style=int(paint.integers(4)))
            _sheet(plan, _on_wall(wall, y, end, 0.0, h), Material.WALL, section)
            y = end
        near = wall - side * 0.004  # far less than the LiDAR's noise
        y = y0 + float(paint.uniform(2.0, 6.0))
        while y < y1 - 4.0:
            if paint.random() < 0.62:
                tint = (0.34, 0.22, 0.12) if paint.random() < 0.6 else (0.42, 0.45, 0.48)
                door = soup.add_object("door", tint, style=int(paint.integers(3)))
                _sheet(plan, _on_wall(near, y, y + 0.95, 0.0, 2.1), Material.DOOR, door)
            else:
                width = float(paint.uniform(0.8, 2.2))
                tint = paint.uniform(0.15, 0.75, 3)
                notice = soup.add_object("notice", tint, seed=int(paint.integers(1 << 20)))
                _sheet(plan, _on_wall(near, y, y + width, 1.1, 1.95), Material.NOTICE, notice)
            y += float(paint.uniform(3.0, 9.0))
    lamp = soup.add_object("lamp", (1.0, 0.97, 0.88))
    count = round((y1 - y0) / LAMP_PITCH_M)
    for k in range(count):
        y = y0 + (k + 0.5) * (y1 - y0) / count
        _sheet(plan, _level(x, 0.15, y - 0.6, y + 0.6, h - 0.01), Material.LAMP, lamp)
        plan.lamps.append((x, y, h - 0.05, 0.10, 0.096, 0.086, float(index), 1.0))


def _build_hull(plan: Plan, index: int, x: float, y0: float, y1: float) -> None:
    """The building around a corridor, of one of the town's types, with a canopy at each door."""
    soup, half, top = plan.soup, 5.5, 7.4
    rng = plan.rng("corridor", index, "hull")
    kind = BUILDING_TYPES[("slab", "stone", "office")[int(rng.integers(3))]]
    hull = soup.add_object(
        "building", kind.tints[int(rng.integers(len(kind.tints)))], style=kind.style,
        pitch=kind.cell_m, floor=kind.floor_m, win_w=kind.window[0], win_h=kind.window[1],
        second=kind.second, seed=int(rng.integers(1 << 20)), top=8.0, ground=PLAIN,
    )  # fmt: skip
    roof = soup.add_object("building", (0.24, 0.24, 0.25))
    for side in (-1.0, 1.0):
        outline = np.array([[x + side * half, y0], [x + side * half, y1]])
        soup.walls(outline, -0.5, top, Material.FACADE, hull, ground=0.0, cell_m=kind.cell_m)
    w, h = WIDTH_M / 2, HEIGHT_M
    for y in (y0, y1):
        for a, b, low in ((x - half, x - w, -0.5), (x + w, x + half, -0.5), (x - w, x + w, h)):
            end = (a, y, low), (b, y, low), (b, y, top), (a, y, top)
            _sheet(plan, end, Material.PLAIN, hull)
        canopy = soup.add_object("building", (0.20, 0.21, 0.22))
        out = -1.0 if y == y0 else 1.0
        outline = rectangle((x, y + out * 0.9), 4.2, 1.8, 0.0)
        soup.block(outline, h + 0.15, h + 0.35, Material.PLAIN, canopy, floor=True)
    soup.cap(rectangle((x, (y0 + y1) / 2), 2 * half, y1 - y0, 0.0), top, Material.ROOF, roof)
    plan.solid.append((x, (y0 + y1) / 2, math.pi / 2, (y1 - y0) / 2, half))
