# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A world in the making: what it is asked to be, its streets and zones, and what stands where."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float64

from adafusion.sim.numeric import keyed_rng
from adafusion.sim.town.shapes import Point, SoupBuilder

ROAD_HALF_M = 5.5
WALK_HALF_M = 8.8  # road and pavements
PATH_HALF_M = 1.7
KERB_M = 0.12

Rect = tuple[float, float, float, float, float]  # x, y, yaw, half length, half width
Rects = Sequence[Rect] | Float64[np.ndarray, "n 5"]


@dataclass(frozen=True, kw_only=True)
class WorldSpec:
    """What a world is made from: equal specs give equal worlds."""

    seed: int
    columns: int = 5  # street crossings from west to east ...
    rows: int = 5  # ... and from south to north
    spacing_m: float = 84.0
    corridors: int = 4  # identical passages, told apart by flat paint alone ...
    corridor_m: float = 140.0
    halls: int = 2
    tunnels: int = 2
    blank_walls: int = 2  # streets between two blank walls

    def __post_init__(self) -> None:
        if self.columns < 2 or self.rows < 3:
            raise ValueError(f"{self.columns} x {self.rows} crossings are no town: 2 x 3 at least")
        if not 55.0 <= self.spacing_m <= 200.0:
            raise ValueError(f"spacing_m = {self.spacing_m}: blocks are 55 to 200 m wide")
        for name, most in (("corridors", 4), ("halls", 2), ("tunnels", 2), ("blank_walls", 2)):
            if not 0 <= getattr(self, name) <= most:
                raise ValueError(f"{name} = {getattr(self, name)}: there is room for 0 to {most}")
        if not 20.0 <= self.corridor_m <= 300.0:
            raise ValueError(f"corridor_m = {self.corridor_m}: corridors are 20 to 300 m long")


@dataclass(frozen=True)
class Zone:
    """An axis-aligned box with a name for the kind of place inside."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    kind: str  # "corridor", "hall", "tunnel", "blank wall", "park"
    indoor: bool
    light: float  # ambient radiance inside, where indoor: lamps bounced off the walls

    def contains(self, x: float, y: float, margin: float = 0.0) -> bool:
        """Whether (x, y) lies within `margin` metres of the box."""
        return bool(
            self.lower[0] - margin <= x <= self.upper[0] + margin
            and self.lower[1] - margin <= y <= self.upper[1] + margin
        )


@dataclass(frozen=True, eq=False)
class Street:
    """An edge of the street graph."""

    ends: tuple[int, int]  # nodes
    line: Float64[np.ndarray, "n 2"]  # middle line from the first node to the second, metres
    kind: str  # "street", "path" (no cars), or one of INDOORS


INDOORS = ("corridor", "hall", "tunnel")
_GRAIN = 1024.0  # a metre in steps that a float holds exactly, up to 8 km from the origin


@dataclass(frozen=True)
class Passage:
    """A building to drive through. Its frame: x along the way, y to the left, z up, from the floor.

    It stands at whole metres and turned by quarters, and its corners lie on a grid of 1/1024 m: so
    the corners of two passages of a kind are equal to the last bit, each seen from its own frame.
    """

    kind: str
    x: int  # middle of the floor in the world, metres
    y: int
    quarter: int  # turns to the left by 90 degrees
    length_m: float

    def place(self, points: Float[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3"]:
        """Map points of its own frame to the world."""
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[self.quarter]
        x, y, z = np.moveaxis(np.round(points * _GRAIN) / _GRAIN, -1, 0)
        return np.stack([self.x + c * x - s * y, self.y + s * x + c * y, z], axis=-1)

    def rect(self, beyond_m: float, half_width_m: float) -> Rect:
        """The ground from `beyond_m` before one door to as much behind the other."""
        yaw = self.quarter * math.pi / 2
        return float(self.x), float(self.y), yaw, self.length_m / 2 + beyond_m, half_width_m


@dataclass(frozen=True, eq=False)
class Hills:
    """Height of the ground: a few long waves, level around passages."""

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

    def at(self, xy: Point) -> float:
        """Height in metres at one point."""
        return float(self(np.array([[xy[0], xy[1]]]))[0])


@dataclass
class Plan:
    """What is built so far."""

    spec: WorldSpec
    soup: SoupBuilder = field(default_factory=SoupBuilder)
    nodes: list[tuple[float, float]] = field(default_factory=list)
    streets: list[Street] = field(default_factory=list)
    zones: list[Zone] = field(default_factory=list)
    lamps: list[tuple[float, ...]] = field(default_factory=list)  # as in `World.lamps`
    passages: list[Passage] = field(default_factory=list)  # the first zones are their insides
    taken: list[Rect] = field(default_factory=list)  # ways, parks, gardens: no building may enter
    solid: list[Rect] = field(default_factory=list)  # buildings, passages: nothing may enter
    aloft: list[Rect] = field(default_factory=list)  # balconies and awnings: no crown may enter
    walled: set[int] = field(default_factory=set)  # numbers of the streets between blank walls
    # points along roads and paths: x, y, half the width, number of the street
    ways: Float64[np.ndarray, "n 4"] = field(default_factory=lambda: np.zeros((0, 4)))
    hills: Hills = field(default_factory=lambda: Hills(np.zeros((0, 4)), ()))

    def rng(self, *key: int | str) -> np.random.Generator:
        """Random numbers of one object of this world."""
        return keyed_rng(self.spec.seed, *key)

    def blocked(self, xy: Point, radius: float) -> bool:
        """Whether a disc on the ground would touch something solid."""
        return touches(xy, radius, self.solid)

    def on_road(self, xy: Point, own: int, clearance: float) -> bool:
        """Whether a point is on a path or a road, other than street number `own`."""
        x, y, half, number = self.ways.T
        near = np.hypot(x - float(xy[0]), y - float(xy[1])) < half + (clearance + 1.0)
        return bool((near & (number != own)).any())

    def clear_run(
        self, number: int, laterals: Sequence[float], clearance: float, *, paths: bool
    ) -> tuple[float, float]:
        """From where to where, in whole metres along a street, its borders meet no other way.

        Borders are lines at those `laterals`; they keep `clearance` from the edges of other roads
        and, with `paths`, of footpaths. The part is the one with the middle of the street in it.
        """
        line = self.streets[number].line
        s = np.arange(0.0, along(line)[-1])
        way = resampled(line, s)
        low, high = way.min(axis=0) - 25.0, way.max(axis=0) + 25.0
        x, y, half, owner = self.ways.T
        near = (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1]) & (owner != number)
        others = self.ways[near & (half >= (0.0 if paths else ROAD_HALF_M))]
        taken = np.zeros(len(s), bool)
        for lateral in laterals:
            apart = offset_line(way, lateral)[:, None] - others[:, :2]
            taken |= (np.hypot(*apart.transpose(2, 0, 1)) < others[:, 2] + clearance).any(axis=1)
        stops = np.flatnonzero(taken)
        k = int(np.searchsorted(stops, len(s) // 2))
        first = stops[k - 1] + 1 if k > 0 else 0
        last = stops[k] - 1 if k < len(stops) else len(s) - 1
        return float(first), float(last)


def touches(xy: Point, radius: float, others: Rects) -> bool:
    """Whether a disc meets any turned rectangle."""
    x, y, yaw, half_length, half_width = np.reshape(others, (-1, 5)).T
    dx, dy = float(xy[0]) - x, float(xy[1]) - y
    along_x = np.abs(np.cos(yaw) * dx + np.sin(yaw) * dy) - half_length
    along_y = np.abs(np.cos(yaw) * dy - np.sin(yaw) * dx) - half_width
    outside = np.hypot(np.maximum(along_x, 0.0), np.maximum(along_y, 0.0))
    return bool((outside < radius).any())


def overlaps(rect: Rect, others: Rects) -> bool:
    """Whether a turned rectangle meets any other (separating axes)."""
    b = np.reshape(others, (-1, 5))
    delta = b[:, :2] - rect[:2]
    near = np.hypot(*delta.T) < np.hypot(*b[:, 3:].T) + math.hypot(*rect[3:])
    b, delta = b[near], delta[near]
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
    return not bool(apart.all())


# ----------------------------------------------------------------------------------------- lines


def arc(
    start: Float[np.ndarray, " 2"], end: Float[np.ndarray, " 2"], bulge: float = 0.0
) -> Float64[np.ndarray, "n 2"]:
    """Points every 4 m or less from start to end, bulging to the left by a parabola."""
    d = end - start
    length = float(np.hypot(*d))
    s = np.linspace(0.0, 1.0, max(2, math.ceil(length / 4.0) + 1))[:, None]
    normal = np.array([-d[1], d[0]]) / length
    return start + s * d + 4.0 * bulge * s * (1.0 - s) * normal


def offset_line(
    line: Float[np.ndarray, "n 2"], lateral: float | Float[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 2"]:
    """Move a line to its left by `lateral` metres."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    return line + normal * np.reshape(lateral, (-1, 1))


def along(line: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
    """Distance from the start of a line to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])


def point_on(line: Float[np.ndarray, "n 2"], s: float) -> tuple[Float64[np.ndarray, " 2"], float]:
    """The point at distance s along a line, and the heading there."""
    way = along(line)
    xy = np.array([np.interp(s, way, line[:, 0]), np.interp(s, way, line[:, 1])])
    k = int(np.clip(np.searchsorted(way, s) - 1, 0, len(line) - 2))
    d = line[k + 1] - line[k]
    return xy, math.atan2(d[1], d[0])


def resampled(
    line: Float[np.ndarray, "n 2"], s: Float[np.ndarray, " m"]
) -> Float64[np.ndarray, "m 2"]:
    """The points at distances s along a line."""
    way = along(line)
    return np.column_stack([np.interp(s, way, line[:, 0]), np.interp(s, way, line[:, 1])])


def trimmed(
    line: Float[np.ndarray, "n 2"], head: float, tail: float
) -> Float64[np.ndarray, "m 2"] | None:
    """A line without its first `head` and last `tail` metres; None if nothing is left."""
    s = along(line)
    if s[-1] <= head + tail + 2.0:
        return None
    pieces = max(1, math.ceil((s[-1] - head - tail) / 4.0))
    return resampled(line, np.linspace(head, s[-1] - tail, pieces + 1))


def forward(yaw: float) -> Float64[np.ndarray, " 2"]:
    """Unit vector that heads `yaw`."""
    return np.array([math.cos(yaw), math.sin(yaw)])


def leftward(yaw: float) -> Float64[np.ndarray, " 2"]:
    """Unit vector to the left of one that heads `yaw`."""
    return np.array([-math.sin(yaw), math.cos(yaw)])
