# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A world made ready for rays: what stands still, what this run brought, in one set of arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8

from adafusion.sim.numeric import Vector, inlined
from adafusion.sim.sensing.bvh import Bvh, Stack, build_bvh, join_bvh, trace
from adafusion.sim.town.shapes import Material, Soup, SoupBuilder
from adafusion.sim.town.world import World


class Scene(NamedTuple):
    """Two trees over one numbering of faces and objects: the world, what is parked, the traffic."""

    still: Bvh  # the world and what stands still during a run
    traffic: Bvh  # what moves, as it is at one moment
    normal: Float32[np.ndarray, "n 3"]  # unit length, either side
    uv: Float32[np.ndarray, "n 6"]
    uv_per_m: Float32[np.ndarray, "n 2"]  # texture units a metre, for anti-aliasing
    material: UInt8[np.ndarray, " n"]
    object_id: Int32[np.ndarray, " n"]
    objects: Float32[np.ndarray, "m 16"]
    zones: Float64[np.ndarray, "z 7"]  # indoor boxes: lower xyz, upper xyz, ambient light


def build_static(world: World) -> Bvh:
    """The tree over what no run changes; build it once a world."""
    return _tree(world.soup)


def build_scene(world: World, static: Bvh, parked: Soup) -> Scene:
    """Join the static world and what one run finds parked; without traffic, see `with_traffic`."""
    soup = world.soup
    normal, uv, uv_per_m = (
        np.concatenate(pair) for pair in zip(_measure(soup), _measure(parked), strict=True)
    )
    indoors = [(*zone.lower, *zone.upper, zone.light) for zone in world.zones if zone.indoor]
    return Scene(
        still=join_bvh(static, _tree(parked)),
        traffic=_tree(SoupBuilder().build()),
        normal=normal,
        uv=uv,
        uv_per_m=uv_per_m,
        material=np.concatenate([soup.material, parked.material]),
        object_id=np.concatenate([soup.object_id, parked.object_id + np.int32(len(soup.objects))]),
        objects=np.concatenate([soup.objects, parked.objects]),
        zones=np.array(indoors, float).reshape(-1, 7),
    )


def with_traffic(scene: Scene, soup: Soup) -> Scene:
    """The scene with traffic in it; the given one stays as it is and serves the next moment too.

    ValueError where the scene has traffic already.
    """
    if len(scene.traffic.face) > 0:
        raise ValueError("this scene has its traffic already: begin with the one without")
    if len(soup.corners) == 0:
        return scene
    normal, uv, uv_per_m = _measure(soup)
    return scene._replace(
        traffic=_tree(soup),
        normal=np.concatenate([scene.normal, normal]),
        uv=np.concatenate([scene.uv, uv]),
        uv_per_m=np.concatenate([scene.uv_per_m, uv_per_m]),
        material=np.concatenate([scene.material, soup.material]),
        object_id=np.concatenate([scene.object_id, soup.object_id + np.int32(len(scene.objects))]),
        objects=np.concatenate([scene.objects, soup.objects]),
    )


def _tree(soup: Soup) -> Bvh:
    return build_bvh(soup.corners, (soup.material == Material.LEAF).astype(np.uint8))


def _measure(
    soup: Soup,
) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 6"], Float32[np.ndarray, "n 2"]]:
    """Normal, texture coordinates, and lengths of the gradients of u and v, of each triangle."""
    edge = (soup.corners[:, 1:] - soup.corners[:, :1]).astype(np.float64)
    a, b = edge[:, 0], edge[:, 1]
    cross = np.cross(a, b)
    area = np.linalg.norm(cross, axis=1)
    duv = (soup.uv[:, 1:] - soup.uv[:, :1]).astype(np.float64)  # n, edge, (u, v)
    # |gradient|^2 = d^T G^-1 d with the Gram matrix G of the edges, whose determinant is area^2
    square = (
        duv[:, 0] ** 2 * (b * b).sum(axis=1)[:, None]
        - 2.0 * duv[:, 0] * duv[:, 1] * (a * b).sum(axis=1)[:, None]
        + duv[:, 1] ** 2 * (a * a).sum(axis=1)[:, None]
    )
    return (
        (cross / area[:, None]).astype(np.float32),
        soup.uv.reshape(-1, 6),
        (np.sqrt(np.maximum(square, 0.0)) / area[:, None]).astype(np.float32),
    )


def shelters(
    zones: Float64[np.ndarray, "z 7"], eye: Vector, reach_m: float
) -> Float64[np.ndarray, "k 7"]:
    """The indoor zones within `reach_m` of a point: few enough to ask every ray about."""
    apart = np.maximum(np.maximum(zones[:, :3] - eye, eye - zones[:, 3:6]), 0.0)
    return zones[np.linalg.norm(apart, axis=1) < reach_m]


@inlined
def trace_scene(
    scene: Scene, stack: Stack, o: Vector, d: Vector, t_max: float, foliage: float
) -> tuple[float, int, float, float]:
    """Nearest hit over all trees, numbered as the scene's faces; see `bvh.trace`."""
    t, face, b1, b2 = trace(scene.still, stack, o, d, t_max, False, foliage)
    t2, face2, c1, c2 = trace(scene.traffic, stack, o, d, t, False, foliage)
    if face2 >= 0:
        return t2, face2 + len(scene.still.face), c1, c2
    return t, face, b1, b2


@inlined
def blocked(scene: Scene, stack: Stack, o: Vector, d: Vector, t_max: float, foliage: float) -> bool:
    """Whether anything stands in the way within `t_max` metres."""
    if trace(scene.still, stack, o, d, t_max, True, foliage)[1] >= 0:
        return True
    return trace(scene.traffic, stack, o, d, t_max, True, foliage)[1] >= 0


@inlined
def outdoor_length(zones: Float64[np.ndarray, "z 7"], o: Vector, d: Vector, t: float) -> float:
    """Metres of a ray's first t that lie outside all indoor zones: weather stays out of doors."""
    length = t
    for k in range(len(zones)):
        enter, leave = 0.0, t
        for axis in range(3):
            if abs(d[axis]) < 1e-12:
                if o[axis] < zones[k, axis] or o[axis] > zones[k, 3 + axis]:
                    leave = -1.0
                continue
            a, b = (zones[k, axis] - o[axis]) / d[axis], (zones[k, 3 + axis] - o[axis]) / d[axis]
            enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
        length -= max(leave - enter, 0.0)
    return length


@inlined
def zone_of(zones: Float64[np.ndarray, "z 7"], p: Vector) -> int:
    """Index of the indoor zone that holds a point, -1 out of doors."""
    for k in range(len(zones)):
        if (
            zones[k, 0] <= p[0] <= zones[k, 3]
            and zones[k, 1] <= p[1] <= zones[k, 4]
            and zones[k, 2] <= p[2] <= zones[k, 5]
        ):
            return k
    return -1


@inlined
def texture_uv(scene: Scene, face: int, b1: float, b2: float) -> tuple[float, float]:
    """Texture coordinates at barycentric coordinates (b1, b2) of a face."""
    uv = scene.uv
    u, v = uv[face, 0], uv[face, 1]
    return (
        u + b1 * (uv[face, 2] - u) + b2 * (uv[face, 4] - u),
        v + b1 * (uv[face, 3] - v) + b2 * (uv[face, 5] - v),
    )
