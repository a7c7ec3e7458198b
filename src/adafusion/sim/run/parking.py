# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicles that one run finds at the kerbs."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Float64
from scipy.spatial import KDTree

from adafusion.sim.numeric import keyed_rng
from adafusion.sim.run.instances import Instance, place, standing
from adafusion.sim.run.vehicles import CAR_ODDS, CARS, paint_of, vehicle
from adafusion.sim.town.plan import ROAD_HALF_M, along, leftward, point_on
from adafusion.sim.town.shapes import Soup
from adafusion.sim.town.world import World

PARKING_M = 4.5  # lateral middle of a parked car
BAY_M = 5.9  # length of a parking place
CLEAR_M = 2.0  # nothing stands nearer to the way of the run's own vehicle


def park_vehicles(world: World, seed: int, density: float, path: Float[np.ndarray, "n 2"]) -> Soup:
    """Vehicles at the kerbs in `density` of the places, some streets fuller than others.

    Each place asks a number of its own: a denser run keeps the cars of a sparser one with the same
    seed. Nothing stands on the `path` that the run takes.
    """
    way, found = KDTree(path), []
    for e, street in enumerate(world.streets):
        if street.kind != "street":
            continue
        length = float(along(street.line)[-1])
        busy = keyed_rng(world.spec.seed, "street", e, "parking").uniform(0.2, 1.8, 2)
        for side, busyness in ((1, busy[1]), (-1, busy[0])):
            for k, s in enumerate(np.arange(15.0, length - 16.0, BAY_M).tolist()):
                rng = keyed_rng(seed, "street", e, side, "parked", k)
                if rng.random() >= density * busyness:
                    continue
                xy, yaw = point_on(street.line, s + float(rng.uniform(-0.4, 0.4)))
                xy = xy + leftward(yaw) * side * (PARKING_M + float(rng.uniform(-0.15, 0.15)))
                if way.query(xy)[0] <= CLEAR_M or _on_another_road(world, e, xy):
                    continue
                # on the left of the line they come towards us
                yaw += (math.pi if side > 0 else 0.0) + float(rng.normal(0.0, 0.02))
                shape = CARS[int(rng.choice(len(CARS), p=CAR_ODDS))]
                found.append((shape, paint_of(shape, rng), xy, yaw))
    if not found:
        return place([])
    shapes, paints, xy, yaw = zip(*found, strict=True)
    poses = standing(world.hills, np.array(xy), np.array(yaw))
    return place(
        [
            Instance(vehicle(shape, lit=False), T, paint)
            for shape, T, paint in zip(shapes, poses, paints, strict=True)
        ]
    )


def _on_another_road(world: World, own: int, xy: Float64[np.ndarray, " 2"]) -> bool:
    """Whether a place at the kerb of street `own` lies on an oblique neighbour."""
    return any(
        np.hypot(*(street.line - xy).T).min() < ROAD_HALF_M + 1.0
        for e, street in enumerate(world.streets)
        if e != own and street.kind == "street"
    )
