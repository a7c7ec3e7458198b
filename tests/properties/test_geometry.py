# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from adafusion.geometry import invert, is_rigid, pose, rotation_from_rpy, transform

angles = st.floats(-10.0, 10.0)
lengths = st.floats(-1e4, 1e4)
poses = st.builds(
    lambda rpy, t: pose(rotation_from_rpy(*rpy), t),
    st.tuples(angles, angles, angles),
    st.tuples(lengths, lengths, lengths),
)
clouds = st.lists(st.tuples(lengths, lengths, lengths), min_size=1, max_size=5).map(np.array)


@given(T_a_b=poses, points_b=clouds)
def test_a_motion_and_its_inverse_cancel(T_a_b: np.ndarray, points_b: np.ndarray) -> None:
    np.testing.assert_allclose(
        transform(invert(T_a_b), transform(T_a_b, points_b)), points_b, atol=1e-8
    )
    np.testing.assert_allclose(invert(T_a_b) @ T_a_b, np.eye(4), atol=1e-8)


@given(T_a_b=poses, T_b_c=poses, points_c=clouds)
def test_motions_chain_by_their_product(
    T_a_b: np.ndarray, T_b_c: np.ndarray, points_c: np.ndarray
) -> None:
    step_by_step = transform(T_a_b, transform(T_b_c, points_c))
    np.testing.assert_allclose(transform(T_a_b @ T_b_c, points_c), step_by_step, atol=1e-8)


@given(T_a_b=poses, points_b=clouds)
def test_distances_survive_a_motion(T_a_b: np.ndarray, points_b: np.ndarray) -> None:
    points_a = transform(T_a_b, points_b)
    np.testing.assert_allclose(
        np.linalg.norm(points_a - points_a[0], axis=1),
        np.linalg.norm(points_b - points_b[0], axis=1),
        atol=1e-7,
    )


@given(T_a_b=poses)
def test_every_pose_built_from_angles_is_rigid(T_a_b: np.ndarray) -> None:
    assert is_rigid(T_a_b)
    assert is_rigid(invert(T_a_b))
