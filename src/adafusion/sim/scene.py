# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A world made ready for rays: what stands still, what this run brought, in one set of arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8

from adafusion.sim.bvh import Bvh, Stack, build_bvh, trace
from adafusion.sim.numeric import Vector, inlined
from adafusion.sim.shapes import Material, Soup
from adafusion.sim.world import World


class Scene(NamedTuple):
    """Two trees (static, of the run) over one numbering of faces and objects: static first."""

    static: Bvh
    moving: Bvh
    normal: Float32[np.ndarray, "n 3"]  # unit length, either side
    uv: Float32[np.ndarray, "n 6"]
    uv_per_m: Float32[np.ndarray, "n 2"]  # texture units a metre, for anti-aliasing
    material: UInt8[np.ndarray, " n"]
    object_id: Int32[np.ndarray, " n"]
    objects: Float32[np.ndarray, "m 16"]
    zones: Float64[np.ndarray, "z 7"]  # indoor boxes: lower xyz, upper xyz, ambient light


def build_static(world: World) -> Bvh:
    """The tree over what no run changes; build it once a world."""
    soup = world.soup
    return build_bvh(soup.corners, (soup.material == Material.LEAF).astype(np.uint8))


def build_scene(world: World, static: Bvh, moving: Soup) -> Scene:
    """Join the static world and the soup of one run."""
    soup = world.soup
    corners = np.concatenate([soup.corners, moving.corners]).astype(np.float64)
    uv = np.concatenate([soup.uv, moving.uv])
    edge = corners[:, 1:] - corners[:, :1]
    cross = np.cross(edge[:, 0], edge[:, 1])
    area = np.linalg.norm(cross, axis=1)
    return Scene(
        static,
        build_bvh(moving.corners, np.zeros(len(moving.corners), np.uint8)),
        (cross / area[:, None]).astype(np.float32),
        uv.reshape(-1, 6),
        _uv_per_m(edge, uv),
        np.concatenate([soup.material, moving.material]),
        np.concatenate([soup.object_id, moving.object_id + len(soup.objects)]).astype(np.int32),
        np.concatenate([soup.objects, moving.objects]),
        np.array(
            [(*zone.lower, *zone.upper, zone.light) for zone in world.zones if zone.indoor], float
        ).reshape(-1, 7),
    )


def _uv_per_m(
    edge: Float64[np.ndarray, "n 2 3"], uv: Float32[np.ndarray, "n 3 2"]
) -> Float32[np.ndarray, "n 2"]:
    """Length of the gradient of u and of v on each triangle."""
    duv = (uv[:, 1:] - uv[:, :1]).astype(np.float64)  # n, edge, (u, v)
    gram = edge @ edge.transpose(0, 2, 1)
    slope = np.linalg.solve(gram, duv)
    return np.sqrt(np.maximum((duv * slope).sum(axis=1), 0.0)).astype(np.float32)


@inlined
def trace_scene(
    scene: Scene, stack: Stack, o: Vector, d: Vector, t_max: float, foliage: float
) -> tuple[float, int, float, float]:
    """Nearest hit over both trees, numbered as the scene's faces; see `bvh.trace`."""
    t, face, b1, b2 = trace(scene.static, stack, o, d, t_max, False, foliage)
    t2, face2, c1, c2 = trace(scene.moving, stack, o, d, t, False, foliage)
    if face2 >= 0:
        return t2, face2 + len(scene.static.face), c1, c2
    return t, face, b1, b2


@inlined
def blocked(scene: Scene, stack: Stack, o: Vector, d: Vector, t_max: float, foliage: float) -> bool:
    """Whether anything stands in the way within `t_max` metres."""
    if trace(scene.static, stack, o, d, t_max, True, foliage)[1] >= 0:
        return True
    return trace(scene.moving, stack, o, d, t_max, True, foliage)[1] >= 0


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
