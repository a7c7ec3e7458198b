# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Which part of a world teaches, which chooses and which judges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from adafusion.datasets.splits import region_of
from adafusion.sim.regions import GUARD_M, split_three, split_two
from adafusion.sim.run.conditions import PRESETS
from adafusion.sim.run.route import Drive, drive
from adafusion.sim.studio import PROFILES
from adafusion.sim.town.world import World, build_world


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(replace(PROFILES["tiny"].world, seed=1))


@pytest.fixture(scope="module")
def way(world: World) -> Drive:
    return drive(world, PRESETS["day"], 1)


@pytest.mark.parametrize("cut", [split_two, split_three])
def test_regions_keep_a_guard_between_them(world: World, way: Drive, cut: object) -> None:
    xy = way.T_world_body[:, :2, 3]
    region = region_of(xy, cut(world))
    share = {name: float((region == name).mean()) for name in np.unique(region)}
    assert 0.1 < share["validation"] < 0.4
    assert share["train"] > 0.25
    used = [name for name in share if name != "guard"]
    assert set(used) == {"train", "validation"} | ({"test"} if cut is split_three else set())
    for a in used:
        for b in used:
            if a < b:
                gap = KDTree(xy[region == a]).query(xy[region == b])[0].min()
                assert gap >= GUARD_M


def test_a_split_world_has_corridors_to_teach_and_to_judge(world: World, way: Drive) -> None:
    region = region_of(way.T_world_body[:, :2, 3], split_three(world))
    zones = np.array(way.zone)
    assert "corridor" in zones[region == "test"]
    assert "corridor" in zones[region == "train"]
