# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import pytest
import torch

from adafusion.losses import (
    active_share,
    contrastive_softmax,
    cosine_similarity,
    pair_distance,
    pair_margin,
)


def test_distance_is_l1_with_the_papers_epsilon() -> None:
    descriptors = torch.tensor([[0.0, 0.0], [3.0, -4.0]])
    assert pair_distance(descriptors, torch.tensor([[0, 1]])).item() == pytest.approx(7.0, abs=1e-5)


def test_pair_margin_adds_the_mean_of_true_and_the_mean_of_wrong_pairs() -> None:
    distance = torch.tensor([30.0, 20.0, 20.0, 40.0])
    is_positive = torch.tensor([True, True, False, False])
    # true: max(0, 30 - 24) and 0; wrong: max(0, 26 - 20) and 0
    assert pair_margin(distance, is_positive).item() == pytest.approx(6 / 2 + 6 / 2)


def test_pair_margin_of_one_kind_alone_is_that_kinds_mean() -> None:
    assert pair_margin(torch.tensor([30.0]), torch.tensor([True])).item() == pytest.approx(6.0)
    assert pair_margin(torch.tensor([20.0]), torch.tensor([False])).item() == pytest.approx(6.0)


def test_met_pairs_are_not_active() -> None:
    distance = torch.tensor([30.0, 20.0, 20.0, 40.0])
    assert active_share(distance, torch.tensor([True, True, False, False])) == 0.5


def test_contrastive_softmax_equals_its_formula_by_hand() -> None:
    similarity = torch.tensor([[9.0, 2.0, 1.0], [2.0, 9.0, 0.0], [1.0, 0.0, 9.0]])
    positive = torch.tensor([[0, 1, 0], [1, 0, 0], [0, 0, 0]], dtype=torch.bool)
    negative = torch.tensor([[0, 0, 1], [0, 0, 1], [1, 1, 0]], dtype=torch.bool)
    rows = [math.exp(2) / (math.exp(2) + math.exp(1)), math.exp(2) / (math.exp(2) + 1)]
    expected = -sum(map(math.log, rows)) / 2  # the third frame has no true match
    assert contrastive_softmax(similarity, positive, negative).item() == pytest.approx(expected)


def test_a_batch_without_true_pairs_gives_zero_and_a_gradient() -> None:
    descriptors = torch.randn(3, 4, requires_grad=True)
    none = torch.zeros(3, 3, dtype=torch.bool)
    wrong = ~torch.eye(3, dtype=torch.bool)
    loss = contrastive_softmax(cosine_similarity(descriptors), none, wrong)
    loss.backward()
    assert loss.item() == 0.0
    assert descriptors.grad is not None


def test_cosine_similarity_ignores_length() -> None:
    similarity = cosine_similarity(torch.tensor([[2.0, 0.0], [1.0, 1.0]]))
    assert similarity[0, 1].item() == pytest.approx(math.sqrt(0.5))
