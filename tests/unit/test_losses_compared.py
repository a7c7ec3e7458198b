# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The compared systems' losses, each against its formula written as a plain loop."""

from __future__ import annotations

import pytest
import torch

from adafusion.losses import (
    batch_hard_triplet,
    hard_quadruplet,
    l2_distances,
    lazy_quadruplet,
    lazy_triplet,
    ranking_triplet,
)

POSITIVE = torch.tensor([[0.30, 0.10], [0.50, 0.40]])  # two queries, two true matches each
NEGATIVE = torch.tensor([[0.90, 0.20, 0.70], [0.95, 2.00, 1.20]])  # three wrong ones
OTHER = torch.tensor([[0.50, 0.25, 0.90], [3.00, 0.45, 1.00]])  # from the frame far from all


def test_the_lazy_triplet_takes_the_nearest_true_and_the_worst_wrong_match() -> None:
    # 0.5 + 0.1 - 0.2 = 0.4; 0.5 + 0.4 - 0.95 < 0
    assert lazy_triplet(POSITIVE, NEGATIVE).item() == pytest.approx(0.4 / 2)


def test_the_lazy_quadruplet_adds_the_same_against_the_other_frame() -> None:
    # 0.2 + 0.1 - 0.25 = 0.05; 0.2 + 0.4 - 0.45 = 0.15
    expected = 0.4 / 2 + (0.05 + 0.15) / 2
    assert lazy_quadruplet(POSITIVE, NEGATIVE, OTHER).item() == pytest.approx(expected)


def test_the_hard_quadruplet_takes_the_farthest_true_match() -> None:
    # 0.5 + 0.3 - 0.2 = 0.6 and 0.2 + 0.3 - 0.25 = 0.25; 0.5 + 0.5 - 0.95 and 0.2 + 0.5 - 0.45
    expected = (0.6 + 0.25 + 0.05 + 0.25) / 2
    assert hard_quadruplet(POSITIVE, NEGATIVE, OTHER).item() == pytest.approx(expected)


def test_the_ranking_triplet_averages_over_all_wrong_matches() -> None:
    # only 0.1 + 0.1 - 0.2 touches the margin, at zero: nothing is violated
    assert ranking_triplet(POSITIVE, NEGATIVE).item() == pytest.approx(0.0, abs=1e-6)
    # with 0.5: 0.4 of one of the six
    assert ranking_triplet(POSITIVE, NEGATIVE, 0.5).item() == pytest.approx(0.4 / 6)


def test_batch_hard_equals_a_plain_loop() -> None:
    torch.manual_seed(0)
    d = torch.randn(12, 5)
    place = torch.arange(12) // 3
    positive = (place[:, None] == place) & ~torch.eye(12, dtype=torch.bool)
    negative = (place[:, None] - place).abs() > 1
    loss, share = batch_hard_triplet(l2_distances(d), positive, negative, margin=2.0)

    terms = []
    for a in range(12):
        p = max((j for j in range(12) if positive[a, j]), key=lambda j: float((d[a] - d[j]).norm()))
        n = min((j for j in range(12) if negative[a, j]), key=lambda j: float((d[a] - d[j]).norm()))
        near = min((d[a] - d[n]).norm(), (d[p] - d[n]).norm())
        terms.append(((d[a] - d[p]).norm() - near + 2.0).clamp(min=0))
    violated = [t for t in terms if t > 0]
    assert loss.item() == pytest.approx(float(sum(violated) / len(violated)), abs=1e-5)
    assert share == pytest.approx(len(violated) / 12)


def test_batch_hard_of_a_batch_without_matches_is_zero_and_has_a_gradient() -> None:
    d = torch.ones(3, 2, requires_grad=True)
    none = torch.zeros(3, 3, dtype=torch.bool)
    loss, share = batch_hard_triplet(l2_distances(d), none, none)
    loss.backward()
    assert loss.item() == share == 0.0
    assert torch.isfinite(d.grad).all()


def test_distances_of_equal_rows_are_zero_with_a_finite_gradient() -> None:
    d = torch.tensor([[3.0, 4.0], [0.0, 0.0], [0.0, 0.0]], requires_grad=True)
    distance = l2_distances(d)
    assert distance[0, 1].item() == pytest.approx(5.0)
    assert distance[1, 2].item() == 0.0
    distance.sum().backward()
    assert torch.isfinite(d.grad).all()
