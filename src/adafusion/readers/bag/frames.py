# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The tree of frames of a robot (/tf, /tf_static): where a sensor sits, and where the robot was."""

from __future__ import annotations

import math
from array import array
from itertools import pairwise

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from adafusion.geometry import invert
from adafusion.readers.bag.messages import Transform
from adafusion.readers.track import Track

POSE_GAP_US = 2_000_000  # between poses farther apart nobody knows where the vehicle was
_THIN_US = 10_000  # hundred poses a second are enough between which to interpolate
_FARTHEST_M = 1e9  # no world is so wide
_ROW = 7  # x y z qx qy qz qw


class PoseLog:
    """Poses by time as they come in, 64 bytes each: hours of them fit into memory."""

    def __init__(self) -> None:
        self._times = array("q")
        self._rows = array("d")
        self.refused = 0  # that were not finite, or had no direction

    def __len__(self) -> int:
        return len(self._times)

    def add(self, one: Transform) -> None:
        """Take a pose in, unless it follows the last within 10 ms."""
        if self._times and 0 <= one.stamp_us - self._times[-1] < _THIN_US:
            return
        known = all(abs(x) < _FARTHEST_M for x in one.position_m)  # False of NaN, too
        if not known or not 0.5 < math.hypot(*one.quaternion) < 2:
            self.refused += 1
            return
        self._times.append(one.stamp_us)
        self._rows.extend((*one.position_m, *one.quaternion))

    def first(self) -> Float64[np.ndarray, "4 4"]:
        """The first pose."""
        return _matrices(np.array(self._rows[:_ROW]).reshape(1, _ROW))[0]

    def track(self) -> Track:
        """All of them by rising time, the first of equal times; ValueError where there is none."""
        times, rows = np.unique(np.array(self._times, dtype=np.int64), return_index=True)
        return Track(times, _matrices(np.array(self._rows).reshape(-1, _ROW)[rows]))


class FrameTree:
    """Every frame and its parent. A frame that is said to have several has the one said most."""

    def __init__(self) -> None:
        self._edges: dict[str, dict[str, PoseLog]] = {}  # by child, then parent
        self._fixed: dict[tuple[str, str], PoseLog] = {}

    def add(self, one: Transform, static: bool) -> None:
        """Take an edge of /tf (or /tf_static: true at all times) in."""
        edge = self._edges.setdefault(one.child, {}).setdefault(one.parent, PoseLog())
        if static:  # its stamp says when it was published, and every part of a bag repeats it
            fixed = PoseLog()
            fixed.add(one)
            self._fixed[one.parent, one.child] = fixed
        else:
            edge.add(one)

    def frames(self) -> list[str]:
        """All that have a parent or a child, by name."""
        parents = {parent for edges in self._edges.values() for parent in edges}
        return sorted(parents | set(self._edges))

    def ancestors(self, frame: str) -> list[str]:
        """`frame`, its parent, and so on to the root."""
        chain = [frame]
        while (parent := self._parent(chain[-1])) is not None and parent not in chain:
            chain.append(parent)
        return chain

    def between(self, a: str, b: str) -> Float64[np.ndarray, "4 4"] | None:
        """T_a_b of two frames of one tree; joints between them as they were at first."""
        up_a, up_b = self.ancestors(a), self.ancestors(b)
        common = next((frame for frame in up_a if frame in up_b), None)
        if common is None:
            return None
        return invert(self._first(common, up_a)) @ self._first(common, up_b)

    def track(self, world: str, frame: str) -> Track | None:
        """Where `frame` was in `world`, one of its ancestors; None where nothing moves between.

        At the times of the edge that is said most often, which is the odometry's; others are
        interpolated to them. Where one of the edges is not known within `POSE_GAP_US`, there is no
        pose.
        """
        chain = self.ancestors(frame)
        edges = list(pairwise(chain[: chain.index(world) + 1]))
        moving = {child: self._log(parent, child) for child, parent in edges}
        tracks = {child: log.track() for child, log in moving.items() if len(log) > 1}
        if not tracks:
            return None
        times = max((track.time_us for track in tracks.values()), key=len)
        for edge in tracks.values():
            times = times[edge.near(times, POSE_GAP_US)]
        if len(times) == 0:
            return None
        T = np.tile(np.eye(4), (len(times), 1, 1))
        for child, parent in reversed(edges):
            track = tracks.get(child)
            T = T @ (self._log(parent, child).first() if track is None else track.at(times))
        return Track(times, T)

    def _parent(self, child: str) -> str | None:
        edges = self._edges.get(child, {})
        known = [p for p in edges if len(self._log(p, child))]
        return max(known, key=lambda parent: len(edges[parent]), default=None)

    def _log(self, parent: str, child: str) -> PoseLog:
        edge = self._edges[child][parent]
        return edge if len(edge) else self._fixed.get((parent, child), edge)

    def _first(self, ancestor: str, chain: list[str]) -> Float64[np.ndarray, "4 4"]:
        """T_ancestor_frame, where `chain` leads from the frame up."""
        T = np.eye(4)
        for child, parent in pairwise(chain[: chain.index(ancestor) + 1]):
            T = self._log(parent, child).first() @ T
        return T


def _matrices(rows: Float64[np.ndarray, "n 7"]) -> Float64[np.ndarray, "n 4 4"]:
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, :3] = Rotation.from_quat(rows[:, 3:]).as_matrix()
    T[:, :3, 3] = rows[:, :3]
    return T
