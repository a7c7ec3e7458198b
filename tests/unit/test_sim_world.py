# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a world holds, and what may and may not differ between runs through it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adafusion.geometry import pose_from_xyz_yaw
from adafusion.sim.buildings import BUILDING_TYPES
from adafusion.sim.conditions import PRESETS
from adafusion.sim.lidar import Lidar, ray_directions, scan_ranges
from adafusion.sim.numeric import keyed_rng
from adafusion.sim.plan import Hills, WorldSpec, overlaps
from adafusion.sim.scene import build_scene, build_static
from adafusion.sim.shapes import STYLE, Material, Soup
from adafusion.sim.vehicles import build_vehicles
from adafusion.sim.world import World, build_world

SPEC = WorldSpec(seed=1, columns=2, rows=3, spacing_m=62.0, corridor_m=120.0)


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(SPEC)


def same(a: Soup, b: Soup) -> bool:
    names = ("corners", "uv", "material", "object_id", "objects")
    return a.kinds == b.kinds and all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in names
    )


def vehicles(world: World, run_seed: int, parked: float = 0.6, traffic: float = 0.3) -> Soup:
    far = np.array([[1e4, 1e4]])
    return build_vehicles(world, run_seed, parked, traffic, far)


def test_it_is_the_same_for_the_same_spec(world: World) -> None:
    again = build_world(SPEC)
    assert same(world.soup, again.soup)
    np.testing.assert_array_equal(world.lamps, again.lamps)


def test_it_is_another_for_another_seed(world: World) -> None:
    assert not same(world.soup, build_world(replace(SPEC, seed=2)).soup)


def test_its_static_geometry_is_equal_over_all_conditions(world: World) -> None:
    static = build_static(world)
    n = len(world.soup.corners)
    scenes = [
        build_scene(world, static, vehicles(world, k, c.parked_density, c.traffic_density))
        for k, c in enumerate(PRESETS.values())
    ]
    for scene in scenes[1:]:
        for part in ("normal", "uv", "uv_per_m", "material", "object_id"):
            np.testing.assert_array_equal(getattr(scene, part)[:n], getattr(scenes[0], part)[:n])
        np.testing.assert_array_equal(scene.zones, scenes[0].zones)
    assert len({len(scene.material) for scene in scenes}) > 1, "vehicles differ"


def test_it_has_everything_a_street_needs(world: World) -> None:
    kinds = set(world.soup.kinds)
    assert kinds >= {"building", "roof", "tree", "pole", "lamp", "road", "pavement", "kerb", "door"}
    assert {street.kind for street in world.streets} == {"street", "path", "corridor"}
    assert 7 <= len(BUILDING_TYPES) <= 10
    buildings = world.soup.objects[[kind == "building" for kind in world.soup.kinds]]
    assert len(np.unique(buildings[:, STYLE])) >= 3


def test_its_streets_are_not_all_axis_aligned(world: World) -> None:
    headings = []
    for street in world.streets:
        if street.kind == "street":
            d = np.diff(street.line, axis=0)
            headings.extend((np.degrees(np.arctan2(d[:, 1], d[:, 0])) % 90.0).tolist())
    assert np.ptp(headings) > 30.0


def test_its_trees_keep_out_of_houses(world: World) -> None:
    """The trunk of no tree stands inside an upright building wall's outline."""
    soup = world.soup
    trunks = [
        soup.corners[(soup.object_id == k) & (soup.material == Material.BARK)].mean(axis=(0, 1))[:2]
        for k, kind in enumerate(soup.kinds)
        if kind == "tree"
    ]
    facade = soup.corners[soup.material == Material.FACADE][:, :, :2].astype(float)
    assert trunks
    for trunk in trunks:
        assert np.hypot(*(facade - trunk).reshape(-1, 2).T).min() > 0.5


def test_its_corridors_differ_in_paint_alone(world: World) -> None:
    """The same noiseless scan, wherever it does not look out of an end."""
    scene = build_scene(world, build_static(world), vehicles(world, 0))
    sensor = Lidar(beams=16, steps=360, sigma_m=0.0, drop_out=0.0, power_half=1e-12, nearest_m=0.3)
    images = []
    for zone in world.zones[:2]:
        assert zone.kind == "corridor"
        x, y = (np.array(zone.lower[:2]) + zone.upper[:2]) / 2
        T = pose_from_xyz_yaw(float(x) + 0.2, float(y) + 3.0, 1.9, np.pi / 2)
        images.append(scan_ranges(scene, sensor, PRESETS["day"], T, seed=1))
    inside = (images[0] < 50.0) & (images[1] < 50.0)
    assert inside.mean() > 0.95
    # doors and notices lie 4 mm before the wall: a fifth of the noise of a range
    across = ray_directions(sensor)[..., 1]
    np.testing.assert_allclose(
        (images[0] * across)[inside], (images[1] * across)[inside], atol=5e-3
    )
    paints = [
        world.soup.objects[np.unique(world.soup.object_id[walls_of(world, k)]), :3]
        for k in range(2)
    ]
    assert paints[0].shape != paints[1].shape or not np.allclose(paints[0], paints[1])


def walls_of(world: World, k: int) -> np.ndarray:
    zone = world.zones[k]
    near = np.abs(world.soup.corners[:, 0, 0] - (zone.lower[0] + zone.upper[0]) / 2) < 2.0
    return near & (world.soup.material == Material.WALL)


def test_its_vehicles_belong_to_the_run(world: World) -> None:
    assert same(vehicles(world, 3), vehicles(world, 3))
    assert not same(vehicles(world, 3), vehicles(world, 4))
    assert len(vehicles(world, 3, 0.0, 0.0).corners) == 0


def test_a_vehicle_keeps_off_the_way_of_the_run(world: World) -> None:
    path = np.concatenate([street.line for street in world.streets])
    soup = build_vehicles(world, 3, 1.0, 1.0, path)
    for k in np.unique(soup.object_id):
        middle = soup.corners[soup.object_id == k].reshape(-1, 3).mean(axis=0)[:2]
        assert np.hypot(*(path - middle).T).min() > 0.5


def test_it_is_level_around_corridors(world: World) -> None:
    zone = world.zones[0]
    ends = np.array([zone.lower[:2], zone.upper[:2]])
    np.testing.assert_array_equal(world.hills(ends), (0.0, 0.0))
    assert np.ptp(world.hills(world.nodes)) > 0.3


def test_hills_add_waves() -> None:
    hills = Hills(np.array([[2.0, 0.5, 0.0, 0.0]]), ())
    assert hills.at((np.pi, 9.0)) == pytest.approx(2.0)
    assert hills.at((0.0, 9.0)) == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("rect", "meets"),
    [
        ((3.9, 0.0, 0.0, 1.0, 1.0), True),
        ((4.1, 0.0, 0.0, 1.0, 1.0), False),
        ((4.1, 0.0, np.pi / 4, 1.0, 1.0), True),  # a corner reaches in
        ((3.8, 1.8, np.pi / 4, 1.0, 1.0), False),  # boxes meet, turned rectangles do not
    ],
)
def test_overlaps_sees_turned_rectangles(rect: tuple[float, ...], meets: bool) -> None:
    others = [(0.0, 0.0, 0.0, 3.0, 1.0), (99.0, 0.0, 0.3, 1.0, 1.0)]
    assert overlaps(rect, others) is meets


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"columns": 1}, "no town"),
        ({"rows": 2}, "no town"),
        ({"spacing_m": 20.0}, "spacing_m"),
        ({"corridors": 5}, "corridors"),
        ({"corridor_m": 1.0}, "a door"),
    ],
)
def test_a_spec_refuses_nonsense(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        WorldSpec(**{"seed": 0, **wrong})


def test_keyed_numbers_do_not_depend_on_other_draws() -> None:
    first = keyed_rng(1, "tree", 4).random(3)
    keyed_rng(1, "tree", 3).random(100)
    np.testing.assert_array_equal(first, keyed_rng(1, "tree", 4).random(3))
    assert not np.array_equal(first, keyed_rng(2, "tree", 4).random(3))
    assert not np.array_equal(keyed_rng(1, "ab", "c").random(3), keyed_rng(1, "a", "bc").random(3))
