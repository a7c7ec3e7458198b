# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where the frames of a run are, and how two runs through one world differ."""

from __future__ import annotations

import numpy as np
import pytest

from adafusion.geometry import is_rigid
from adafusion.sim.conditions import PRESETS
from adafusion.sim.plan import WorldSpec
from adafusion.sim.route import drive, plan_route
from adafusion.sim.simulate import choose_regions
from adafusion.sim.world import World, build_world

DAY = PRESETS["day"]


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(WorldSpec(seed=1, columns=2, rows=3, spacing_m=62.0, corridor_m=120.0))


def test_it_drives_every_street_and_corridor(world: World) -> None:
    way, _ = plan_route(world)
    for street in world.streets:
        middle = street.line[len(street.line) // 2]
        assert np.hypot(*(way - middle).T).min() < 1e-6


def test_keyframes_are_ten_metres_apart(world: World) -> None:
    way = drive(world, DAY, 1)
    gaps = np.hypot(*np.diff(way.T_world_body[:, :2, 3], axis=0).T)
    assert 8.5 < np.median(gaps) < 11.0
    assert gaps.max() < 16.0


def test_it_passes_corridors_within_the_first_places(world: World) -> None:
    short = drive(world, DAY, 1, places=8)
    assert len(short.zone) == 8
    assert "corridor" in short.zone
    assert set(drive(world, DAY, 1).zone) >= {"street", "path", "corridor"}


def test_it_stays_inside_corridors(world: World) -> None:
    for run_seed in range(4):
        way = drive(world, DAY, run_seed)
        for T, kind in zip(way.T_world_body, way.zone, strict=True):
            if kind == "corridor":
                zone = next(z for z in world.zones if z.contains(*T[:2, 3]))
                assert abs(T[0, 3] - (zone.lower[0] + zone.upper[0]) / 2) < 0.8


def test_poses_stand_on_the_ground(world: World) -> None:
    way = drive(world, DAY, 2)
    assert all(is_rigid(T) for T in way.T_world_body)
    xyz = way.T_world_body[:, :3, 3]
    np.testing.assert_allclose(xyz[:, 2], world.hills(xyz[:, :2]), atol=1e-9)
    assert way.T_world_body[:, 2, 2].min() > np.cos(0.12)


def test_the_same_seed_drives_the_same_way(world: World) -> None:
    a, b = drive(world, DAY, 3), drive(world, DAY, 3)
    np.testing.assert_array_equal(a.T_world_body, b.T_world_body)
    np.testing.assert_array_equal(a.timestamp_us, b.timestamp_us)


def test_another_run_comes_by_the_same_places_another_way(world: World) -> None:
    a, b = drive(world, DAY, 3), drive(world, DAY, 4)
    p, q = (way.T_world_body[:, :2, 3] for way in (a, b))
    nearest = np.hypot(*(p[:, None] - q[None]).transpose(2, 0, 1)).min(axis=1)
    assert 0.8 < np.median(nearest) < 5.0
    assert nearest.max() < 12.0


def test_timestamps_rise_and_tell_nothing_of_the_place(world: World) -> None:
    runs = [drive(world, DAY, seed) for seed in range(3)]
    for way in runs:
        assert (np.diff(way.timestamp_us) > 0).all()
    elapsed = [(way.timestamp_us - way.timestamp_us[0])[:80] for way in runs]
    assert np.abs(elapsed[0] - elapsed[1]).max() > 2_000_000
    assert len({int(way.timestamp_us[0]) // 86_400_000_000 for way in runs}) == 3


def test_regions_cut_the_world_in_three(world: World) -> None:
    regions = choose_regions(world)
    way = drive(world, DAY, 1)
    inside = {
        name: np.array(
            [box[0] <= x < box[2] and box[1] <= y < box[3] for x, y in way.T_world_body[:, :2, 3]]
        )
        for name, (box,) in regions.items()
    }
    test, validation = inside["test"], inside["validation"]
    assert not (test & validation).any()
    assert 0.25 < test.mean() < 0.55
    assert 0.05 < validation.mean() < 0.3
    assert (~test & ~validation).mean() > 0.25
    zones = np.array(way.zone)
    assert "corridor" in zones[test]
    assert "corridor" in zones[~test & ~validation]
