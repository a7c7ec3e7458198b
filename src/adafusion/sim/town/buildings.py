# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Buildings of nine shared types, set along the streets where there is room."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from adafusion.sim.numeric import keyed_seed
from adafusion.sim.town.plan import (
    WALK_HALF_M,
    Plan,
    Rect,
    Street,
    along,
    leftward,
    overlaps,
    point_on,
)
from adafusion.sim.town.shapes import Material, Rgb, SoupBuilder, rectangle

PLINTH_M = 0.35
_BAY_M, _PORCH_M, _WING_M, _BALCONY_M, _AWNING_M = 0.8, 1.4, 2.6, 1.6, 1.8  # reach of a front
BELOW_M = -1.2  # walls go into the ground: streets slope


@dataclass(frozen=True, kw_only=True)
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
    ground: int  # ground floor: as above, shop windows, doors, gates
    extras: tuple[str, ...] = ()


# facade styles, and ground floors
BRICK, PLASTER, CURTAIN, SLAB, STONE, METAL_SHEET, TIMBER = range(7)
AS_ABOVE, SHOPS, DOORS, GATES = range(4)

BUILDING_TYPES = {
    "terrace": BuildingType(
        style=BRICK,
        tints=(
            (0.34, 0.14, 0.10), (0.40, 0.21, 0.14), (0.30, 0.17, 0.13), (0.42, 0.28, 0.20),
        ),
        second=(0.70, 0.68, 0.62),
        storeys=(2, 3), floor_m=2.9, cell_m=2.6, window=(0.40, 0.52),
        width_m=(9.0, 17.0), depth_m=(9.0, 11.0), setback_m=1.0, gap_m=(0.0, 0.2),
        roof="gable", ground=DOORS, extras=("chimney", "bay"),
    ),
    "apartments": BuildingType(
        style=PLASTER,
        tints=(
            (0.62, 0.56, 0.42), (0.58, 0.46, 0.34), (0.55, 0.58, 0.55), (0.66, 0.62, 0.56),
            (0.50, 0.36, 0.28),
        ),
        second=(0.72, 0.70, 0.66),
        storeys=(4, 5), floor_m=3.0, cell_m=3.2, window=(0.42, 0.50),
        width_m=(14.0, 26.0), depth_m=(11.0, 14.0), setback_m=1.5, gap_m=(0.0, 5.0),
        roof="flat", ground=DOORS, extras=("balcony",),
    ),
    "office": BuildingType(
        style=CURTAIN,
        tints=(
            (0.30, 0.33, 0.36), (0.22, 0.27, 0.30), (0.42, 0.42, 0.40),
        ),
        second=(0.16, 0.17, 0.18),
        storeys=(4, 7), floor_m=3.6, cell_m=1.8, window=(0.92, 0.66),
        width_m=(18.0, 32.0), depth_m=(14.0, 18.0), setback_m=4.0, gap_m=(4.0, 9.0),
        roof="flat", ground=SHOPS, extras=("wing",),
    ),
    "slab": BuildingType(
        style=SLAB,
        tints=(
            (0.48, 0.47, 0.44), (0.42, 0.42, 0.42), (0.52, 0.48, 0.42),
        ),
        second=(0.30, 0.32, 0.36),
        storeys=(5, 8), floor_m=2.8, cell_m=3.6, window=(0.74, 0.46),
        width_m=(22.0, 36.0), depth_m=(11.0, 13.0), setback_m=6.0, gap_m=(7.0, 14.0),
        roof="flat", ground=DOORS, extras=("balcony",),
    ),
    "shops": BuildingType(
        style=PLASTER,
        tints=(
            (0.58, 0.50, 0.40), (0.46, 0.22, 0.16), (0.35, 0.40, 0.44), (0.64, 0.62, 0.58),
        ),
        second=(0.16, 0.22, 0.20),
        storeys=(2, 3), floor_m=3.3, cell_m=2.5, window=(0.44, 0.50),
        width_m=(8.0, 15.0), depth_m=(10.0, 13.0), setback_m=0.3, gap_m=(0.0, 0.0),
        roof="flat", ground=SHOPS, extras=("awning",),
    ),
    "stone": BuildingType(
        style=STONE,
        tints=(
            (0.50, 0.45, 0.36), (0.45, 0.42, 0.37), (0.55, 0.49, 0.40),
        ),
        second=(0.62, 0.58, 0.50),
        storeys=(3, 4), floor_m=3.7, cell_m=2.4, window=(0.40, 0.62),
        width_m=(13.0, 22.0), depth_m=(11.0, 14.0), setback_m=1.0, gap_m=(0.0, 3.0),
        roof="hip", ground=DOORS, extras=("cornice", "bay"),
    ),
    "warehouse": BuildingType(
        style=METAL_SHEET,
        tints=(
            (0.32, 0.38, 0.42), (0.42, 0.40, 0.36), (0.24, 0.33, 0.28), (0.45, 0.30, 0.24),
        ),
        second=(0.20, 0.22, 0.25),
        storeys=(2, 2), floor_m=3.6, cell_m=6.0, window=(0.55, 0.22),
        width_m=(24.0, 38.0), depth_m=(15.0, 20.0), setback_m=5.0, gap_m=(6.0, 12.0),
        roof="gable", ground=GATES,
    ),
    "house": BuildingType(
        style=PLASTER,
        tints=(
            (0.68, 0.66, 0.60), (0.62, 0.54, 0.40), (0.44, 0.30, 0.22), (0.52, 0.56, 0.58),
        ),
        second=(0.46, 0.44, 0.42),
        storeys=(1, 2), floor_m=2.8, cell_m=3.0, window=(0.42, 0.46),
        width_m=(9.0, 13.0), depth_m=(8.0, 10.0), setback_m=5.0, gap_m=(4.0, 9.0),
        roof="gable", ground=DOORS, extras=("chimney", "porch", "hedge"),
    ),
    "timber": BuildingType(
        style=TIMBER,
        tints=(
            (0.40, 0.29, 0.18), (0.30, 0.26, 0.22), (0.52, 0.42, 0.30),
        ),
        second=(0.66, 0.66, 0.64),
        storeys=(2, 4), floor_m=3.0, cell_m=2.9, window=(0.52, 0.60),
        width_m=(12.0, 20.0), depth_m=(10.0, 12.0), setback_m=2.5, gap_m=(3.0, 7.0),
        roof="flat", ground=DOORS, extras=("wing", "balcony"),
    ),
}  # fmt: skip
_SHOP_RGB: tuple[Rgb, ...] = (
    (0.10, 0.22, 0.16), (0.30, 0.06, 0.06), (0.08, 0.12, 0.24), (0.35, 0.26, 0.10),
    (0.12, 0.12, 0.12),
)  # fmt: skip
ROOF_TINTS: tuple[Rgb, ...] = (
    (0.30, 0.12, 0.08), (0.16, 0.15, 0.16), (0.24, 0.17, 0.13), (0.20, 0.20, 0.21),
)  # fmt: skip


def line_with_buildings(plan: Plan) -> None:
    """Walk along both sides of every street and set buildings where there is room."""
    names, taken = sorted(BUILDING_TYPES), np.array(plan.taken)
    for e, street in enumerate(plan.streets):
        if street.kind != "street":
            continue
        length = float(along(street.line)[-1])
        for side in (1, -1):
            rng = plan.rng("street", e, side, "palette")
            palette = rng.choice(len(names), size=3, replace=False)
            s, slot = float(rng.uniform(10.0, 15.0)), 0
            while s < length - 16.0:
                draw = plan.rng("street", e, side, "building", slot)
                slot += 1
                kind = BUILDING_TYPES[names[palette[draw.choice(3, p=(0.55, 0.3, 0.15))]]]
                kind = replace(  # no two of a type are quite the same
                    kind,
                    cell_m=kind.cell_m * float(draw.uniform(0.92, 1.12)),
                    floor_m=kind.floor_m * float(draw.uniform(0.95, 1.07)),
                )
                width, depth = (float(draw.uniform(*r)) for r in (kind.width_m, kind.depth_m))
                setback = kind.setback_m * float(draw.uniform(0.7, 1.3))
                smallest = kind.width_m[0] * 0.8, kind.depth_m[0] * 0.9
                for size in ((min(width, length - 9.0 - s), depth), smallest):
                    rect = _lot(street, side, s, size, setback)
                    low, aloft = (_with_front(rect, reach) for reach in _reach(kind, setback))
                    fits = not overlaps(rect, taken) and not overlaps(low, plan.solid)
                    if size[0] >= smallest[0] and fits:
                        plan.solid.append(low)
                        plan.aloft.append(aloft)
                        _add_building(plan, kind, draw, rect, setback, f"{e}/{side}/{slot}")
                        s += size[0] + float(draw.uniform(*kind.gap_m))
                        break
                else:
                    s += 3.0


def _lot(street: Street, side: int, s: float, size: tuple[float, float], setback: float) -> Rect:
    """The ground of a building, `size` (wide, deep), from s on along a street that it looks at."""
    width, depth = size
    xy, yaw = point_on(street.line, s + width / 2)
    out = WALK_HALF_M + 0.3 + setback + depth / 2
    x, y = (xy + side * leftward(yaw) * out).tolist()
    facing = yaw if side < 0 else yaw + math.pi
    return x, y, facing, width / 2 - 0.05, depth / 2


def _reach(kind: BuildingType, setback: float) -> tuple[float, float]:
    """How far what may stand out of a front reaches, on the ground and above heads."""
    wing = max(min(_WING_M, setback - 0.3), 0.4)
    reach = {"bay": _BAY_M, "wing": wing, "porch": _PORCH_M}
    low = max(reach.get(extra, 0.0) for extra in (*kind.extras, ""))
    reach = {"balcony": _BALCONY_M, "awning": _AWNING_M}
    return low, max(low, *(reach.get(extra, 0.0) for extra in (*kind.extras, "")))


def _with_front(rect: Rect, reach: float) -> Rect:
    """The ground of a building and of what stands out of its front by `reach`."""
    x, y, yaw, half_w, half_d = rect
    x, y = (np.array([x, y]) + leftward(yaw) * reach / 2).tolist()
    return x, y, yaw, half_w, half_d + reach / 2


def _add_building(
    plan: Plan, kind: BuildingType, rng: np.random.Generator, rect: Rect, setback: float, path: str
) -> None:
    soup = plan.soup
    x, y, yaw, half_w, half_d = rect
    outline = rectangle((x, y), 2 * half_w, 2 * half_d, yaw)
    ground = float(plan.hills(outline).mean())
    storeys = int(rng.integers(kind.storeys[0], kind.storeys[1] + 1))
    height = PLINTH_M + storeys * kind.floor_m
    tint = np.array(kind.tints[int(rng.integers(len(kind.tints)))]) * rng.uniform(0.82, 1.15)
    second = np.array(kind.second) * rng.uniform(0.8, 1.1)
    if "awning" in kind.extras:
        second = np.array(_SHOP_RGB[rng.integers(len(_SHOP_RGB))])
    walls = soup.add_object(
        "building", tint, style=kind.style, pitch=kind.cell_m, floor=kind.floor_m,
        win_w=kind.window[0] * float(rng.uniform(0.92, 1.08)), win_h=kind.window[1],
        second=second, seed=keyed_seed(plan.spec.seed, "building", path) & 0xFFFFF,
        top=height, ground=kind.ground,
    )  # fmt: skip
    roof = soup.add_object("roof", ROOF_TINTS[int(rng.integers(len(ROOF_TINTS)))])
    trim = soup.add_object("trim", second)
    house = _House(soup, kind, rect, ground, height, storeys, walls, roof, trim)
    house.box(-half_w, half_w, 0.0, 2 * half_d, BELOW_M, height, Material.FACADE, walls, lid=False)
    if kind.roof == "flat":
        _add_flat_roof(house, rng)
    else:
        _add_pitched_roof(house, rng)
    _add_front(house, rng, setback)
    _add_garden(house, rng, setback)


@dataclass(frozen=True, eq=False)
class _House:
    """A building being put together; x along its front, y behind the front, z above its ground."""

    soup: SoupBuilder
    kind: BuildingType
    rect: Rect
    ground: float
    height: float
    storeys: int
    walls: int  # objects
    roof: int
    trim: int

    def place(self, points: Sequence[tuple[float, float, float]]) -> Float64[np.ndarray, "n 3"]:
        """Map local points to the world."""
        x, y, yaw, _, half_d = self.rect
        c, s = math.cos(yaw), math.sin(yaw)
        p = np.array(points, float)
        px, py = p[:, 0], half_d - p[:, 1]
        return np.stack([x + c * px - s * py, y + s * px + c * py, self.ground + p[:, 2]], axis=1)

    def sheet(
        self, points: Sequence[tuple[float, float, float]], material: Material, owner: int
    ) -> None:
        """Add a quad, or a triangle of three points."""
        corners = self.place(points)
        self.soup.quads(corners[[0, 1, 2, len(points) - 1]][None], material, owner)

    def box(
        self, x0: float, x1: float, y0: float, y1: float, z0: float, z1: float,
        material: Material, owner: int, lid: bool = True,
    ) -> None:  # fmt: skip
        """Add a box; one of facade gets windows and, with `lid`, a roof."""
        base = self.place([(x0, y1, 0.0), (x1, y1, 0.0), (x1, y0, 0.0), (x0, y0, 0.0)])[:, :2]
        bottom, top = self.ground + z0, self.ground + z1
        if material == Material.FACADE:
            self.soup.walls(
                base, bottom, top, material, owner, ground=self.ground, cell_m=self.kind.cell_m
            )
            if lid:
                self.soup.cap(base, top, Material.ROOF, self.roof)
        else:
            self.soup.block(base, bottom, top, material, owner, floor=z0 > 0.5)


def _add_flat_roof(house: _House, rng: np.random.Generator) -> None:
    """A parapet, and often a stair head."""
    _, _, _, half_w, half_d = house.rect
    depth, height = 2 * half_d, house.height
    outline = house.place(
        [(-half_w, depth, 0.0), (half_w, depth, 0.0), (half_w, 0.0, 0.0), (-half_w, 0.0, 0.0)]
    )
    house.soup.cap(outline[:, :2], house.ground + height, Material.ROOF, house.roof)
    for x0, x1, y0, y1 in (
        (-half_w, half_w, -0.12, 0.14), (-half_w, half_w, depth - 0.14, depth + 0.12),
        (-half_w - 0.12, -half_w + 0.14, 0.0, depth), (half_w - 0.14, half_w + 0.12, 0.0, depth),
    ):  # fmt: skip
        house.box(x0, x1, y0, y1, height - 0.25, height + 0.5, Material.PLAIN, house.trim)
    if rng.random() < 0.6:
        x, low, high = float(rng.uniform(-half_w * 0.6, half_w * 0.2)), depth * 0.4, depth * 0.75
        house.box(x, x + 4.0, low, high, height, height + 2.4, Material.PLAIN, house.trim)


def _add_pitched_roof(house: _House, rng: np.random.Generator) -> None:
    """A gable or hip roof along the front, overhanging, perhaps with chimneys."""
    kind, (_, _, _, half_w, half_d), height = house.kind, house.rect, house.height
    depth, over = 2 * half_d, 0.35
    steep = 0.45 if kind.style == METAL_SHEET else 1.0
    rise = float(rng.uniform(0.55, 0.75)) * half_d * steep
    ridge, low = height + rise, height - over * rise / half_d
    # the ridge reaches over the gables, or ends before them
    end = half_w + over if kind.roof == "gable" else max(half_w - half_d * 0.8, 0.3)
    a, b = -half_w - over, half_w + over
    front = [(a, -over, low), (b, -over, low), (end, half_d, ridge), (-end, half_d, ridge)]
    back = [(b, depth + over, low), (a, depth + over, low), (-end, half_d, ridge),
            (end, half_d, ridge)]  # fmt: skip
    house.sheet(front, Material.ROOF, house.roof)
    house.sheet(back, Material.ROOF, house.roof)
    for side in (-1.0, 1.0):
        x = side * half_w
        if kind.roof == "gable":
            gable = [(x, 0.0, height), (x, depth, height), (x, half_d, ridge)]
            house.sheet(gable, Material.PLAIN, house.walls)
        else:
            x += side * over
            hip = [(x, -over, low), (x, depth + over, low), (side * end, half_d, ridge)]
            house.sheet(hip, Material.ROOF, house.roof)
    if "chimney" in kind.extras:
        for _ in range(int(rng.integers(1, 3))):
            x, y = float(rng.uniform(-half_w + 0.5, half_w - 1.2)), half_d - 0.3
            top = ridge + 1.1
            house.box(x, x + 0.9, y, half_d + 0.4, height, top, Material.PLAIN, house.walls)


def _add_front(house: _House, rng: np.random.Generator, setback: float) -> None:
    """What stands out of the front, as far as the type has it and chance adds it."""
    kind, half_w, height, storeys = house.kind, house.rect[3], house.height, house.storeys
    plain, facade, trim = Material.PLAIN, Material.FACADE, house.trim
    cells = max(round(2 * half_w / kind.cell_m), 1)
    cell = 2 * half_w / cells
    if "cornice" in kind.extras:
        house.box(-half_w - 0.3, half_w + 0.3, -0.35, 0.0, height - 0.5, height - 0.1, plain, trim)
        z = PLINTH_M + kind.floor_m
        house.box(-half_w, half_w, -0.14, 0.0, z - 0.15, z + 0.1, plain, trim)
    if "bay" in kind.extras and rng.random() < 0.75:
        step = int(rng.integers(2, 5))
        top = PLINTH_M + kind.floor_m * int(rng.integers(1, storeys + 1))
        for k in range(int(rng.integers(step)), cells, step):
            x = -half_w + k * cell + 0.15
            house.box(x, x + cell - 0.3, -_BAY_M, 0.0, BELOW_M, top, facade, house.walls)
    if "balcony" in kind.extras and rng.random() < 0.8:
        step, first = int(rng.integers(2, 4)), int(rng.integers(3))
        reach = float(rng.uniform(0.9, _BALCONY_M))
        for k in range(first, cells, step):
            a = -half_w + k * cell + 0.1
            b = min(a + cell - 0.2, half_w - 0.1)
            for storey in range(1, storeys):
                z = PLINTH_M + storey * kind.floor_m
                house.box(a, b, -reach, 0.0, z - 0.12, z + 0.04, plain, trim)
                rail = [(a, -reach, z), (b, -reach, z), (b, -reach, z + 1.0), (a, -reach, z + 1.0)]
                house.sheet(rail, plain, trim)
    if "awning" in kind.extras and rng.random() < 0.8:
        z, reach = PLINTH_M + kind.floor_m - 0.45, float(rng.uniform(1.0, _AWNING_M))
        a, b = -half_w + 0.4, half_w - 0.4
        cloth = [(a, -reach, z - 0.7), (b, -reach, z - 0.7), (b, 0.0, z), (a, 0.0, z)]
        house.sheet(cloth, plain, trim)
    if "wing" in kind.extras:  # one end stands forward
        wing = float(rng.uniform(0.25, 0.45)) * 2 * half_w
        x = -half_w if rng.random() < 0.5 else half_w - wing
        reach = min(float(rng.uniform(1.2, _WING_M)), max(setback - 0.3, 0.4))
        top = height - kind.floor_m * int(rng.integers(0, 2))
        house.box(x, x + wing, -reach, 0.0, BELOW_M, top, facade, house.walls)
    if "porch" in kind.extras:
        x = float(rng.uniform(-half_w + 1.0, half_w - 3.0))
        house.box(x, x + 2.2, -_PORCH_M, 0.0, 2.45, 2.65, plain, trim)
        for post in (x + 0.1, x + 2.0):
            house.box(post, post + 0.12, -1.3, -1.18, BELOW_M, 2.45, plain, trim)


def _add_garden(house: _House, rng: np.random.Generator, setback: float) -> None:
    """A hedge with a gate, or a low wall, between the building and the street."""
    half_w = house.rect[3]
    if "hedge" in house.kind.extras and rng.random() < 0.75:
        tint = np.array([0.075, 0.13, 0.04]) * rng.uniform(0.8, 1.3)
        hedge = house.soup.add_object("hedge", tint)
        tall = float(rng.uniform(0.8, 1.7))
        gate = float(rng.uniform(-half_w + 1.0, half_w - 2.5))
        for a, b in ((-half_w, gate), (gate + 1.6, half_w)):
            house.box(a, b, -setback + 0.1, -setback + 0.8, -0.4, tall, Material.HEDGE, hedge)
    elif setback > 3.0 and rng.random() < 0.5:
        tall, y = float(rng.uniform(0.5, 1.1)), -setback + 0.1
        house.box(-half_w, half_w * 0.2, y, y + 0.25, -0.4, tall, Material.PLAIN, house.trim)
