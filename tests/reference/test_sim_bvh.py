# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The tree against a plain loop over all triangles, ray by ray."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from adafusion.sim.sensing.bvh import Bvh, build_bvh, join_bvh, leaf_is_there, new_stack, trace
from adafusion.sim.town.shapes import Material, Soup, SoupBuilder, rectangle


@njit
def trace_all(bvh, origins, directions, t_max, any_hit, foliage):  # type: ignore[no-untyped-def]
    """Trace each ray through the tree."""
    out = np.empty((len(origins), 4))
    stack = new_stack()
    for i in range(len(origins)):
        o = (origins[i, 0], origins[i, 1], origins[i, 2])
        d = (directions[i, 0], directions[i, 1], directions[i, 2])
        t, face, b1, b2 = trace(bvh, stack, o, d, t_max, any_hit, foliage)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = t, face, b1, b2
    return out


def brute_force(
    corners: np.ndarray,
    porous: np.ndarray,
    o: np.ndarray,
    d: np.ndarray,
    t_max: float,
    foliage: float,
) -> tuple[float, int]:
    """Moller and Trumbore over every triangle, in double precision."""
    a, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(d, e2)
    det = (e1 * p).sum(axis=1)
    s = o - a
    b1 = (s * p).sum(axis=1) / det
    q = np.cross(s, e1)
    b2 = (q @ d) / det
    t = (e2 * q).sum(axis=1) / det
    best, face = t_max, -1
    for i in np.flatnonzero((b1 >= 0) & (b2 >= 0) & (b1 + b2 <= 1) & (t > 0)):
        there = not porous[i] or leaf_is_there(i, b1[i], b2[i], foliage)
        if t[i] < best and there:
            best, face = float(t[i]), int(i)
    return best, face


def random_rays(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return rng.uniform(-12.0, 12.0, (count, 3)), directions


def triangles(rng: np.random.Generator, count: int) -> np.ndarray:
    """Small and large, some of them flat in z as the ground is."""
    centre = rng.uniform(-10.0, 10.0, (count, 1, 3))
    corners = centre + rng.normal(0.0, rng.choice([0.3, 4.0], (count, 1, 1)), (count, 3, 3))
    flat = count // 5
    corners[:flat, :, 2] = np.linspace(-1.0, 1.0, flat)[:, None]  # no two at equal distance
    return corners.astype(np.float32)


@pytest.mark.parametrize("count", [1, 3, 5, 400])
@pytest.mark.parametrize("foliage", [0.0, 0.6, 1.0])
def test_it_finds_what_a_loop_over_all_triangles_finds(count: int, foliage: float) -> None:
    rng = np.random.default_rng(count)
    corners = triangles(rng, count)
    porous = (rng.random(count) < 0.3).astype(np.uint8)
    bvh = build_bvh(corners, porous)
    origins, directions = random_rays(rng, 400)
    found = trace_all(bvh, origins, directions, 30.0, False, foliage)
    for i in range(len(origins)):
        t, face = brute_force(
            corners.astype(float), porous, origins[i], directions[i], 30.0, foliage
        )
        assert found[i, 1] == face, f"ray {i}"
        assert found[i, 0] == pytest.approx(t, abs=1e-4)
    shadow = trace_all(bvh, origins, directions, 30.0, True, foliage)
    np.testing.assert_array_equal(shadow[:, 1] >= 0, found[:, 1] >= 0)


def test_it_holds_every_triangle_once_and_inside_its_boxes() -> None:
    rng = np.random.default_rng(7)
    corners = triangles(rng, 300)
    bvh = build_bvh(corners, np.zeros(300, np.uint8))
    assert sorted(bvh.face.tolist()) == list(range(300))
    assert check_node(bvh, corners, 0) == 300


def check_node(bvh: Bvh, corners: np.ndarray, node: int) -> int:
    """Count the triangles below a node, each of them and each child inside its box."""
    first, count = bvh.link[node]
    lower, upper = bvh.bounds[node, :3], bvh.bounds[node, 3:]
    if count > 0:
        inside = corners[bvh.face[first : first + count]]
        assert (inside >= lower).all()
        assert (inside <= upper).all()
        return int(count)
    for child in (first, first + 1):
        assert (bvh.bounds[child, :3] >= lower).all()
        assert (bvh.bounds[child, 3:] <= upper).all()
    return check_node(bvh, corners, first) + check_node(bvh, corners, first + 1)


@pytest.mark.parametrize(("first", "second"), [(300, 1), (1, 300), (5, 40), (0, 40), (40, 0)])
def test_two_trees_joined_find_what_one_over_both_finds(first: int, second: int) -> None:
    rng = np.random.default_rng(first)
    corners = triangles(rng, first + second)
    porous = (rng.random(len(corners)) < 0.3).astype(np.uint8)
    parts = slice(None, first), slice(first, None)
    joined = join_bvh(*(build_bvh(corners[part], porous[part]) for part in parts))
    assert sorted(joined.face.tolist()) == list(range(first + second))
    assert check_node(joined, corners, 0) == first + second
    origins, directions = random_rays(rng, 300)
    found, one = (
        trace_all(tree, origins, directions, 30.0, False, 0.6)
        for tree in (joined, build_bvh(corners, porous))
    )
    np.testing.assert_array_equal(found, one)


def test_it_hits_nothing_in_an_empty_world() -> None:
    empty = build_bvh(np.zeros((0, 3, 3), np.float32), np.zeros(0, np.uint8))
    out = trace_all(empty, np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]), 50.0, False, 1.0)
    np.testing.assert_array_equal(out[0, :2], (50.0, -1.0))


def test_no_ray_slips_between_two_triangles() -> None:
    """Rays that graze the diagonal of every wall of a closed room."""
    soup = room()
    bvh = build_bvh(soup.corners, np.zeros(len(soup.corners), np.uint8))
    a, c = soup.corners[:, 0].astype(float), soup.corners[:, 2].astype(float)
    share = np.linspace(0.01, 0.99, 400)[:, None, None]
    eye = np.array([0.3, -0.7, 1.1])
    ways = (a + share * (c - a)).reshape(-1, 3) - eye
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    found = trace_all(bvh, np.tile(eye, (len(ways), 1)), ways, 50.0, False, 1.0)
    assert (found[:, 1] >= 0).all()


def test_it_follows_rays_along_the_axes() -> None:
    soup = room()
    bvh = build_bvh(soup.corners, np.zeros(len(soup.corners), np.uint8))
    directions = np.concatenate([np.eye(3), -np.eye(3)])
    found = trace_all(bvh, np.full((6, 3), 0.125), directions, 50.0, False, 1.0)
    expected = [5 - 0.125, 4 - 0.125, 3 - 0.125, 5.125, 4.125, 0.125]
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-5)


def room() -> Soup:
    """A closed box of 10 x 8 x 3 m around the origin, its floor at z = 0."""
    soup = SoupBuilder()
    owner = soup.add_object("room")
    soup.block(rectangle((0.0, 0.0), 10.0, 8.0, 0.0), 0.0, 3.0, Material.PLAIN, owner, floor=True)
    return soup.build()
