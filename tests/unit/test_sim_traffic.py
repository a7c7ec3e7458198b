# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicles and people: how they look, where they park, and where they are at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adafusion.geometry import pose_from_xyz_yaw
from adafusion.sim.run.instances import Instance, place, standing
from adafusion.sim.run.parking import park_vehicles
from adafusion.sim.run.people import STRIDES, person
from adafusion.sim.run.traffic import (
    END_M,
    NEAREST_M,
    TRAFFIC_LANE_M,
    WALK_M,
    Traffic,
    plan_traffic,
    positions,
    traffic_at,
)
from adafusion.sim.run.vehicles import BUS, CARS, LORRY, VEHICLES, vehicle
from adafusion.sim.sensing.scene import build_scene, build_static, with_traffic
from adafusion.sim.town.plan import KERB_M, Hills, Street, WorldSpec
from adafusion.sim.town.shapes import LIT, Material, Soup, SoupBuilder, rectangle
from adafusion.sim.town.world import World

FAR = np.array([[1e4, 1e4]])
HERE = pose_from_xyz_yaw(100.0, 0.0, 0.0, 0.0)


def town(kinds: tuple[str, ...] = ("street",), slope: float = 0.0) -> World:
    """Straight ways of 200 m along x, 60 m apart, on ground that rises along x."""
    soup = SoupBuilder()
    ground = soup.add_object("ground", (0.2, 0.2, 0.2))
    soup.cap(rectangle((100.0, 0.0), 600.0, 400.0, 0.0), -0.1, Material.PLAIN, ground)
    lines = [
        np.stack([np.linspace(0.0, 200.0, 51), np.full(51, 60.0 * k)], axis=1)
        for k in range(len(kinds))
    ]
    streets = [
        Street((2 * k, 2 * k + 1), line, kind)
        for k, (line, kind) in enumerate(zip(lines, kinds, strict=True))
    ]
    # one wave so long that it is a plane
    hills = Hills(np.array([[1e6 * slope, 1e-6, 0.0, 0.0]]) if slope else np.zeros((0, 4)), ())
    nodes = np.array([end for line in lines for end in (line[0], line[-1])])
    lamps = np.zeros((0, 8))
    return World(WorldSpec(seed=0), nodes, tuple(streets), soup.build(), (), lamps, hills)


def middles(soup: Soup, kind: str) -> np.ndarray:
    """Where things of a kind stand: the middle of the first object of each, x and y."""
    rows = [k for k, name in enumerate(soup.kinds) if name == kind]
    return np.array(
        [soup.corners[soup.object_id == k].reshape(-1, 3).mean(axis=0)[:2] for k in rows]
    )


# ------------------------------------------------------------------------------------ prototypes


@pytest.mark.parametrize("shape", VEHICLES)
def test_a_vehicle_stands_on_its_wheels_and_is_as_long_and_wide_as_it_says(shape) -> None:  # type: ignore[no-untyped-def]
    soup = vehicle(shape, lit=False)
    corners = soup.corners.reshape(-1, 3)
    assert corners[:, 2].min() == pytest.approx(0.0, abs=1e-6)
    assert np.ptp(corners[:, 0]) == pytest.approx(shape.length, abs=0.05)
    assert np.ptp(corners[:, 1]) == pytest.approx(2 * shape.half_width, abs=0.1)
    assert np.abs(corners[:, 1].max() + corners[:, 1].min()) < 1e-5, "both sides are alike"
    assert {Material.CAR_BODY, Material.GLASS, Material.RUBBER, Material.CAR_LIGHT} <= set(
        soup.material.tolist()
    )
    assert len(soup.corners) < 320


def test_a_bus_and_a_lorry_hide_more_than_any_car() -> None:
    def side(shape: object) -> float:
        corners = vehicle(shape, lit=False).corners.reshape(-1, 3)  # type: ignore[arg-type]
        return float(np.ptp(corners[:, 0]) * np.ptp(corners[:, 2]))

    assert min(map(side, (BUS, LORRY))) > 2 * max(map(side, CARS))


def test_only_a_vehicle_that_drives_has_its_lamps_lit() -> None:
    for lit in (False, True):
        soup = vehicle(BUS, lit=lit)
        lamps = np.unique(soup.object_id[soup.material == Material.CAR_LIGHT])
        assert (soup.objects[lamps, 3] == (LIT if lit else 0)).all()


def test_a_person_is_of_full_height_and_walks() -> None:
    bodies = [person(k).corners.reshape(-1, 3) for k in range(STRIDES)]
    for body in bodies:
        assert body[:, 2].max() == pytest.approx(1.75, abs=1e-5)
        assert -0.02 < body[:, 2].min() < 0.12
    lengths = [float(np.ptp(body[:, 0])) for body in bodies]
    assert max(lengths) > 2 * min(lengths), "feet apart and feet together"
    assert len(person(0).corners) < 90


def test_an_instance_is_its_prototype_moved_and_dyed() -> None:
    soup = SoupBuilder()
    paint = soup.add_object("box", (0.5, 0.5, 0.5))
    foot = soup.add_object("box", (0.1, 0.1, 0.1))
    soup.block(rectangle((0.0, 0.0), 2.0, 1.0, 0.0), 0.0, 1.0, Material.PLAIN, paint)
    soup.cap(rectangle((0.0, 0.0), 2.0, 1.0, 0.0), 0.0, Material.RUBBER, foot)
    box = soup.build()
    T = pose_from_xyz_yaw(10.0, 20.0, 3.0, np.pi / 2)
    red = np.array([[1.0, 0.0, 0.0]])
    two = place([Instance(box, T, red), Instance(box, np.eye(4), red)])
    lower, upper = (f(two.corners[: len(box.corners)], axis=(0, 1)) for f in (np.min, np.max))
    np.testing.assert_allclose(lower, (9.5, 19.0, 3.0), atol=1e-6)
    np.testing.assert_allclose(upper, (10.5, 21.0, 4.0), atol=1e-6)
    np.testing.assert_array_equal(np.unique(two.object_id), range(4))
    np.testing.assert_allclose(two.objects[:, :3], [(1, 0, 0), (0.1, 0.1, 0.1)] * 2)
    assert box.objects[0, 0] == 0.5, "the prototype stays as it was"
    assert len(place([]).corners) == 0


def test_a_vehicle_tilts_with_the_ground_and_a_person_does_not() -> None:
    hills = town(slope=0.1).hills
    at, east = np.array([[50.0, 0.0]]), np.zeros(1)
    leaning, upright = standing(hills, at, east)[0], standing(hills, at, east, upright=True)[0]
    np.testing.assert_allclose(leaning[:3, 0], np.array([1.0, 0.0, 0.1]) / np.hypot(1.0, 0.1))
    np.testing.assert_allclose(upright[:3, :3], np.eye(3), atol=1e-12)
    assert leaning[2, 3] == upright[2, 3] == pytest.approx(5.0)


# ----------------------------------------------------------------------------------------- parked


def test_parked_cars_line_the_kerbs_and_look_the_way_one_drives() -> None:
    soup = park_vehicles(town(), 3, 1.0, FAR)
    bodies = middles(soup, "car")
    paint = bodies[np.abs(np.abs(bodies[:, 1]) - 4.5) < 0.3]
    assert len(paint) > 10
    assert (np.abs(soup.corners[:, :, 1]) > 3.2).all(), "the lanes are free"
    rear = (soup.material == Material.CAR_LIGHT) & (soup.objects[soup.object_id, 1] < 0.1)
    for y, yaw in ((-4.5, 0.0), (4.5, np.pi)):  # those on the left come towards us
        side = np.abs(soup.corners[:, 0, 1] - y) < 1.2
        lamps = soup.corners[rear & side].reshape(-1, 3)[:, 0]
        cars = soup.corners[side].reshape(-1, 3)[:, 0]
        assert (lamps.mean() < cars.mean()) == (yaw == 0.0)


def test_a_fuller_street_keeps_the_cars_of_a_sparser_one() -> None:
    few, many = (park_vehicles(town(), 3, density, FAR) for density in (0.3, 0.8))
    found = {tuple(corner) for corner in many.corners[:, 0].tolist()}
    assert 0 < len(few.corners) < len(many.corners)
    assert all(tuple(corner) in found for corner in few.corners[:, 0].tolist())


def test_parked_cars_belong_to_their_seed(same) -> None:
    assert same(park_vehicles(town(), 3, 0.5, FAR), park_vehicles(town(), 3, 0.5, FAR))
    assert not same(park_vehicles(town(), 3, 0.5, FAR), park_vehicles(town(), 4, 0.5, FAR))
    assert len(park_vehicles(town(), 3, 0.0, FAR).corners) == 0


def test_nothing_parks_on_the_way_or_where_no_cars_go() -> None:
    kerb = np.stack([np.linspace(0.0, 200.0, 401), np.full(401, 4.5)], axis=1)
    soup = park_vehicles(town(), 3, 1.0, kerb)
    assert (soup.corners[:, :, 1] < 0.0).all()
    assert len(park_vehicles(town(("path", "corridor")), 3, 1.0, FAR).corners) == 0


# ----------------------------------------------------------------------------------------- moving


@pytest.fixture(scope="module")
def busy() -> Traffic:
    return plan_traffic(town(), 7, 2.0, 2.0)


def test_vehicles_keep_to_the_right_whichever_way_they_go(busy: Traffic) -> None:
    xy, yaw = positions(busy.tracks, busy.vehicles, 12.0)
    ways = np.cos(yaw)
    assert set(np.sign(ways)) == {-1.0, 1.0}, "with us and towards us"
    np.testing.assert_allclose(xy[:, 1], TRAFFIC_LANE_M * np.sign(ways), atol=0.16)
    assert ((xy[:, 0] >= END_M) & (xy[:, 0] <= 200.0 - END_M)).all()


def test_people_walk_on_the_pavements_both_ways(busy: Traffic) -> None:
    xy, yaw = positions(busy.tracks, busy.people, 5.0)
    assert len(xy) > 30
    assert ((np.abs(xy[:, 1]) >= WALK_M[0]) & (np.abs(xy[:, 1]) <= WALK_M[1])).all()
    for side in (-1.0, 1.0):
        there = np.sign(xy[:, 1]) == side
        assert set(np.sign(np.cos(yaw[there]))) == {-1.0, 1.0}


def test_all_move_at_their_speed_and_come_round_again(busy: Traffic) -> None:
    for movers, slow, fast in ((busy.vehicles, 3.0, 9.0), (busy.people, 0.8, 1.8)):
        assert ((movers.speed_m_s >= slow) & (movers.speed_m_s <= fast)).all()
        before, yaw = positions(busy.tracks, movers, 40.0)
        after, then = positions(busy.tracks, movers, 40.5)
        straight = yaw == then
        moved = np.linalg.norm(after - before, axis=1)
        np.testing.assert_allclose(moved[straight], 0.5 * movers.speed_m_s[straight])
        assert straight.mean() > 0.8
        one = replace(movers, speed_m_s=np.full(len(movers.size), 2.0))
        again, _ = positions(busy.tracks, one, 40.0 + 2 * (200.0 - 2 * END_M) / 2.0)
        np.testing.assert_allclose(again, positions(busy.tracks, one, 40.0)[0], atol=1e-9)


def test_no_vehicle_drives_through_another(busy: Traffic) -> None:
    length = np.array([VEHICLES[model].length for model in busy.vehicles.model])
    for time_s in np.linspace(0.0, 90.0, 200):
        xy, _ = positions(busy.tracks, busy.vehicles, float(time_s))
        for lane in (xy[:, 1] > 0, xy[:, 1] < 0):
            order = np.argsort(xy[lane, 0])
            x, half = xy[lane, 0][order], length[lane][order] / 2
            assert (np.diff(x) > half[1:] + half[:-1]).all()


def test_density_says_how_many() -> None:
    world = town(("street",) * 20)
    traffic = plan_traffic(world, 1, 0.5, 0.4)
    assert len(traffic.vehicles.size) == pytest.approx(20 * 176 / 40 * 0.5, rel=0.3)
    assert len(traffic.people.size) == pytest.approx(20 * 2 * 176 / 10 * 0.4, rel=0.15)
    assert {VEHICLES[model] for model in traffic.vehicles.model} >= {BUS, LORRY}
    none = plan_traffic(world, 1, 0.0, 0.0)
    assert len(traffic_at(world, none, 3.0, HERE).corners) == 0


def test_only_streets_have_traffic() -> None:
    world = town(("path", "street", "corridor"))
    traffic = plan_traffic(world, 1, 2.0, 2.0)
    for movers in (traffic.vehicles, traffic.people):
        xy, _ = positions(traffic.tracks, movers, 3.0)
        assert (np.abs(xy[:, 1] - 60.0) < 9.0).all()


def test_it_shows_what_is_near_and_nothing_too_near(busy: Traffic) -> None:
    world = town()
    for time_s in range(0, 60, 3):
        soup = traffic_at(world, busy, float(time_s), HERE, reach_m=50.0)
        assert {"car", "person"} == set(soup.kinds)
        corners = soup.corners.reshape(-1, 3)
        distance = np.linalg.norm(corners[:, :2] - HERE[:2, 3], axis=1)
        assert distance.min() > NEAREST_M - 0.1
        assert distance.max() < 50.0 + BUS.length + 1.0
        people = soup.corners[np.isin(soup.object_id, rows(soup, "person"))]
        assert people[:, :, 2].min() > KERB_M - 0.03


def rows(soup: Soup, kind: str) -> list[int]:
    return [k for k, name in enumerate(soup.kinds) if name == kind]


def test_it_is_a_function_of_seed_and_time(same, busy: Traffic) -> None:
    world = town()
    again = plan_traffic(world, 7, 2.0, 2.0)
    assert same(traffic_at(world, busy, 9.0, HERE), traffic_at(world, again, 9.0, HERE))
    assert not same(traffic_at(world, busy, 9.0, HERE), traffic_at(world, busy, 9.1, HERE))
    other = plan_traffic(world, 8, 2.0, 2.0)
    assert not same(traffic_at(world, busy, 9.0, HERE), traffic_at(world, other, 9.0, HERE))


# ------------------------------------------------------------------------------------------ scene


def test_traffic_joins_a_scene_and_leaves_it_as_it_was(busy: Traffic) -> None:
    world = town()
    parked = park_vehicles(world, 3, 0.5, FAR)
    still = build_scene(world, build_static(world), parked)
    moving = traffic_at(world, busy, 9.0, HERE)
    scene = with_traffic(still, moving)
    n, m = len(still.material), len(still.objects)
    assert n == len(world.soup.corners) + len(parked.corners) == len(still.still.face)
    assert len(still.traffic.face) == 0
    for part in ("normal", "uv", "uv_per_m", "material", "object_id"):
        np.testing.assert_array_equal(getattr(scene, part)[:n], getattr(still, part))
        assert len(getattr(scene, part)) == n + len(moving.corners)
    np.testing.assert_array_equal(scene.object_id[n:], moving.object_id + m)
    np.testing.assert_array_equal(scene.objects[m:], moving.objects)
    np.testing.assert_allclose(np.linalg.norm(scene.normal, axis=1), 1.0, atol=1e-5)
    with pytest.raises(ValueError, match="already"):
        with_traffic(scene, moving)
    assert with_traffic(still, SoupBuilder().build()) is still


def test_a_texture_of_one_unit_a_metre_says_so() -> None:
    """A wall of 4 x 2 m whose u counts 8 cells and whose v is in metres."""
    soup = SoupBuilder()
    wall = soup.add_object("wall")
    corners = np.array([[(0, 0, 0), (0, 4, 0), (0, 4, 2), (0, 0, 2)]], float)
    uv = np.array([[(0, 0), (8, 0), (8, 2), (0, 2)]], float)
    soup.quads(corners, Material.FACADE, wall, uv)
    world = town()
    scene = build_scene(world, build_static(world), soup.build())
    np.testing.assert_allclose(scene.uv_per_m[-2:], [(2.0, 1.0)] * 2, rtol=1e-6)
    np.testing.assert_allclose(np.abs(scene.normal[-2:]), [(1.0, 0.0, 0.0)] * 2, atol=1e-7)
