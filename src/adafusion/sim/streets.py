# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The street graph and what is underfoot: a jittered grid, curves, diagonals, hills, kerbs."""

from __future__ import annotations

import itertools
import math

import numpy as np
from jaxtyping import Float

from adafusion.sim.corridors import lay_out_corridor
from adafusion.sim.plan import (
    KERB_M,
    PATH_HALF_M,
    ROAD_HALF_M,
    WALK_HALF_M,
    Hills,
    Plan,
    Street,
    along,
    arc,
    offset_line,
    trimmed,
)
from adafusion.sim.shapes import Material, disc

MARGIN_M = 110.0  # open land around the town
CLEAR_M = 9.5  # of a crossing: kerbs begin there
_ASPHALT_RGB = (0.105, 0.105, 0.11)


def lay_out_streets(plan: Plan) -> None:
    """Draw the graph, the ground that its streets take, and the hills."""
    spec, rng = plan.spec, plan.rng("streets")
    x = np.cumsum(rng.uniform(0.88, 1.14, spec.columns)) * spec.spacing_m
    y = np.cumsum(rng.uniform(0.88, 1.14, spec.rows)) * spec.spacing_m
    x, y = x - x.mean(), y - y.mean()
    grid = {}
    for i in range(spec.columns):
        for j in range(spec.rows):
            dx, dy = rng.uniform(-6.5, 6.5, 2).tolist()
            grid[i, j] = len(plan.nodes)
            plan.nodes.append((float(x[i]) + dx, float(y[j]) + dy))
    edges = [((i, j), (i + 1, j)) for i in range(spec.columns - 1) for j in range(spec.rows)]
    edges += [((i, j), (i, j + 1)) for i in range(spec.columns) for j in range(spec.rows - 1)]
    curved = set(rng.permutation(len(edges))[: max(1, len(edges) // 7)].tolist())
    for index, (a, b) in enumerate(edges):
        start, end = np.array(plan.nodes[grid[a]]), np.array(plan.nodes[grid[b]])
        bulge = float(rng.choice([-1, 1]) * rng.uniform(8.0, 13.0)) if index in curved else 0.0
        plan.streets.append(Street((grid[a], grid[b]), arc(start, end, bulge), "street"))
    # oblique streets: diagonals of single blocks
    blocks = [(i, j) for i in range(spec.columns - 1) for j in range(spec.rows - 1)]
    for k in rng.permutation(len(blocks))[: max(1, len(blocks) // 6)]:
        i, j = blocks[k]
        p, q = ((i, j), (i + 1, j + 1)) if rng.random() < 0.5 else ((i + 1, j), (i, j + 1))
        line = arc(np.array(plan.nodes[grid[p]]), np.array(plan.nodes[grid[q]]))
        plan.streets.append(Street((grid[p], grid[q]), line, "street"))
    for k in range(spec.corridors):
        column = 0 if k % 2 == 0 else spec.columns - 1
        beside = [grid[column, j] for j in range(spec.rows)]
        lay_out_corridor(plan, beside, west=column == 0)
    # a path may not use what a building wants, nor a building what a path wants
    for street in plan.streets:
        half = WALK_HALF_M if street.kind == "street" else 3.0
        for start, end in itertools.pairwise(street.line):
            (x, y), d = ((start + end) / 2).tolist(), end - start
            reach = float(np.hypot(*d)) / 2 + 1.0
            plan.taken.append((x, y, math.atan2(d[1], d[0]), reach, half))
    plan.hills = _raise_hills(plan)


def _raise_hills(plan: Plan) -> Hills:
    rng = plan.rng("hills")
    k, angle = 2 * np.pi / rng.uniform(150.0, 280.0, 5), rng.uniform(0, 2 * np.pi, 5)
    amplitude = rng.uniform(0.3, 0.9, 5)
    phase = rng.uniform(0, 2 * np.pi, 5)
    table = np.stack([amplitude, k * np.cos(angle), k * np.sin(angle), phase], axis=1)
    return Hills(table, tuple(plan.zones))


def pave(plan: Plan) -> None:
    """Ground, roads with kerbs and pavements, crossings."""
    _lay_grass(plan)
    paving = plan.soup.add_object("pavement", (0.36, 0.35, 0.33))
    kerb = plan.soup.add_object("kerb", (0.42, 0.41, 0.39))
    marks = plan.rng("markings")
    for index, street in enumerate(plan.streets):
        if street.kind == "path":
            edges = ((PATH_HALF_M, 0.0), (-PATH_HALF_M, 0.0))
            _strip(plan, street.line, *edges, Material.PAVING, paving)
        elif street.kind == "street":
            _pave_street(plan, index, marks, paving, kerb)
    _pave_crossings(plan, paving)


def _lay_grass(plan: Plan) -> None:
    """Ground in squares of 7 m, a little below what is paved."""
    grass = plan.soup.add_object("ground", (0.11, 0.16, 0.045))
    xy = np.array(plan.nodes)
    low, high = xy.min(axis=0) - MARGIN_M, xy.max(axis=0) + MARGIN_M
    gx, gy = (np.linspace(a, b, math.ceil((b - a) / 7.0)) for a, b in zip(low, high, strict=True))
    grid = np.stack(np.meshgrid(gx, gy, indexing="ij"), axis=-1)
    z = plan.hills(grid.reshape(-1, 2)).reshape(*grid.shape[:2], 1) - 0.06
    points = np.concatenate([grid, z], axis=2)
    cells = np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], axis=2)
    cells = cells.reshape(-1, 4, 3)
    plan.soup.quads(cells, Material.GRASS, grass, cells[:, :, :2])


def _pave_street(
    plan: Plan, index: int, marks: np.random.Generator, paving: int, kerb: int
) -> None:
    line = plan.streets[index].line
    # style of the markings: 0 none, 1 dashed middle line, 2 solid, 3 parking bays only
    style = int(marks.choice(4, p=(0.2, 0.45, 0.2, 0.15)))
    road = plan.soup.add_object("road", _ASPHALT_RGB, style=style)
    across = ((ROAD_HALF_M, 0.0), (-ROAD_HALF_M, 0.0))
    _strip(plan, line, *across, Material.ASPHALT, road)
    between = trimmed(line, CLEAR_M, CLEAR_M)
    if between is None:
        return
    for side in (1.0, -1.0):
        inner, outer = side * ROAD_HALF_M, side * WALK_HALF_M
        rim = inner + side * 0.18
        _strip(plan, between, (inner, 0.0), (inner, KERB_M), Material.PLAIN, kerb)
        _strip(plan, between, (inner, KERB_M), (rim, KERB_M), Material.PLAIN, kerb)
        _strip(plan, between, (rim, KERB_M), (outer, KERB_M), Material.PAVING, paving)
        _strip(plan, between, (outer, KERB_M), (outer, -0.1), Material.PLAIN, kerb)
    if marks.random() < 0.45:
        stripes = plan.soup.add_object("road", (0.62, 0.62, 0.60), seed=index)
        rest = float(along(line)[-1]) - 14.0
        above = ((ROAD_HALF_M, 0.02), (-ROAD_HALF_M, 0.02))
        for zebra in (trimmed(line, 11.0, rest), trimmed(line, rest, 11.0)):
            if zebra is not None:
                _strip(plan, zebra, *above, Material.STRIPES, stripes)


def _pave_crossings(plan: Plan, paving: int) -> None:
    """A disc of asphalt over the ends of the roads, on a wider one of paving for the corners."""
    plain = plan.soup.add_object("road", _ASPHALT_RGB)
    used = {n for street in plan.streets if street.kind == "street" for n in street.ends}
    for node in sorted(used):
        for radius, lift, material, owner in (
            (13.0, -0.03, Material.PAVING, paving),
            (8.6, 0.012, Material.ASPHALT, plain),
        ):
            rim = disc(plan.nodes[node], radius, 12)
            ring = np.column_stack([rim, plan.hills(rim) + lift])
            centre = np.array([*plan.nodes[node], plan.hills.at(plan.nodes[node]) + lift])
            after = np.roll(ring, -1, axis=0)
            corners = np.stack([np.tile(centre, (12, 1)), ring, after, after], axis=1)
            uv = corners[:, :, :2] - np.array(plan.nodes[node]) + 20.0  # away from lane markings
            plan.soup.quads(corners, material, owner, uv)


def _strip(
    plan: Plan,
    line: Float[np.ndarray, "n 2"],
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
    s = along(line)
    corners = np.stack([edges[0][:-1], edges[0][1:], edges[1][1:], edges[1][:-1]], axis=1)
    across = a[0] if a[0] != b[0] else a[1], b[0] if a[0] != b[0] else b[1]
    uv = np.empty((len(corners), 4, 2))
    uv[:, :2, 0], uv[:, 2:, 0] = across
    uv[:, 0, 1] = uv[:, 3, 1] = s[:-1]
    uv[:, 1, 1] = uv[:, 2, 1] = s[1:]
    plan.soup.quads(corners, material, object_id, uv)
