# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Point clouds to point sets of one size, as networks over points take them."""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Float64, Int


@dataclass(frozen=True, kw_only=True)
class PointSet:
    """Exactly `count` points of the box, as the PointNetVLAD benchmark makes its submaps.

    Points outside the box are dropped; the rest are thinned out to means of cells just large enough
    to be no more than `count`, and points of the cloud, evenly spaced in it, make up for what is
    missing. `normalise` puts their mean at zero and the mean distance from it at one half, and
    replaces what then lies outside [-1, 1]; the unit is then no metre any more. A cloud that is a
    set already (the benchmark's own) goes through unchanged with `normalise` off and a box of 1.
    An empty cloud is all zeros.
    """

    count: int = 4096
    lower_m: tuple[float, float, float] = (-20.0, -20.0, 0.0)
    upper_m: tuple[float, float, float] = (20.0, 20.0, 5.0)
    normalise: bool = True
    quantum: float = 0.01  # edge of the voxels that a sparse network keeps one point of

    def __post_init__(self) -> None:
        object.__setattr__(self, "lower_m", tuple(float(v) + 0.0 for v in self.lower_m))
        object.__setattr__(self, "upper_m", tuple(float(v) + 0.0 for v in self.upper_m))
        object.__setattr__(self, "count", operator.index(self.count))
        if self.count < 1 or not 0 < self.quantum < math.inf:
            raise ValueError(f"count {self.count} and quantum {self.quantum} must be positive")
        if not len(self.lower_m) == len(self.upper_m) == 3 or not all(
            -math.inf < lo < hi < math.inf
            for lo, hi in zip(self.lower_m, self.upper_m, strict=True)
        ):
            raise ValueError(f"upper_m {self.upper_m} must exceed lower_m {self.lower_m}")


def sample_points(
    points_body: Float[np.ndarray, "n 3"], settings: PointSet
) -> Float32[np.ndarray, "count 3"]:
    """The point set of a cloud in metres, body frame. A function of the cloud alone: no chance."""
    points = points_body.astype(np.float64)
    inside = ((points >= settings.lower_m) & (points <= settings.upper_m)).all(axis=1)
    points = points[inside]
    if len(points) == 0:
        return np.zeros((settings.count, 3), np.float32)
    points = thin_out(points, settings.count)
    if settings.normalise:
        points = normalise(points)
    return points.astype(np.float32)


def normalise(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """Mean at zero, mean distance from it one half; points beyond [-1, 1] give way to others."""
    points = points - points.mean(axis=0)
    mean_distance = float(np.linalg.norm(points, axis=1).mean())
    if mean_distance == 0.0:
        return points
    points = points * (0.5 / mean_distance)
    inside = np.flatnonzero((np.abs(points) <= 1.0).all(axis=1))
    outside = np.setdiff1d(np.arange(len(points)), inside)
    points[outside] = points[inside[_evenly(len(inside), len(outside))]]
    return points


def thin_out(points: Float64[np.ndarray, "n 3"], count: int) -> Float64[np.ndarray, "count 3"]:
    """Means of cells just large enough to be no more than `count`, then points to fill up."""
    if len(points) <= count:
        return np.concatenate([points, points[_evenly(len(points), count - len(points))]])
    few, many = float(np.ptp(points, axis=0).max()) + 1e-6, 0.0  # edges: too few means, too many
    for _ in range(14):
        edge = 0.5 * (few + many)
        fits = len(_cells(points, edge)[1]) <= count
        few, many = (edge, many) if fits else (few, edge)
    cell, occupancy = _cells(points, few)
    means = np.column_stack([np.bincount(cell, column) / occupancy for column in points.T])
    return np.concatenate([means, points[_evenly(len(points), count - len(means))]])


def _cells(
    points: Float64[np.ndarray, "n 3"], edge: float
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " m"]]:
    """The cell of each point, and how many points each of the m occupied cells has."""
    index = np.floor((points - points.min(axis=0)) / edge).astype(np.int64)
    _, ny, nz = (index.max(axis=0) + 1).tolist()
    flat = (index[:, 0] * ny + index[:, 1]) * nz + index[:, 2]
    return np.unique(flat, return_inverse=True, return_counts=True)[1:]


def _evenly(n: int, count: int) -> Int[np.ndarray, " count"]:
    """`count` indices below n, evenly spaced."""
    return np.arange(count) * n // max(count, 1) % max(n, 1)
