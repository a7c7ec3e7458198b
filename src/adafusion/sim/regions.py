# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Which part of a world teaches, which chooses and which judges: no match reaches another part."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from adafusion.datasets.splits import GUARD, TEST, VALIDATION
from adafusion.sim.run.route import plan_route
from adafusion.sim.town.world import World

Boxes = dict[str, list[list[float]]]

GUARD_M = 26.0  # no frame is used in a strip so wide along a border: matches reach 20 or 25 m
TEST_SHARE, VALIDATION_SHARE = 0.40, 0.30  # of the way; of what is left of it


def split_three(world: World) -> Boxes:
    """Test in the east, about 40 % of the way; validation the north of the rest."""
    way, (xmin, ymin, xmax, ymax) = plan_route(world)[0], _bounds(world)
    cut_x = float(np.quantile(way[:, 0], 1.0 - TEST_SHARE))
    rest = way[way[:, 0] < cut_x]
    cut_y = float(np.quantile(rest[:, 1], 1.0 - VALIDATION_SHARE))
    half = GUARD_M / 2
    return _rounded(
        {
            GUARD: [
                [cut_x - half, ymin, cut_x + half, ymax],
                [xmin, cut_y - half, cut_x, cut_y + half],
            ],
            TEST: [[cut_x, ymin, xmax, ymax]],
            VALIDATION: [[xmin, cut_y, cut_x, ymax]],
        }
    )


def split_two(world: World) -> Boxes:
    """Validation in the north, about a quarter of the way beside the guard; the rest teaches."""
    way, (xmin, _, xmax, ymax) = plan_route(world)[0], _bounds(world)
    cut_y = float(np.quantile(way[:, 1], 1.0 - VALIDATION_SHARE))
    half = GUARD_M / 2
    return _rounded(
        {
            GUARD: [[xmin, cut_y - half, xmax, cut_y + half]],
            VALIDATION: [[xmin, cut_y, xmax, ymax]],
        }
    )


def nowhere(world: World) -> Boxes:
    """No region at all: every place teaches."""
    return {}


def everywhere(world: World) -> Boxes:
    """Every place judges."""
    return _rounded({TEST: [list(_bounds(world))]})


REGIONS: dict[str, Callable[[World], Boxes]] = {
    "split": split_three,
    "teach": split_two,
    "all-train": nowhere,
    "all-test": everywhere,
}


def _bounds(world: World) -> tuple[float, float, float, float]:
    low, high = world.nodes.min(axis=0) - 100.0, world.nodes.max(axis=0) + 100.0
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _rounded(regions: Boxes) -> Boxes:
    return {
        name: [[round(edge, 3) for edge in box] for box in part] for name, part in regions.items()
    }
