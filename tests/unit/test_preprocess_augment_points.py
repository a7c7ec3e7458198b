# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Point sets change as MinkLoc++'s training changes them, and alike from the same state."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from adafusion.preprocess import augment
from adafusion.preprocess.augment import augment_points


def seeded(seed: int = 1) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def sets(b: int = 64, n: int = 400) -> Tensor:
    return torch.rand(b, n, 3, generator=seeded(0)) * 2 - 1


def only(monkeypatch: pytest.MonkeyPatch, *kept: str) -> None:
    """Switch off every change but those whose constants are named."""
    off: dict[str, object] = {
        "SET_JITTER": 0.0,
        "SET_DROPPED": 0.0,
        "SET_SHIFT": 0.0,
        "ERASE_CHANCE": 0.0,
        "YAW_RAD": 0.0,
        "FLIP_X": 0.0,
        "FLIP_Y": 0.0,
    }
    for name, value in off.items():
        if name not in kept:
            monkeypatch.setattr(augment, name, value)


def test_it_is_alike_from_the_same_state_and_the_sets_stay() -> None:
    points = sets()
    before = points.clone()
    first = augment_points(points, seeded())
    assert torch.equal(first, augment_points(points, seeded()))
    assert torch.equal(points, before)
    assert not torch.equal(first, augment_points(points, seeded(2)))
    assert first.shape == points.shape
    assert first.dtype == points.dtype


def test_with_all_switched_off_nothing_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    only(monkeypatch)
    assert torch.equal(augment_points(sets(), seeded()), sets())


def test_a_point_is_jittered_within_its_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    only(monkeypatch, "SET_JITTER")
    moved = augment_points(sets(), seeded()) - sets()
    assert float(moved.abs().max()) == pytest.approx(0.002, abs=1e-6)
    # a normal distribution cut at two deviations: 0.001 times the root of 0.9205
    assert float(moved.std()) == pytest.approx(0.000959, rel=0.02)


def test_a_set_is_shifted_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    only(monkeypatch, "SET_SHIFT")
    moved = augment_points(sets(b=2000, n=3), seeded()) - sets(b=2000, n=3)
    assert torch.allclose(moved, moved[:, :1], atol=1e-6)
    assert float(moved[:, 0].std()) == pytest.approx(0.01, rel=0.05)
    assert abs(float(moved[:, 0].mean())) < 0.001


def test_up_to_a_tenth_of_the_points_goes_to_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    only(monkeypatch, "SET_DROPPED")
    points = sets(b=400)
    changed = augment_points(points, seeded())
    gone = (changed == 0).all(dim=2)
    share = gone.float().mean(dim=1)
    assert torch.equal(changed[~gone], points[~gone])
    assert float(share.max()) <= 0.1
    assert float(share.mean()) == pytest.approx(0.05, abs=0.005)
    spread = gone.float().mean(dim=0)  # which of a set's points go is chance
    assert float(spread.max()) < 0.1


def test_two_sets_of_five_lose_an_upright_box(monkeypatch: pytest.MonkeyPatch) -> None:
    only(monkeypatch, "ERASE_CHANCE")
    points = sets(b=2000, n=300)
    changed = augment_points(points, seeded())
    gone = (changed == 0).all(dim=2)
    assert torch.equal(changed[~gone], points[~gone])
    assert float(gone.any(dim=1).float().mean()) == pytest.approx(0.4, abs=0.03)
    # the box's share of the set's extent, from 2 to 33 in 100, less what reaches out at the sides
    share = gone.float().mean(dim=1)[gone.any(dim=1)]
    assert float(share.max()) < 0.42
    assert float(share.mean()) == pytest.approx(0.175, abs=0.015)
    for i in gone.any(dim=1).nonzero().flatten()[:50].tolist():
        box = points[i, gone[i], :2]
        xy = points[i, ~gone[i], :2]
        within = ((xy > box.amin(dim=0)) & (xy < box.amax(dim=0))).all(dim=1)
        assert not within.any()


def test_the_batch_is_turned_about_z_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    only(monkeypatch, "YAW_RAD")
    yaws = []
    for seed in range(200):
        points = torch.tensor([[[1.0, 0.0, 0.3]], [[0.0, 2.0, -0.1]]])
        (x, y, z), (x2, y2, z2) = augment_points(points, seeded(seed))[:, 0].tolist()
        yaw = math.atan2(y, x)
        assert math.hypot(x, y) == pytest.approx(1.0)
        assert (x2, y2) == pytest.approx((-2 * math.sin(yaw), 2 * math.cos(yaw)), abs=1e-6)
        assert (z, z2) == pytest.approx((0.3, -0.1))
        yaws.append(math.degrees(yaw))
    assert -5 <= min(yaws) < -4.8
    assert 4.8 < max(yaws) <= 5


def test_a_batch_in_four_is_flipped_along_x_and_one_along_y(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    only(monkeypatch, "FLIP_X", "FLIP_Y")
    point = torch.ones(1, 1, 3)
    seen = [tuple(augment_points(point, seeded(seed)).flatten().tolist()) for seed in range(400)]
    assert set(seen) == {(1.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (1.0, -1.0, 1.0)}
    assert seen.count((-1.0, 1.0, 1.0)) == pytest.approx(100, abs=30)
    assert seen.count((1.0, -1.0, 1.0)) == pytest.approx(100, abs=30)


def test_a_set_without_any_extent_goes_through() -> None:
    assert torch.isfinite(augment_points(torch.zeros(4, 5, 3), seeded())).all()
