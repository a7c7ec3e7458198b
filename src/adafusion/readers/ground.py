# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where the ground is under a LiDAR, measured where no file says it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from adafusion.types import UserError

_NEAR_M, _FAR_M = 3.0, 15.0  # where a cloud shows the ground that the vehicle stands on
_THICK_M = 0.05
_TILT_RAD = np.deg2rad(6.0)
_POINTS, _PLANES = 1000, 1000  # tried for each cloud
_SHARE = 0.1  # of the points there; the largest plane of trees and walls holds less
_PROBES = 9  # clouds looked at


def measure_height(
    clouds: Sequence[Callable[[], Float[np.ndarray, "n 3"]]], where: str | Path
) -> float:
    """Height of a LiDAR above the ground, to the centimetre, from a few clouds spread evenly.

    The clouds have z up and the LiDAR at the origin; the ground is the largest nearly level plane
    around it. Damaged clouds are passed over; UserError where none is left.
    """
    heights = []
    for row in sorted({row * (len(clouds) - 1) // (_PROBES - 1) for row in range(_PROBES)}):
        try:
            height = ground_below(clouds[row]())
        except UserError:
            continue
        if height is not None:
            heights.append(height)
    if not heights:
        raise UserError(f"no cloud of {where} shows the ground: give --lidar-height-m")
    return round(float(np.median(heights)), 2)


def ground_below(points: Float[np.ndarray, "n 3"]) -> float | None:
    """How far below the origin the largest nearly level plane lies; None where there is none.

    Only what is below the origin counts.
    """
    points = points.astype(np.float64)
    away = np.hypot(points[:, 0], points[:, 1])
    near = points[(away > _NEAR_M) & (away < _FAR_M) & (points[:, 2] < 0.0)]
    if len(near) < 100:
        return None
    rng = np.random.default_rng(0)
    few = near[rng.permutation(len(near))[:_POINTS]]
    corners = few[rng.integers(len(few), size=(_PLANES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    level = np.abs(normals[:, 2]) > np.cos(_TILT_RAD) * lengths
    level &= lengths > 1e-6
    if not level.any():
        return None
    # z = slope_x x + slope_y y + offset: three numbers a plane
    slopes = -normals[level, :2] / normals[level, 2:]
    offsets = corners[level, 0, 2] - (slopes * corners[level, 0, :2]).sum(axis=1)
    apart = np.abs(few[:, 2:] - few[:, :2] @ slopes.T - offsets)  # (points, planes)
    best = int((apart < _THICK_M).sum(axis=0).argmax())
    on = near[np.abs(near[:, 2] - near[:, :2] @ slopes[best] - offsets[best]) < _THICK_M]
    if len(on) < _SHARE * len(near):
        return None
    design = np.column_stack([on[:, :2], np.ones(len(on))])
    return -float(np.linalg.lstsq(design, on[:, 2], rcond=None)[0][2])
