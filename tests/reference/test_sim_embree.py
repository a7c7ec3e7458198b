# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Rays through whole worlds against Intel's Embree."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numba import njit

from adafusion.geometry import pose_from_xyz_yaw
from adafusion.sim.numeric import keyed_rng
from adafusion.sim.run.parking import park_vehicles
from adafusion.sim.run.traffic import plan_traffic, traffic_at
from adafusion.sim.sensing.bvh import new_stack
from adafusion.sim.sensing.lidar import HDL_64E, ray_directions
from adafusion.sim.sensing.scene import Scene, build_scene, build_static, trace_scene, with_traffic
from adafusion.sim.town.plan import WorldSpec, point_on
from adafusion.sim.town.shapes import Material, Soup
from adafusion.sim.town.world import World, build_world

embree = pytest.importorskip(
    "embreex.rtcore_scene", reason="embreex has no wheel for this platform"
)
REACH_M = 80.0


class Hits(NamedTuple):
    """What n rays met: distance (`REACH_M` for nothing), face or -1, barycentric coordinates."""

    t: np.ndarray
    face: np.ndarray
    b: np.ndarray  # n, 3: of the first, second and third corner


@njit
def trace_all(scene, o, directions):  # type: ignore[no-untyped-def]
    """Trace rays through a scene whose trees are bare."""
    out = np.empty((len(directions), 4))
    stack = new_stack()
    for i in range(len(directions)):
        d = (directions[i, 0], directions[i, 1], directions[i, 2])
        t, face, b1, b2 = trace_scene(scene, stack, o, d, REACH_M, 0.0)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = t, face, b1, b2
    return out


def ours(scene: Scene, origin: np.ndarray, directions: np.ndarray) -> Hits:
    x, y, z = origin.tolist()
    t, face, b1, b2 = trace_all(scene, (x, y, z), directions).T
    return Hits(t, face.astype(int), np.stack([1.0 - b1 - b2, b1, b2], axis=1))


def theirs(oracle: object, number: np.ndarray, origin: np.ndarray, directions: np.ndarray) -> Hits:
    """`number` translates Embree's faces to those of the scene."""
    origins = np.tile(origin, (len(directions), 1)).astype(np.float32)
    found = oracle.run(origins, directions.astype(np.float32), output=True)  # type: ignore[attr-defined]
    hit = (found["primID"] >= 0) & (found["tfar"] < REACH_M)
    u, v = found["u"].astype(float), found["v"].astype(float)
    return Hits(
        np.where(hit, found["tfar"], REACH_M).astype(float),
        np.where(hit, number[found["primID"]], -1),
        np.stack([1.0 - u - v, u, v], axis=1),
    )


def poses(world: World, rng: np.random.Generator) -> list[np.ndarray]:
    """Four on streets, one in a passage, one on a path between the two."""
    found = []
    kinds = [street.kind for street in world.streets]
    indoors = [k for k, kind in enumerate(kinds) if kind not in ("street", "path")]
    for e in [
        *rng.choice([k for k, kind in enumerate(kinds) if kind == "street"], 4).tolist(),
        int(rng.choice(indoors)),
        kinds.index("path"),
    ]:
        line = world.streets[e].line
        xy, yaw = point_on(line, float(rng.uniform(5.0, 40.0)))
        x, y = (xy + rng.uniform(-1.0, 1.0, 2)).tolist()
        T = pose_from_xyz_yaw(x, y, world.hills.at((x, y)), yaw + float(rng.uniform(-3, 3)))
        tilt = rng.normal(0.0, 0.02)  # rays along the axes of the world would be a special case
        T[:3, :3] = T[:3, :3] @ np.array(
            [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
        )
        found.append(T)
    return found


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_measures_what_embree_measures(seed: int) -> None:
    counts = {"corridors": 2, "halls": 1, "tunnels": 1, "blank_walls": 1}
    world = build_world(WorldSpec(seed=seed, columns=2, rows=3, spacing_m=62.0, **counts))
    parked = park_vehicles(world, seed, 0.6, np.array([[1e4, 1e4]]))
    still = build_scene(world, build_static(world), parked)
    traffic = plan_traffic(world, seed, 1.0, 1.0)
    rng, checked, wrong = keyed_rng(seed, "embree"), 0, 0
    for k, T in enumerate(poses(world, rng)):
        moving = traffic_at(world, traffic, 10.0 * k, T)
        scene = with_traffic(still, moving)
        oracle, number = build_oracle(world.soup, parked, moving)
        sensor = T @ HDL_64E.T_body_lidar
        directions = ray_directions(HDL_64E).reshape(-1, 3) @ sensor[:3, :3].T
        a = ours(scene, sensor[:3, 3], directions)
        b = theirs(oracle, number, sensor[:3, 3], directions)
        off = np.flatnonzero(np.abs(a.t - b.t) > 1e-3)
        for ray in off:
            assert on_edge(scene, a, b, ray, directions[ray]), (
                f"pose {k}, ray {ray}: {a.t[ray]:.4f} m on face {a.face[ray]}, "
                f"Embree {b.t[ray]:.4f} m on face {b.face[ray]}"
            )
        checked, wrong = checked + len(directions), wrong + len(off)
        assert (a.t < REACH_M).mean() > 0.3, "most rays hit something"
    assert wrong <= 1e-4 * checked, f"{wrong} of {checked} rays"


def build_oracle(*soups: Soup) -> tuple[object, np.ndarray]:
    """Embree's scene of all faces but leaves, and the number of each of its faces in ours."""
    from embreex.mesh_construction import TriangleMesh

    corners = np.concatenate([soup.corners for soup in soups])
    solid = np.flatnonzero(np.concatenate([soup.material for soup in soups]) != Material.LEAF)
    oracle = embree.EmbreeScene()
    TriangleMesh(oracle, np.ascontiguousarray(corners[solid]))
    return oracle, solid


def on_edge(scene: Scene, a: Hits, b: Hits, ray: int, direction: np.ndarray) -> bool:
    """Whether the nearer hit, which the other tracer missed, is at an edge or all but parallel."""
    hits = a if a.t[ray] < b.t[ray] else b
    grazing = abs(float(scene.normal[hits.face[ray]] @ direction)) < 1e-3
    return grazing or float(hits.b[ray].min()) < 1e-3
