# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where a vehicle was when: poses between those recorded, sensors joined by time, keyframes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64, Int, Int64
from scipy.spatial.transform import Rotation, Slerp


@dataclass(frozen=True, eq=False)
class Track:
    """Poses by strictly rising time, microseconds; ValueError where it does not rise."""

    time_us: Int64[np.ndarray, " n"]
    T_world_body: Float64[np.ndarray, "n 4 4"]

    def __post_init__(self) -> None:
        if len(self.time_us) == 0 or (np.diff(self.time_us) <= 0).any():
            raise ValueError("a track needs poses, and times that rise")

    def near(self, at_us: Int[np.ndarray, " k"], gap_us: int) -> Bool[np.ndarray, " k"]:
        """Which times lie on a recorded pose, or between two that are at most `gap_us` apart."""
        after = np.searchsorted(self.time_us, at_us)
        inside = (at_us >= self.time_us[0]) & (at_us <= self.time_us[-1])
        after = np.clip(after, 0, len(self.time_us) - 1)
        before = np.where(self.time_us[after] == at_us, after, np.maximum(after - 1, 0))
        return inside & (self.time_us[after] - self.time_us[before] <= gap_us)

    def at(self, at_us: Int[np.ndarray, " k"]) -> Float64[np.ndarray, "k 4 4"]:
        """Poses at any times within the track: straight lines between positions, slerp of turns.

        ValueError outside of it: nobody knows where the vehicle was.
        """
        if len(at_us) and (at_us.min() < self.time_us[0] or at_us.max() > self.time_us[-1]):
            raise ValueError("a time lies outside the track: ask `near` first")
        T = np.tile(np.eye(4), (len(at_us), 1, 1))
        if len(self.time_us) == 1 or len(at_us) == 0:
            T[:] = self.T_world_body[:1]
            return T
        # microseconds since the epoch lose a quarter of one as float64: count from the start
        knots = (self.time_us - self.time_us[0]).astype(float)
        at = (at_us - self.time_us[0]).astype(float)
        turns = Slerp(knots, Rotation.from_matrix(self.T_world_body[:, :3, :3]))
        T[:, :3, :3] = turns(at).as_matrix()
        for axis in range(3):
            T[:, axis, 3] = np.interp(at, knots, self.T_world_body[:, axis, 3])
        return T


def nearest(times: Int[np.ndarray, " n"], at: Int[np.ndarray, " k"]) -> Int64[np.ndarray, " k"]:
    """Index of the time nearest to each of `at`, the earlier of two as near; `times` rises."""
    if len(times) == 0:
        raise ValueError("there is no time to be near to")
    after = np.clip(np.searchsorted(times, at), 1, max(len(times) - 1, 1))
    after = np.minimum(after, len(times) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(at - times[before] <= times[after] - at, before, after).astype(np.int64)


def keyframes(positions_m: Float[np.ndarray, "n d"], every_m: float) -> Int64[np.ndarray, " k"]:
    """Rows to keep: the first, then each that lies `every_m` or more from the last one kept.

    A vehicle that stands still gives one frame; 0 keeps every row.
    """
    if every_m <= 0:
        return np.arange(len(positions_m))
    kept: list[int] = []
    for row, position in enumerate(positions_m):
        if not kept or np.linalg.norm(position - positions_m[kept[-1]]) >= every_m:
            kept.append(row)
    return np.array(kept, dtype=np.int64)
