# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Brown's lens by hand, and there and back."""

from __future__ import annotations

import pytest

from adafusion.sim.sensing.projection import Brown, distorted, undistorted

BROWN: Brown = (-0.25, 0.07, 0.002, -0.001, 0.01)


def test_it_leaves_rays_alone_without_distortion() -> None:
    nothing: Brown = (0.0, 0.0, 0.0, 0.0, 0.0)
    assert distorted(0.5, -0.3, nothing) == undistorted(0.5, -0.3, nothing) == (0.5, -0.3)


@pytest.mark.parametrize(
    ("term", "bent"),
    [
        (0, (0.5 * 1.025, 0.0)),  # k1 r^2
        (1, (0.5 * 1.00625, 0.0)),  # k2 r^4
        (4, (0.5 * 1.0015625, 0.0)),  # k3 r^6
        (2, (0.5, 0.025)),  # p1 r^2, across
        (3, (0.5 + 0.075, 0.0)),  # p2 (r^2 + 2 u^2), along
    ],
)
def test_each_term_bends_a_ray_as_brown_has_it(term: int, bent: tuple[float, float]) -> None:
    k1, k2, p1, p2, k3 = (0.1 if k == term else 0.0 for k in range(5))
    assert distorted(0.5, 0.0, (k1, k2, p1, p2, k3)) == pytest.approx(bent)


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.5, -0.3), (-0.6, 0.45)])
def test_a_ray_comes_back_to_where_it_was_bent_to(x: float, y: float) -> None:
    assert distorted(*undistorted(x, y, BROWN), BROWN) == pytest.approx((x, y), abs=1e-6)
