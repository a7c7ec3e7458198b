# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Submaps from a LiDAR that sees little at a time: its scans along a stretch of the way, joined.

A laser that is pushed along draws one thin fan after another; only the poses of the vehicle make a
cloud of them. A submap begins at an instant of reference, in whose body frame its points are, and
ends a given length of the way later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64

from adafusion.geometry import transform
from adafusion.readers.track import Track, keyframes


@dataclass(frozen=True, eq=False)
class Sweep:
    """The scans of one run that are worth joining, by time, and where the vehicle was at each."""

    time_us: Int64[np.ndarray, " n"]
    T_world_body: Float64[np.ndarray, "n 4 4"]
    driven_m: Float64[np.ndarray, " n"]  # from the first scan, along the way


def sweep(track: Track, time_us: Int64[np.ndarray, " n"], *, every_m: float, gap_us: int) -> Sweep:
    """Keep the scans that have a pose and lie `every_m` from one another; `time_us` rises.

    A vehicle that waits at a red light draws the same fan a thousand times.
    """
    time_us = time_us[track.near(time_us, gap_us)]
    T = track.at(time_us)
    kept = keyframes(T[:, :3, 3], every_m)
    time_us, T = time_us[kept], T[kept]
    steps = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    driven = np.concatenate([np.zeros(min(len(T), 1)), np.cumsum(steps)])
    return Sweep(time_us, T, driven)


def stretches(
    scans: Sweep,
    at_us: Int64[np.ndarray, " k"],
    position_m: Float[np.ndarray, "k 3"],
    *,
    length_m: float,
    hole_m: float,
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"], Bool[np.ndarray, " k"]]:
    """Rows `first <= row < end` of the scans of the submaps that begin at `at_us`, if `whole`.

    Not whole is a submap that the run ends too early for, and one with a hole: two scans in a row,
    or the place of reference and the first scan, more than `hole_m` apart. That is so where scans
    are missing, where poses are, and where poses jump; to wait there does no harm.
    """
    n = len(scans.time_us)
    if n == 0:
        nothing = np.zeros(len(at_us), np.int64)
        return nothing, nothing, np.zeros(len(at_us), bool)
    first = np.searchsorted(scans.time_us, at_us)
    begins = first < n
    row = np.minimum(first, n - 1)
    goal = scans.driven_m[row] + length_m
    end = np.searchsorted(scans.driven_m, goal, side="right")
    steps = np.diff(scans.driven_m, prepend=scans.driven_m[0])
    holes = np.cumsum(steps > hole_m)
    near = np.linalg.norm(scans.T_world_body[row, :3, 3] - position_m, axis=1) <= hole_m
    # the next scan too: it shows that the way goes on to the end of the stretch
    unbroken = holes[np.minimum(end, n - 1)] == holes[row]
    return first, end, begins & near & unbroken & (scans.driven_m[-1] >= goal)


def join(
    read_scan: Callable[[int], Float[np.ndarray, "n 3"]],
    scans: Iterable[int],
    T_body_lidar: Float[np.ndarray, "k 4 4"],
) -> Float32[np.ndarray, "m 3"]:
    """Points of all scans in the frame of reference; row i of the poses is that of scan i."""
    clouds = [
        transform(T, read_scan(scan)).astype(np.float32)
        for scan, T in zip(scans, T_body_lidar, strict=True)
    ]
    return np.concatenate([np.zeros((0, 3), np.float32), *clouds])


def looks_down_rad(
    track: Track, *, chord_us: int, shortest_m: float, gap_us: int
) -> Float64[np.ndarray, " n"]:
    """How far the x axis of a mounted frame (x forward, z down) points below the way it travels.

    An angle for each chord of the way that lasts `chord_us` and is `shortest_m` or longer; chords
    begin a tenth of that apart. The median over a long drive is how the frame is mounted: a
    vehicle goes along the road, whatever its slope.
    """
    tenth = (track.time_us - track.time_us[0]) // (chord_us // 10)
    begin = track.time_us[np.unique(tenth, return_index=True)[1]]
    known = track.near(begin, gap_us) & track.near(begin + chord_us, gap_us)
    begin = begin[known & track.near(begin + chord_us // 2, gap_us)]
    chord = track.at(begin + chord_us)[:, :3, 3] - track.at(begin)[:, :3, 3]
    ahead, _, down = np.einsum("nji,nj->in", track.at(begin + chord_us // 2)[:, :3, :3], chord)
    moving = ahead >= shortest_m  # forward: to back out of a drive says the same, but upside down
    return np.arctan2(-down[moving], ahead[moving])
