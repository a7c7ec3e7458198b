# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The street graph and what is underfoot: a jittered grid, curves, diagonals, hills, kerbs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float64

from adafusion.sim.town.passages import COURT_HALF_M, court_rects, lay_out_passages
from adafusion.sim.town.plan import (
    INDOORS,
    KERB_M,
    PATH_HALF_M,
    ROAD_HALF_M,
    WALK_HALF_M,
    Hills,
    Plan,
    Rect,
    Street,
    along,
    arc,
    offset_line,
    resampled,
    touches,
    trimmed,
)
from adafusion.sim.town.shapes import Material, disc

MARGIN_M = 110.0  # open land around the town
CROSSING_M = 9.5  # of a crossing: kerbs begin there
LEVEL_M = 25.0  # around passages: their courts and a little more
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
    lay_out_passages(plan, [rect for street in plan.streets for rect in _ground_of(street)])
    plan.taken.extend(rect for street in plan.streets for rect in _ground_of(street))
    plan.ways = np.concatenate([_points_of(e, street) for e, street in enumerate(plan.streets)])
    plan.hills = _raise_hills(plan)


def _ground_of(street: Street) -> Iterator[Rect]:
    """The ground that a street or path takes, piece by piece."""
    half = WALK_HALF_M if street.kind == "street" else 3.0
    for start, end in itertools.pairwise(street.line):
        (x, y), d = ((start + end) / 2).tolist(), end - start
        yield x, y, math.atan2(d[1], d[0]), float(np.hypot(*d)) / 2 + 1.0, half


def _points_of(number: int, street: Street) -> Float64[np.ndarray, "n 4"]:
    """The rows of `Plan.ways` of one street; none for what lies indoors."""
    line = street.line[:0] if street.kind in INDOORS else street.line
    half = ROAD_HALF_M if street.kind == "street" else PATH_HALF_M
    return np.column_stack([line, np.full(len(line), half), np.full(len(line), float(number))])


def _raise_hills(plan: Plan) -> Hills:
    rng = plan.rng("hills")
    k, angle = 2 * np.pi / rng.uniform(150.0, 280.0, 5), rng.uniform(0, 2 * np.pi, 5)
    amplitude = rng.uniform(0.3, 0.9, 5)
    phase = rng.uniform(0, 2 * np.pi, 5)
    table = np.stack([amplitude, k * np.cos(angle), k * np.sin(angle), phase], axis=1)
    level = [
        replace(
            zone,
            lower=(zone.lower[0] - LEVEL_M, zone.lower[1] - LEVEL_M, zone.lower[2]),
            upper=(zone.upper[0] + LEVEL_M, zone.upper[1] + LEVEL_M, zone.upper[2]),
        )
        for zone in plan.zones
    ]
    return Hills(table, tuple(level))


def pave(plan: Plan) -> None:
    """Ground, roads with kerbs and pavements, crossings."""
    _lay_grass(plan)
    paving = plan.soup.add_object("pavement", (0.36, 0.35, 0.33))
    kerb = plan.soup.add_object("kerb", (0.42, 0.41, 0.39))
    marks = plan.rng("markings")
    for index, street in enumerate(plan.streets):
        if street.kind == "path":
            _pave_path(plan, street, paving)
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


def _pave_path(plan: Plan, street: Street, paving: int) -> None:
    """A footpath as far as the courts before doors, which are all alike."""
    courts = [rect for p in plan.passages for rect in court_rects(p, COURT_HALF_M)]
    s = np.arange(0.0, along(street.line)[-1], 0.5)
    line = resampled(street.line, s)
    line = line[[not touches(xy, 0.01, courts) for xy in line]]
    if len(line) > 1:
        edges = ((PATH_HALF_M, 0.0), (-PATH_HALF_M, 0.0))
        _strip(plan, arc(line[0], line[-1]), *edges, Material.PAVING, paving)


def _pave_street(
    plan: Plan, index: int, marks: np.random.Generator, paving: int, kerb: int
) -> None:
    line = plan.streets[index].line
    # style of the markings: 0 none, 1 dashed middle line, 2 solid, 3 parking bays only
    style = int(marks.choice(4, p=(0.2, 0.45, 0.2, 0.15)))
    road = plan.soup.add_object("road", _ASPHALT_RGB, style=style)
    edges = (ROAD_HALF_M, 0.0), (0.0, 0.0), (-ROAD_HALF_M, 0.0)
    for left, right in itertools.pairwise(edges):  # halves follow the slope better
        _strip(plan, line, left, right, Material.ASPHALT, road)
    length = float(along(line)[-1])
    for side in (1.0, -1.0):
        inner, outer = side * ROAD_HALF_M, side * WALK_HALF_M
        start, end = plan.clear_run(index, [inner, outer], 0.4, paths=False)
        between = trimmed(line, max(start, CROSSING_M), max(length - end, CROSSING_M))
        if between is None:
            continue
        rim = inner + side * 0.18
        _strip(plan, between, (inner, 0.0), (inner, KERB_M), Material.PLAIN, kerb)
        _strip(plan, between, (inner, KERB_M), (rim, KERB_M), Material.PLAIN, kerb)
        _strip(plan, between, (rim, KERB_M), (outer, KERB_M), Material.PAVING, paving)
        _strip(plan, between, (outer, KERB_M), (outer, -0.1), Material.PLAIN, kerb)
    if marks.random() < 0.45:
        stripes = plan.soup.add_object("road", (0.62, 0.62, 0.60), seed=index)
        rest = length - 14.0
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
            middle = np.array(plan.nodes[node])
            # in rings of about 4 m: a wider sheet would leave the slope
            radii = np.linspace(0.0, radius, math.ceil(radius / 4.4) + 1)
            rings = np.stack([disc(plan.nodes[node], r, 12) for r in radii])
            z = plan.hills(rings.reshape(-1, 2)).reshape(*rings.shape[:2], 1) + lift
            points = np.concatenate([rings, z], axis=2)
            after = np.roll(points, -1, axis=1)
            corners = np.stack([points[:-1], points[1:], after[1:], after[:-1]], axis=2)
            corners = corners.reshape(-1, 4, 3)
            uv = corners[:, :, :2] - middle + 20.0  # away from lane markings
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
