# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Triangles with texture coordinates, and the things a street is made of: walls, trees, cars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8

from adafusion.sim.numeric import keyed_rng

Rgb = tuple[float, float, float]


class Material(IntEnum):
    """What a face is made of; `textures.py` says how it looks and how it reflects a laser."""

    PLAIN = 0  # painted or cast: the object's tint, nothing else
    ASPHALT = 1  # uv: metres across from the middle line, metres along
    PAVING = 2
    GRASS = 3
    FACADE = 4  # uv: window cells along the wall, metres above the ground
    ROOF = 5
    BARK = 6
    LEAF = 7
    METAL = 8
    SIGN = 9
    CAR_BODY = 10
    GLASS = 11
    RUBBER = 12
    WALL = 13  # indoors: uv in metres
    FLOOR = 14
    CEILING = 15
    LAMP = 16  # the part of a lamp that shines
    HEDGE = 17
    STRIPES = 18  # zebra crossing
    NOTICE = 19
    DOOR = 20
    CAR_LIGHT = 21


# columns of the object table
TINT, STYLE, PITCH, FLOOR, WIN_W, WIN_H, SECOND, SEED, TOP, GROUND = 0, 3, 4, 5, 6, 7, 8, 11, 12, 13
COLUMNS = 16


@dataclass(frozen=True, eq=False)
class Soup:
    """Triangles: corners in metres, texture coordinates, material and object of each face."""

    corners: Float32[np.ndarray, "n 3 3"]
    uv: Float32[np.ndarray, "n 3 2"]
    material: UInt8[np.ndarray, " n"]
    object_id: Int32[np.ndarray, " n"]
    objects: Float32[np.ndarray, "m 16"]  # a row an object, columns as named above
    kinds: tuple[str, ...]  # what each object is: "building", "tree", "car" ...


@dataclass
class SoupBuilder:
    """Collects quads (a triangle is a quad whose last two corners are one)."""

    _quads: list[np.ndarray] = field(default_factory=list)
    _uvs: list[np.ndarray] = field(default_factory=list)
    _tags: list[tuple[int, int, int]] = field(default_factory=list)  # how many, material, object
    _rows: list[np.ndarray] = field(default_factory=list)
    _kinds: list[str] = field(default_factory=list)

    def add_object(self, kind: str, tint: Sequence[float] = (0.5, 0.5, 0.5), **columns: Any) -> int:
        """Open a row of the object table; `columns` are `style=`, `pitch=` ... as named above."""
        row = np.zeros(COLUMNS, np.float32)
        row[TINT : TINT + 3] = tint
        for name, value in columns.items():
            index = globals()[name.upper()]
            row[index : index + np.size(value)] = value
        self._rows.append(row)
        self._kinds.append(kind)
        return len(self._rows) - 1

    def quads(
        self,
        corners: Float[np.ndarray, "k 4 3"],
        material: Material,
        object_id: int,
        uv: Float[np.ndarray, "k 4 2"] | None = None,
    ) -> None:
        """Add k quads; without `uv` the coordinates are the lengths along the edges, in metres."""
        if uv is None:
            along = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
            up = np.linalg.norm(corners[:, 3] - corners[:, 0], axis=1)
            nought = np.zeros_like(along)
            uv = np.stack(
                [
                    np.stack([nought, along, along, nought], 1),
                    np.stack([nought, nought, up, up], 1),
                ],
                axis=2,
            )
        self._quads.append(np.asarray(corners, np.float64))
        self._uvs.append(np.asarray(uv, np.float64))
        self._tags.append((len(corners), int(material), object_id))

    def walls(
        self,
        outline: Float[np.ndarray, "k 2"],
        bottom: float,
        top: float,
        material: Material,
        object_id: int,
        *,
        ground: float | None = None,
        cell_m: float | None = None,
    ) -> None:
        """Extrude a closed outline upwards; u counts whole cells of about `cell_m` where given."""
        a, b = outline, np.roll(outline, -1, axis=0)
        length = np.linalg.norm(b - a, axis=1)
        u = length if cell_m is None else np.maximum(np.round(length / cell_m), 1.0)
        ground = bottom if ground is None else ground
        k = len(a)
        corners = np.empty((k, 4, 3))
        corners[:, 0, :2] = corners[:, 3, :2] = a
        corners[:, 1, :2] = corners[:, 2, :2] = b
        corners[:, :2, 2], corners[:, 2:, 2] = bottom, top
        uv = np.zeros((k, 4, 2))
        uv[:, 1, 0] = uv[:, 2, 0] = u
        uv[:, :2, 1], uv[:, 2:, 1] = bottom - ground, top - ground
        self.quads(corners, material, object_id, uv)

    def cap(
        self, outline: Float[np.ndarray, "k 2"], z: float, material: Material, object_id: int
    ) -> None:
        """Close a convex outline with a level lid."""
        k = len(outline)
        fan = [(0, i, i + 1, min(i + 2, k - 1)) for i in range(1, k - 1, 2)]
        corners = np.array([[[*outline[j], z] for j in quad] for quad in fan])
        self.quads(corners, material, object_id, corners[:, :, :2])

    def block(
        self,
        outline: Float[np.ndarray, "k 2"],
        bottom: float,
        top: float,
        material: Material,
        object_id: int,
        *,
        lid: Material | None = None,
        floor: bool = False,
    ) -> None:
        """Walls and lid over an outline; with `floor` closed below as well."""
        self.walls(outline, bottom, top, material, object_id)
        self.cap(outline, top, material if lid is None else lid, object_id)
        if floor:
            self.cap(outline, bottom, material, object_id)

    def build(self) -> Soup:
        """Cut the quads into triangles; those without area are left out."""
        quads = np.concatenate(self._quads) if self._quads else np.zeros((0, 4, 3))
        uvs = np.concatenate(self._uvs) if self._uvs else np.zeros((0, 4, 2))
        counts, materials, objects = np.array(self._tags, np.int64).reshape(-1, 3).T
        corners = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
        uv = uvs[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 2)
        material = np.repeat(np.repeat(materials, counts), 2).astype(np.uint8)
        object_id = np.repeat(np.repeat(objects, counts), 2).astype(np.int32)
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        real = np.linalg.norm(cross, axis=1) > 1e-7
        return Soup(
            corners[real].astype(np.float32),
            uv[real].astype(np.float32),
            material[real],
            object_id[real],
            np.array(self._rows, np.float32).reshape(-1, COLUMNS),
            tuple(self._kinds),
        )


# ------------------------------------------------------------------------------------- outlines


def turned(
    points: Float[np.ndarray, "n 2"], xy: Sequence[float], yaw: float
) -> Float[np.ndarray, "n 2"]:
    """Turn points by `yaw` and move them to `xy`."""
    c, s = np.cos(yaw), np.sin(yaw)
    return points @ np.array([[c, s], [-s, c]]) + np.asarray(xy, float)


def rectangle(
    xy: Sequence[float], length: float, width: float, yaw: float
) -> Float[np.ndarray, "4 2"]:
    """Outline of a rectangle, anticlockwise; its first side is the far right one, along `yaw`."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (length / 2, width / 2)
    return turned(corners, xy, yaw)


def disc(xy: Sequence[float], radius: float, sides: int) -> Float[np.ndarray, "k 2"]:
    """Outline of a regular polygon."""
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    return np.asarray(xy, float) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


# ---------------------------------------------------------------------------------------- trees

TREE_KINDS = ("round", "column", "conifer")
TREE_VARIANTS = 4  # crowns to choose from, of each kind: many trees share one


def _crown(kind: str, variant: int) -> Float[np.ndarray, "k 4 3"]:
    """Leaf cards of a crown about 1 high and 1 wide, standing on z = 0."""
    rng = keyed_rng("tree", kind, variant)  # a tree species is the same in all worlds
    if kind == "round":
        k = 90
        blobs = rng.normal(0.0, 0.17, (5, 3)) + (0, 0, 0.55)
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


def add_tree(
    soup: SoupBuilder,
    xy: Sequence[float],
    z: float,
    kind: str,
    variant: int,
    height: float,
    yaw: float,
    tint: Rgb,
    crowns: dict[tuple[str, int], np.ndarray],
) -> None:
    """Plant a tree; `crowns` keeps the crowns already made."""
    if (kind, variant) not in crowns:
        crowns[kind, variant] = _crown(kind, variant)
    share = {"round": 0.68, "column": 0.88, "conifer": 0.9}[kind]  # of the height is crown
    width = height * {"round": 0.72, "column": 0.28, "conifer": 0.46}[kind]
    cards = crowns[kind, variant] * (width, width, height * share)
    cards[:, :, :2] = turned(cards[:, :, :2].reshape(-1, 2), xy, yaw).reshape(-1, 4, 2)
    cards[:, :, 2] += z + height * (1 - share)
    tree = soup.add_object("tree", tint)
    soup.quads(cards, Material.LEAF, tree)
    trunk_top = z + height * (1 - share * (0.55 if kind == "round" else 0.3))
    radius = 0.016 * height + 0.05
    soup.walls(disc(xy, radius, 6), z - 0.5, trunk_top, Material.BARK, tree)


# ------------------------------------------------------------------------------------- vehicles


@dataclass(frozen=True)
class VehicleShape:
    """Side view of a vehicle: x along its length from the rear, z up, in metres."""

    body: tuple[tuple[float, float], ...]  # closed outline, clockwise from the rear bottom
    cabin: tuple[tuple[float, float], ...]  # lower rear, upper rear, upper front, lower front
    width: float
    wheels: tuple[float, float]
    wheel_radius: float


VEHICLES = (
    VehicleShape(  # hatchback
        ((0.0, 0.35), (0.05, 0.95), (2.7, 1.0), (3.85, 0.82), (4.0, 0.6), (4.0, 0.32)),
        ((0.12, 0.95), (0.55, 1.48), (1.95, 1.5), (2.9, 0.97)),
        1.75,
        (0.72, 3.2),
        0.31,
    ),
    VehicleShape(  # saloon
        (
            (0.0, 0.38),
            (0.05, 0.92),
            (0.9, 1.0),
            (3.2, 0.98),
            (4.5, 0.84),
            (4.65, 0.6),
            (4.65, 0.33),
        ),
        ((0.75, 0.98), (1.35, 1.42), (2.6, 1.44), (3.4, 0.96)),
        1.82,
        (0.9, 3.75),
        0.33,
    ),
    VehicleShape(  # estate or off-roader
        ((0.0, 0.45), (0.04, 1.08), (3.3, 1.12), (4.5, 0.98), (4.65, 0.7), (4.65, 0.42)),
        ((0.1, 1.08), (0.35, 1.68), (2.45, 1.72), (3.4, 1.1)),
        1.88,
        (0.9, 3.75),
        0.37,
    ),
    VehicleShape(  # van
        ((0.0, 0.4), (0.02, 2.3), (3.9, 2.35), (4.35, 1.5), (5.1, 1.1), (5.2, 0.42)),
        ((3.4, 1.35), (3.5, 2.1), (3.98, 2.1), (4.38, 1.4)),
        1.98,
        (0.95, 4.3),
        0.36,
    ),
)
_PAINTS = (
    (0.62, 0.62, 0.63), (0.03, 0.03, 0.035), (0.28, 0.29, 0.31), (0.72, 0.72, 0.70),
    (0.05, 0.09, 0.25), (0.35, 0.03, 0.03), (0.10, 0.11, 0.12), (0.07, 0.16, 0.12),
    (0.45, 0.42, 0.36), (0.55, 0.25, 0.05),
)  # fmt: skip


def add_vehicle(
    soup: SoupBuilder, rng: np.random.Generator, xy: Sequence[float], z: float, yaw: float
) -> None:
    """Put one vehicle of random make and colour on the ground at `xy`."""
    shape = VEHICLES[rng.choice(len(VEHICLES), p=(0.36, 0.30, 0.22, 0.12))]
    paint = _PAINTS[rng.integers(len(_PAINTS))]
    car = soup.add_object("car", tuple(np.array(paint) * rng.uniform(0.8, 1.1)))
    body, cabin = np.array(shape.body), np.array(shape.cabin)
    half, middle = shape.width / 2, body[:, 0].max() / 2

    def place(x: np.ndarray, y: np.ndarray, height: np.ndarray) -> np.ndarray:
        flat = turned(np.stack([x - middle, y], axis=-1).reshape(-1, 2), xy, yaw)
        return np.concatenate([flat, np.reshape(height + z, (-1, 1))], axis=1)

    def skin(outline: np.ndarray, half_low: float, half_top: np.ndarray) -> None:
        """Loft the side view across the width; `half_top` narrows it at each point."""
        left = place(outline[:, 0], half_top, outline[:, 1])
        right = place(outline[:, 0], -half_top, outline[:, 1])
        k = len(outline)
        across = np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)
        soup.quads(across, Material.CAR_BODY, car)
        for side in (left, right):
            fan = np.array([[side[0], side[i], side[i + 1], side[min(i + 2, k - 1)]]
                            for i in range(1, k - 1, 2)])  # fmt: skip
            soup.quads(fan, Material.CAR_BODY, car)

    skin(body, half, np.full(len(body), half))
    if shape.body[1][1] > 2.0:  # a van: windscreen and two side windows on the body
        x0, x1 = 3.97, 4.33
        screen = place(np.array([x0, x1, x1, x0]), np.array([1, 1, -1, -1]) * half * 0.88,
                       np.array([2.22, 1.56, 1.56, 2.22])) + (0, 0, 0.02)  # fmt: skip
        soup.quads(screen[None], Material.GLASS, car)
        for side in (1.01, -1.01):
            pane = place(cabin[:, 0], np.full(4, side * half), cabin[:, 1])
            soup.quads(pane[None], Material.GLASS, car)
    else:
        low, top = half * 0.96, half * 0.78
        widths = np.array([low, top, top, low])
        left = place(cabin[:, 0], widths, cabin[:, 1])
        right = place(cabin[:, 0], -widths, cabin[:, 1])
        soup.quads(
            np.stack([left[[1]], left[[2]], right[[2]], right[[1]]], 1), Material.CAR_BODY, car
        )
        rear = np.stack([left[0], left[1], right[1], right[0]])
        front = np.stack([left[3], left[2], right[2], right[3]])
        soup.quads(np.stack([rear, front]), Material.GLASS, car)
        for side in (left, right):
            soup.quads(side[None], Material.CAR_BODY, car)  # pillars, then panes a hair outside
        for sign in (1, -1):
            for a, b in ((0.10, 0.50), (0.55, 0.94)):
                low_x = cabin[0, 0] + (cabin[3, 0] - cabin[0, 0]) * np.array([a, b])
                top_x = cabin[1, 0] + (cabin[2, 0] - cabin[1, 0]) * np.array([a, b])
                zl, zt = cabin[0, 1] + 0.06, cabin[1, 1] - 0.07
                pane = place(
                    np.array([low_x[0] + 0.05, low_x[1], top_x[1], top_x[0]]),
                    sign
                    * (np.array([low, low, top, top]) + np.array([-0.005, -0.005, 0.03, 0.03])),
                    np.array([zl, zl, zt, zt]),
                )
                soup.quads(pane[None], Material.GLASS, car)
    angle = 2 * np.pi * np.arange(9) / 8
    for x in shape.wheels:
        rim = np.stack([x + shape.wheel_radius * np.cos(angle),
                        shape.wheel_radius * (1 + np.sin(angle))], axis=1)  # fmt: skip
        for sign in (1, -1):
            face = place(rim[:8, 0], np.full(8, sign * (half + 0.015)), rim[:8, 1])
            fan = np.array(
                [[face[0], face[i], face[i + 1], face[min(i + 2, 7)]] for i in (1, 3, 5)]
            )
            soup.quads(fan, Material.RUBBER, car)
            hub = place(x + 0.55 * (rim[:8, 0] - x), np.full(8, sign * (half + 0.022)),
                        shape.wheel_radius + 0.55 * (rim[:8, 1] - shape.wheel_radius))  # fmt: skip
            fan = np.array([[hub[0], hub[i], hub[i + 1], hub[min(i + 2, 7)]] for i in (1, 3, 5)])
            soup.quads(fan, Material.METAL, car)
            inner = place(rim[:, 0], np.full(9, sign * (half - 0.2)), rim[:, 1])
            outer = place(rim[:, 0], np.full(9, sign * (half + 0.015)), rim[:, 1])
            tread = np.stack([inner[:-1], inner[1:], outer[1:], outer[:-1]], axis=1)
            soup.quads(tread[4:], Material.RUBBER, car)  # the lower half: the arch hides the rest
    bottom = np.array([[0.1, 0.33], [middle * 2 - 0.1, 0.33]])
    under = place(
        bottom[[0, 1, 1, 0], 0], np.array([1, 1, -1, -1]) * (half - 0.05), bottom[[0, 1, 1, 0], 1]
    )
    soup.quads(under[None], Material.RUBBER, car)
    lights = np.array([[-0.95, -0.6], [0.6, 0.95]]) * half
    for end, x in (("rear", -0.01), ("front", middle * 2 + 0.01)):
        glow = soup.add_object("car", (0.5, 0.02, 0.02) if end == "rear" else (0.8, 0.8, 0.75))
        for a, b in lights:
            lamp = place(np.full(4, x), np.array([a, b, b, a]), np.array([0.58, 0.58, 0.74, 0.74]))
            soup.quads(lamp[None], Material.CAR_LIGHT, glow)
        plate = place(np.full(4, x), np.array([-0.26, 0.26, 0.26, -0.26]),
                      np.array([0.42, 0.42, 0.53, 0.53]))  # fmt: skip
        sign_id = soup.add_object("car", (0.75, 0.72, 0.6))
        soup.quads(plate[None], Material.PLAIN, sign_id)
