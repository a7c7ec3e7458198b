# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""How a camera projects: a pinhole, and Brown's lens before it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from adafusion.sim.numeric import Vector, inlined

Brown = tuple[float, float, float, float, float]  # k1, k2, p1, p2, k3: OpenCV's order


class View(NamedTuple):
    """Where a camera is and how it projects."""

    eye: Vector
    R_world_camera: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Brown


def distorted(u: float, v: float, distortion: Brown) -> tuple[float, float]:
    """Where the lens bends a ray to that would meet the plane at depth 1 in (u, v) unbent."""
    k1, k2, p1, p2, k3 = distortion
    r2 = u * u + v * v
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u),
        v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v,
    )


@inlined
def undistorted(x: float, y: float, distortion: Brown) -> tuple[float, float]:
    """Where a ray that the lens bends to (x, y) on the plane at depth 1 would meet it unbent."""
    k1, k2, p1, p2, k3 = distortion
    if k1 == 0.0 and k2 == 0.0 and p1 == 0.0 and p2 == 0.0 and k3 == 0.0:
        return x, y
    u, v = x, y
    for _ in range(20):  # a fixed point: Brown's polynomial has no inverse in closed form
        r2 = u * u + v * v
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        u, v = (
            (x - 2.0 * p1 * u * v - p2 * (r2 + 2.0 * u * u)) / radial,
            (y - p1 * (r2 + 2.0 * v * v) - 2.0 * p2 * u * v) / radial,
        )
    return u, v
