# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What several tests of the synthetic world, and of studies, share."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from adafusion.sim.sensing.scene import Scene, build_scene, build_static
from adafusion.sim.town.plan import Hills, WorldSpec, Zone
from adafusion.sim.town.shapes import LIT, Material, Soup, SoupBuilder, rectangle
from adafusion.sim.town.world import World


@pytest.fixture
def heading() -> dict[str, Any]:
    """What every picture of an experiment says of its results."""
    return {
        "experiment": "made",
        "budget": 100,
        "seeds": [0],
        "training_data": [],
        "test_data": [{"synthetic": True}],
    }


@pytest.fixture
def same():
    """Whether two soups are equal to the last bit."""

    def compare(a: Soup, b: Soup) -> bool:
        names = ("corners", "uv", "material", "object_id", "objects")
        return a.kinds == b.kinds and all(
            np.array_equal(getattr(a, name), getattr(b, name)) for name in names
        )

    return compare


@pytest.fixture
def yard():
    """Build a level ground and one wall ten metres ahead, out of doors or within a hall."""

    def build(
        *, indoor: bool = False, wall: Material = Material.PLAIN, ground: Material = Material.PLAIN
    ) -> tuple[World, Scene]:
        soup = SoupBuilder()
        grey = soup.add_object("ground", (0.2, 0.2, 0.2))
        soup.cap(rectangle((0.0, 0.0), 120.0, 120.0, 0.0), 0.0, ground, grey)
        red = soup.add_object("wall", (0.6, 0.1, 0.1), style=LIT)
        face = [(10.0, -50.0, 0.0), (10.0, 50.0, 0.0), (10.0, 50.0, 30.0), (10.0, -50.0, 30.0)]
        soup.quads(np.array([face]), wall, red)
        zones = (
            (Zone((-60.0, -60.0, -1.0), (60.0, 60.0, 40.0), "hall", True, 0.01),) if indoor else ()
        )
        lamps = np.array([[5.0, 3.0, 6.0, 0.5, 0.4, 0.3, 0.0 if indoor else -1.0, 0.0]])
        level = Hills(np.zeros((0, 4)), ())
        world = World(WorldSpec(seed=0), np.zeros((1, 2)), (), soup.build(), zones, lamps, level)
        return world, build_scene(world, build_static(world), SoupBuilder().build())

    return build
