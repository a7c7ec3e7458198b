# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicles of one run, parked and in traffic: the only geometry that differs between runs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64
from scipy.spatial import KDTree

from adafusion.sim.numeric import keyed_rng
from adafusion.sim.plan import along, leftward, point_on
from adafusion.sim.shapes import Material, Point, Soup, SoupBuilder, turned
from adafusion.sim.world import World

PARKING_M = 4.5  # lateral middle of a parked car
BAY_M = 5.9  # length of a parking place
CLEAR_M = 2.0  # nothing stands nearer to the way of the run's own vehicle


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
    soup: SoupBuilder, rng: np.random.Generator, xy: Point, z: float, yaw: float
) -> None:
    """Put one vehicle of random make and colour on the ground at `xy`."""
    shape = VEHICLES[rng.choice(len(VEHICLES), p=(0.36, 0.30, 0.22, 0.12))]
    paint = np.array(_PAINTS[rng.integers(len(_PAINTS))]) * rng.uniform(0.8, 1.1)
    site = _Site(shape, xy, z, yaw)
    car = soup.add_object("car", paint)
    _add_body(soup, site, car)
    if shape.body[1][1] > 2.0:
        _add_van_panes(soup, site, car)
    else:
        _add_cabin(soup, site, car)
    for x in shape.wheels:
        for side in (1, -1):
            _add_wheel(soup, site, car, x, side)
    ends = np.array([0.1, site.length - 0.1, site.length - 0.1, 0.1])
    under = site(ends, np.array([1, 1, -1, -1]) * (site.half - 0.05), np.full(4, 0.33))
    soup.quads(under[None], Material.RUBBER, car)
    _add_lights(soup, site)


class _Site:
    """Where a vehicle stands: maps (x from its rear, y to its left, z up) to the world."""

    def __init__(self, shape: VehicleShape, xy: Point, z: float, yaw: float) -> None:
        self.shape, self.xy, self.z, self.yaw = shape, xy, z, yaw
        self.half = shape.width / 2
        self.length = max(x for x, _ in shape.body)

    def __call__(
        self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], z: Float[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3"]:
        flat = turned(np.column_stack([x - self.length / 2, y]), self.xy, self.yaw)
        return np.column_stack([flat, z + self.z])


def _fan(outline: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, "k 4 3"]:
    """Quads that fill a convex outline."""
    n = len(outline)
    return np.array([outline[[0, i, i + 1, min(i + 2, n - 1)]] for i in range(1, n - 1, 2)])


def _add_body(soup: SoupBuilder, site: _Site, car: int) -> None:
    """Draw the side view across the whole width."""
    x, z = np.array(site.shape.body).T
    left, right = (site(x, np.full(len(x), y), z) for y in (site.half, -site.half))
    across = np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)
    soup.quads(across, Material.CAR_BODY, car)
    for side in (left, right):
        soup.quads(_fan(side), Material.CAR_BODY, car)


def _add_van_panes(soup: SoupBuilder, site: _Site, car: int) -> None:
    """Windscreen and side windows, flat on the body."""
    x = np.array([3.97, 4.33, 4.33, 3.97])
    screen = site(
        x, np.array([1, 1, -1, -1]) * site.half * 0.88, np.array([2.22, 1.56, 1.56, 2.22])
    )
    screen[:, 2] += 0.02
    soup.quads(screen[None], Material.GLASS, car)
    x, z = np.array(site.shape.cabin).T
    for side in (1.01, -1.01):
        pane = site(x, np.full(4, side * site.half), z)
        soup.quads(pane[None], Material.GLASS, car)


def _add_cabin(soup: SoupBuilder, site: _Site, car: int) -> None:
    """A cabin that narrows upwards: roof, screens, pillars, and side panes a hair outside."""
    cabin = np.array(site.shape.cabin)
    low, top = site.half * 0.96, site.half * 0.78
    widths = np.array([low, top, top, low])
    left, right = (site(cabin[:, 0], y * widths, cabin[:, 1]) for y in (1, -1))
    roof = np.stack([left[1], left[2], right[2], right[1]])
    soup.quads(roof[None], Material.CAR_BODY, car)
    rear = np.stack([left[0], left[1], right[1], right[0]])
    front = np.stack([left[3], left[2], right[2], right[3]])
    soup.quads(np.stack([rear, front]), Material.GLASS, car)
    soup.quads(left[None], Material.CAR_BODY, car)
    soup.quads(right[None], Material.CAR_BODY, car)
    z0, z1 = cabin[0, 1] + 0.06, cabin[1, 1] - 0.07
    outside = np.array([low - 0.005, low - 0.005, top + 0.03, top + 0.03])
    for side in (1, -1):
        for a, b in ((0.10, 0.50), (0.55, 0.94)):
            below = cabin[0, 0] + (cabin[3, 0] - cabin[0, 0]) * np.array([a, b])
            above = cabin[1, 0] + (cabin[2, 0] - cabin[1, 0]) * np.array([a, b])
            x = np.array([below[0] + 0.05, below[1], above[1], above[0]])
            pane = site(x, side * outside, np.array([z0, z0, z1, z1]))
            soup.quads(pane[None], Material.GLASS, car)


def _add_wheel(soup: SoupBuilder, site: _Site, car: int, x: float, side: int) -> None:
    angle, radius = 2 * np.pi * np.arange(9) / 8, site.shape.wheel_radius
    rim_x, rim_z = x + radius * np.cos(angle), radius * (1 + np.sin(angle))
    half = site.half
    face = site(rim_x[:8], np.full(8, side * (half + 0.015)), rim_z[:8])
    soup.quads(_fan(face), Material.RUBBER, car)
    hub = site(
        x + 0.55 * (rim_x[:8] - x),
        np.full(8, side * (half + 0.022)),
        radius + 0.55 * (rim_z[:8] - radius),
    )
    soup.quads(_fan(hub), Material.METAL, car)
    inner = site(rim_x, np.full(9, side * (half - 0.2)), rim_z)
    outer = site(rim_x, np.full(9, side * (half + 0.015)), rim_z)
    tread = np.stack([inner[:-1], inner[1:], outer[1:], outer[:-1]], axis=1)
    soup.quads(tread[4:], Material.RUBBER, car)  # the lower half: the arch hides the rest


def _add_lights(soup: SoupBuilder, site: _Site) -> None:
    """Lamps and a number plate at both ends."""
    for x, colour in ((-0.01, (0.5, 0.02, 0.02)), (site.length + 0.01, (0.8, 0.8, 0.75))):
        glow = soup.add_object("car", colour)
        z = np.array([0.58, 0.58, 0.74, 0.74])
        for a, b in ((-0.95, -0.6), (0.6, 0.95)):
            lamp = site(np.full(4, x), np.array([a, b, b, a]) * site.half, z)
            soup.quads(lamp[None], Material.CAR_LIGHT, glow)
        plate = soup.add_object("car", (0.75, 0.72, 0.6))
        y, z = np.array([-0.26, 0.26, 0.26, -0.26]), np.array([0.42, 0.42, 0.53, 0.53])
        soup.quads(site(np.full(4, x), y, z)[None], Material.PLAIN, plate)


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
    for e, street in enumerate(world.streets):
        if street.kind != "street":
            continue
        length = float(along(street.line)[-1])

        def put(
            rng: np.random.Generator, s: float, side: float, lateral: float, skew: float,
            line: Float64[np.ndarray, "n 2"] = street.line,
        ) -> None:  # fmt: skip
            xy, yaw = point_on(line, s)
            foot = xy + leftward(yaw) * (side * lateral)
            if way.query(foot)[0] > CLEAR_M:  # on the left of the line they come towards us
                heading = yaw + (math.pi if side > 0 else 0.0) + skew
                add_vehicle(soup, rng, foot, world.hills.at(foot), heading)

        busy = keyed_rng(world.spec.seed, "street", e, "parking").uniform(0.2, 1.8, 2)
        for side, busyness in ((1, busy[1]), (-1, busy[0])):
            for k, s in enumerate(np.arange(15.0, length - 16.0, BAY_M).tolist()):
                rng = keyed_rng(run_seed, "street", e, side, "parked", k)
                if rng.random() < parked * busyness:
                    s += float(rng.uniform(-0.4, 0.4))
                    lateral = PARKING_M + float(rng.uniform(-0.15, 0.15))
                    put(rng, s, float(side), lateral, float(rng.normal(0.0, 0.02)))
        rng = keyed_rng(run_seed, "street", e, "traffic")
        count = rng.poisson(traffic * length / 40.0)
        for s in rng.uniform(20.0, max(length - 20.0, 21.0), count).tolist():
            put(rng, s, float(rng.choice([-1.0, 1.0])), 2.3, 0.0)
    return soup.build()
