# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A small town from a seed: streets, typed buildings, parks, trees, and identical corridors.

Buildings and trees are drawn from few shared types, so places look alike on purpose; what tells
them apart is their arrangement, size and tint. Every draw is keyed by (seed, object, purpose).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float64
from scipy.spatial import KDTree

from adafusion.sim.numeric import keyed_rng, keyed_seed
from adafusion.sim.shapes import (
    TREE_KINDS,
    TREE_VARIANTS,
    Material,
    Rgb,
    Soup,
    SoupBuilder,
    add_tree,
    add_vehicle,
    disc,
    rectangle,
)

ROAD_HALF_M = 5.5
WALK_HALF_M = 8.8  # road and pavements
PARKING_M = 4.5  # lateral middle of a parked car
CORRIDOR_WIDTH_M = 2.6
CORRIDOR_HEIGHT_M = 2.8
MARGIN_M = 110.0  # open land around the town


@dataclass(frozen=True, kw_only=True)
class WorldSpec:
    """What a world is made from: equal specs give equal worlds."""

    seed: int
    columns: int = 5  # street crossings from west to east ...
    rows: int = 5  # ... and from south to north
    spacing_m: float = 84.0
    corridors: int = 2
    corridor_m: float = 140.0

    def __post_init__(self) -> None:
        if self.columns < 2 or self.rows < 3:
            raise ValueError(f"{self.columns} x {self.rows} crossings are no town: 2 x 3 at least")
        if not 0 <= self.corridors <= 2:
            raise ValueError(f"corridors = {self.corridors}: west and east have room for one each")


@dataclass(frozen=True)
class Zone:
    """An axis-aligned box with a name for the kind of place inside."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    kind: str  # "park", "corridor"
    indoor: bool
    light: float  # ambient radiance inside, where indoor: lamps bounced off the walls

    def contains(self, x: float, y: float, margin: float = 0.0) -> bool:
        """Whether (x, y) lies within `margin` metres of the box."""
        return (
            self.lower[0] - margin <= x <= self.upper[0] + margin
            and self.lower[1] - margin <= y <= self.upper[1] + margin
        )


@dataclass(frozen=True, eq=False)
class Street:
    """An edge of the street graph."""

    ends: tuple[int, int]  # nodes
    line: Float64[np.ndarray, "n 2"]  # middle line from the first node to the second, metres
    kind: str  # "street", "path" (no cars), "corridor"


@dataclass(frozen=True, eq=False)
class World:
    """Everything that stays the same from run to run."""

    spec: WorldSpec
    nodes: Float64[np.ndarray, "n 2"]
    streets: tuple[Street, ...]
    soup: Soup
    zones: tuple[Zone, ...]
    lamps: Float64[np.ndarray, "m 8"]  # xyz, RGB power, zone (-1 outdoors), 1 where always on
    hills: Hills


@dataclass(frozen=True, eq=False)
class Hills:
    """Height of the ground: a few long waves, level around corridors."""

    waves: Float64[np.ndarray, "k 4"]  # amplitude, wave vector x and y, phase
    level: tuple[Zone, ...]

    def __call__(self, xy: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """Height in metres at n points."""
        amplitude, kx, ky, phase = self.waves.T
        angle = xy[:, :1] * kx + xy[:, 1:] * ky + phase
        height = (amplitude * np.sin(angle)).sum(axis=1)
        for zone in self.level:
            outside = np.maximum(np.array(zone.lower[:2]) - xy, xy - np.array(zone.upper[:2]))
            t = np.clip(np.hypot(*np.maximum(outside, 0.0).T) / 45.0, 0.0, 1.0)
            height = height * t * t * (3.0 - 2.0 * t)
        return height

    def at(self, xy: Sequence[float]) -> float:
        """Height in metres at one point."""
        return float(self(np.array([[xy[0], xy[1]]]))[0])


# ------------------------------------------------------------------------------------- buildings


@dataclass(frozen=True)
class BuildingType:
    """What the buildings of one type share; `style` is their facade in `textures.py`."""

    style: int
    tints: tuple[Rgb, ...]
    second: Rgb  # frames, bands, ground floor
    storeys: tuple[int, int]
    floor_m: float
    cell_m: float  # window pitch
    window: tuple[float, float]  # share of a cell that is window, across and up
    width_m: tuple[float, float]
    depth_m: tuple[float, float]
    setback_m: float
    gap_m: tuple[float, float]
    roof: str  # "flat", "gable", "hip"
    ground: int  # ground floor: 0 as above, 1 shop windows, 2 doors, 3 gates
    extras: tuple[str, ...] = ()


BRICK, PLASTER, CURTAIN, SLAB, STONE, METAL_SHEET, TIMBER = range(7)

BUILDING_TYPES = {
    "terrace": BuildingType(
        BRICK, ((0.34, 0.14, 0.10), (0.40, 0.21, 0.14), (0.30, 0.17, 0.13), (0.42, 0.28, 0.20)),
        (0.70, 0.68, 0.62), (2, 3), 2.9, 2.6, (0.40, 0.52), (9, 17), (9, 11), 1.0, (0, 0.2),
        "gable", 2, ("chimney", "bay"),
    ),
    "apartments": BuildingType(
        PLASTER, ((0.62, 0.56, 0.42), (0.58, 0.46, 0.34), (0.55, 0.58, 0.55), (0.66, 0.62, 0.56),
                  (0.50, 0.36, 0.28)),
        (0.72, 0.70, 0.66), (4, 5), 3.0, 3.2, (0.42, 0.50), (14, 26), (11, 14), 1.5, (0, 5),
        "flat", 2, ("balcony",),
    ),
    "office": BuildingType(
        CURTAIN, ((0.30, 0.33, 0.36), (0.22, 0.27, 0.30), (0.42, 0.42, 0.40)),
        (0.16, 0.17, 0.18), (4, 7), 3.6, 1.8, (0.92, 0.66), (18, 32), (14, 18), 4.0, (4, 9),
        "flat", 1, ("recess",),
    ),
    "slab": BuildingType(
        SLAB, ((0.48, 0.47, 0.44), (0.42, 0.42, 0.42), (0.52, 0.48, 0.42)),
        (0.30, 0.32, 0.36), (5, 8), 2.8, 3.6, (0.74, 0.46), (22, 36), (11, 13), 6.0, (7, 14),
        "flat", 2, ("balcony",),
    ),
    "shops": BuildingType(
        PLASTER, ((0.58, 0.50, 0.40), (0.46, 0.22, 0.16), (0.35, 0.40, 0.44), (0.64, 0.62, 0.58)),
        (0.16, 0.22, 0.20), (2, 3), 3.3, 2.5, (0.44, 0.50), (8, 15), (10, 13), 0.3, (0, 0),
        "flat", 1, ("awning",),
    ),
    "stone": BuildingType(
        STONE, ((0.50, 0.45, 0.36), (0.45, 0.42, 0.37), (0.55, 0.49, 0.40)),
        (0.62, 0.58, 0.50), (3, 4), 3.7, 2.4, (0.40, 0.62), (13, 22), (11, 14), 1.0, (0, 3),
        "hip", 2, ("cornice", "bay"),
    ),
    "warehouse": BuildingType(
        METAL_SHEET, ((0.32, 0.38, 0.42), (0.42, 0.40, 0.36), (0.24, 0.33, 0.28), (0.45, 0.30, 0.24)),
        (0.20, 0.22, 0.25), (2, 2), 3.6, 6.0, (0.55, 0.22), (24, 38), (15, 20), 5.0, (6, 12),
        "gable", 3, (),
    ),
    "house": BuildingType(
        PLASTER, ((0.68, 0.66, 0.60), (0.62, 0.54, 0.40), (0.44, 0.30, 0.22), (0.52, 0.56, 0.58)),
        (0.46, 0.44, 0.42), (1, 2), 2.8, 3.0, (0.42, 0.46), (9, 13), (8, 10), 5.0, (4, 9),
        "gable", 2, ("chimney", "porch", "hedge"),
    ),
    "timber": BuildingType(
        TIMBER, ((0.40, 0.29, 0.18), (0.30, 0.26, 0.22), (0.52, 0.42, 0.30)),
        (0.66, 0.66, 0.64), (2, 4), 3.0, 2.9, (0.52, 0.60), (12, 20), (10, 12), 2.5, (3, 7),
        "flat", 2, ("recess", "balcony"),
    ),
}  # fmt: skip
ROOF_TINTS: tuple[Rgb, ...] = (
    (0.30, 0.12, 0.08), (0.16, 0.15, 0.16), (0.24, 0.17, 0.13), (0.20, 0.20, 0.21),
)  # fmt: skip


def build_world(spec: WorldSpec) -> World:
    """Build the world of `spec`; equal specs give bit-equal worlds on one machine."""
    plan = _Plan(spec)
    _lay_out_streets(plan)
    _pave(plan)
    for index in range(len(plan.corridors)):
        _build_corridor(plan, index)
    _choose_parks(plan)
    _line_with_buildings(plan)
    _furnish_streets(plan)
    _plant_parks(plan)
    return World(
        spec,
        np.array(plan.nodes),
        tuple(plan.streets),
        plan.soup.build(),
        tuple(plan.zones),
        np.array(plan.lamps).reshape(-1, 8),
        plan.hills,
    )


@dataclass
class _Plan:
    """A world in the making."""

    spec: WorldSpec
    soup: SoupBuilder = field(default_factory=SoupBuilder)
    nodes: list[tuple[float, float]] = field(default_factory=list)
    streets: list[Street] = field(default_factory=list)
    zones: list[Zone] = field(default_factory=list)
    lamps: list[tuple[float, ...]] = field(default_factory=list)
    corridors: list[tuple[float, float, float]] = field(default_factory=list)  # x, y0, y1
    taken: list[tuple[float, ...]] = field(default_factory=list)  # rectangles nothing may enter
    solid: list[tuple[float, ...]] = field(default_factory=list)  # buildings: trees keep away
    hills: Hills = field(default_factory=lambda: Hills(np.zeros((0, 4)), ()))
    crowns: dict[tuple[str, int], np.ndarray] = field(default_factory=dict)

    def rng(self, *key: int | str) -> np.random.Generator:
        """Random numbers of one object of this world."""
        return keyed_rng(self.spec.seed, *key)


Rect = tuple[float, float, float, float, float]  # x, y, yaw, half length, half width


def _overlaps(rect: Rect, others: Sequence[tuple[float, ...]]) -> bool:
    """Whether a turned rectangle meets any other (separating axes)."""
    if not others:
        return False
    b = np.array(others)
    delta = b[:, :2] - rect[:2]
    yaws = np.stack([np.full(len(b), rect[2]), b[:, 2]])
    reach_a, reach_b = np.array([rect[3], rect[4]]), b[:, 3:5]
    apart = np.zeros(len(b), bool)
    for yaw in (yaws[0], yaws[0] + np.pi / 2, yaws[1], yaws[1] + np.pi / 2):
        distance = np.abs(delta[:, 0] * np.cos(yaw) + delta[:, 1] * np.sin(yaw))
        size = np.zeros(len(b))
        for own, reach in ((yaws[0], reach_a[None]), (yaws[1], reach_b)):
            turn = yaw - own
            size += np.abs(np.cos(turn)) * reach[:, 0] + np.abs(np.sin(turn)) * reach[:, 1]
        apart |= distance > size
    return not apart.all()


# --------------------------------------------------------------------------------------- streets


def _lay_out_streets(plan: _Plan) -> None:
    spec, rng = plan.spec, plan.rng("streets")
    x = np.cumsum(rng.uniform(0.88, 1.14, spec.columns)) * spec.spacing_m
    y = np.cumsum(rng.uniform(0.88, 1.14, spec.rows)) * spec.spacing_m
    x, y = x - x.mean(), y - y.mean()
    grid = {}
    for i in range(spec.columns):
        for j in range(spec.rows):
            jitter = rng.uniform(-6.5, 6.5, 2)
            grid[i, j] = len(plan.nodes)
            plan.nodes.append((x[i] + jitter[0], y[j] + jitter[1]))
    edges = [((i, j), (i + 1, j)) for i in range(spec.columns - 1) for j in range(spec.rows)]
    edges += [((i, j), (i, j + 1)) for i in range(spec.columns) for j in range(spec.rows - 1)]
    order = [
        tuple(map(int, e)) for e in rng.permutation([(a, b) for a, b in np.ndindex(1, len(edges))])
    ]
    curved = {index for _, index in order[: max(1, len(edges) // 7)]}
    for index, (a, b) in enumerate(edges):
        start, end = np.array(plan.nodes[grid[a]]), np.array(plan.nodes[grid[b]])
        bulge = float(rng.choice([-1, 1]) * rng.uniform(8.0, 13.0)) if index in curved else 0.0
        plan.streets.append(Street((grid[a], grid[b]), _arc(start, end, bulge), "street"))
    # oblique streets: diagonals of single blocks
    blocks = [(i, j) for i in range(spec.columns - 1) for j in range(spec.rows - 1)]
    for k in rng.permutation(len(blocks))[: max(1, len(blocks) // 6)]:
        i, j = blocks[k]
        ends = ((i, j), (i + 1, j + 1)) if rng.random() < 0.5 else ((i + 1, j), (i, j + 1))
        a, b = grid[ends[0]], grid[ends[1]]
        line = _arc(np.array(plan.nodes[a]), np.array(plan.nodes[b]), 0.0)
        plan.streets.append(Street((a, b), line, "street"))
    for k in range(spec.corridors):
        _lay_out_corridor(plan, grid, west=k % 2 == 0)
    # a path may not use what a building wants, nor a building what a path wants
    for street in plan.streets:
        half = WALK_HALF_M if street.kind == "street" else 3.0
        for p, q in zip(street.line[:-1], street.line[1:], strict=True):
            d = q - p
            middle, length = (p + q) / 2, float(np.hypot(*d))
            plan.taken.append((*middle, math.atan2(d[1], d[0]), length / 2 + 1.0, half))
    waves = plan.rng("hills")
    k, angle = 2 * np.pi / waves.uniform(150.0, 280.0, 5), waves.uniform(0, 2 * np.pi, 5)
    amplitude = waves.uniform(0.3, 0.9, 5)
    table = np.stack(
        [amplitude, k * np.cos(angle), k * np.sin(angle), waves.uniform(0, 2 * np.pi, 5)], axis=1
    )
    plan.hills = Hills(table, tuple(plan.zones))


def _arc(start: np.ndarray, end: np.ndarray, bulge: float) -> Float64[np.ndarray, "n 2"]:
    """Points every 4 m or less from start to end, bulging to the left by a parabola."""
    d = end - start
    length = float(np.hypot(*d))
    s = np.linspace(0.0, 1.0, max(2, math.ceil(length / 4.0) + 1))[:, None]
    normal = np.array([-d[1], d[0]]) / length
    return start + s * d + 4.0 * bulge * s * (1.0 - s) * normal


def _lay_out_corridor(plan: _Plan, grid: dict[tuple[int, int], int], *, west: bool) -> None:
    """A straight indoor passage beside the town, reached by a footpath at each end."""
    spec = plan.spec
    column = 0 if west else spec.columns - 1
    nodes = [grid[column, j] for j in range(spec.rows)]
    sign = -1.0 if west else 1.0
    x = sign * max(sign * plan.nodes[n][0] for n in nodes) + sign * 48.0
    span = spec.corridor_m + 30.0
    # the pair of crossings whose distance suits the corridor best
    pairs = [(a, b) for k, a in enumerate(nodes) for b in nodes[k + 1 :]]
    low, high = min(pairs, key=lambda p: abs(plan.nodes[p[1]][1] - plan.nodes[p[0]][1] - span))
    middle = (plan.nodes[low][1] + plan.nodes[high][1]) / 2
    y0, y1 = middle - spec.corridor_m / 2, middle + spec.corridor_m / 2
    plan.corridors.append((x, y0, y1))
    half = CORRIDOR_WIDTH_M / 2
    plan.zones.append(
        Zone(
            (x - half, y0, -0.5), (x + half, y1, CORRIDOR_HEIGHT_M + 0.05), "corridor", True, 0.006
        )
    )
    plan.taken.append((x, middle, math.pi / 2, spec.corridor_m / 2 + 2.0, 8.0))
    inner = []
    for y in (y0 - 9.0, y1 + 9.0):
        inner.append(len(plan.nodes))
        plan.nodes.append((x, y))
    for outer, near in ((low, inner[0]), (high, inner[1])):
        line = _arc(np.array(plan.nodes[outer]), np.array(plan.nodes[near]), 0.0)
        plan.streets.append(Street((outer, near), line, "path"))
    line = _arc(np.array(plan.nodes[inner[0]]), np.array(plan.nodes[inner[1]]), 0.0)
    plan.streets.append(Street((inner[0], inner[1]), line, "corridor"))


def offset_line(
    line: Float[np.ndarray, "n 2"], lateral: float | Float[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 2"]:
    """Move a line to its left by `lateral` metres."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    return line + normal * np.reshape(lateral, (-1, 1))


def _along(line: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
    """Distance from the start of a line to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])


def _point_on(line: np.ndarray, s: float) -> tuple[np.ndarray, float]:
    """The point at distance s along a line, and the heading there."""
    along = _along(line)
    xy = np.array([np.interp(s, along, line[:, 0]), np.interp(s, along, line[:, 1])])
    k = int(np.clip(np.searchsorted(along, s) - 1, 0, len(line) - 2))
    d = line[k + 1] - line[k]
    return xy, math.atan2(d[1], d[0])


def _strip(
    plan: _Plan,
    line: np.ndarray,
    a: tuple[float, float],
    b: tuple[float, float],
    material: Material,
    object_id: int,
) -> None:
    """Ribbon along a line between two (lateral, height above ground) edges; left edge first."""
    edges = []
    for lateral, height in (a, b):
        xy = offset_line(line, lateral)
        edges.append(np.column_stack([xy, plan.hills(xy) + height]))
    s = _along(line)
    corners = np.stack([edges[0][:-1], edges[0][1:], edges[1][1:], edges[1][:-1]], axis=1)
    across = a[0] if a[0] != b[0] else a[1], b[0] if a[0] != b[0] else b[1]
    uv = np.empty((len(corners), 4, 2))
    uv[:, :2, 0], uv[:, 2:, 0] = across
    uv[:, 0, 1] = uv[:, 3, 1] = s[:-1]
    uv[:, 1, 1] = uv[:, 2, 1] = s[1:]
    plan.soup.quads(corners, material, object_id, uv)


def _trimmed(line: np.ndarray, head: float, tail: float) -> np.ndarray | None:
    """The line without `head` metres at its start and `tail` at its end; None if nothing is left."""
    s = _along(line)
    if s[-1] <= head + tail + 2.0:
        return None
    at = np.linspace(head, s[-1] - tail, max(2, math.ceil((s[-1] - head - tail) / 4.0) + 1))
    return np.column_stack([np.interp(at, s, line[:, 0]), np.interp(at, s, line[:, 1])])


def _pave(plan: _Plan) -> None:
    """Ground, roads with kerbs and pavements, crossings."""
    soup, hills = plan.soup, plan.hills
    grass = soup.add_object("ground", (0.11, 0.16, 0.045))
    paving = soup.add_object("pavement", (0.36, 0.35, 0.33))
    kerb = soup.add_object("kerb", (0.42, 0.41, 0.39))
    xy = np.array(plan.nodes)
    low, high = xy.min(axis=0) - MARGIN_M, xy.max(axis=0) + MARGIN_M
    gx = np.linspace(low[0], high[0], math.ceil((high[0] - low[0]) / 7.0))
    gy = np.linspace(low[1], high[1], math.ceil((high[1] - low[1]) / 7.0))
    grid = np.stack(np.meshgrid(gx, gy, indexing="ij"), axis=-1)
    points = np.concatenate([grid, hills(grid.reshape(-1, 2)).reshape(*grid.shape[:2], 1)], axis=2)
    points[..., 2] -= 0.06
    cells = np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], axis=2)
    cells = cells.reshape(-1, 4, 3)
    soup.quads(cells, Material.GRASS, grass, cells[:, :, :2])
    marks = plan.rng("markings")
    for index, street in enumerate(plan.streets):
        if street.kind == "corridor":
            continue
        if street.kind == "path":
            _strip(plan, street.line, (1.7, 0.0), (-1.7, 0.0), Material.PAVING, paving)
            continue
        # style: 0 no marking, 1 dashed middle line, 2 solid; parking lines in 3 of 4 streets
        style = int(marks.choice(4, p=(0.2, 0.45, 0.2, 0.15)))
        road = soup.add_object("road", (0.105, 0.105, 0.11), style=style)
        _strip(plan, street.line, (ROAD_HALF_M, 0.0), (-ROAD_HALF_M, 0.0), Material.ASPHALT, road)
        clear = [9.5, 9.5]
        line = _trimmed(street.line, *clear)
        if line is None:
            continue
        for side in (1.0, -1.0):
            inner, outer = side * ROAD_HALF_M, side * WALK_HALF_M
            rim = inner + side * 0.18
            _strip(plan, line, (inner, 0.0), (inner, 0.12), Material.PLAIN, kerb)
            _strip(plan, line, (inner, 0.12), (rim, 0.12), Material.PLAIN, kerb)
            _strip(plan, line, (rim, 0.12), (outer, 0.12), Material.PAVING, paving)
            _strip(plan, line, (outer, 0.12), (outer, -0.1), Material.PLAIN, kerb)
        if marks.random() < 0.45:  # zebra crossings at both ends
            stripes = soup.add_object("road", (0.62, 0.62, 0.60), seed=index)
            for end in (0, 1):
                s = _along(street.line)[-1]
                zebra = _trimmed(street.line, *((11.0, s - 14.0) if end == 0 else (s - 14.0, 11.0)))
                if zebra is not None:
                    _strip(
                        plan,
                        zebra,
                        (ROAD_HALF_M, 0.02),
                        (-ROAD_HALF_M, 0.02),
                        Material.STRIPES,
                        stripes,
                    )
    plain = soup.add_object("road", (0.105, 0.105, 0.11))
    used = {n for street in plan.streets if street.kind == "street" for n in street.ends}
    for node in sorted(used):
        for radius, lift, material, owner in (
            (13.0, -0.03, Material.PAVING, paving),
            (8.6, 0.012, Material.ASPHALT, plain),
        ):
            rim = disc(plan.nodes[node], radius, 12)
            z = hills(rim) + lift
            centre = np.array([*plan.nodes[node], hills.at(plan.nodes[node]) + lift])
            ring = np.column_stack([rim, z])
            corners = np.stack(
                [np.tile(centre, (12, 1)), ring, np.roll(ring, -1, 0), np.roll(ring, -1, 0)], axis=1
            )
            uv = corners[:, :, :2] - np.array(plan.nodes[node]) + 20.0  # away from lane markings
            soup.quads(corners, material, owner, uv)


# -------------------------------------------------------------------------------------- corridors


def _build_corridor(plan: _Plan, index: int) -> None:
    """The same box each time; only flat paint, doors and notices tell corridors apart."""
    soup = plan.soup
    x, y0, y1 = plan.corridors[index]
    w, h = CORRIDOR_WIDTH_M / 2, CORRIDOR_HEIGHT_M
    paint = plan.rng("corridor", index, "paint")
    palette = np.array(
        [(0.62, 0.60, 0.54), (0.62, 0.60, 0.54), (0.20, 0.34, 0.45), (0.55, 0.42, 0.16),
         (0.24, 0.40, 0.24), (0.50, 0.20, 0.16), (0.40, 0.40, 0.42)]
    )  # fmt: skip
    floor = soup.add_object("corridor", (0.30, 0.29, 0.27))
    ceiling = soup.add_object("corridor", (0.66, 0.66, 0.64))

    def sheet(a: Sequence[float], b: Sequence[float], c: Sequence[float], d: Sequence[float],
              material: Material, owner: int) -> None:  # fmt: skip
        soup.quads(np.array([[a, b, c, d]], float), material, owner)

    sheet((x - w, y0, 0), (x - w, y1, 0), (x + w, y1, 0), (x + w, y0, 0), Material.FLOOR, floor)
    sheet((x - w, y0, h), (x - w, y1, h), (x + w, y1, h), (x + w, y0, h), Material.CEILING, ceiling)
    for side in (-1.0, 1.0):
        wall, y = x + side * w, y0
        while y < y1 - 1e-6:
            end = min(y + float(paint.uniform(7.0, 14.0)), y1)
            end = y1 if y1 - end < 5.0 else end
            tint = palette[paint.integers(len(palette))] * paint.uniform(0.85, 1.1)
            section = soup.add_object("corridor", tint, style=int(paint.integers(4)))
            sheet(
                (wall, y, 0), (wall, end, 0), (wall, end, h), (wall, y, h), Material.WALL, section
            )
            y = end
        y = y0 + float(paint.uniform(2.0, 6.0))
        while y < y1 - 4.0:
            near = wall - side * 0.004
            what = paint.random()
            if what < 0.62:
                tint = (0.34, 0.22, 0.12) if paint.random() < 0.6 else (0.42, 0.45, 0.48)
                leaf = soup.add_object("door", tint, style=int(paint.integers(3)))
                sheet((near, y, 0), (near, y + 0.95, 0), (near, y + 0.95, 2.1), (near, y, 2.1),
                      Material.DOOR, leaf)  # fmt: skip
            else:
                width = float(paint.uniform(0.8, 2.2))
                tint = paint.uniform(0.15, 0.75, 3)
                notice = soup.add_object("notice", tint, seed=int(paint.integers(1 << 20)))
                sheet((near, y, 1.1), (near, y + width, 1.1), (near, y + width, 1.95), (near, y, 1.95),
                      Material.NOTICE, notice)  # fmt: skip
            y += float(paint.uniform(3.0, 9.0))
    lamp = soup.add_object("lamp", (1.0, 0.97, 0.88))
    count = round((y1 - y0) / 8.0)
    for k in range(count):
        y = y0 + (k + 0.5) * (y1 - y0) / count
        sheet((x - 0.15, y - 0.6, h - 0.01), (x - 0.15, y + 0.6, h - 0.01),
              (x + 0.15, y + 0.6, h - 0.01), (x + 0.15, y - 0.6, h - 0.01),
              Material.LAMP, lamp)  # fmt: skip
        plan.lamps.append((x, y, h - 0.05, 0.10, 0.096, 0.086, float(index), 1.0))
    # the building around it
    style = plan.rng("corridor", index, "hull")
    kind = BUILDING_TYPES[("slab", "stone", "office")[int(style.integers(3))]]
    hull = soup.add_object(
        "building", kind.tints[int(style.integers(len(kind.tints)))], style=kind.style,
        pitch=kind.cell_m, floor=kind.floor_m, win_w=kind.window[0], win_h=kind.window[1],
        second=kind.second, seed=int(style.integers(1 << 20)), top=8.0, ground=0,
    )  # fmt: skip
    half, top = 5.5, 7.4
    roof = soup.add_object("building", (0.24, 0.24, 0.25))
    for side in (-1.0, 1.0):
        outline = np.array([[x + side * half, y0], [x + side * half, y1]])
        soup.walls(outline, -0.5, top, Material.FACADE, hull, ground=0.0, cell_m=kind.cell_m)
    for y in (y0, y1):
        for a, b in ((x - half, x - w), (x + w, x + half)):
            sheet((a, y, -0.5), (b, y, -0.5), (b, y, top), (a, y, top), Material.PLAIN, hull)
        sheet((x - w, y, h), (x + w, y, h), (x + w, y, top), (x - w, y, top), Material.PLAIN, hull)
        canopy = soup.add_object("building", (0.20, 0.21, 0.22))
        out = -1.0 if y == y0 else 1.0
        outline = rectangle((x, y + out * 0.9), 4.2, 1.8, 0.0)
        soup.block(outline, h + 0.15, h + 0.35, Material.PLAIN, canopy, floor=True)
    soup.cap(rectangle((x, (y0 + y1) / 2), 2 * half, y1 - y0, 0.0), top, Material.ROOF, roof)
    plan.solid.append((x, (y0 + y1) / 2, math.pi / 2, (y1 - y0) / 2, half))


# -------------------------------------------------------------------------------------- buildings


def _choose_parks(plan: _Plan) -> None:
    """Make blocks without a diagonal into parks, in the west and in the east of the town."""
    spec, rng = plan.spec, plan.rng("parks")
    nodes = np.array(plan.nodes)
    diagonals = [s for s in plan.streets if s.kind == "street"]
    free: list[tuple[float, float, float, float]] = []
    for i in range(spec.columns - 1):
        for j in range(spec.rows - 1):
            corner = [i * spec.rows + j, (i + 1) * spec.rows + j]
            ring = nodes[[corner[0], corner[1], corner[0] + 1, corner[1] + 1]]
            x0, x1 = ring[[0, 2], 0].max(), ring[[1, 3], 0].min()
            y0, y1 = ring[[0, 1], 1].max(), ring[[2, 3], 1].min()
            middle = ring.mean(axis=0)
            crossed = any(np.hypot(*(street.line - middle).T).min() < 20.0 for street in diagonals)
            if not crossed:
                free.append((x0 + 11.0, y0 + 11.0, x1 - 11.0, y1 - 11.0))
    if not free:
        return
    ordered = sorted(free)
    wanted = max(1, len(free) // 6)
    picks = {int(len(ordered) * (k + rng.random()) / (wanted + 1e-9)) for k in range(wanted)}
    for pick in sorted(min(p, len(ordered) - 1) for p in picks):
        x0, y0, x1, y1 = ordered[pick]
        plan.zones.append(Zone((x0, y0, -5.0), (x1, y1, 30.0), "park", False, 0.0))
        centre = ((x0 + x1) / 2, (y0 + y1) / 2)
        plan.taken.append((*centre, 0.0, (x1 - x0) / 2, (y1 - y0) / 2))


def _line_with_buildings(plan: _Plan) -> None:
    """Walk along both sides of every street and set buildings where there is room."""
    names = sorted(BUILDING_TYPES)
    for e, street in enumerate(plan.streets):
        if street.kind != "street":
            continue
        length = float(_along(street.line)[-1])
        for side in (1, -1):
            rng = plan.rng("street", e, side, "palette")
            palette = rng.choice(len(names), size=3, replace=False)
            s, slot = float(rng.uniform(10.0, 15.0)), 0
            while s < length - 16.0:
                draw = plan.rng("street", e, side, "building", slot)
                slot += 1
                kind = BUILDING_TYPES[names[palette[draw.choice(3, p=(0.55, 0.3, 0.15))]]]
                width = min(float(draw.uniform(*kind.width_m)), length - 9.0 - s)
                if width < kind.width_m[0] * 0.75:
                    s += 4.0
                    continue
                depth = float(draw.uniform(*kind.depth_m))
                setback = kind.setback_m * float(draw.uniform(0.7, 1.3))
                xy, yaw = _point_on(street.line, s + width / 2)
                out = WALK_HALF_M + 0.3 + setback + depth / 2
                normal = side * np.array([-math.sin(yaw), math.cos(yaw)])
                centre = xy + normal * out
                facing = yaw if side < 0 else yaw + math.pi  # the front looks at the street
                rect = (centre[0], centre[1], facing, width / 2 - 0.05, depth / 2)
                if _overlaps(rect, plan.taken) or _overlaps(rect, plan.solid):
                    s += 4.0
                    continue
                plan.solid.append(rect)
                _add_building(plan, kind, draw, rect, setback, f"{e}/{side}/{slot}")
                s += width + float(draw.uniform(*kind.gap_m))


def _add_building(
    plan: _Plan, kind: BuildingType, rng: np.random.Generator, rect: Rect, setback: float, path: str
) -> None:
    """One building; its local frame has x along the front and y from the front to the back."""
    soup = plan.soup
    x, y, yaw, half_w, half_d = rect
    outline = rectangle((x, y), 2 * half_w, 2 * half_d, yaw)
    ground = float(plan.hills(outline).mean())
    storeys = int(rng.integers(kind.storeys[0], kind.storeys[1] + 1))
    plinth = 0.35
    top = ground + plinth + storeys * kind.floor_m
    tint = np.array(kind.tints[int(rng.integers(len(kind.tints)))]) * rng.uniform(0.82, 1.15)
    second = np.array(kind.second) * rng.uniform(0.8, 1.1)
    if "awning" in kind.extras:
        second = np.array([(0.10, 0.22, 0.16), (0.30, 0.06, 0.06), (0.08, 0.12, 0.24),
                           (0.35, 0.26, 0.10), (0.12, 0.12, 0.12)])[rng.integers(5)]  # fmt: skip
    owner = soup.add_object(
        "building", tint, style=kind.style, pitch=kind.cell_m, floor=kind.floor_m,
        win_w=kind.window[0] * float(rng.uniform(0.92, 1.08)), win_h=kind.window[1],
        second=second, seed=keyed_seed(plan.spec.seed, "building", path) & 0xFFFFF,
        top=top - ground, ground=kind.ground,
    )  # fmt: skip
    roof = soup.add_object("roof", np.array(ROOF_TINTS[int(rng.integers(len(ROOF_TINTS)))]))
    trim = soup.add_object("trim", second)

    def local(points: Sequence[Sequence[float]]) -> np.ndarray:
        """(x along the front, y behind the front, z above the ground) -> world."""
        p = np.asarray(points, float)
        c, s = math.cos(yaw), math.sin(yaw)
        px, py = p[..., 0], half_d - p[..., 1]
        return np.stack([x + c * px - s * py, y + s * px + c * py, ground + p[..., 2]], axis=-1)

    def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float, material: Material,
            who: int, lid: Material | None = None) -> None:  # fmt: skip
        base = local([(x0, y1, 0), (x1, y1, 0), (x1, y0, 0), (x0, y0, 0)])[:, :2]
        if material == Material.FACADE:
            soup.walls(
                base, ground + z0, ground + z1, material, who, ground=ground, cell_m=kind.cell_m
            )
            soup.cap(base, ground + z1, Material.ROOF if lid is None else lid, roof)
        else:
            soup.block(base, ground + z0, ground + z1, material, who, lid=lid, floor=z0 > 0.5)

    height = top - ground
    bottom = -1.2
    soup.walls(
        outline, ground + bottom, top, Material.FACADE, owner, ground=ground, cell_m=kind.cell_m
    )
    depth = 2 * half_d
    if kind.roof == "flat":
        soup.cap(outline, top, Material.ROOF, roof)
        rim = 0.5
        for x0, x1, y0, y1 in (
            (-half_w, half_w, -0.12, 0.14), (-half_w, half_w, depth - 0.14, depth + 0.12),
            (-half_w - 0.12, -half_w + 0.14, 0, depth), (half_w - 0.14, half_w + 0.12, 0, depth),
        ):  # fmt: skip
            box(x0, x1, y0, y1, height - 0.25, height + rim, Material.PLAIN, trim)
        if rng.random() < 0.6:  # stair head or plant room
            a = float(rng.uniform(-half_w * 0.6, half_w * 0.2))
            box(a, a + 4.0, depth * 0.4, depth * 0.75, height, height + 2.4, Material.PLAIN, trim)
    else:
        rise = (
            float(rng.uniform(0.55, 0.75)) * half_d * (0.45 if kind.style == METAL_SHEET else 1.0)
        )
        over, ridge = 0.35, height + rise
        inset = half_w if kind.roof == "gable" else max(half_w - half_d * 0.8, 0.3)
        reach = over if kind.roof == "gable" else 0.0
        a, b = -half_w - over, half_w + over
        ra, rb = -inset - reach, inset + reach
        low = height - over * rise / half_d
        front = local([(a, -over, low), (b, -over, low), (rb, half_d, ridge), (ra, half_d, ridge)])
        back = local(
            [
                (b, depth + over, low),
                (a, depth + over, low),
                (ra, half_d, ridge),
                (rb, half_d, ridge),
            ]
        )
        soup.quads(np.stack([front, back]), Material.ROOF, roof)
        for end, mid in ((-half_w, ra), (half_w, rb)):
            if kind.roof == "gable":
                gable = local([(end, 0, height), (end, depth, height), (end, half_d, ridge),
                               (end, half_d, ridge)])  # fmt: skip
                soup.quads(gable[None], Material.PLAIN, owner)
            else:
                e = end + math.copysign(over, end)
                hip = local([(e, -over, low), (e, depth + over, low), (mid, half_d, ridge),
                             (mid, half_d, ridge)])  # fmt: skip
                soup.quads(hip[None], Material.ROOF, roof)
        if "chimney" in kind.extras:
            for _ in range(int(rng.integers(1, 3))):
                a = float(rng.uniform(-half_w + 0.5, half_w - 1.2))
                box(
                    a,
                    a + 0.9,
                    half_d - 0.3,
                    half_d + 0.4,
                    height,
                    ridge + 1.1,
                    Material.PLAIN,
                    owner,
                )
    cells = max(round(2 * half_w / kind.cell_m), 1)
    cell = 2 * half_w / cells
    if "cornice" in kind.extras:
        box(
            -half_w - 0.3,
            half_w + 0.3,
            -0.35,
            0.0,
            height - 0.5,
            height - 0.1,
            Material.PLAIN,
            trim,
        )
        z = plinth + kind.floor_m
        box(-half_w, half_w, -0.14, 0.0, z - 0.15, z + 0.1, Material.PLAIN, trim)
    if "bay" in kind.extras and rng.random() < 0.75:
        step = int(rng.integers(2, 5))
        bay_top = plinth + kind.floor_m * int(rng.integers(1, storeys + 1))
        for k in range(int(rng.integers(step)), cells, step):
            a = -half_w + k * cell + 0.15
            box(a, a + cell - 0.3, -0.8, 0.0, bottom, bay_top, Material.FACADE, owner)
    if "balcony" in kind.extras and rng.random() < 0.8:
        step, first = int(rng.integers(2, 4)), int(rng.integers(3))
        reach = float(rng.uniform(0.9, 1.6))
        for k in range(first, cells, step):
            a = -half_w + k * cell + 0.1
            b = min(a + cell - 0.2, half_w - 0.1)
            for f in range(1, storeys):
                z = plinth + f * kind.floor_m
                box(a, b, -reach, 0.0, z - 0.12, z + 0.04, Material.PLAIN, trim)
                rail = local(
                    [(a, -reach, z), (b, -reach, z), (b, -reach, z + 1.0), (a, -reach, z + 1.0)]
                )
                soup.quads(rail[None], Material.PLAIN, trim)
    if "awning" in kind.extras and rng.random() < 0.8:
        z, reach = plinth + kind.floor_m - 0.45, float(rng.uniform(1.0, 1.8))
        cloth = local([(-half_w + 0.4, -reach, z - 0.7), (half_w - 0.4, -reach, z - 0.7),
                       (half_w - 0.4, 0, z), (-half_w + 0.4, 0, z)])  # fmt: skip
        soup.quads(cloth[None], Material.PLAIN, trim)
    if "recess" in kind.extras:  # a wing that stands forward, at one end
        wing = float(rng.uniform(0.25, 0.45)) * 2 * half_w
        a = -half_w if rng.random() < 0.5 else half_w - wing
        forward = min(float(rng.uniform(1.2, 2.6)), max(setback - 0.3, 0.4))
        box(a, a + wing, -forward, 0.0, bottom, height - kind.floor_m * int(rng.integers(0, 2)),
            Material.FACADE, owner)  # fmt: skip
    if "porch" in kind.extras:
        a = float(rng.uniform(-half_w + 1.0, half_w - 3.0))
        box(a, a + 2.2, -1.4, 0.0, 2.45, 2.65, Material.PLAIN, trim)
        for px in (a + 0.1, a + 2.0):
            box(px, px + 0.12, -1.3, -1.18, bottom, 2.45, Material.PLAIN, trim)
    if "hedge" in kind.extras and rng.random() < 0.75:
        hedge = soup.add_object("hedge", np.array([0.075, 0.13, 0.04]) * rng.uniform(0.8, 1.3))
        tall = float(rng.uniform(0.8, 1.7))
        gate = float(rng.uniform(-half_w + 1.0, half_w - 2.5))
        for a, b in ((-half_w, gate), (gate + 1.6, half_w)):
            box(a, b, -setback + 0.1, -setback + 0.8, -0.4, tall, Material.HEDGE, hedge)
    elif setback > 3.0 and rng.random() < 0.5:  # a low wall or a fence to the street
        wall = float(rng.uniform(0.5, 1.1))
        box(
            -half_w, half_w * 0.2, -setback + 0.1, -setback + 0.35, -0.4, wall, Material.PLAIN, trim
        )


# -------------------------------------------------------------------------------------- furniture


def _pole(
    plan: _Plan, xy: Sequence[float], z: float, height: float, radius: float, owner: int
) -> None:
    plan.soup.walls(disc(xy, radius, 5), z - 0.3, z + height, Material.METAL, owner)


def _blocked(plan: _Plan, xy: Sequence[float], radius: float) -> bool:
    """Whether a disc would touch a building."""
    return _overlaps((xy[0], xy[1], 0.0, radius, radius), plan.solid)


def _in_road(plan: _Plan, xy: np.ndarray, own: int, clearance: float) -> bool:
    """Whether a point is on another street's road or on a path."""
    for index, street in enumerate(plan.streets):
        if index == own or street.kind == "corridor":
            continue
        half = (ROAD_HALF_M if street.kind == "street" else 1.7) + clearance
        if np.hypot(*(street.line - xy).T).min() < half + 1.0:
            return True
    return False


def _furnish_streets(plan: _Plan) -> None:
    """Lamps, trees, signs, shelters, cabinets, benches along the pavements."""
    soup = plan.soup
    for e, street in enumerate(plan.streets):
        if street.kind == "corridor":
            continue
        rng = plan.rng("street", e, "furniture")
        length = float(_along(street.line)[-1])
        edge = ROAD_HALF_M + 0.75 if street.kind == "street" else 2.6
        metal = soup.add_object("pole", np.array([0.22, 0.23, 0.24]) * rng.uniform(0.6, 1.5))
        lamp_height = float(rng.choice([5.0, 6.5, 8.0])) if street.kind == "street" else 4.2
        glow = soup.add_object(
            "lamp", (1.0, 0.80, 0.52) if rng.random() < 0.6 else (0.9, 0.93, 1.0)
        )
        power = np.array(soup._rows[glow][:3]) * 0.085 * lamp_height
        pitch = float(rng.uniform(24.0, 33.0))
        s, side = float(rng.uniform(6.0, 14.0)), int(rng.choice([-1, 1]))
        both = rng.random() < 0.25
        while s < length - 5.0:
            for k in (side, -side) if both else (side,):
                xy, yaw = _point_on(street.line, s)
                across = np.array([-math.sin(yaw), math.cos(yaw)]) * k
                foot = xy + across * edge
                if not _in_road(plan, foot, e, 0.3) and not _blocked(plan, foot, 0.4):
                    z = plan.hills.at(foot)
                    _pole(plan, foot, z, lamp_height, 0.085, metal)
                    head = foot - across * (1.5 if street.kind == "street" else 0.2)
                    middle = (foot + head) / 2
                    arm = rectangle(middle, 0.1, 1.5, yaw)
                    soup.block(
                        arm, z + lamp_height - 0.05, z + lamp_height + 0.05, Material.METAL, metal
                    )
                    shade = rectangle(head, 0.35, 0.8, yaw)
                    soup.block(
                        shade, z + lamp_height + 0.02, z + lamp_height + 0.16, Material.METAL, metal
                    )
                    soup.cap(shade, z + lamp_height, Material.LAMP, glow)
                    plan.lamps.append((*head, z + lamp_height - 0.1, *power, -1.0, 0.0))
            side = -side
            s += pitch * float(rng.uniform(0.9, 1.1))
        _plant_street(plan, e, street, length, edge)
        if street.kind == "street":
            _place_small_things(plan, e, street, length)


def _plant_street(plan: _Plan, e: int, street: Street, length: float, edge: float) -> None:
    """Street trees: kind, spacing and sides belong to the street; gaps and sizes to the tree."""
    rng = plan.rng("street", e, "trees")
    if rng.random() < (0.35 if street.kind == "street" else 0.1):
        return
    kind = TREE_KINDS[int(rng.choice(3, p=(0.65, 0.25, 0.10)))]
    sides = (1, -1) if rng.random() < 0.5 else (int(rng.choice([1, -1])),)
    pitch, size = float(rng.uniform(9.0, 20.0)), float(rng.uniform(5.0, 9.0))
    tint = np.array((0.085, 0.135, 0.035)) * rng.uniform(0.8, 1.3) * rng.uniform(0.85, 1.15, 3)
    for side in sides:
        s, k = float(rng.uniform(10.0, 18.0)), 0
        while s < length - 10.0:
            own = plan.rng("street", e, side, "tree", k)
            k += 1
            xy, yaw = _point_on(street.line, s)
            across = np.array([-math.sin(yaw), math.cos(yaw)]) * side
            out = (
                edge + 0.3 + float(own.uniform(0.0, 0.7)) + (1.5 if street.kind == "path" else 0.0)
            )
            foot = xy + across * out
            height = size * float(own.uniform(0.75, 1.2))
            crown = height * {"round": 0.3, "column": 0.12, "conifer": 0.2}[kind]
            if (
                own.random() > 0.15
                and not _in_road(plan, foot, e, 1.2)
                and not _blocked(plan, foot, crown)
            ):
                _grow(plan, foot, kind, height, own, tint)
            s += pitch * float(own.uniform(0.8, 1.25))


def _grow(
    plan: _Plan,
    xy: np.ndarray,
    kind: str,
    height: float,
    rng: np.random.Generator,
    tint: np.ndarray,
) -> None:
    variant, yaw = int(rng.integers(TREE_VARIANTS)), float(rng.uniform(0, 2 * np.pi))
    r, g, b = (tint * rng.uniform(0.88, 1.12)).tolist()
    add_tree(plan.soup, xy, plan.hills.at(xy), kind, variant, height, yaw, (r, g, b), plan.crowns)


def _place_small_things(plan: _Plan, e: int, street: Street, length: float) -> None:
    soup = plan.soup
    makers: list[Callable[[np.ndarray, float, float, np.random.Generator], None]] = []

    def sign(xy: np.ndarray, z: float, yaw: float, rng: np.random.Generator) -> None:
        post = soup.add_object("pole", (0.4, 0.4, 0.4))
        _pole(plan, xy, z, 2.7, 0.04, post)
        tint = [(0.55, 0.03, 0.03), (0.03, 0.10, 0.45), (0.65, 0.60, 0.05), (0.6, 0.6, 0.6)]
        plate = soup.add_object("sign", tint[int(rng.integers(4))], style=int(rng.integers(3)))
        half = float(rng.uniform(0.28, 0.42))
        c, s = math.cos(yaw + math.pi / 2), math.sin(yaw + math.pi / 2)
        face = [(-half, 2.0), (half, 2.0), (half, 2.0 + 2 * half), (-half, 2.0 + 2 * half)]
        back = np.array([math.cos(yaw), math.sin(yaw)]) * 0.05
        soup.quads(
            np.array([[(xy[0] - back[0] + c * a, xy[1] - back[1] + s * a, z + h) for a, h in face]]),
            Material.SIGN, plate, np.array([[(-1, -1), (1, -1), (1, 1), (-1, 1)]], float),
        )  # fmt: skip

    def cabinet(xy: np.ndarray, z: float, yaw: float, rng: np.random.Generator) -> None:
        tints = [(0.16, 0.24, 0.18), (0.35, 0.35, 0.34), (0.45, 0.08, 0.06), (0.5, 0.42, 0.08)]
        owner = soup.add_object("cabinet", tints[int(rng.integers(4))])
        size = rng.uniform((0.6, 0.4, 0.9), (1.6, 0.7, 1.7))
        soup.block(
            rectangle(xy, size[0], size[1], yaw), z - 0.2, z + size[2], Material.PLAIN, owner
        )

    def bench(xy: np.ndarray, z: float, yaw: float, rng: np.random.Generator) -> None:
        owner = soup.add_object("bench", (0.30, 0.18, 0.09))
        soup.block(
            rectangle(xy, 1.7, 0.45, yaw), z + 0.4, z + 0.48, Material.PLAIN, owner, floor=True
        )
        for k in (-0.7, 0.7):
            foot = xy + np.array([math.cos(yaw), math.sin(yaw)]) * k
            soup.block(rectangle(foot, 0.08, 0.4, yaw), z - 0.2, z + 0.4, Material.PLAIN, owner)

    def shelter(xy: np.ndarray, z: float, yaw: float, rng: np.random.Generator) -> None:
        frame = soup.add_object("shelter", (0.16, 0.17, 0.18))
        soup.block(
            rectangle(xy, 4.2, 1.6, yaw), z + 2.35, z + 2.5, Material.PLAIN, frame, floor=True
        )
        for a, b in ((-2.0, -0.7), (2.0, -0.7), (-2.0, 0.7), (2.0, 0.7)):
            c, s = math.cos(yaw), math.sin(yaw)
            _pole(plan, (xy[0] + c * a - s * b, xy[1] + s * a + c * b), z, 2.35, 0.05, frame)
        advert = soup.add_object("sign", rng.uniform(0.1, 0.6, 3), seed=int(rng.integers(1 << 20)))
        end = xy + np.array([math.cos(yaw), math.sin(yaw)]) * 1.95
        panel = rectangle(end, 0.12, 1.2, yaw)
        soup.walls(panel, z + 0.3, z + 2.1, Material.NOTICE, advert)

    def bollards(xy: np.ndarray, z: float, yaw: float, rng: np.random.Generator) -> None:
        owner = soup.add_object("bollard", (0.12, 0.12, 0.13))
        for k in range(int(rng.integers(3, 7))):
            foot = xy + np.array([math.cos(yaw), math.sin(yaw)]) * 1.4 * k
            _pole(plan, foot, plan.hills.at(foot), 1.0, 0.08, owner)

    def post(xy: np.ndarray, z: float, yaw: float, rng: np.random.Generator) -> None:
        owner = soup.add_object("pole", (0.24, 0.18, 0.12))
        _pole(plan, xy, z, float(rng.uniform(6.0, 9.0)), 0.12, owner)

    def column(xy: np.ndarray, z: float, yaw: float, rng: np.random.Generator) -> None:
        owner = soup.add_object("column", rng.uniform(0.1, 0.6, 3), seed=int(rng.integers(1 << 20)))
        soup.walls(disc(xy, 0.65, 10), z - 0.2, z + 3.0, Material.NOTICE, owner)
        soup.block(disc(xy, 0.75, 10), z + 3.0, z + 3.25, Material.PLAIN, owner, floor=True)

    makers = [sign, cabinet, bench, shelter, bollards, post, column]
    odds = np.array((0.30, 0.18, 0.12, 0.06, 0.14, 0.14, 0.06))
    count = int(plan.rng("street", e, "things").poisson(length / 11.0))
    for k in range(count):
        rng = plan.rng("street", e, "thing", k)
        s, side = float(rng.uniform(11.0, max(length - 11.0, 12.0))), float(rng.choice([-1.0, 1.0]))
        make = makers[int(rng.choice(len(makers), p=odds))]
        xy, yaw = _point_on(street.line, s)
        inner = make in (shelter, bench, column, cabinet)
        out = side * (float(rng.uniform(7.6, 8.1)) if inner else ROAD_HALF_M + 0.5)
        foot = xy + np.array([-math.sin(yaw), math.cos(yaw)]) * out
        if _in_road(plan, foot, e, 1.0) or _blocked(plan, foot, 0.9):
            continue
        make(foot, plan.hills.at(foot) + 0.12, yaw, rng)


def _plant_parks(plan: _Plan) -> None:
    parks = [zone for zone in plan.zones if zone.kind == "park"]
    for p, zone in enumerate(parks):
        rng = plan.rng("park", p)
        (x0, y0, _), (x1, y1, _) = zone.lower, zone.upper
        area = (x1 - x0) * (y1 - y0)
        kinds = rng.choice(3, p=(0.5, 0.2, 0.3), size=3)
        placed: list[np.ndarray] = []
        for k in range(int(area / 70.0)):
            own = plan.rng("park", p, "tree", k)
            xy = own.uniform((x0, y0), (x1, y1))
            if any(np.hypot(*(xy - other)) < 4.5 for other in placed):
                continue
            placed.append(xy)
            kind = TREE_KINDS[int(kinds[int(own.integers(3))])]
            tint = (
                np.array((0.08, 0.13, 0.035)) * own.uniform(0.7, 1.35) * own.uniform(0.85, 1.15, 3)
            )
            _grow(plan, xy, kind, float(own.uniform(4.5, 12.0)), own, tint)
        hedge = plan.soup.add_object("hedge", np.array([0.07, 0.12, 0.035]) * rng.uniform(0.8, 1.3))
        tall = float(rng.uniform(0.7, 1.3))
        sides = (
            ((x0, y0), (x1, y0)),
            ((x1, y0), (x1, y1)),
            ((x1, y1), (x0, y1)),
            ((x0, y1), (x0, y0)),
        )
        for a, b in sides:
            if rng.random() < 0.35:
                continue
            start, end = np.array(a), np.array(b)
            pieces = int(np.hypot(*(end - start)) // 6)
            gate = int(rng.integers(pieces))
            for k in range(pieces):
                if k == gate:
                    continue
                p0, p1 = (
                    start + (end - start) * k / pieces,
                    start + (end - start) * (k + 1) / pieces,
                )
                d = p1 - p0
                bed = rectangle((p0 + p1) / 2, float(np.hypot(*d)), 0.8, math.atan2(d[1], d[0]))
                z = plan.hills.at((p0 + p1) / 2)
                plan.soup.block(bed, z - 0.5, z + tall, Material.HEDGE, hedge)


# ----------------------------------------------------------------------------------- what changes


def build_vehicles(
    world: World,
    run_seed: int,
    parked: float,
    traffic: float,
    path: Float[np.ndarray, "n 2"],
) -> Soup:
    """Vehicles of one run: parked at the kerbs, and caught in the other lane.

    `parked` is the share of places taken, `traffic` the vehicles per 40 m of street; nothing
    stands on the `path` that the run takes.
    """
    soup = SoupBuilder()
    way = KDTree(path)

    def put(rng: np.random.Generator, xy: np.ndarray, heading: float) -> None:
        if way.query(xy)[0] > 2.0:
            add_vehicle(soup, rng, xy, world.hills.at(xy), heading)

    for e, street in enumerate(world.streets):
        if street.kind != "street":
            continue
        length = float(_along(street.line)[-1])
        busy = keyed_rng(world.spec.seed, "street", e, "parking").uniform(0.2, 1.8, 2)
        for side in (1, -1):
            s, k = 15.0, 0
            while s < length - 16.0:
                rng = keyed_rng(run_seed, "street", e, side, "parked", k)
                k += 1
                taken = rng.random() < parked * busy[(side + 1) // 2]
                if taken:
                    xy, yaw = _point_on(street.line, s + float(rng.uniform(-0.4, 0.4)))
                    lateral = side * (PARKING_M + float(rng.uniform(-0.15, 0.15)))
                    foot = xy + lateral * np.array([-math.sin(yaw), math.cos(yaw)])
                    heading = yaw + (math.pi if side > 0 else 0.0) + float(rng.normal(0.0, 0.02))
                    put(rng, foot, heading)
                s += 5.9
        rng = keyed_rng(run_seed, "street", e, "traffic")
        # both lanes' directions are driven: the passing lane is the left one of either
        for s in rng.uniform(20.0, max(length - 20.0, 21.0), rng.poisson(traffic * length / 40.0)):
            xy, yaw = _point_on(street.line, float(s))
            side = float(rng.choice([-1.0, 1.0]))
            foot = xy + side * 2.3 * np.array([-math.sin(yaw), math.cos(yaw)])
            put(rng, foot, yaw + (math.pi if side > 0 else 0.0))
    return soup.build()
