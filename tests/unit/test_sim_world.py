# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a world holds, and what may and may not differ between runs through it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adafusion.geometry import pose_from_xyz_yaw
from adafusion.sim.numeric import keyed_rng
from adafusion.sim.run.conditions import PRESETS
from adafusion.sim.sensing.lidar import Lidar, ray_directions, scan_ranges
from adafusion.sim.sensing.scene import Scene, build_scene, build_static
from adafusion.sim.town.buildings import BUILDING_TYPES
from adafusion.sim.town.passages import COURT_HALF_M, COURT_M, NODE_M, PASSAGE_KINDS, court_rects
from adafusion.sim.town.plan import (
    INDOORS,
    ROAD_HALF_M,
    Hills,
    Passage,
    Plan,
    Street,
    WorldSpec,
    Zone,
    overlaps,
    touches,
)
from adafusion.sim.town.shapes import PITCH, STYLE, Material, SoupBuilder, rectangle
from adafusion.sim.town.world import STEPS, World, build_world, geometry_hash, zone_labels

SPEC = WorldSpec(
    seed=1,
    columns=2,
    rows=3,
    spacing_m=62.0,
    corridors=2,
    corridor_m=120.0,
    halls=1,
    tunnels=1,
    blank_walls=1,
)
WHOLE_KIT = WorldSpec(seed=1, columns=3, rows=3, spacing_m=80.0)
FLAT = (Material.WALL, Material.DOOR, Material.NOTICE)


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(SPEC)


@pytest.fixture(scope="module")
def whole_kit() -> World:
    return build_world(WHOLE_KIT)


@pytest.fixture(scope="module")
def scene(whole_kit: World) -> Scene:
    return build_scene(whole_kit, build_static(whole_kit), SoupBuilder().build())


def test_it_is_the_same_for_the_same_spec(same, world: World) -> None:
    again = build_world(SPEC)
    assert same(world.soup, again.soup)
    np.testing.assert_array_equal(world.lamps, again.lamps)


def test_it_is_another_for_another_seed(same, world: World) -> None:
    assert not same(world.soup, build_world(replace(SPEC, seed=2)).soup)


def test_its_hash_stands_for_everything_static(world: World) -> None:
    assert geometry_hash(world) == geometry_hash(build_world(SPEC))
    assert len(geometry_hash(world)) == 16
    others = [
        build_world(replace(SPEC, seed=2)),
        replace(world, lamps=world.lamps + 0.01),
        replace(world, zones=world.zones[1:]),
        replace(world, streets=world.streets[1:]),
        replace(world, soup=replace(world.soup, material=world.soup.material[::-1])),
        replace(world, soup=replace(world.soup, uv=world.soup.uv + 0.01)),
    ]
    assert len({geometry_hash(w) for w in [world, *others]}) == 1 + len(others)


def test_its_hash_forgives_the_last_bits(world: World) -> None:
    lamps = world.lamps + 1e-9
    assert geometry_hash(replace(world, lamps=lamps)) == geometry_hash(world)


def test_what_a_run_brings_leaves_the_static_part_as_it_is(world: World) -> None:
    static, n = build_static(world), len(world.soup.corners)
    parked = SoupBuilder()
    car = parked.add_object("car", (0.1, 0.2, 0.3))
    parked.block(rectangle((1.0, 2.0), 4.0, 2.0, 0.3), 0.0, 1.5, Material.PLAIN, car)
    alone, with_car = (
        build_scene(world, static, soup) for soup in (SoupBuilder().build(), parked.build())
    )
    assert len(with_car.material) > len(alone.material) == n
    for part in ("normal", "uv", "uv_per_m", "material", "object_id"):
        np.testing.assert_array_equal(getattr(with_car, part)[:n], getattr(alone, part))
    np.testing.assert_array_equal(with_car.zones, alone.zones)


def test_it_has_everything_a_street_needs(whole_kit: World) -> None:
    kinds = set(whole_kit.soup.kinds)
    assert kinds >= {"building", "roof", "tree", "pole", "lamp", "road", "pavement", "kerb", "door"}
    assert {street.kind for street in whole_kit.streets} == {"street", "path", *INDOORS}
    assert 7 <= len(BUILDING_TYPES) <= 10
    buildings = whole_kit.soup.objects[[kind == "building" for kind in whole_kit.soup.kinds]]
    assert len(np.unique(buildings[:, STYLE])) >= 5


def test_buildings_of_one_type_differ(whole_kit: World) -> None:
    soup = whole_kit.soup
    buildings = soup.objects[[kind == "building" for kind in soup.kinds]]
    styles, counts = np.unique(buildings[:, STYLE], return_counts=True)
    often = styles[counts >= 3]
    assert len(often) >= 3
    for style in often:
        assert np.ptp(buildings[buildings[:, STYLE] == style, PITCH]) > 0.05


def test_its_streets_are_not_all_axis_aligned(world: World) -> None:
    headings = []
    for street in world.streets:
        if street.kind == "street":
            d = np.diff(street.line, axis=0)
            headings.extend((np.degrees(np.arctan2(d[:, 1], d[:, 0])) % 90.0).tolist())
    assert np.ptp(headings) > 30.0


def test_no_kerb_lies_on_a_road() -> None:
    plan = plan_of(WHOLE_KIT)
    soup = plan.soup.build()
    kerb = np.array([soup.kinds[k] == "kerb" for k in soup.object_id])
    points = soup.corners[kerb].reshape(-1, 3)[:, :2]
    roads = plan.ways[plan.ways[:, 2] == ROAD_HALF_M]
    apart = np.hypot(*(points[:, None] - roads[:, :2]).transpose(2, 0, 1)).min(axis=1)
    assert apart.min() > ROAD_HALF_M - 0.05


@pytest.mark.parametrize("spec", [SPEC, WHOLE_KIT])
def test_no_leaf_is_in_a_wall(spec: WorldSpec) -> None:
    """No crown reaches into the ground that a building, a blank wall or a passage takes."""
    plan = plan_of(spec)
    soup = plan.soup.build()
    solid = [*plan.solid, *plan.aloft]
    trees = [k for k, kind in enumerate(soup.kinds) if kind == "tree"]
    assert len(trees) > 10
    for tree in trees:
        leaves = soup.corners[(soup.object_id == tree) & (soup.material == Material.LEAF)]
        for x, y in leaves[::4].reshape(-1, 3)[:, :2].astype(float):
            assert not touches((x, y), 0.3, solid)


@pytest.mark.parametrize(
    "spec",
    [SPEC, WHOLE_KIT, replace(WHOLE_KIT, seed=4), replace(SPEC, corridor_m=200.0, tunnels=2)],
)
def test_nothing_overlaps_anything_else(spec: WorldSpec) -> None:
    plan = plan_of(spec)
    built = [r for r in plan.solid if not any(r in court_rects(p, 20.0) for p in plan.passages)]
    for k, rect in enumerate(built):
        # terraces share party walls
        assert not overlaps((*rect[:3], rect[3] - 0.1, rect[4] - 0.1), built[k + 1 :])
    courts = [p.rect(COURT_M, COURT_HALF_M) for p in plan.passages]
    for k, rect in enumerate(courts):
        assert not overlaps((*rect[:3], rect[3] - 0.5, rect[4] - 0.5), courts[k + 1 :])
    parks = [zone for zone in plan.zones if zone.kind == "park"]
    for x, y, half, _ in plan.ways:
        assert not touches((x, y), half, built)
        assert not any(park.contains(x, y, half) for park in parks)


def plan_of(spec: WorldSpec) -> Plan:
    """What a world was built from."""
    plan = Plan(spec)
    for step in STEPS:
        step(plan)
    return plan


# ----------------------------------------------------------------------- the degenerate places


def passages(world: World, kind: str) -> list[Passage]:
    """The passages of a kind, from their ways."""
    found = []
    for street in world.streets:
        if street.kind == kind:
            (x, y), (dx, dy) = street.line[[0, -1]].mean(axis=0), street.line[-1] - street.line[0]
            length = float(np.hypot(dx, dy)) - 2 * NODE_M
            found.append(Passage(kind, round(x), round(y), int(abs(dy) > abs(dx)), length))
    return found


def test_it_holds_what_its_spec_counts(world: World, whole_kit: World) -> None:
    for w in (world, whole_kit):
        counts = [sum(zone.kind == kind for zone in w.zones) for kind in (*INDOORS, "blank wall")]
        assert counts == [w.spec.corridors, w.spec.halls, w.spec.tunnels, w.spec.blank_walls]
    nothing = replace(SPEC, corridors=0, halls=0, tunnels=0, blank_walls=0)
    bare = build_world(nothing)
    assert {zone.kind for zone in bare.zones} <= {"park"}
    assert {street.kind for street in bare.streets} == {"street"}


def test_its_passages_have_their_sizes(whole_kit: World) -> None:
    sizes = {"corridor": (2.6, 140.0), "hall": (40.0, 24.0), "tunnel": (70.0, 8.0)}
    for zone in whole_kit.zones:
        if zone.indoor:
            extent = np.subtract(zone.upper[:2], zone.lower[:2])
            np.testing.assert_allclose(extent, sizes[zone.kind], atol=0.01)
        if zone.kind == "blank wall":
            assert max(np.subtract(zone.upper[:2], zone.lower[:2])) > 50.0


@pytest.mark.parametrize("kind", INDOORS)
def test_its_passages_are_equal_to_the_last_bit(whole_kit: World, kind: str) -> None:
    """Whatever is solid, each seen from its own frame."""
    shapes = [solid_of(whole_kit, passage) for passage in passages(whole_kit, kind)]
    assert len(shapes) >= 2
    assert len(shapes[0]) > 30
    for shape in shapes[1:]:
        np.testing.assert_array_equal(shape, shapes[0])


def solid_of(world: World, passage: Passage) -> np.ndarray:
    """Sorted (corners, material) of all that stands on a passage's ground and is not paint."""
    soup, (x, y, yaw, _, _) = world.soup, passage.rect(0.0, 0.0)
    corners = soup.corners.astype(float) - (x, y, 0.0)
    if yaw > 0.0:
        corners = np.stack([corners[..., 1], -corners[..., 0], corners[..., 2]], axis=-1)
    reach = passage.length_m / 2 + 3.0, PASSAGE_KINDS[passage.kind].outer_m / 2
    inside = (np.abs(corners[..., :2]) <= reach).all(axis=(1, 2))
    inside &= ~np.isin(soup.material, FLAT)
    inside &= np.array([soup.kinds[k] not in ("ground", "pavement") for k in soup.object_id])
    rows = np.column_stack([corners[inside].reshape(-1, 9), soup.material[inside]])
    return rows[np.lexsort(rows.T)]


@pytest.mark.parametrize("kind", INDOORS)
def test_a_lidar_cannot_tell_its_passages_apart(whole_kit: World, scene: Scene, kind: str) -> None:
    """The same noiseless scan in each and from either end, as far as the sensor reaches."""
    across = np.abs(ray_directions(SENSOR)[..., 1])
    for from_door in (1.0, 6.0, 20.0):
        scans = [
            scan_at(scene, passage, from_door, end)
            for passage in passages(whole_kit, kind)
            for end in (-1, 1)
        ]
        assert (scans[0] > 0.0).mean() > 0.3
        for other in scans[1:]:
            # doors and notices lie 4 mm before the wall: a fifth of the noise of a range
            apart = np.abs(other - scans[0])
            same = (apart < 2e-3) | (apart * across < 5e-3)
            assert same.mean() > 0.999


SENSOR = Lidar(
    beams=16, steps=360, lowest_deg=-15.0, highest_deg=15.0, range_m=20.0,
    sigma_m=0.0, drop_out=0.0, power_half=1e-12, nearest_m=0.3,
)  # fmt: skip


def scan_at(scene: Scene, passage: Passage, from_door: float, end: int) -> np.ndarray:
    """Ranges seen a little left of the middle, looking out of the door at x = end * half."""
    x = end * (passage.length_m / 2 - from_door)
    (wx, wy, wz) = passage.place(np.array([x, 0.25 * end, 1.9])).tolist()
    yaw = passage.quarter * np.pi / 2 + (0.0 if end > 0 else np.pi)
    T = pose_from_xyz_yaw(wx, wy, wz, yaw)
    return scan_ranges(scene, SENSOR, PRESETS["day"], T, seed=1, run_seed=1)


@pytest.mark.parametrize("kind", [*INDOORS, "blank wall"])
def test_paint_tells_degenerate_places_apart(whole_kit: World, kind: str) -> None:
    soup = whole_kit.soup
    paints = []
    for zone in whole_kit.zones:
        if zone.kind == kind:
            low, high = np.array(zone.lower) - 0.1, np.array(zone.upper) + 0.1
            inside = ((soup.corners >= low) & (soup.corners <= high)).all(axis=(1, 2))
            walls = np.unique(soup.object_id[inside & (soup.material == Material.WALL)])
            assert len(walls) >= 4
            paints.append(soup.objects[walls, :3])
    for k, a in enumerate(paints):
        for b in paints[:k]:
            assert a.shape != b.shape or not np.allclose(a, b)


def test_a_blank_wall_stands_at_the_pavement_and_hides_what_is_behind(whole_kit: World) -> None:
    """Along the middle of the street every level ray to the side meets it, 8.7 to 8.8 m away."""
    soup = whole_kit.soup
    zone = next(zone for zone in whole_kit.zones if zone.kind == "blank wall")
    near = (np.abs(soup.corners[:, 0, :2] - middle_of(zone)) < 30.0).all(axis=1)
    wall = near & (soup.material == Material.WALL)
    top = soup.corners[wall][..., 2].max(axis=1) - whole_kit.hills(soup.corners[wall][:, 0, :2])
    assert (top > 3.0).mean() > 0.45  # of two triangles of a sheet both reach up or down
    street = nearest_street(whole_kit, middle_of(zone))
    d = (street.line[-1] - street.line[0]) / np.hypot(*(street.line[-1] - street.line[0]))
    lateral = (soup.corners[wall][..., :2] - street.line[0]) @ np.array([-d[1], d[0]])
    np.testing.assert_allclose(np.abs(lateral), 8.75, atol=0.02)


def middle_of(zone: Zone) -> np.ndarray:
    return (np.array(zone.lower[:2]) + zone.upper[:2]) / 2


def nearest_street(world: World, xy: np.ndarray) -> Street:
    streets = [street for street in world.streets if street.kind == "street"]
    return min(streets, key=lambda s: np.hypot(*(s.line - xy).T).min())


def test_lamps_inside_know_their_zone(whole_kit: World) -> None:
    """The zone of a lamp counts indoor zones alone, which come first."""
    indoor = [zone.indoor for zone in whole_kit.zones]
    assert indoor == sorted(indoor, reverse=True)
    lamps = whole_kit.lamps
    for k in range(sum(indoor)):
        own = lamps[lamps[:, 6] == k]
        assert len(own) >= 8
        assert (own[:, 7] == 1.0).all()
        assert all(whole_kit.zones[k].contains(x, y) for x, y in own[:, :2])
    outdoors = lamps[lamps[:, 6] < 0.0]
    assert len(outdoors) > 20
    assert not any(
        z.contains(x, y) for z in whole_kit.zones if z.indoor for x, y in outdoors[:, :2]
    )


# ------------------------------------------------------------------------------------- labels


def test_labels_put_indoors_first_then_walls_then_parks() -> None:
    """A street along y = 0, a path along y = 100, and zones that overlap."""
    high = (30.0,)
    world = World(
        SPEC,
        np.zeros((0, 2)),
        (
            Street((0, 1), np.array([(x, 0.0) for x in range(-200, 200, 4)]), "street"),
            Street((2, 3), np.array([(x, 100.0) for x in range(-200, 200, 4)]), "path"),
            Street((4, 5), np.array([(0.0, 40.0), (0.0, 60.0)]), "hall"),
        ),
        SoupBuilder().build(),
        (
            Zone((-5.0, -5.0, 0.0), (5.0, 5.0, *high), "hall", True, 0.01),
            Zone((0.0, 0.0, 0.0), (50.0, 10.0, *high), "park", False, 0.0),
            Zone((40.0, -9.0, 0.0), (60.0, 9.0, *high), "blank wall", False, 0.0),
        ),
        np.zeros((0, 8)),
        Hills(np.zeros((0, 4)), ()),
    )
    points = {
        (4.0, 4.0): "hall",
        (6.0, 6.0): "park",
        (45.0, 5.0): "blank wall",
        (61.0, 5.0): "park",  # within 22 m of it
        (73.0, 5.0): "street",
        (20.0, -21.0): "park",
        (20.0, -23.0): "street",
        (0.0, 49.0): "street",  # the way through the hall lends no name outside it
        (0.0, 51.0): "path",
    }
    assert zone_labels(world, np.array(list(points))) == tuple(points.values())
    assert zone_labels(world, np.zeros((0, 2))) == ()


def test_it_is_level_around_passages(world: World) -> None:
    for zone in (zone for zone in world.zones if zone.indoor):
        around = np.array([(-COURT_M, -COURT_M), (0.0, 0.0), (COURT_M, COURT_M)])
        np.testing.assert_array_equal(world.hills(zone.lower[:2] + around), 0.0)
        np.testing.assert_array_equal(world.hills(zone.upper[:2] + around), 0.0)
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
        ({"spacing_m": float("nan")}, "spacing_m"),
        ({"corridors": 5}, "corridors = 5"),
        ({"halls": -1}, "halls = -1"),
        ({"tunnels": 3}, "tunnels = 3"),
        ({"blank_walls": 3}, "blank_walls = 3"),
        ({"corridor_m": 1.0}, "corridor_m"),
        ({"corridor_m": 999.0}, "corridor_m"),
    ],
)
def test_a_spec_refuses_nonsense(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        WorldSpec(**{"seed": 0, **wrong})


@pytest.mark.parametrize(
    ("xy", "radius", "meets"),
    [
        ((4.0, 0.0), 1.1, True),
        ((4.0, 0.0), 0.9, False),
        ((4.0, 2.0), 1.3, False),  # the corner is farther than either side
        ((0.0, 0.0), 0.0001, True),
    ],
)
def test_touches_sees_round_corners(xy: tuple[float, float], radius: float, meets: bool) -> None:
    assert touches(xy, radius, [(0.0, 0.0, 0.0, 3.0, 1.0)]) is meets
    assert not touches(xy, radius, [])


def test_keyed_numbers_do_not_depend_on_other_draws() -> None:
    first = keyed_rng(1, "tree", 4).random(3)
    keyed_rng(1, "tree", 3).random(100)
    np.testing.assert_array_equal(first, keyed_rng(1, "tree", 4).random(3))
    assert not np.array_equal(first, keyed_rng(2, "tree", 4).random(3))
    assert not np.array_equal(keyed_rng(1, "ab", "c").random(3), keyed_rng(1, "a", "bc").random(3))
