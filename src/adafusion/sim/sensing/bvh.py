# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A bounding volume hierarchy over triangles: binned surface-area heuristic, stack traversal.

Wald, "On fast construction of SAH-based bounding volume hierarchies", RT 2007;
Moller and Trumbore, "Fast, minimum storage ray-triangle intersection", JGT 1997.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8

from adafusion.sim.numeric import Vector, hashed, inlined, kernel

BINS = 16
LEAF_SIZE = 4
STACK = 64
_NONE, _ONE = np.uint64(0), np.uint64(1)  # unsigned: numba need not look for negative indices
Stack = np.ndarray  # of _STACK_ITEM: nodes still to be visited, and where the ray enters them
_STACK_ITEM = np.dtype([("node", np.uint32), ("entry", np.float64)], align=True)
EDGE = 1e-8  # triangles overlap by this share of an edge, so that no ray slips between them
LEAF_CELLS = 5.0  # a leaf card is cut into cells of 1/5 of its edges ...
LEAF_SHARE = 0.62  # ... of which this share is there: the rest lets light and pulses through


class Bvh(NamedTuple):
    """Triangles and the tree over them; a tuple of arrays, so that numba kernels take it."""

    bounds: Float32[np.ndarray, "nodes 6"]  # lower xyz, upper xyz
    link: Int32[np.ndarray, "nodes 2"]  # (left child, 0), or (first triangle, count) of a leaf
    triangle: Float32[np.ndarray, "n 9"]  # first corner, then its two edges, in leaf order
    face: Int32[np.ndarray, " n"]  # which face of the soup each triangle is
    porous: UInt8[np.ndarray, " n"]  # 1 for a leaf card


def build_bvh(corners: Float32[np.ndarray, "n 3 3"], porous: UInt8[np.ndarray, " n"]) -> Bvh:
    """Build the tree over n >= 0 triangles given by their corners in metres."""
    n = len(corners)
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    order = np.arange(n, dtype=np.int32)
    bounds = np.zeros((max(2 * n, 2), 6), np.float32)
    link = np.zeros((max(2 * n, 2), 2), np.int32)
    nodes = _split(lower, upper, 0.5 * (lower + upper), order, bounds, link) if n else 0
    sorted_corners = corners[order]
    triangle = np.empty((n, 9), np.float32)
    triangle[:, 0:3] = sorted_corners[:, 0]
    triangle[:, 3:6] = sorted_corners[:, 1] - sorted_corners[:, 0]
    triangle[:, 6:9] = sorted_corners[:, 2] - sorted_corners[:, 0]
    return Bvh(bounds[:nodes].copy(), link[:nodes].copy(), triangle, order, porous[order])


def join_bvh(a: Bvh, b: Bvh) -> Bvh:
    """One tree over the triangles of both; the faces of `b` are numbered after those of `a`.

    A root over two roots: one descent finds the nearest of both, and nothing is sorted anew.
    """
    face = np.concatenate([a.face, b.face + np.int32(len(a.face))])
    if len(a.face) == 0 or len(b.face) == 0:
        return (b if len(a.face) == 0 else a)._replace(face=face)
    # nodes: the new root, the roots of a and b side by side, the rest of a, the rest of b
    root = np.concatenate(
        [np.minimum(a.bounds[0, :3], b.bounds[0, :3]), np.maximum(a.bounds[0, 3:], b.bounds[0, 3:])]
    )
    bounds = np.concatenate([root[None], a.bounds[:1], b.bounds[:1], a.bounds[1:], b.bounds[1:]])
    links = []
    for tree, nodes, triangles in ((a, 2, 0), (b, 1 + len(a.link), len(a.face))):
        link = tree.link.copy()
        link[:, 0] += np.where(link[:, 1] > 0, triangles, nodes).astype(np.int32)
        links.append(link)
    top = np.array([[1, 0]], np.int32)
    return Bvh(
        bounds,
        np.concatenate([top, links[0][:1], links[1][:1], links[0][1:], links[1][1:]]),
        np.concatenate([a.triangle, b.triangle]),
        face,
        np.concatenate([a.porous, b.porous]),
    )


@kernel
def _split(
    lower: Float32[np.ndarray, "n 3"],
    upper: Float32[np.ndarray, "n 3"],
    centre: Float32[np.ndarray, "n 3"],
    order: Int32[np.ndarray, " n"],
    bounds: Float32[np.ndarray, "nodes 6"],
    link: Int32[np.ndarray, "nodes 2"],
) -> int:
    """Sort `order` into leaves and fill `bounds` and `link`; returns the number of nodes."""
    todo = np.empty((STACK * 4, 3), np.int32)  # node, first, end
    todo[0, 0], todo[0, 1], todo[0, 2] = 0, 0, len(order)
    depth, nodes = 1, 1
    count = np.empty(BINS, np.int64)
    low = np.empty((BINS, 3), np.float64)
    high = np.empty((BINS, 3), np.float64)
    right_cost = np.empty(BINS, np.float64)
    scratch = np.empty_like(order)
    while depth > 0:
        depth -= 1
        node, first, end = todo[depth, 0], todo[depth, 1], todo[depth, 2]
        for k in range(3):
            a, b = np.inf, -np.inf
            for i in range(first, end):
                a, b = min(a, lower[order[i], k]), max(b, upper[order[i], k])
            bounds[node, k], bounds[node, 3 + k] = a, b
        best, best_axis, best_bin, best_min, best_scale = np.inf, -1, 0, 0.0, 0.0
        if end - first > LEAF_SIZE:
            for axis in range(3):
                a, b = np.inf, -np.inf
                for i in range(first, end):
                    c = centre[order[i], axis]
                    a, b = min(a, c), max(b, c)
                if b - a < 1e-6:
                    continue
                scale = BINS * 0.9999 / (b - a)
                count[:], low[:], high[:] = 0, np.inf, -np.inf
                for i in range(first, end):
                    f = order[i]
                    j = int((centre[f, axis] - a) * scale)
                    count[j] += 1
                    for k in range(3):
                        low[j, k] = min(low[j, k], lower[f, k])
                        high[j, k] = max(high[j, k], upper[f, k])
                lo, hi, total = np.full(3, np.inf), np.full(3, -np.inf), 0
                for j in range(BINS - 1, 0, -1):
                    total += count[j]
                    for k in range(3):
                        lo[k], hi[k] = min(lo[k], low[j, k]), max(hi[k], high[j, k])
                    right_cost[j] = total * _half_area(lo, hi) if total else 0.0
                lo[:], hi[:], total = np.inf, -np.inf, 0
                for j in range(BINS - 1):
                    total += count[j]
                    for k in range(3):
                        lo[k], hi[k] = min(lo[k], low[j, k]), max(hi[k], high[j, k])
                    if total == 0 or total == end - first:
                        continue
                    cost = total * _half_area(lo, hi) + right_cost[j + 1]
                    if cost < best:
                        best, best_axis, best_bin = cost, axis, j
                        best_min, best_scale = a, scale
        if best_axis < 0:
            link[node, 0], link[node, 1] = first, end - first
            continue
        middle, right = first, 0
        for i in range(first, end):
            f = order[i]
            if int((centre[f, best_axis] - best_min) * best_scale) <= best_bin:
                order[middle] = f
                middle += 1
            else:
                scratch[right] = f
                right += 1
        order[middle:end] = scratch[:right]
        link[node, 0], link[node, 1] = nodes, 0
        todo[depth, 0], todo[depth, 1], todo[depth, 2] = nodes, first, middle
        todo[depth + 1, 0], todo[depth + 1, 1], todo[depth + 1, 2] = nodes + 1, middle, end
        depth += 2
        nodes += 2
    return nodes


@inlined
def _half_area(lo: Float64[np.ndarray, " 3"], hi: Float64[np.ndarray, " 3"]) -> float:
    x, y, z = hi[0] - lo[0], hi[1] - lo[1], hi[2] - lo[2]
    return x * y + y * z + z * x


@kernel
def new_stack() -> Stack:
    """Memory for one `trace` at a time; allocating it would cost as much as the ray."""
    return np.empty(STACK, _STACK_ITEM)


@inlined
def trace(
    bvh: Bvh, stack: Stack, o: Vector, d: Vector, t_max: float, any_hit: bool, foliage: float
) -> tuple[float, int, float, float]:
    """Follow a ray from o in the unit direction d; returns (distance, face, b1, b2) of a hit.

    Of the nearest hit, or with `any_hit` of the first one found (shadows). Face is -1 and the
    distance `t_max` where nothing is hit. (b1, b2) are the barycentric coordinates of the second
    and third corner. `foliage` in [0, 1] is the share of leaf cards that are on the trees.
    """
    t, face, u, v = t_max, -1, 0.0, 0.0
    if len(bvh.link) == 0:
        return t, face, u, v
    link = bvh.link
    # boxes in single precision: exact enough with the slack of `_enter`, and a tenth faster
    o32 = np.float32(o[0]), np.float32(o[1]), np.float32(o[2])
    inv32 = _inverse(d[0]), _inverse(d[1]), _inverse(d[2])
    stack[0].node, stack[0].entry = _NONE, 0.0
    depth = _ONE
    while depth > _NONE:
        depth -= _ONE
        if stack[depth].entry >= t:
            continue
        node = np.uint64(stack[depth].node)
        while True:
            first, count = np.uint64(link[node, 0]), np.uint64(link[node, 1])
            if count > _NONE:
                for i in range(first, first + count):
                    s, b1, b2 = _intersect(bvh.triangle, i, o, d)
                    if s <= 0.0 or s >= t:
                        continue
                    if bvh.porous[i] != 0 and not leaf_is_there(bvh.face[i], b1, b2, foliage):
                        continue
                    t, face, u, v = s, bvh.face[i], b1, b2
                    if any_hit:
                        return t, face, u, v
                break
            near, far = first, first + _ONE
            t_near = _enter(bvh.bounds, near, o32, inv32, np.float32(t))
            t_far = _enter(bvh.bounds, far, o32, inv32, np.float32(t))
            if t_far < t_near:
                near, far, t_near, t_far = far, near, t_far, t_near
            if t_near == np.inf:
                break
            if t_far < np.inf:
                stack[depth].node, stack[depth].entry = far, t_far
                depth += _ONE
            node = near
    return t, face, u, v


@inlined
def _intersect(
    triangle: Float32[np.ndarray, "n 9"], i: int, o: Vector, d: Vector
) -> tuple[float, float, float]:
    """Distance and barycentric coordinates of a hit on one triangle; distance -1 for a miss."""
    e1x, e1y, e1z = triangle[i, 3], triangle[i, 4], triangle[i, 5]
    e2x, e2y, e2z = triangle[i, 6], triangle[i, 7], triangle[i, 8]
    px, py, pz = d[1] * e2z - d[2] * e2y, d[2] * e2x - d[0] * e2z, d[0] * e2y - d[1] * e2x
    det = e1x * px + e1y * py + e1z * pz
    if det == 0.0:
        return -1.0, 0.0, 0.0
    inv = 1.0 / det
    sx, sy, sz = o[0] - triangle[i, 0], o[1] - triangle[i, 1], o[2] - triangle[i, 2]
    b1 = (sx * px + sy * py + sz * pz) * inv
    if b1 < -EDGE or b1 > 1.0 + EDGE:
        return -1.0, 0.0, 0.0
    qx, qy, qz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
    b2 = (d[0] * qx + d[1] * qy + d[2] * qz) * inv
    if b2 < -EDGE or b1 + b2 > 1.0 + EDGE:
        return -1.0, 0.0, 0.0
    return (e2x * qx + e2y * qy + e2z * qz) * inv, b1, b2


@inlined
def _inverse(x: float) -> np.float32:
    return np.float32(1.0 / (x if abs(x) > 1e-12 else 1e-12))


@inlined
def _enter(
    bounds: Float32[np.ndarray, "nodes 6"],
    node: np.uint64,
    o: tuple[np.float32, np.float32, np.float32],
    inv: tuple[np.float32, np.float32, np.float32],
    t: np.float32,
) -> np.float32:
    """Distance at which a ray enters the box of `node`, infinity where it misses."""
    x0, x1 = (bounds[node, 0] - o[0]) * inv[0], (bounds[node, 3] - o[0]) * inv[0]
    y0, y1 = (bounds[node, 1] - o[1]) * inv[1], (bounds[node, 4] - o[1]) * inv[1]
    z0, z1 = (bounds[node, 2] - o[2]) * inv[2], (bounds[node, 5] - o[2]) * inv[2]
    near = max(max(min(x0, x1), min(y0, y1)), max(min(z0, z1), np.float32(0.0)))
    far = min(min(max(x0, x1), max(y0, y1)), min(max(z0, z1), t))
    # a hair of slack, lest a ray slips between two boxes that touch
    return near if near <= far * np.float32(1.000001) else np.float32(np.inf)


@inlined
def leaf_is_there(face: int, b1: float, b2: float, foliage: float) -> bool:
    """Whether a leaf card has a leaf at (b1, b2): the season thins cards, cells are holes."""
    if (hashed(face, 1, 7) & 0xFFFF) >= foliage * 65536.0:
        return False
    cell = int(b1 * LEAF_CELLS) * 16 + int(b2 * LEAF_CELLS)
    return (hashed(face, cell, 11) & 0xFFFF) < LEAF_SHARE * 65536.0
