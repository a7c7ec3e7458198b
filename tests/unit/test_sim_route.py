# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where the frames of a run are, and how two runs through one world differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adafusion.geometry import is_rigid
from adafusion.sim.run.conditions import PRESETS
from adafusion.sim.run.route import YAW_RAD_S, drive, plan_route, pose_along
from adafusion.sim.studio import PROFILES
from adafusion.sim.town.world import World, build_world

DAY = PRESETS["day"]


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(replace(PROFILES["tiny"].world, seed=1))


def gaps(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.hypot(*(a[:, None] - b[None]).transpose(2, 0, 1))


def test_it_drives_every_street_and_passage(world: World) -> None:
    way, _ = plan_route(world)
    for street in world.streets:
        middle = street.line[len(street.line) // 2]
        assert np.hypot(*(way - middle).T).min() < 1e-6


def test_keyframes_are_ten_metres_apart(world: World) -> None:
    way = drive(world, DAY, 1)
    steps = np.hypot(*np.diff(way.T_world_body[:, :2, 3], axis=0).T)
    assert 8.5 < np.median(steps) < 11.0
    assert steps.min() > 5.0
    assert steps.max() < 16.0


def test_it_passes_corridors_within_the_first_places(world: World) -> None:
    short = drive(world, DAY, 1, places=8)
    assert len(short.zone) == 8
    assert "corridor" in short.zone


def test_it_passes_every_kind_of_zone(world: World) -> None:
    kinds = set(drive(world, DAY, 1).zone)
    assert kinds >= {"street", "path", "corridor", "hall", "tunnel", "blank wall"}


def test_it_stays_inside_corridors(world: World) -> None:
    corridors = [zone for zone in world.zones if zone.kind == "corridor"]
    for way_seed in range(4):
        way = drive(world, replace(DAY, other_lane=0.3), way_seed)
        for T, kind in zip(way.T_world_body, way.zone, strict=True):
            if kind == "corridor":
                zone = next(z for z in corridors if z.contains(*T[:2, 3]))
                across = np.argmin(np.subtract(zone.upper, zone.lower)[:2])
                middle = (zone.lower[across] + zone.upper[across]) / 2
                assert abs(T[across, 3] - middle) < 0.8


def test_poses_stand_on_the_ground(world: World) -> None:
    way = drive(world, DAY, 2)
    assert all(is_rigid(T) for T in way.T_world_body)
    xyz = way.T_world_body[:, :3, 3]
    np.testing.assert_allclose(xyz[:, 2], world.hills(xyz[:, :2]), atol=1e-9)
    assert way.T_world_body[:, 2, 2].min() > np.cos(0.12)


def test_keyframes_lie_on_the_dense_path(world: World) -> None:
    way = drive(world, DAY, 2)
    np.testing.assert_allclose(
        pose_along(world, way, way.timestamp_us), way.T_world_body, atol=1e-12
    )
    between = (way.timestamp_us[3:5].sum() // 2)[None]
    (T,) = pose_along(world, way, between)
    assert is_rigid(T)
    assert gaps(T[None, :2, 3], way.T_world_body[3:5, :2, 3]).max() < 8.0
    with pytest.raises(ValueError, match="the drive lasts"):
        pose_along(world, way, way.path_time_us[-1:] + 1)


def test_speed_and_turning_are_those_of_the_path(world: World) -> None:
    way = drive(world, DAY, 2)
    half_us = 50_000
    at = way.timestamp_us[1:-1]
    before, after = (pose_along(world, way, at + d) for d in (-half_us, half_us))
    driven = np.linalg.norm(after[:, :3, 3] - before[:, :3, 3], axis=1)
    np.testing.assert_allclose(driven / 0.1, way.speed_m_s[1:-1], rtol=0.25)
    turned = np.arctan2(
        *(np.einsum("nji,njk->nik", before[:, :3, :3], after[:, :3, :3])[:, [1, 0], 0].T)
    )
    np.testing.assert_allclose(
        np.clip(turned / 0.1, -YAW_RAD_S, YAW_RAD_S), way.yaw_rate_rad_s[1:-1], atol=0.12
    )


def test_a_run_in_reverse_passes_the_same_places_the_other_way(world: World) -> None:
    forth, back = (
        drive(world, replace(DAY, reverse=reverse, path_offset_m=0.5), 3, places=20)
        for reverse in (False, True)
    )
    near = gaps(forth.T_world_body[:, :2, 3], back.T_world_body[:, :2, 3])
    assert np.median(near.min(axis=1)) < 6.0
    facing = []
    for i, row in enumerate(near):
        j = int(row.argmin())
        if row[j] < 6.0:
            facing.append(forth.T_world_body[i, :2, 0] @ back.T_world_body[j, :2, 0])
    assert np.median(facing) < -0.9


def test_the_other_lane_is_beside_its_own(world: World) -> None:
    own = drive(world, replace(DAY, path_offset_m=0.0), 3)
    both = drive(world, replace(DAY, path_offset_m=0.0, other_lane=0.5), 3)
    aside = gaps(both.path, own.path).min(axis=1)
    assert aside.max() == pytest.approx(2.4, abs=0.4)
    assert 0.1 < (aside > 1.2).mean() < 0.6


def test_the_same_seed_drives_the_same_way(world: World) -> None:
    a, b = drive(world, DAY, 3), drive(world, DAY, 3)
    np.testing.assert_array_equal(a.T_world_body, b.T_world_body)
    np.testing.assert_array_equal(a.T_world_ins, b.T_world_ins)
    np.testing.assert_array_equal(a.timestamp_us, b.timestamp_us)


def test_another_run_comes_by_the_same_places_another_way(world: World) -> None:
    a, b = drive(world, DAY, 3), drive(world, DAY, 4)
    nearest = gaps(*(way.T_world_body[:, :2, 3] for way in (a, b))).min(axis=1)
    assert 0.8 < np.median(nearest) < 5.0
    assert nearest.max() < 14.0


def test_the_ins_is_off_by_about_a_metre_and_drifts(world: World) -> None:
    way = drive(world, DAY, 3)
    off = way.T_world_ins[:, :3, 3] - way.T_world_body[:, :3, 3]
    assert all(is_rigid(T) for T in way.T_world_ins)
    assert 0.3 < np.hypot(*off[:, :2].T).mean() < 3.0
    bends = np.linalg.norm(np.diff(off[:, :2], 2, axis=0), axis=1) / 10.0
    assert bends.max() < np.radians(1.5), "it drifts, and hardly bends the track"
    other = drive(world, DAY, 4)
    again = other.T_world_ins[:, :3, 3] - other.T_world_body[:, :3, 3]
    assert not np.allclose(off[:50], again[:50])


def test_timestamps_rise_and_tell_nothing_of_the_place(world: World) -> None:
    runs = [drive(world, DAY, seed) for seed in range(3)]
    for way in runs:
        assert (np.diff(way.timestamp_us) > 0).all()
        assert (np.diff(way.path_time_us) > 0).all()
    elapsed = [(way.timestamp_us - way.timestamp_us[0])[:80] for way in runs]
    assert np.abs(elapsed[0] - elapsed[1]).max() > 2_000_000
    assert len({int(way.timestamp_us[0]) // 86_400_000_000 for way in runs}) == 3
