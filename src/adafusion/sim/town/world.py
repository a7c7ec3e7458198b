# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A small town from a seed: streets, typed buildings, parks, trees, and identical passages.

Buildings and trees are drawn from few shared types, so places look alike on purpose; what tells
them apart is their arrangement, size and tint. Every draw is keyed by (seed, object, purpose).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from adafusion.sim.town.blank_walls import build_blank_walls
from adafusion.sim.town.buildings import line_with_buildings
from adafusion.sim.town.furniture import furnish_streets
from adafusion.sim.town.interiors import build_passages
from adafusion.sim.town.plan import INDOORS, Hills, Plan, Street, WorldSpec, Zone
from adafusion.sim.town.planting import choose_parks, plant_parks
from adafusion.sim.town.shapes import Soup
from adafusion.sim.town.streets import lay_out_streets, pave

STEPS = (  # in this order: each keeps off what stands already
    lay_out_streets,
    pave,
    build_passages,
    choose_parks,
    build_blank_walls,
    line_with_buildings,
    furnish_streets,
    plant_parks,
)
_REACH_M = {"park": 22.0}  # how far around a zone still counts as that kind of place


@dataclass(frozen=True, eq=False)
class World:
    """Everything that stays the same from run to run."""

    spec: WorldSpec
    nodes: Float64[np.ndarray, "n 2"]
    streets: tuple[Street, ...]
    soup: Soup
    zones: tuple[Zone, ...]
    lamps: Float64[np.ndarray, "m 8"]  # xyz, RGB power, zone (-1 outdoors), 1 where always on
    hills: Hills


def build_world(spec: WorldSpec) -> World:
    """Build the world of `spec`; equal specs give bit-equal worlds on one machine."""
    plan = Plan(spec)
    for step in STEPS:
        step(plan)
    return World(
        spec=spec,
        nodes=np.array(plan.nodes),
        streets=tuple(plan.streets),
        soup=plan.soup.build(),
        zones=tuple(plan.zones),
        lamps=np.array(plan.lamps).reshape(-1, 8),
        hills=plan.hills,
    )


def zone_labels(world: World, xy: Float[np.ndarray, "n 2"]) -> tuple[str, ...]:
    """What kind of place each point is: a passage, "blank wall", "park", "street" or "path".

    A zone counts with its surroundings as far as they belong to it; outside all of them the
    nearest street decides.
    """
    ways = [street for street in world.streets if street.kind not in INDOORS]
    tree = KDTree(np.concatenate([street.line for street in ways]))
    kinds = np.concatenate([np.full(len(street.line), street.kind, object) for street in ways])
    labels = kinds[tree.query(xy)[1]]
    # what comes later wins: indoors over everything
    for kind in ("park", "blank wall", *INDOORS):
        for zone in world.zones:
            if zone.kind == kind:
                margin = _REACH_M.get(kind, 0.0)
                low, high = np.array(zone.lower[:2]) - margin, np.array(zone.upper[:2]) + margin
                labels[((xy >= low) & (xy <= high)).all(axis=1)] = kind
    return tuple(labels)


def geometry_hash(world: World) -> str:
    """16 hexadecimal digits that stand for everything static.

    Lengths count in millimetres and the rest in 1e-4, so that the last bits of another machine's
    floats do not show.
    """
    soup, digest = world.soup, hashlib.sha256()
    tables: list[tuple[ArrayLike, float]] = [
        (world.nodes, 1e-3),
        (soup.corners, 1e-3),
        (soup.uv, 1e-4),
        (soup.material, 1.0),
        (soup.object_id, 1.0),
        (soup.objects, 1e-4),
        (world.lamps, 1e-4),
        *((street.line, 1e-3) for street in world.streets),
        *(((*zone.lower, *zone.upper), 1e-3) for zone in world.zones),
        *(((zone.indoor, zone.light), 1e-4) for zone in world.zones),
    ]
    for table, step in tables:
        counts = np.rint(np.asarray(table, np.float64) / step).astype("<i8")
        digest.update(f"{counts.shape}".encode() + counts.tobytes())
    names = soup.kinds, [zone.kind for zone in world.zones]
    ways = [(street.kind, *street.ends) for street in world.streets]
    digest.update(repr((names, ways)).encode())
    return digest.hexdigest()[:16]
