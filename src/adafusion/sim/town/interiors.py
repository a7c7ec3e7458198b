# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What the passages look like: of each kind one shape, told apart by flat paint alone.

Paint, doors and notices are drawn for every passage by its own; nothing that is solid is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from adafusion.sim.town.buildings import AS_ABOVE, BUILDING_TYPES
from adafusion.sim.town.paint import add_paint, paint_wall
from adafusion.sim.town.passages import COURT_HALF_M, COURT_M, PASSAGE_KINDS
from adafusion.sim.town.plan import Passage, Plan
from adafusion.sim.town.shapes import Material, SoupBuilder

_CONCRETE = (0.42, 0.41, 0.39)
_PAVING = (0.36, 0.35, 0.33)
_LAMP = 1.0, 0.96, 0.86
_SODIUM = 1.0, 0.78, 0.50


def build_passages(plan: Plan) -> None:
    """Build every passage laid out."""
    for number, passage in enumerate(plan.passages):
        site = _Site(plan.soup, passage, number, plan.rng("passage", number, "paint"), plan.lamps)
        _BUILDERS[passage.kind](site)
        _pave_courts(site)


@dataclass(frozen=True, eq=False)
class _Site:
    """A passage being built, in its own frame: x along the way, y to the left, z up."""

    soup: SoupBuilder
    passage: Passage
    number: int  # of the passage and its zone
    rng: np.random.Generator  # for what is flat
    lamps: list[tuple[float, ...]]

    @property
    def half(self) -> float:
        """Half the length."""
        return self.passage.length_m / 2

    def sheet(
        self,
        points: Sequence[tuple[float, float, float]],
        material: Material,
        owner: int,
        uv: Float[np.ndarray, "4 2"] | None = None,
    ) -> None:
        """Add a quad, or a triangle of three points."""
        corners = self.passage.place(np.array(points, float))[[0, 1, 2, len(points) - 1]]
        self.soup.quads(corners[None], material, owner, None if uv is None else uv[None])

    def along(
        self, y: float, x0: float, x1: float, z0: float, z1: float, material: Material, owner: int
    ) -> None:
        """Add an upright sheet along the way."""
        self.sheet([(x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1)], material, owner)

    def across(
        self, x: float, y0: float, y1: float, z0: float, z1: float, material: Material, owner: int
    ) -> None:
        """Add an upright sheet across the way."""
        self.sheet([(x, y0, z0), (x, y1, z0), (x, y1, z1), (x, y0, z1)], material, owner)

    def level(
        self, x0: float, x1: float, y0: float, y1: float, z: float, material: Material, owner: int
    ) -> None:
        """Add a level sheet; the first texture coordinate runs along the way."""
        self.sheet([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)], material, owner)

    def box(
        self, x0: float, x1: float, y0: float, y1: float, z0: float, z1: float,
        material: Material, owner: int,
    ) -> None:  # fmt: skip
        """Add a box that is closed but for its bottom where that lies on the floor."""
        for y in (y0, y1):
            self.along(y, x0, x1, z0, z1, material, owner)
        for x in (x0, x1):
            self.across(x, y0, y1, z0, z1, material, owner)
        for z in (z0, z1) if z0 > 0.0 else (z1,):
            self.level(x0, x1, y0, y1, z, material, owner)

    def hang_lamp(
        self, x: float, y: float, z: float, owner: int, rgb: tuple[float, ...], power: float
    ) -> None:
        """Add a lamp below the ceiling, always on."""
        self.level(x - 0.6, x + 0.6, y - 0.15, y + 0.15, z - 0.01, Material.LAMP, owner)
        (wx, wy, wz) = self.passage.place(np.array([x, y, z - 0.05])).tolist()
        self.lamps.append((wx, wy, wz, *(power * c for c in rgb), float(self.number), 1.0))

    def light_door(self, x: float, z: float) -> None:
        """A street lamp outdoors above a door."""
        (wx, wy, wz) = self.passage.place(np.array([x, 0.0, z])).tolist()
        self.lamps.append((wx, wy, wz, *(0.25 * c for c in _LAMP), -1.0, 0.0))


def _paint_side(site: _Site, side: float, y: float, floor: float, high: float) -> None:
    """Paint one long wall from the floor beside it, which is `floor` above the way, to `high`."""

    def put(
        a: float, b: float, low: float, top: float, off: float, material: Material, owner: int
    ) -> None:
        a, b = a - site.half, b - site.half
        site.along(side * (y - off), a, b, floor + low, floor + top, material, owner)

    paint_wall(site.soup, site.rng, 2 * site.half, 0.0, high - floor, put)


def _spaced(half: float, pitch: float) -> list[float]:
    """Places about `pitch` apart and even over (-half, half)."""
    count = max(round(2 * half / pitch), 1)
    return [-half + (k + 0.5) * 2 * half / count for k in range(count)]


def _add_hull(site: _Site, type_name: str, half_width: float, half_length: float) -> int:
    """Long outer walls of one of the town's types and a flat roof; gives the walls' object."""
    soup, kind, top = site.soup, BUILDING_TYPES[type_name], 7.4
    tint = np.array(kind.tints[int(site.rng.integers(len(kind.tints)))])
    hull = soup.add_object(
        "building", tint, style=kind.style, pitch=kind.cell_m, floor=kind.floor_m,
        win_w=kind.window[0], win_h=kind.window[1], second=kind.second,
        seed=int(site.rng.integers(1 << 20)), top=top + 0.6, ground=AS_ABOVE,
    )  # fmt: skip
    cells = round(2 * half_length / kind.cell_m)
    uv = np.array([(0.0, -0.5), (cells, -0.5), (cells, top), (0.0, top)])
    for y in (-half_width, half_width):
        a, b = -half_length, half_length
        site.sheet(
            [(a, y, -0.5), (b, y, -0.5), (b, y, top), (a, y, top)], Material.FACADE, hull, uv
        )
    roof = soup.add_object("roof", (0.24, 0.24, 0.25))
    site.level(-half_length, half_length, -half_width, half_width, top, Material.ROOF, roof)
    return hull


def _add_front(
    site: _Site, x: float, half_width: float, door: tuple[float, float], top: float, owner: int
) -> None:
    """An end wall with an opening of half width and height `door` in its middle."""
    half, height = door
    for side in (-1.0, 1.0):
        site.across(x, side * half_width, side * half, -0.5, top, Material.PLAIN, owner)
    site.across(x, -half, half, height, top, Material.PLAIN, owner)


def _add_canopy(site: _Site, x: float, half_width: float, z: float) -> None:
    """A roof over a door, with a lamp below it."""
    out = 1.8 if x > 0.0 else -1.8
    owner = site.soup.add_object("canopy", (0.20, 0.21, 0.22))
    a, b = sorted((x, x + out))
    site.box(a, b, -half_width, half_width, z, z + 0.2, Material.PLAIN, owner)
    site.light_door(x + out / 2, z - 0.05)


def _build_corridor(site: _Site) -> None:
    kind = PASSAGE_KINDS["corridor"]
    half, w, h = site.half, kind.width_m / 2, kind.height_m
    floor = site.soup.add_object("floor", (0.30, 0.29, 0.27))
    ceiling = site.soup.add_object("ceiling", (0.66, 0.66, 0.64))
    lap = w + 0.05  # under the walls: no ray slips out along an edge
    site.level(-half, half, -lap, lap, 0.0, Material.FLOOR, floor)
    site.level(-half, half, -lap, lap, h, Material.CEILING, ceiling)
    for side in (-1.0, 1.0):
        _paint_side(site, side, w, 0.0, h)
    lamp = site.soup.add_object("lamp", _LAMP)
    for x in _spaced(half, 8.0):
        site.hang_lamp(x, 0.0, h, lamp, _LAMP, 0.10)
    hull = _add_hull(site, "slab", kind.outer_m / 2, half)
    for x in (-half, half):
        _add_front(site, x, kind.outer_m / 2, (w, h), 7.4, hull)
        _add_canopy(site, x, 2.1, h + 0.15)


def _build_hall(site: _Site) -> None:
    """One room with two rows of pillars and a gateway in the middle of either end."""
    kind = PASSAGE_KINDS["hall"]
    soup, half, w, h = site.soup, site.half, kind.width_m / 2, kind.height_m
    gate, lintel, thick = 2.4, 3.6, (kind.outer_m - kind.width_m) / 2
    floor = soup.add_object("floor", (0.34, 0.33, 0.31))
    ceiling = soup.add_object("ceiling", (0.60, 0.60, 0.58))
    concrete = soup.add_object("pillar", _CONCRETE)
    lap = w + 0.05
    site.level(-half - thick, half + thick, -lap, lap, 0.0, Material.FLOOR, floor)
    site.level(-half - thick, half + thick, -lap, lap, h, Material.CEILING, ceiling)
    for side in (-1.0, 1.0):
        _paint_side(site, side, w, 0.0, h)
        for x in _spaced(half, 10.0):
            site.box(x - 0.3, x + 0.3, side * 6.0 - 0.3, side * 6.0 + 0.3, 0.0, h,
                     Material.PLAIN, concrete)  # fmt: skip
    hull = _add_hull(site, "warehouse", w + thick, half + thick)
    for end in (-1.0, 1.0):
        for side in (-1.0, 1.0):
            paint = add_paint(soup, site.rng)
            site.across(end * half, side * gate, side * w, 0.0, h, Material.WALL, paint)
            a, b = sorted((end * half, end * (half + thick)))
            site.along(side * gate, a, b, 0.0, lintel, Material.PLAIN, concrete)
        site.level(a, b, -gate, gate, lintel, Material.PLAIN, concrete)
        site.across(end * half, -gate, gate, lintel, h, Material.PLAIN, concrete)
        _add_front(site, end * (half + thick), w + thick, (gate, lintel), 7.4, hull)
        _add_canopy(site, end * (half + thick), gate + 0.8, lintel + 0.2)
    lamp = soup.add_object("lamp", _LAMP)
    for x in _spaced(half, 8.0):
        for y in (-4.0, 4.0):
            site.hang_lamp(x, y, h, lamp, _LAMP, 0.42)


def _build_tunnel(site: _Site) -> None:
    """A road with raised walkways below a ceiling with slanted corners, in a grassy mound."""
    kind = PASSAGE_KINDS["tunnel"]
    soup, half, w, h = site.soup, site.half, kind.width_m / 2, kind.height_m
    shoulder, road, top = 3.8, 3.2, 6.0  # of the slant, the carriageway, the mound
    foot = kind.outer_m / 2
    asphalt = soup.add_object("road", (0.105, 0.105, 0.11), style=1)
    kerb = soup.add_object("walkway", _CONCRETE)
    paving = soup.add_object("walkway", _PAVING)
    concrete = soup.add_object("tunnel", _CONCRETE)
    grass = soup.add_object("mound", (0.11, 0.16, 0.045))
    lane = [(-half, w, 0.0), (half, w, 0.0), (half, -w, 0.0), (-half, -w, 0.0)]
    uv = np.array([(y, x + half) for x, y, _ in lane])  # across, along
    site.sheet(lane, Material.ASPHALT, asphalt, uv)
    site.level(-half, half, -w + 1.0, w - 1.0, h, Material.PLAIN, concrete)
    site.level(-half, half, -w - 1.0, w + 1.0, top, Material.GRASS, grass)
    for side in (-1.0, 1.0):
        _paint_side(site, side, w, 0.15, shoulder)
        site.along(side * road, -half, half, 0.0, 0.15, Material.PLAIN, kerb)
        site.level(-half, half, side * road, side * (w + 0.05), 0.15, Material.PAVING, paving)
        slant = [(-half, side * w, shoulder), (half, side * w, shoulder),
                 (half, side * (w - 1.0), h), (-half, side * (w - 1.0), h)]  # fmt: skip
        site.sheet(slant, Material.PLAIN, concrete)
        slope = [(-half, side * foot, -0.4), (half, side * foot, -0.4),
                 (half, side * (w + 1.0), top), (-half, side * (w + 1.0), top)]  # fmt: skip
        site.sheet(slope, Material.GRASS, grass)
    for x in (-half, half):
        for side in (-1.0, 1.0):
            a, b = side * w, side * (w + 1.0)
            site.across(x, side * road, side * w, 0.0, 0.15, Material.PLAIN, kerb)
            site.across(x, a, b, -0.4, top + 0.5, Material.PLAIN, concrete)
            site.sheet([(x, a, shoulder), (x, a, h), (x, side * (w - 1.0), h)],
                       Material.PLAIN, concrete)  # fmt: skip
            wing = [(x, b, -0.4), (x, side * foot, -0.4), (x, b, top)]
            site.sheet(wing, Material.PLAIN, concrete)
        site.across(x, -w, w, h, top + 0.5, Material.PLAIN, concrete)
        site.light_door(x + (0.8 if x > 0.0 else -0.8), h)
    lamp = soup.add_object("lamp", _SODIUM)
    for x in _spaced(half, 7.0):
        site.hang_lamp(x, 0.0, h, lamp, _SODIUM, 0.25)


def _pave_courts(site: _Site) -> None:
    """Level paving before both doors."""
    paving = site.soup.add_object("pavement", _PAVING)
    for end in (-1.0, 1.0):
        a, b = sorted((end * site.half, end * (site.half + COURT_M)))
        site.level(a, b, -COURT_HALF_M, COURT_HALF_M, -0.02, Material.PAVING, paving)


_BUILDERS: dict[str, Callable[[_Site], None]] = {
    "corridor": _build_corridor,
    "hall": _build_hall,
    "tunnel": _build_tunnel,
}
