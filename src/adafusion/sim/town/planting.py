# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Trees, hedges and parks: three kinds of tree, few crowns of each, shared by all worlds."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Float64

from adafusion.sim.numeric import keyed_rng
from adafusion.sim.town.plan import Plan, Street, Zone, along, leftward, overlaps, point_on, touches
from adafusion.sim.town.shapes import Material, Point, SoupBuilder, disc, rectangle, turned

EAVES_M = 0.4  # roofs reach out of their walls
VARIANTS = 4  # crowns to choose from, of each kind: many trees share one
LEAF_RGB = (0.085, 0.135, 0.035)
HEDGE_RGB = (0.07, 0.12, 0.035)


@dataclass(frozen=True)
class TreeKind:
    """Proportions of a tree."""

    name: str
    crown: float  # share of the height
    width: float  # of the crown, over the height
    trunk: float  # share of the crown that the trunk leaves out


TREE_KINDS = (
    TreeKind("round", crown=0.68, width=0.72, trunk=0.55),
    TreeKind("column", crown=0.88, width=0.28, trunk=0.3),
    TreeKind("conifer", crown=0.9, width=0.46, trunk=0.3),
)
SLENDER = TREE_KINDS[1]


@cache
def _crown(kind: str, variant: int) -> Float[np.ndarray, "k 4 3"]:
    """Leaf cards of a crown about 1 high and 1 wide, standing on z = 0; not to be written to."""
    rng = keyed_rng("tree", kind, variant)  # a tree species is the same in all worlds
    if kind == "round":
        k = 90
        blobs = rng.normal(0.0, 0.17, (5, 3)) + np.array([0.0, 0.0, 0.55])
        direction = rng.normal(size=(k, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        centre = blobs[rng.integers(5, size=k)] + direction * rng.uniform(0.18, 0.32, (k, 1))
        size = rng.uniform(0.16, 0.26, k)
    elif kind == "column":
        k = 80
        z = rng.uniform(0.02, 0.98, k)
        radius = 0.5 * np.sin(np.pi * np.clip(z * 0.93 + 0.05, 0, 1)) ** 0.7
        angle = rng.uniform(0, 2 * np.pi, k)
        reach = radius * rng.uniform(0.6, 1.0, k)
        centre = np.stack([reach * np.cos(angle), reach * np.sin(angle), z], axis=1)
        size = rng.uniform(0.16, 0.24, k)
    else:
        k = 84
        z = 1.0 - np.sqrt(rng.uniform(0.0, 1.0, k)) * 0.97
        angle = rng.uniform(0, 2 * np.pi, k)
        reach = 0.5 * (1.02 - z) * rng.uniform(0.65, 1.0, k)
        centre = np.stack([reach * np.cos(angle), reach * np.sin(angle), z], axis=1)
        size = rng.uniform(0.12, 0.22, k)
    normal = rng.normal(size=(k, 3)) + 0.8 * (centre - (0, 0, 0.5)) / 0.4
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    side = np.cross(normal, rng.normal(size=(k, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(normal, side)
    side, up = side * size[:, None] * 0.5, up * size[:, None] * 0.5
    return np.stack(
        [centre - side - up, centre + side - up, centre + side + up, centre - side + up], axis=1
    )


def crown_reach(kind: TreeKind, variant: int, height: float) -> float:
    """Metres from the middle of a trunk to the farthest leaf."""
    cards = _crown(kind.name, variant)
    return float(np.hypot(cards[..., 0], cards[..., 1]).max()) * kind.width * height


def add_tree(
    soup: SoupBuilder,
    xy: Point,
    z: float,
    kind: TreeKind,
    variant: int,
    height: float,
    yaw: float,
    tint: Float[np.ndarray, " 3"],
) -> None:
    """Plant a tree of `height` metres at `xy` on ground at `z`."""
    width = height * kind.width
    cards = _crown(kind.name, variant) * (width, width, height * kind.crown)
    cards[:, :, :2] = turned(cards[:, :, :2].reshape(-1, 2), xy, yaw).reshape(-1, 4, 2)
    cards[:, :, 2] += z + height * (1 - kind.crown)
    tree = soup.add_object("tree", tint)
    soup.quads(cards, Material.LEAF, tree)
    trunk_top = z + height * (1 - kind.crown * kind.trunk)
    radius = 0.016 * height + 0.05
    soup.walls(disc(xy, radius, 6), z - 0.5, trunk_top, Material.BARK, tree)


def plant_street(plan: Plan, e: int, street: Street, edge: float) -> None:
    """Street trees: kind, spacing and sides belong to the street; gaps and sizes to the tree."""
    rng = plan.rng("street", e, "trees")
    if rng.random() < (0.35 if street.kind == "street" else 0.1):
        return
    length = float(along(street.line)[-1])
    kind = TREE_KINDS[int(rng.choice(3, p=(0.65, 0.25, 0.10)))]
    sides = (1, -1) if rng.random() < 0.5 else (int(rng.choice([1, -1])),)
    pitch, size = float(rng.uniform(9.0, 20.0)), float(rng.uniform(5.0, 9.0))
    tint = np.array(LEAF_RGB) * rng.uniform(0.8, 1.3) * rng.uniform(0.85, 1.15, 3)
    for side in sides:
        s, k = float(rng.uniform(10.0, 18.0)), 0
        while s < length - 10.0:
            own = plan.rng("street", e, side, "tree", k)
            k += 1
            xy, yaw = point_on(street.line, s)
            across = leftward(yaw) * side
            off_path = 1.5 if street.kind == "path" else 0.0
            foot = xy + across * (edge + 0.3 + float(own.uniform(0.0, 0.7)) + off_path)
            height = size * float(own.uniform(0.75, 1.2))
            if own.random() > 0.15 and not plan.on_road(foot, e, 1.2):
                _grow(plan, foot, kind, height, own, tint)
            s += pitch * float(own.uniform(0.8, 1.25))


def _grow(
    plan: Plan,
    xy: Float64[np.ndarray, " 2"],
    kind: TreeKind,
    height: float,
    rng: np.random.Generator,
    tint: Float[np.ndarray, " 3"],
) -> None:
    """Plant a tree; where walls are near a smaller or a slender one, or none."""
    variant, yaw = int(rng.integers(VARIANTS)), float(rng.uniform(0, 2 * np.pi))
    own_tint = tint * rng.uniform(0.88, 1.12)
    around = [*plan.solid, *plan.aloft]
    for fit, size in ((kind, height), (kind, 0.75 * height), (SLENDER, height)):
        if not touches(xy, crown_reach(fit, variant, size) + EAVES_M, around):
            add_tree(plan.soup, xy, plan.hills.at(xy), fit, variant, size, yaw, own_tint)
            return


def choose_parks(plan: Plan) -> None:
    """Make some blocks without a diagonal into parks, spread from west to east."""
    spec, rng = plan.spec, plan.rng("parks")
    nodes = np.array(plan.nodes)
    free: list[tuple[float, float, float, float]] = []
    for i in range(spec.columns - 1):
        for j in range(spec.rows - 1):
            south_west, south_east = i * spec.rows + j, (i + 1) * spec.rows + j
            ring = nodes[[south_west, south_east, south_west + 1, south_east + 1]]
            x0, x1 = ring[[0, 2], 0].max(), ring[[1, 3], 0].min()
            y0, y1 = ring[[0, 1], 1].max(), ring[[2, 3], 1].min()
            x, y = float((x0 + x1) / 2), float((y0 + y1) / 2)
            for rim in (11.0, 15.0, 19.0, 23.0):  # a curved street leaves less
                half_x, half_y = float((x1 - x0) / 2) - rim, float((y1 - y0) / 2) - rim
                if not overlaps((x, y, 0.0, half_x, half_y), plan.taken):
                    free.append((x - half_x, y - half_y, x + half_x, y + half_y))
                    break
    free.sort()
    wanted = max(1, len(free) // 6) if free else 0
    picks = {int(len(free) * (k + rng.random()) / (wanted + 1e-9)) for k in range(wanted)}
    for pick in sorted(min(p, len(free) - 1) for p in picks):
        x0, y0, x1, y1 = free[pick]
        plan.zones.append(Zone((x0, y0, -5.0), (x1, y1, 30.0), "park", False, 0.0))
        plan.taken.append(((x0 + x1) / 2, (y0 + y1) / 2, 0.0, (x1 - x0) / 2, (y1 - y0) / 2))


def plant_parks(plan: Plan) -> None:
    """Trees of all kinds and sizes, with hedges along some sides."""
    for p, zone in enumerate(zone for zone in plan.zones if zone.kind == "park"):
        rng = plan.rng("park", p)
        (x0, y0, _), (x1, y1, _) = zone.lower, zone.upper
        kinds = rng.choice(3, p=(0.5, 0.2, 0.3), size=3)
        placed: list[np.ndarray] = []
        for k in range(int((x1 - x0) * (y1 - y0) / 70.0)):
            own = plan.rng("park", p, "tree", k)
            xy = own.uniform((x0, y0), (x1, y1))
            if any(np.hypot(*(xy - other)) < 4.5 for other in placed):
                continue
            placed.append(xy)
            kind = TREE_KINDS[int(kinds[int(own.integers(3))])]
            shade = own.uniform(0.7, 1.35)
            tint = np.array((0.08, 0.13, 0.035)) * shade * own.uniform(0.85, 1.15, 3)
            _grow(plan, xy, kind, float(own.uniform(4.5, 12.0)), own, tint)
        hedge = plan.soup.add_object("hedge", np.array(HEDGE_RGB) * rng.uniform(0.8, 1.3))
        tall = float(rng.uniform(0.7, 1.3))
        ring = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)])
        for start, end in itertools.pairwise(ring):
            if rng.random() < 0.35:
                continue
            side = end - start
            pieces = int(np.hypot(*side) // 6)
            gate = int(rng.integers(pieces))
            for k in range(pieces):
                if k == gate:
                    continue
                a, b = start + side * k / pieces, start + side * (k + 1) / pieces
                d = b - a
                bed = rectangle((a + b) / 2, float(np.hypot(*d)), 0.8, math.atan2(d[1], d[0]))
                z = plan.hills.at((a + b) / 2)
                plan.soup.block(bed, z - 0.5, z + tall, Material.HEDGE, hedge)
