# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A 2-D laser scanner that the vehicle pushes along: one upright fan after another, traced anew.

RobotCar's scans and the submaps that PointNetVLAD made from them are both this sweep.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Float64, Int64

from adafusion.sim.exports.frames import T_UP_DOWN, ins_along, pose_of
from adafusion.sim.numeric import keyed_seed
from adafusion.sim.run.route import pose_along
from adafusion.sim.sensing.lidar import Lidar, measure
from adafusion.sim.sensing.scene import Scene
from adafusion.sim.studio import Studio

# a SICK LMS-151: 270 degrees in steps of half a degree, 50 Hz
LMS = Lidar(beams=1, steps=541, range_m=50.0, nearest_m=0.5, sigma_m=0.012)
FAN_RAD = math.radians(270.0)
PERIOD_US = 20_000
SPACING_M = 0.1  # the fan turns faster than 50 Hz where the vehicle would go farther in between
TRAFFIC_US = 100_000  # moving objects stand still for so long

# z-down frames of the vehicle: its camera, and from there the INS and the front laser
CAMERA_HEIGHT_M, CAMERA_FORWARD_M = 1.6, 0.4
INS = (-1.7132, 0.1181, 1.1948, -0.0125, 0.0400, 0.0050)
LMS_FRONT = (1.7589, 0.2268, 1.0411, -0.0437, -1.4572, 0.0356)


def mounting(numbers: tuple[float, ...]) -> Float64[np.ndarray, "4 4"]:
    """Pose on the z-up body of a z-down sensor that is mounted so, as seen from the camera."""
    T_body_camera = T_UP_DOWN.copy()
    T_body_camera[:3, 3] = (CAMERA_FORWARD_M, 0.0, CAMERA_HEIGHT_M)
    return T_body_camera @ pose_of(numbers)


class Sweep:
    """All scans of one run: when, where, how far along the way, and what each of them saw."""

    def __init__(self, studio: Studio, run: str) -> None:
        way = studio.drive(run)
        path_m = np.hypot(*np.diff(way.path, axis=0).T)
        fastest_m_us = float((path_m / np.diff(way.path_time_us)).max())
        period = min(PERIOD_US, math.floor(SPACING_M / fastest_m_us))
        first, last = way.path_time_us[[0, -1]].tolist()
        self.time_us: Int64[np.ndarray, " n"] = np.arange(first, last, period)
        self.T_world_body: Float64[np.ndarray, "n 4 4"] = pose_along(
            studio.world, way, self.time_us
        )
        self.T_world_ins: Float64[np.ndarray, "n 4 4"] = ins_along(
            way, self.T_world_body, self.time_us
        )
        knots = (way.path_time_us - first).astype(float)
        self.driven_m: Float64[np.ndarray, " n"] = np.interp(
            (self.time_us - first).astype(float), knots, np.concatenate([[0.0], np.cumsum(path_m)])
        )
        self._studio, self._run = studio, run
        self._scene = lru_cache(maxsize=1)(self._scene_of)
        self.scan = lru_cache(maxsize=512)(self._trace)  # submaps overlap by half

    def _scene_of(self, tick: int) -> Scene:
        k = int(np.searchsorted(self.time_us, tick * TRAFFIC_US))
        return self._studio.scene_at(self._run, int(self.time_us[k]), self.T_world_body[k])

    def _trace(self, k: int) -> Float64[np.ndarray, "n 2"]:
        """Points of the k-th scan in the fan's plane, metres; what gave no echo is left out."""
        time_us, conditions = int(self.time_us[k]), self._studio.conditions[self._run]
        T = self._studio.lifted(self._run, self.T_world_body[k]) @ mounting(LMS_FRONT)
        plane = fan()
        x, y, z = T[:3, 3].tolist()
        ranges = measure(
            self._scene(time_us // TRAFFIC_US),
            (x, y, z),
            plane @ T[:3, :2].T,
            LMS,
            conditions,
            keyed_seed(self._studio.job.seed, "run", self._run, "lms_front", time_us),
        )
        return (plane * ranges[:, None])[ranges > 0.0]


def fan() -> Float64[np.ndarray, "rays 2"]:
    """Unit directions in the plane of the fan; the middle one is the sensor's x axis."""
    angle = np.linspace(-0.5 * FAN_RAD, 0.5 * FAN_RAD, LMS.steps)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def lift(points: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 3"]:
    """Points of a fan's plane as points of the sensor's frame."""
    return np.column_stack([points, np.zeros(len(points))])
