# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A small town from a seed: streets, typed buildings, parks, trees, and identical corridors.

Buildings and trees are drawn from few shared types, so places look alike on purpose; what tells
them apart is their arrangement, size and tint. Every draw is keyed by (seed, object, purpose).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from adafusion.sim.buildings import line_with_buildings
from adafusion.sim.corridors import build_corridors
from adafusion.sim.furniture import furnish_streets
from adafusion.sim.plan import Hills, Plan, Street, WorldSpec, Zone
from adafusion.sim.planting import choose_parks, plant_parks
from adafusion.sim.shapes import Soup
from adafusion.sim.streets import lay_out_streets, pave


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
    lay_out_streets(plan)
    pave(plan)
    build_corridors(plan)
    choose_parks(plan)
    line_with_buildings(plan)
    furnish_streets(plan)
    plant_parks(plan)
    return World(
        spec,
        np.array(plan.nodes),
        tuple(plan.streets),
        plan.soup.build(),
        tuple(plan.zones),
        np.array(plan.lamps).reshape(-1, 8),
        plan.hills,
    )
