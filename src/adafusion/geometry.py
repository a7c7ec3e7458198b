# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Rigid motions as 4x4 matrices: `T_a_b` maps points of b into a."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def pose(
    R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, " 3"] | tuple[float, float, float]
) -> Float[np.ndarray, "4 4"]:
    """Put a rotation and a translation in metres together into one 4x4 float64 matrix."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def pose_from_xyz_yaw(x: float, y: float, z: float, yaw: float) -> Float[np.ndarray, "4 4"]:
    """Pose of a vehicle at (x, y, z) metres that heads `yaw` radians from x towards y."""
    return pose(rotation_from_rpy(0.0, 0.0, yaw), (x, y, z))


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> Float[np.ndarray, "3 3"]:
    """R = Rz(yaw) Ry(pitch) Rx(roll), angles in radians."""
    cr, sr = np.cos(roll), np.sin(roll)
    cp, sp = np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def invert(T_a_b: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """T_b_a: the rigid inverse, exact where a general inverse would round."""
    R_b_a = T_a_b[:3, :3].T
    return pose(R_b_a, -R_b_a @ T_a_b[:3, 3])


def transform(
    T_a_b: Float[np.ndarray, "4 4"], points_b: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Map points of b into a, keeping their float type."""
    R = T_a_b[:3, :3].astype(points_b.dtype)
    t = T_a_b[:3, 3].astype(points_b.dtype)
    return points_b @ R.T + t


def is_rigid(T: Float[np.ndarray, "*n 4 4"], tolerance: float = 1e-3) -> bool:
    """Whether T, or every T of a stack, is a rigid motion.

    Finite, with a proper rotation (within `tolerance`) and a last row of 0 0 0 1.
    """
    R = T[..., :3, :3]
    return bool(
        np.isfinite(T).all()
        and np.allclose(R @ R.swapaxes(-1, -2), np.eye(3), atol=tolerance)
        and (np.linalg.det(R) > 0).all()
        and (T[..., 3, :] == (0.0, 0.0, 0.0, 1.0)).all()
    )
