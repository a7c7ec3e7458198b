# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Cars, vans, buses and lorries: of each kind one shape, built once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Float64

from adafusion.sim.town.shapes import LIT, Material, Soup, SoupBuilder, rectangle

# a hull is drawn through cross-sections, each a polygon of one half:
# share of the half width, share of the way from the underside to the shoulder
_ROUND = ((0.90, 0.0), (1.0, 0.32), (0.985, 0.74), (0.88, 1.0))
_UPRIGHT = ((0.96, 0.0), (1.0, 0.12), (0.985, 0.86), (0.90, 1.0))
Section = tuple[float, float, float, float]  # x from the rear, underside, shoulder, half width


@dataclass(frozen=True)
class VehicleShape:
    """A vehicle in metres: x along its length from the rear bumper, z up."""

    hull: tuple[Section, ...]  # from the rear to the front
    profile: tuple[tuple[float, float], ...]
    cabin: tuple[tuple[float, float], ...]  # lower rear, upper rear, upper front, lower front
    panes: tuple[tuple[float, float], ...]  # of the cabin's sides, as shares of its length
    wheels: tuple[float, ...]
    wheel_radius: float
    lamp_m: float  # height of the lamps' middle

    @property
    def length(self) -> float:
        """From bumper to bumper."""
        return self.hull[-1][0]

    @property
    def half_width(self) -> float:
        """Half of the widest section."""
        return max(section[3] for section in self.hull)


HATCHBACK = VehicleShape(
    hull=(
        (0.0, 0.42, 0.90, 0.74), (0.12, 0.30, 0.98, 0.83), (0.7, 0.22, 1.0, 0.875),
        (2.7, 0.2, 0.98, 0.875), (3.5, 0.22, 0.88, 0.855), (3.88, 0.28, 0.80, 0.78),
        (4.0, 0.36, 0.73, 0.68),
    ),
    profile=_ROUND,
    cabin=((0.10, 0.96), (0.52, 1.46), (1.95, 1.50), (2.95, 0.96)),
    panes=((0.08, 0.30), (0.34, 0.62), (0.65, 0.94)),
    wheels=(0.72, 3.2), wheel_radius=0.31, lamp_m=0.62,
)  # fmt: skip
SALOON = VehicleShape(
    hull=(
        (0.0, 0.42, 0.84, 0.76), (0.15, 0.28, 0.96, 0.86), (0.9, 0.22, 1.0, 0.91),
        (3.2, 0.2, 0.97, 0.91), (4.1, 0.22, 0.86, 0.89), (4.5, 0.28, 0.80, 0.81),
        (4.65, 0.36, 0.73, 0.70),
    ),
    profile=_ROUND,
    cabin=((0.72, 0.96), (1.42, 1.40), (2.65, 1.44), (3.5, 0.94)),
    panes=((0.10, 0.50), (0.54, 0.94)),
    wheels=(0.9, 3.75), wheel_radius=0.33, lamp_m=0.62,
)  # fmt: skip
ESTATE = VehicleShape(
    hull=(
        (0.0, 0.5, 1.0, 0.80), (0.12, 0.38, 1.08, 0.89), (0.9, 0.32, 1.12, 0.94),
        (3.3, 0.3, 1.10, 0.94), (4.15, 0.32, 1.02, 0.92), (4.5, 0.38, 0.94, 0.84),
        (4.65, 0.46, 0.87, 0.74),
    ),
    profile=_ROUND,
    cabin=((0.08, 1.06), (0.38, 1.66), (2.45, 1.70), (3.4, 1.06)),
    panes=((0.05, 0.28), (0.32, 0.60), (0.63, 0.94)),
    wheels=(0.9, 3.75), wheel_radius=0.37, lamp_m=0.75,
)  # fmt: skip
VAN = VehicleShape(
    hull=(
        (0.0, 0.4, 2.25, 0.93), (0.1, 0.3, 2.34, 0.98), (3.75, 0.28, 2.36, 0.99),
        (4.0, 0.28, 2.2, 0.98), (4.5, 0.28, 1.38, 0.97), (5.05, 0.32, 1.08, 0.86),
        (5.2, 0.42, 0.85, 0.74),
    ),
    profile=_UPRIGHT,
    cabin=((3.35, 1.22), (3.4, 1.98), (4.0, 1.98), (4.42, 1.3)),
    panes=((0.04, 0.94),),
    wheels=(0.95, 4.25), wheel_radius=0.36, lamp_m=0.78,
)  # fmt: skip
BUS = VehicleShape(
    hull=(
        (0.0, 0.5, 2.75, 1.15), (0.12, 0.32, 2.95, 1.24), (10.7, 0.3, 2.95, 1.24),
        (10.95, 0.32, 2.8, 1.2), (11.0, 0.5, 2.6, 1.12),
    ),
    profile=_UPRIGHT,
    cabin=((0.5, 1.25), (0.5, 2.35), (10.6, 2.35), (10.6, 1.25)),
    panes=tuple((k / 7 + 0.008, (k + 1) / 7 - 0.008) for k in range(7)),
    wheels=(2.7, 8.4), wheel_radius=0.48, lamp_m=0.75,
)  # fmt: skip
LORRY = VehicleShape(  # its cab; the box behind it is added apart
    hull=(
        (6.35, 0.55, 2.55, 1.16), (6.5, 0.5, 2.75, 1.2), (7.9, 0.45, 2.7, 1.2),
        (8.3, 0.42, 1.7, 1.18), (8.4, 0.45, 1.55, 1.1),
    ),
    profile=_UPRIGHT,
    cabin=((7.05, 1.5), (7.05, 2.35), (7.75, 2.35), (7.95, 1.5)),
    panes=((0.0, 1.0),),
    wheels=(1.3, 2.4, 7.35), wheel_radius=0.48, lamp_m=0.85,
)  # fmt: skip
CARS = (HATCHBACK, SALOON, ESTATE, VAN)  # what parks
CAR_ODDS = (0.36, 0.30, 0.22, 0.12)
VEHICLES = (*CARS, BUS, LORRY)  # what drives
VEHICLE_ODDS = (0.29, 0.25, 0.20, 0.12, 0.08, 0.06)
_PAINTS = (
    (0.62, 0.62, 0.63), (0.03, 0.03, 0.035), (0.28, 0.29, 0.31), (0.72, 0.72, 0.70),
    (0.05, 0.09, 0.25), (0.35, 0.03, 0.03), (0.10, 0.11, 0.12), (0.07, 0.16, 0.12),
    (0.45, 0.42, 0.36), (0.55, 0.25, 0.05),
)  # fmt: skip
_LIVERIES = ((0.45, 0.03, 0.03), (0.62, 0.42, 0.03), (0.65, 0.65, 0.63), (0.05, 0.22, 0.10))


def paint_of(shape: VehicleShape, rng: np.random.Generator) -> Float64[np.ndarray, "1 3"]:
    """Draw a colour that such a vehicle comes in."""
    choice = _LIVERIES if shape in (BUS, LORRY) else _PAINTS
    return np.array([choice[int(rng.integers(len(choice)))]]) * rng.uniform(0.8, 1.1)


@cache
def vehicle(shape: VehicleShape, *, lit: bool) -> Soup:
    """Triangles of a vehicle around the origin, x forward, its wheels on z = 0.

    Its first object is what is painted. With `lit` its lamps have the style `LIT`.
    """
    soup = SoupBuilder()
    paint = soup.add_object("car")
    trim = soup.add_object("car", (0.02, 0.02, 0.02))
    body = _Bodywork(soup, shape)
    body.add_hull(paint)
    body.add_cabin(paint)
    if shape is LORRY:
        body.add_box(trim)
    for x in shape.wheels:
        for side in (1.0, -1.0):
            body.add_wheel(x, side, trim)
    body.add_ends(trim, LIT if lit else 0)
    return soup.build()


class _Bodywork:
    """A vehicle in the making: puts quads at (x from its rear, y to its left, z up)."""

    def __init__(self, soup: SoupBuilder, shape: VehicleShape) -> None:
        self.soup, self.shape = soup, shape
        self.half = shape.half_width

    def quads(self, corners: Float[np.ndarray, "k 4 3"], material: Material, owner: int) -> None:
        self.soup.quads(corners - (self.shape.length / 2, 0.0, 0.0), material, owner)

    def panel(
        self,
        x: tuple[float, float, float, float],
        y: tuple[float, float, float, float],
        z: tuple[float, float, float, float],
        material: Material,
        owner: int,
    ) -> None:
        """One quad, by its columns."""
        self.quads(np.column_stack([x, y, z])[None], material, owner)

    def add_hull(self, paint: int) -> None:
        """Skin over the sections, both ends, and a dark underside."""
        sections = np.array(self.shape.hull)
        width, level = np.array(self.shape.profile).T
        x, low, high, half = sections.T[:, :, None]
        left = np.stack(np.broadcast_arrays(x, half * width, low + level * (high - low)), axis=2)
        right = left * (1.0, -1.0, 1.0)
        ring = np.concatenate([left, right[:, ::-1]], axis=1)  # up the left side, down the right
        skin = np.stack([ring[:-1, :-1], ring[1:, :-1], ring[1:, 1:], ring[:-1, 1:]], axis=2)
        self.quads(skin.reshape(-1, 4, 3), Material.CAR_BODY, paint)
        for end in (ring[0], ring[-1]):
            self.quads(_fan(end), Material.CAR_BODY, paint)
        below = np.stack([left[:-1, 0], left[1:, 0], right[1:, 0], right[:-1, 0]], axis=1)
        self.quads(below, Material.RUBBER, paint)

    def add_cabin(self, paint: int) -> None:
        """Roof, pillars and panes above the shoulder, or panes alone on a hull that is high."""
        (x0, z0), (x1, z1), (x2, z2), (x3, z3) = self.shape.cabin
        low, top = 0.86 * self.half, 0.72 * self.half
        tall = self.shape.profile is _UPRIGHT
        if tall:
            low = top = self.half
            self._add_windscreen()
        else:
            cabin = np.array(self.shape.cabin)
            left = np.column_stack([cabin[:, 0], (low, top, top, low), cabin[:, 1]])
            right = left * (1.0, -1.0, 1.0)
            # up the rear, over the roof, down the windscreen
            bands = np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)
            self.quads(np.stack([*bands, left, right]), Material.CAR_BODY, paint)
            for (xa, za), (xb, zb), away in (
                ((x0, z0), (x1, z1), -0.012),
                ((x3, z3), (x2, z2), 0.012),
            ):
                a, b = 0.10, 0.90  # of the way up
                xs = (xa + a * (xb - xa) + away, xa + b * (xb - xa) + away)
                ys = tuple(0.9 * (low + share * (top - low)) for share in (a, b))
                zs = (za + a * (zb - za) + 0.01, za + b * (zb - za) + 0.01)
                self.panel(
                    (xs[0], xs[1], xs[1], xs[0]), (ys[0], ys[1], -ys[1], -ys[0]),
                    (zs[0], zs[1], zs[1], zs[0]), Material.GLASS, paint,
                )  # fmt: skip
        for a, b in self.shape.panes:
            rise = (0.0, 1.0) if tall else (0.12, 0.86)

            def at(share: float, up: float) -> tuple[float, float, float]:
                below, above = x0 + share * (x3 - x0), x1 + share * (x2 - x1)
                foot, head = z0 + share * (z3 - z0), z1 + share * (z2 - z1)
                y = low + up * (top - low) + 0.012
                return below + up * (above - below), y, foot + up * (head - foot)

            pane = np.array([at(a, rise[0]), at(b, rise[0]), at(b, rise[1]), at(a, rise[1])])
            self.quads(np.stack([pane, pane * (1.0, -1.0, 1.0)]), Material.GLASS, paint)

    def _add_windscreen(self) -> None:
        """Glass on the sections before the cabin, where a high hull slopes down to its front."""
        hull = np.array(self.shape.hull)
        # the last part of the roof line that falls steeply is the screen
        fall = np.diff(hull[:, 2]) / np.maximum(np.diff(hull[:, 0]), 1e-3)
        k = int(np.argmin(fall[len(fall) // 2 :])) + len(fall) // 2
        (xa, _, za, wa), (xb, _, zb, wb) = hull[k], hull[k + 1]
        if self.shape is BUS:  # its screen is its whole front
            (xa, za, wa), (xb, zb, wb) = (11.0, 2.45, 1.12), (11.0, 1.15, 1.12)
        ya, yb = 0.84 * wa, 0.86 * wb
        xs = np.array([xa + 0.06 * (xb - xa), xb - 0.06 * (xb - xa)]) + 0.02
        zs = np.array([za + 0.06 * (zb - za), zb - 0.06 * (zb - za)]) + 0.01
        self.panel(
            (xs[0], xs[1], xs[1], xs[0]), (ya, yb, -yb, -ya), (zs[0], zs[1], zs[1], zs[0]),
            Material.GLASS, 0,
        )  # fmt: skip

    def add_box(self, trim: int) -> None:
        """The load of a lorry on its chassis."""
        load = self.soup.add_object("car", (0.55, 0.55, 0.53))
        middle = (3.1 - self.shape.length / 2, 0.0)
        self.soup.block(
            rectangle(middle, 6.2, 2.48, 0.0), 1.05, 3.5, Material.PLAIN, load, floor=True
        )
        beam = rectangle((3.3 - self.shape.length / 2, 0.0), 6.5, 1.0, 0.0)
        self.soup.block(beam, 0.6, 1.05, Material.RUBBER, trim)

    def add_wheel(self, x: float, side: float, trim: int) -> None:
        """Arch, tyre and rim flat on the side; of the tread the lower half."""
        radius, y = self.shape.wheel_radius, side * (self.half + 0.004)
        if x > self.shape.hull[0][0]:
            arch = np.linspace(-0.35, math.pi + 0.35, 8)
            self._disc(x, y, radius * 1.2, radius, arch, Material.RUBBER, trim)
        around = 2 * np.pi * np.arange(8) / 8
        self._disc(x, y + side * 0.006, radius, radius, around, Material.RUBBER, trim)
        rim = self.soup.add_object("car", (0.34, 0.34, 0.36))
        self._disc(x, y + side * 0.012, radius * 0.62, radius, around, Material.METAL, rim)
        self._disc(x, y + side * 0.018, radius * 0.16, radius, around, Material.RUBBER, trim)
        angle = np.pi + np.pi * np.arange(5) / 4
        a, b = (
            np.column_stack(
                [x + radius * np.cos(angle), np.full(5, depth), radius * (1 + np.sin(angle))]
            )
            for depth in (y + side * 0.006, y - side * 0.2)
        )
        tread = np.stack([a[:-1], a[1:], b[1:], b[:-1]], axis=1)
        self.quads(tread, Material.RUBBER, trim)

    def _disc(
        self,
        x: float,
        y: float,
        radius: float,
        z: float,
        angle: Float[np.ndarray, " n"],
        material: Material,
        owner: int,
    ) -> None:
        n = len(angle)
        edge = [x + radius * np.cos(angle), np.full(n, y), z + radius * np.sin(angle)]
        self.quads(_fan(np.column_stack(edge)), material, owner)

    def add_ends(self, trim: int, style: int) -> None:
        """Lamps, number plates and the grille."""
        soup, z = self.soup, self.shape.lamp_m
        rear, front = self.shape.hull[0], self.shape.hull[-1]
        plate = soup.add_object("car", (0.75, 0.72, 0.6))
        for (x, _, _, half), away, colour in (
            ((min(rear[0], 0.0), *rear[1:]), -0.012, (0.5, 0.02, 0.02)),
            (front, 0.012, (0.8, 0.8, 0.75)),
        ):
            lamp = soup.add_object("car", colour, style=style)
            at = (x + away,) * 4
            for side in (1.0, -1.0):
                y = (side * 0.5 * half, side * 0.93 * half)
                up, low = z + 0.075, z - 0.075
                self.panel(
                    at, (y[0], y[1], y[1], y[0]), (low, low, up, up), Material.CAR_LIGHT, lamp
                )
            mark = (0.26, -0.26, -0.26, 0.26)
            self.panel(at, mark, (z - 0.24, z - 0.24, z - 0.13, z - 0.13), Material.PLAIN, plate)
        x, wide = front[0] + 0.008, 0.46 * front[3]
        self.panel(
            (x,) * 4, (wide, -wide, -wide, wide), (z - 0.08, z - 0.08, z + 0.06, z + 0.06),
            Material.RUBBER, trim,
        )  # fmt: skip


def _fan(outline: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, "k 4 3"]:
    """Quads that fill a convex outline."""
    n = len(outline)
    return np.array([outline[[0, i, i + 1, min(i + 2, n - 1)]] for i in range(1, n - 1, 2)])
