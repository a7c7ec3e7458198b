# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from adafusion.geometry import (
    invert,
    is_rigid,
    pose,
    pose_from_xyz_yaw,
    rotation_from_rpy,
    transform,
)

QUARTER = np.pi / 2
X, Y, Z = np.eye(3)


def test_pose_puts_rotation_and_translation_in_their_places() -> None:
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    expected = [[0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]]
    assert pose(R, (5.0, 6.0, 7.0)).tolist() == expected


@pytest.mark.parametrize(
    ("rpy", "before", "after"),
    [
        ((QUARTER, 0.0, 0.0), Y, Z),  # roll turns left into up
        ((0.0, QUARTER, 0.0), X, -Z),  # pitch turns the nose down
        ((0.0, 0.0, QUARTER), X, Y),  # yaw turns forward into left
        ((QUARTER, 0.0, QUARTER), Y, Z),  # roll first ...
        ((0.0, QUARTER, QUARTER), Z, Y),  # ... then pitch (z to x), then yaw (x to y)
    ],
)
def test_rotation_turns_axes_in_the_order_roll_pitch_yaw(
    rpy: tuple[float, float, float], before: np.ndarray, after: np.ndarray
) -> None:
    np.testing.assert_allclose(rotation_from_rpy(*rpy) @ before, after, atol=1e-15)


def test_a_vehicle_that_heads_left_sees_its_front_on_the_left() -> None:
    T_world_body = pose_from_xyz_yaw(10.0, 20.0, 0.5, QUARTER)
    ahead_body = np.array([[3.0, 0.0, 0.0]])
    np.testing.assert_allclose(transform(T_world_body, ahead_body), [[10.0, 23.0, 0.5]])


def test_the_inverse_leads_back() -> None:
    T_world_body = pose_from_xyz_yaw(10.0, 20.0, 0.5, QUARTER)
    expected = [[0, 1, 0, -20], [-1, 0, 0, 10], [0, 0, 1, -0.5], [0, 0, 0, 1]]
    np.testing.assert_allclose(invert(T_world_body), expected, atol=1e-14)


def test_points_keep_their_float_type() -> None:
    points = np.zeros((4, 3), np.float32)
    assert transform(np.eye(4), points).dtype == np.float32
    assert transform(np.eye(4), points.astype(np.float64)).dtype == np.float64


@pytest.mark.parametrize(
    "broken",
    [
        np.diag([1.0, 1.0, -1.0, 1.0]),  # a mirror
        np.diag([1.1, 1.1, 1.1, 1.0]),  # a scale
        np.diag([1.0, 1.0, 1.0, 2.0]),  # not homogeneous
        pose(np.eye(3), (np.nan, 0.0, 0.0)),
    ],
)
def test_what_is_no_rigid_motion_is_told_so(broken: np.ndarray) -> None:
    assert not is_rigid(broken)
    assert is_rigid(np.eye(4))
    assert not is_rigid(np.stack([np.eye(4), broken]))
    assert is_rigid(np.stack([np.eye(4), np.eye(4)]))
    assert is_rigid(np.empty((0, 4, 4)))
