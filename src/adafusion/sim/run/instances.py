# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes built once and put into the world many times: each with a pose, a size and tints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64

from adafusion.sim.town.plan import Hills
from adafusion.sim.town.shapes import TINT, Soup, SoupBuilder


@dataclass(frozen=True, eq=False)
class Instance:
    """One thing in the world, made after a prototype that stands at the origin."""

    prototype: Soup
    T_world_thing: Float64[np.ndarray, "4 4"]  # its rotation may hold a scale
    tints: Float64[np.ndarray, "k 3"]  # of the first k objects of the prototype, linear RGB


def place(instances: Sequence[Instance]) -> Soup:
    """All instances as triangles in the world, their objects numbered one after another."""
    if not instances:
        return SoupBuilder().build()
    corners, object_id, objects = [], [], []
    kinds: list[str] = []
    for thing in instances:
        shape, T = thing.prototype, thing.T_world_thing
        corners.append((shape.corners @ T[:3, :3].T + T[:3, 3]).astype(np.float32))
        object_id.append((shape.object_id + len(kinds)).astype(np.int32))
        table = shape.objects.copy()
        table[: len(thing.tints), TINT : TINT + 3] = thing.tints
        objects.append(table)
        kinds.extend(shape.kinds)
    return Soup(
        corners=np.concatenate(corners),
        uv=np.concatenate([thing.prototype.uv for thing in instances]),
        material=np.concatenate([thing.prototype.material for thing in instances]),
        object_id=np.concatenate(object_id),
        objects=np.concatenate(objects),
        kinds=tuple(kinds),
    )


def standing(
    hills: Hills,
    xy: Float[np.ndarray, "n 2"],
    yaw: Float[np.ndarray, " n"],
    *,
    upright: bool = False,
) -> Float64[np.ndarray, "n 4 4"]:
    """Poses on the ground, heading `yaw`: tilted with the slope, or `upright` as people are."""
    n = len(xy)
    here, east, north = hills(
        np.concatenate([xy, xy + np.array((1.0, 0.0)), xy + np.array((0.0, 1.0))])
    ).reshape(3, n)
    slope = 0.0 if upright else 1.0
    up = np.stack([slope * (here - east), slope * (here - north), np.ones(n)], axis=1)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    ahead = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(n)], axis=1)
    ahead -= (ahead * up).sum(axis=1, keepdims=True) * up
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    T = np.zeros((n, 4, 4))
    T[:, :3, 0], T[:, :3, 1], T[:, :3, 2] = ahead, np.cross(up, ahead), up
    T[:, :2, 3], T[:, 2, 3], T[:, 3, 3] = xy, here, 1.0
    return T
