# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What stands along the pavements: lamps, signs, shelters, cabinets, benches, posts."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float64

from adafusion.sim.town.plan import (
    INDOORS,
    KERB_M,
    ROAD_HALF_M,
    Plan,
    Street,
    along,
    forward,
    leftward,
    point_on,
)
from adafusion.sim.town.planting import plant_street
from adafusion.sim.town.shapes import Material, Point, disc, rectangle

Xy = Float64[np.ndarray, " 2"]


def furnish_streets(plan: Plan) -> None:
    """Lamps and trees along streets and paths, small things along streets."""
    for e, street in enumerate(plan.streets):
        if street.kind in INDOORS:
            continue
        edge = ROAD_HALF_M + 0.75 if street.kind == "street" else 2.6
        _light_street(plan, e, street, edge)
        if e in plan.walled:  # nothing but lamps: blank walls are to look alike
            continue
        plant_street(plan, e, street, edge)
        if street.kind == "street":
            _place_things(plan, e, street)


def _light_street(plan: Plan, e: int, street: Street, edge: float) -> None:
    """Lamps of one kind, on alternate sides or on both."""
    soup, rng = plan.soup, plan.rng("street", e, "furniture")
    length = float(along(street.line)[-1])
    metal = soup.add_object("pole", np.array([0.22, 0.23, 0.24]) * rng.uniform(0.6, 1.5))
    height = float(rng.choice([5.0, 6.5, 8.0])) if street.kind == "street" else 4.2
    reach = 1.5 if street.kind == "street" else 0.2  # of the arm over the road
    colour = (1.0, 0.80, 0.52) if rng.random() < 0.6 else (0.9, 0.93, 1.0)
    glow = soup.add_object("lamp", colour)
    # the ground below a tall lamp is to be about as bright as below a low one
    power = np.array(colour, np.float32) * 0.085 * height
    pitch = float(rng.uniform(24.0, 33.0))
    s, side = float(rng.uniform(6.0, 14.0)), int(rng.choice([-1, 1]))
    both = rng.random() < 0.25
    while s < length - 5.0:
        for k in (side, -side) if both else (side,):
            xy, yaw = point_on(street.line, s)
            across = leftward(yaw) * k
            foot = xy + across * edge
            if plan.on_road(foot, e, 0.3) or plan.blocked(foot, 0.4):
                continue
            z = plan.hills.at(foot)
            top = z + height
            _add_pole(plan, foot, z, height, 0.085, metal)
            head = foot - across * reach
            arm = rectangle((foot + head) / 2, 0.1, 1.5, yaw)
            soup.block(arm, top - 0.05, top + 0.05, Material.METAL, metal)
            shade = rectangle(head, 0.35, 0.8, yaw)
            soup.block(shade, top + 0.02, top + 0.16, Material.METAL, metal)
            soup.cap(shade, top, Material.LAMP, glow)
            plan.lamps.append((*head.tolist(), top - 0.1, *power.tolist(), -1.0, 0.0))
        side = -side
        s += pitch if e in plan.walled else pitch * float(rng.uniform(0.9, 1.1))


def _add_pole(plan: Plan, xy: Point, z: float, height: float, radius: float, owner: int) -> None:
    plan.soup.walls(disc(xy, radius, 5), z - 0.3, z + height, Material.METAL, owner)


def _place_things(plan: Plan, e: int, street: Street) -> None:
    """Scatter small things over both pavements of a street."""
    length = float(along(street.line)[-1])
    count = int(plan.rng("street", e, "things").poisson(length / 11.0))
    odds = [thing[1] for thing in THINGS]
    for k in range(count):
        rng = plan.rng("street", e, "thing", k)
        s, side = float(rng.uniform(11.0, max(length - 11.0, 12.0))), float(rng.choice([-1.0, 1.0]))
        add, _, at_walls = THINGS[int(rng.choice(len(THINGS), p=odds))]
        xy, yaw = point_on(street.line, s)
        out = side * (float(rng.uniform(7.6, 8.1)) if at_walls else ROAD_HALF_M + 0.5)
        foot = xy + leftward(yaw) * out
        if not plan.on_road(foot, e, 1.0) and not plan.blocked(foot, 0.9):
            add(plan, foot, plan.hills.at(foot) + KERB_M, yaw, rng)


def _add_sign(plan: Plan, xy: Xy, z: float, yaw: float, rng: np.random.Generator) -> None:
    post = plan.soup.add_object("pole", (0.4, 0.4, 0.4))
    _add_pole(plan, xy, z, 2.7, 0.04, post)
    tints = [(0.55, 0.03, 0.03), (0.03, 0.10, 0.45), (0.65, 0.60, 0.05), (0.6, 0.6, 0.6)]
    plate = plan.soup.add_object("sign", tints[int(rng.integers(4))], style=int(rng.integers(3)))
    half = float(rng.uniform(0.28, 0.42))
    c, s = math.cos(yaw + math.pi / 2), math.sin(yaw + math.pi / 2)
    face = [(-half, 2.0), (half, 2.0), (half, 2.0 + 2 * half), (-half, 2.0 + 2 * half)]
    x, y = xy - forward(yaw) * 0.05
    corners = np.array([[(x + c * a, y + s * a, z + h) for a, h in face]])
    uv = np.array([[(-1, -1), (1, -1), (1, 1), (-1, 1)]], float)
    plan.soup.quads(corners, Material.SIGN, plate, uv)


def _add_cabinet(plan: Plan, xy: Xy, z: float, yaw: float, rng: np.random.Generator) -> None:
    tints = [(0.16, 0.24, 0.18), (0.35, 0.35, 0.34), (0.45, 0.08, 0.06), (0.5, 0.42, 0.08)]
    owner = plan.soup.add_object("cabinet", tints[int(rng.integers(4))])
    length, width, height = rng.uniform((0.6, 0.4, 0.9), (1.6, 0.7, 1.7)).tolist()
    bed = rectangle(xy, length, width, yaw)
    plan.soup.block(bed, z - 0.2, z + height, Material.PLAIN, owner)


def _add_bench(plan: Plan, xy: Xy, z: float, yaw: float, rng: np.random.Generator) -> None:
    owner = plan.soup.add_object("bench", (0.30, 0.18, 0.09))
    seat = rectangle(xy, 1.7, 0.45, yaw)
    plan.soup.block(seat, z + 0.4, z + 0.48, Material.PLAIN, owner, floor=True)
    for k in (-0.7, 0.7):
        leg = rectangle(xy + forward(yaw) * k, 0.08, 0.4, yaw)
        plan.soup.block(leg, z - 0.2, z + 0.4, Material.PLAIN, owner)


def _add_shelter(plan: Plan, xy: Xy, z: float, yaw: float, rng: np.random.Generator) -> None:
    frame = plan.soup.add_object("shelter", (0.16, 0.17, 0.18))
    roof = rectangle(xy, 4.2, 1.6, yaw)
    plan.soup.block(roof, z + 2.35, z + 2.5, Material.PLAIN, frame, floor=True)
    c, s = math.cos(yaw), math.sin(yaw)
    for a, b in ((-2.0, -0.7), (2.0, -0.7), (-2.0, 0.7), (2.0, 0.7)):
        _add_pole(plan, (xy[0] + c * a - s * b, xy[1] + s * a + c * b), z, 2.35, 0.05, frame)
    tint = rng.uniform(0.1, 0.6, 3)
    advert = plan.soup.add_object("sign", tint, seed=int(rng.integers(1 << 20)))
    panel = rectangle(xy + forward(yaw) * 1.95, 0.12, 1.2, yaw)
    plan.soup.walls(panel, z + 0.3, z + 2.1, Material.NOTICE, advert)


def _add_bollards(plan: Plan, xy: Xy, z: float, yaw: float, rng: np.random.Generator) -> None:
    owner = plan.soup.add_object("bollard", (0.12, 0.12, 0.13))
    for k in range(int(rng.integers(3, 7))):
        foot = xy + forward(yaw) * 1.4 * k
        _add_pole(plan, foot, plan.hills.at(foot), 1.0, 0.08, owner)


def _add_post(plan: Plan, xy: Xy, z: float, yaw: float, rng: np.random.Generator) -> None:
    owner = plan.soup.add_object("pole", (0.24, 0.18, 0.12))
    _add_pole(plan, xy, z, float(rng.uniform(6.0, 9.0)), 0.12, owner)


def _add_column(plan: Plan, xy: Xy, z: float, yaw: float, rng: np.random.Generator) -> None:
    tint = rng.uniform(0.1, 0.6, 3)
    owner = plan.soup.add_object("column", tint, seed=int(rng.integers(1 << 20)))
    plan.soup.walls(disc(xy, 0.65, 10), z - 0.2, z + 3.0, Material.NOTICE, owner)
    plan.soup.block(disc(xy, 0.75, 10), z + 3.0, z + 3.25, Material.PLAIN, owner, floor=True)


AddThing = Callable[[Plan, Xy, float, float, np.random.Generator], None]
# what adds it, how often it is chosen, whether it stands at the walls or at the kerb
THINGS: tuple[tuple[AddThing, float, bool], ...] = (
    (_add_sign, 0.30, False),
    (_add_cabinet, 0.18, True),
    (_add_bench, 0.12, True),
    (_add_shelter, 0.06, True),
    (_add_bollards, 0.14, False),
    (_add_post, 0.14, False),
    (_add_column, 0.06, True),
)
