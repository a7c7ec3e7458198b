# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Submaps in the layout of the PointNetVLAD benchmark's Oxford part.

    oxford/<run>/pointcloud_20m_10overlap/<timestamp>.bin       4096 x 3 float64 in [-1, 1]
    oxford/<run>/pointcloud_locations_20m_10overlap.csv         timestamp, northing, easting

A submap is 20 m of front laser scans, and every 10 m one begins. It lies in the negated frame of
its first scan (x back, y left, z up), without the road, its mean at zero and the mean distance
from there one half. It bears the time of its first scan, and the place of its centroid.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float64, Int

from adafusion.geometry import invert, transform
from adafusion.sim.exports.frames import T_NED_WORLD, table
from adafusion.sim.exports.layout import Layout, Piece
from adafusion.sim.exports.pushbroom import INS, LMS_FRONT, Sweep, lift, mounting
from adafusion.sim.numeric import keyed_rng
from adafusion.sim.studio import Job, Studio
from adafusion.types import UserError

LENGTH_M, STEP_M = 20.0, 10.0
POINTS = 4096
ROAD_M = 0.5  # what is this near to the plane of the road is road
HYPOTHESES, WITNESSES = 400, 2000  # planes that are tried, and points that judge them
UPRIGHT = 0.9  # cosine of the largest slope that is still a road
FOLDER, TABLE = "pointcloud_20m_10overlap", "pointcloud_locations_20m_10overlap.csv"

SIMPLIFIED = [
    "a scan is taken from one pose; objects in traffic move every 0.1 s",
    "scans are joined by the poses of an INS whose error changes slowly and evenly",
    "northing and easting count from the world's origin",
    "every submap of the route, and none of the benchmark's regions",
]


def lay_out(job: Job) -> Layout:
    """Submaps of the runs of a job."""
    for run, conditions in job.runs:
        if conditions.lidar_dead:
            raise UserError(f"run {run!r} has no LiDAR (lidar_dead), so no submaps: leave it out")
    calibration = {
        "T_body_ins": mounting(INS).tolist(),
        "T_body_lms_front": mounting(LMS_FRONT).tolist(),
    }
    return Layout({"calibration": calibration, "simplified": SIMPLIFIED}, _pieces(Studio(job)))


def _pieces(studio: Studio) -> Iterator[Piece]:
    for run in studio.conditions:
        submaps = _Submaps(Sweep(studio, run), studio.job.seed, run)
        if not submaps.first:
            raise UserError(f"run {run!r} is shorter than {LENGTH_M:g} m: ask for more places")
        for first in submaps.first:
            name = f"oxford/{run}/{FOLDER}/{submaps.sweep.time_us[first]}.bin"
            yield Piece(name, partial(submaps.encode, first))
        yield Piece(f"oxford/{run}/{TABLE}", submaps.table)


class _Submaps:
    """The submaps of one run. Where those lie that were built is kept for the table."""

    def __init__(self, sweep: Sweep, seed: int, run: str) -> None:
        self.sweep, self.seed, self.run = sweep, seed, run
        starts = np.arange(0.0, sweep.driven_m[-1] - LENGTH_M, STEP_M)
        self.first: list[int] = np.searchsorted(sweep.driven_m, starts).tolist()
        self._places: dict[int, tuple[float, float]] = {}

    def encode(self, first: int) -> bytes:
        """The file of the submap that begins with this scan."""
        submap, T_ned_first = self._build(first)
        north, east, _ = transform(T_ned_first, submap.centroid[None])[0].tolist()
        self._places[first] = north, east
        return encode_points(submap.points)

    def table(self) -> bytes:
        """The file of all locations; a job that was resumed builds again what it did not build."""
        for first in self.first:
            if first not in self._places:
                self.encode(first)
        return table(
            (
                (int(self.sweep.time_us[k]), *(f"{value:.6f}" for value in self._places[k]))
                for k in self.first
            ),
            *("timestamp", "northing", "easting"),
        )

    def _build(self, first: int) -> tuple[Submap, Float64[np.ndarray, "4 4"]]:
        """The submap, and the pose of its frame: the INS at the first scan, z down."""
        sweep = self.sweep
        last = int(np.searchsorted(sweep.driven_m, sweep.driven_m[first] + LENGTH_M))
        T_ned_first = T_NED_WORLD @ sweep.T_world_ins[first] @ mounting(INS)
        T_first_ned = invert(T_ned_first)
        points = np.concatenate(
            [
                transform(
                    T_first_ned @ T_NED_WORLD @ sweep.T_world_ins[k] @ mounting(LMS_FRONT),
                    lift(sweep.scan(k)),
                )
                for k in range(first, last)
            ]
        )
        time_us = int(sweep.time_us[first])
        try:
            submap = make_submap(points, keyed_rng(self.seed, "run", self.run, "submap", time_us))
        except ValueError as error:
            raise UserError(
                f"run {self.run!r} gives no submap at {time_us}: {error}; thin the fog that its "
                "laser sees (lidar_fog_per_m), or leave the run out"
            ) from error
        return submap, T_ned_first


class Submap(NamedTuple):
    """The points of a submap as the benchmark has them, and what takes them back to metres."""

    points: Float64[np.ndarray, "4096 3"]  # in [-1, 1]
    centroid: Float64[np.ndarray, " 3"]  # in the frame that the points came in, metres
    scale: float  # of a metre


def make_submap(points: Float[np.ndarray, "n 3"], rng: np.random.Generator) -> Submap:
    """Cut the road, thin out to 4096 points, normalise and negate.

    `points` are in a frame with z down, metres. ValueError where the road is all there is, or
    nothing at all.
    """
    if len(points) == 0:
        raise ValueError("no scan had an echo")
    above = points[~on_road(points, rng)]
    if len(above) == 0:
        raise ValueError("its scans see the road alone")
    points = thin_out(above, rng)
    centroid = points.mean(axis=0)
    points = points - centroid
    scale = 0.5 / float(np.linalg.norm(points, axis=1).mean())
    points = -scale * points
    inside = (np.abs(points) <= 1.0).all(axis=1)
    points[~inside] = points[rng.choice(np.flatnonzero(inside), int((~inside).sum()))]
    return Submap(points, centroid, scale)


def on_road(points: Float[np.ndarray, "n 3"], rng: np.random.Generator) -> Bool[np.ndarray, " n"]:
    """Which points are near to the level plane that most points are near to."""
    corners = points[rng.integers(len(points), size=(HYPOTHESES, 3))]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    level = np.abs(normal[:, 2]) > UPRIGHT * size
    if not level.any():
        return np.zeros(len(points), bool)
    normal = normal[level] / size[level, None]
    offset = (normal * corners[level, 0]).sum(axis=1)
    witnesses = points[rng.integers(len(points), size=WITNESSES)]
    near = np.abs(witnesses @ normal.T - offset) < ROAD_M
    witnesses = witnesses[near[:, near.sum(axis=0).argmax()]]
    # the best of the planes through three points, made the best one through all that are near
    middle = witnesses.mean(axis=0)
    across = np.linalg.svd(witnesses - middle, full_matrices=False)[2][2]
    return np.abs((points - middle) @ across) < ROAD_M


def thin_out(
    points: Float[np.ndarray, "n 3"], rng: np.random.Generator
) -> Float64[np.ndarray, "4096 3"]:
    """Means of cells just large enough to be no more than 4096, and random points for the rest.

    A cloud that is too small gives some of its points twice.
    """
    few, many = 64.0, 0.0  # edges of cells in metres that give too few means, and too many
    for _ in range(14):
        edge = 0.5 * (few + many)
        fits = len(_cells(points, edge)[1]) <= POINTS
        few, many = (edge, many) if fits else (few, edge)
    cell, count = _cells(points, few)
    means = np.column_stack([np.bincount(cell, column) / count for column in points.T])
    missing = POINTS - len(means)
    rest = points[rng.choice(len(points), missing, replace=len(points) < missing)]
    return np.concatenate([means, rest])


def _cells(
    points: Float[np.ndarray, "n 3"], edge_m: float
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " m"]]:
    """The cell of each point, and how many points each of the m cells has."""
    index = np.floor(points / edge_m).astype(np.int64)
    index -= index.min(axis=0)
    _, ny, nz = (index.max(axis=0) + 1).tolist()
    flat = (index[:, 0] * ny + index[:, 1]) * nz + index[:, 2]
    return np.unique(flat, return_inverse=True, return_counts=True)[1:]


def encode_points(points: Float[np.ndarray, "4096 3"]) -> bytes:
    """A submap file."""
    return points.astype("<f8").tobytes()
