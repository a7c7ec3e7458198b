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
from adafusion.sim.shapes import Point, SoupBuilder

ROAD_HALF_M = 5.5
WALK_HALF_M = 8.8  # road and pavements
PATH_HALF_M = 1.7
KERB_M = 0.12


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
        if self.spacing_m < 55.0:
            raise ValueError(f"spacing_m = {self.spacing_m}: blocks need 55 m for houses or parks")
        if not 0 <= self.corridors <= 2:
            raise ValueError(f"corridors = {self.corridors}: west and east have room for one each")
        if self.corridor_m < 20.0:
            raise ValueError(f"corridor_m = {self.corridor_m} is a door, not a corridor")


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
        return bool(
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

    def at(self, xy: Point) -> float:
        """Height in metres at one point."""
        return float(self(np.array([[xy[0], xy[1]]]))[0])


Rect = tuple[float, float, float, float, float]  # x, y, yaw, half length, half width


@dataclass
class Plan:
    """What is built so far."""

    spec: WorldSpec
    soup: SoupBuilder = field(default_factory=SoupBuilder)
    nodes: list[tuple[float, float]] = field(default_factory=list)
    streets: list[Street] = field(default_factory=list)
    zones: list[Zone] = field(default_factory=list)
    lamps: list[tuple[float, ...]] = field(default_factory=list)  # as in `World.lamps`
    taken: list[Rect] = field(default_factory=list)  # ways and parks: no building may enter
    solid: list[Rect] = field(default_factory=list)  # buildings: nothing may enter
    hills: Hills = field(default_factory=lambda: Hills(np.zeros((0, 4)), ()))

    def rng(self, *key: int | str) -> np.random.Generator:
        """Random numbers of one object of this world."""
        return keyed_rng(self.spec.seed, *key)

    def blocked(self, xy: Point, radius: float) -> bool:
        """Whether a disc would touch a building."""
        return overlaps((float(xy[0]), float(xy[1]), 0.0, radius, radius), self.solid)

    def on_road(self, xy: Point, own: int, clearance: float) -> bool:
        """Whether a point is on a path or a road, other than street number `own`."""
        for index, street in enumerate(self.streets):
            if index == own or street.kind == "corridor":
                continue
            half = ROAD_HALF_M if street.kind == "street" else PATH_HALF_M
            if np.hypot(*(street.line - np.asarray(xy)).T).min() < half + clearance + 1.0:
                return True
        return False


def overlaps(rect: Rect, others: Sequence[Rect]) -> bool:
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


def trimmed(
    line: Float[np.ndarray, "n 2"], head: float, tail: float
) -> Float64[np.ndarray, "m 2"] | None:
    """A line without its first `head` and last `tail` metres; None if nothing is left."""
    s = along(line)
    if s[-1] <= head + tail + 2.0:
        return None
    at = np.linspace(head, s[-1] - tail, max(2, math.ceil((s[-1] - head - tail) / 4.0) + 1))
    return np.column_stack([np.interp(at, s, line[:, 0]), np.interp(at, s, line[:, 1])])


def forward(yaw: float) -> Float64[np.ndarray, " 2"]:
    """Unit vector that heads `yaw`."""
    return np.array([math.cos(yaw), math.sin(yaw)])


def leftward(yaw: float) -> Float64[np.ndarray, " 2"]:
    """Unit vector to the left of one that heads `yaw`."""
    return np.array([-math.sin(yaw), math.cos(yaw)])
