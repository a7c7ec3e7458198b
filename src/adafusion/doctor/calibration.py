# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where points of the body frame fall in the camera's image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float

from adafusion.datasets import DatasetInfo
from adafusion.geometry import invert, is_rigid, transform

NEAREST_M = 0.5  # before the camera; nearer points are parts of the vehicle
NAMES = ("K", "T_body_camera")


@dataclass(frozen=True, eq=False)
class CameraModel:
    """A pinhole, Brown's lens before it where the images are distorted."""

    K: Float[np.ndarray, "3 3"]
    T_body_camera: Float[np.ndarray, "4 4"]  # camera: x right, y down, z forward
    distortion: Float[np.ndarray, " d"]  # k1, k2, p1, p2, k3

    def project(
        self, points_body: Float[np.ndarray, "n 3"], size: tuple[int, int]
    ) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, "m 2"], Float[np.ndarray, " m"]]:
        """Which points fall into an image of `size` (height, width); their pixels and depths."""
        height, width = size
        points = transform(invert(self.T_body_camera), points_body.astype(np.float64))
        ahead = np.flatnonzero(points[:, 2] > NEAREST_M)
        plane = points[ahead, :2] / points[ahead, 2:]
        # far outside the image the lens's polynomial folds back into it
        corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], dtype=np.float64)
        rays = cv2.undistortPoints(corners[:, None], self.K, self.distortion)[:, 0]
        near = (np.abs(plane) <= 1.1 * np.abs(rays).max(axis=0)).all(axis=1)
        ahead = ahead[near]
        if not len(ahead):
            return np.zeros(len(points), dtype=bool), np.zeros((0, 2)), np.zeros(0)
        pixels = cv2.projectPoints(
            points[ahead], np.zeros(3), np.zeros(3), self.K, self.distortion
        )[0][:, 0]
        inside = ((pixels >= 0) & (pixels < (width, height))).all(axis=1)
        seen = np.zeros(len(points), dtype=bool)
        seen[ahead[inside]] = True
        return seen, pixels[inside], points[ahead[inside], 2]


def camera_of(info: DatasetInfo, run: str) -> CameraModel | str:
    """The camera of a run as the dataset's calibration gives it, or why there is none."""
    known: Any = info.calibration.get(run, info.calibration)
    if not isinstance(known, Mapping) or not all(name in known for name in NAMES):
        return f"the calibration has no {' and '.join(NAMES)}"
    try:
        K, T = (np.array(known[name], dtype=np.float64) for name in NAMES)
        lens = np.array(known.get("distortion") or np.zeros(5), dtype=np.float64)
    except (TypeError, ValueError):
        return "K, T_body_camera or distortion are no numbers"
    if K.shape != (3, 3) or not np.isfinite(K).all() or not (K[0, 0] > 0 and K[1, 1] > 0):
        return "K is no 3x3 camera matrix with positive focal lengths"
    if T.shape != (4, 4) or not is_rigid(T):
        return "T_body_camera is no rigid motion"
    if lens.shape not in ((4,), (5,), (8,)) or not np.isfinite(lens).all():
        return "distortion is not k1, k2, p1, p2, k3"
    return CameraModel(K, T, lens)
