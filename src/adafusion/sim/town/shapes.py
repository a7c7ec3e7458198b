# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Triangles with texture coordinates, and the prisms that most things are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8

Rgb = tuple[float, float, float]
Colour = Sequence[float] | Float[np.ndarray, " 3"]  # linear RGB, 0 to 1
Point = Sequence[float] | Float[np.ndarray, " 2"]  # x, y in metres


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
    WALL = 13  # painted: indoors, and blank ones along streets; uv in metres
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
LIT = 1  # style of the lamps of a vehicle that drives: those of a parked one are off


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

    def add_object(self, kind: str, tint: Colour = (0.5, 0.5, 0.5), **columns: Any) -> int:
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
        # from the first corner: world coordinates would make the texture mark the place
        self.quads(corners, material, object_id, corners[:, :, :2] - outline[0])

    def block(
        self,
        outline: Float[np.ndarray, "k 2"],
        bottom: float,
        top: float,
        material: Material,
        object_id: int,
        *,
        floor: bool = False,
    ) -> None:
        """Walls and lid over an outline; with `floor` closed below as well."""
        self.walls(outline, bottom, top, material, object_id)
        self.cap(outline, top, material, object_id)
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
            corners=corners[real].astype(np.float32),
            uv=uv[real].astype(np.float32),
            material=material[real],
            object_id=object_id[real],
            objects=np.array(self._rows, np.float32).reshape(-1, COLUMNS),
            kinds=tuple(self._kinds),
        )


# ------------------------------------------------------------------------------------- outlines


def turned(points: Float[np.ndarray, "n 2"], xy: Point, yaw: float) -> Float[np.ndarray, "n 2"]:
    """Turn points by `yaw` and move them to `xy`."""
    c, s = np.cos(yaw), np.sin(yaw)
    return points @ np.array([[c, s], [-s, c]]) + np.asarray(xy, float)


def rectangle(xy: Point, length: float, width: float, yaw: float) -> Float[np.ndarray, "4 2"]:
    """Outline of a rectangle, anticlockwise; its first side is the far right one, along `yaw`."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (length / 2, width / 2)
    return turned(corners, xy, yaw)


def disc(xy: Point, radius: float, sides: int) -> Float[np.ndarray, "k 2"]:
    """Outline of a regular polygon."""
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    return np.asarray(xy, float) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
