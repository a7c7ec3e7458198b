# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Losses as functions of arrays: no model, loader or configuration comes near them."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor


def pair_distance(
    descriptors: Float[Tensor, "b d"], pair: Int[Tensor, "m 2"]
) -> Float[Tensor, " m"]:
    """L1 distance of each pair of rows, with 1e-6 added to every difference as the paper's code has."""
    a, b = descriptors[pair[:, 0]], descriptors[pair[:, 1]]
    return (a - b + 1e-6).abs().sum(dim=1)


def pair_margin(
    distance: Float[Tensor, " m"],
    is_positive: Bool[Tensor, " m"],
    margin: float = 25.0,
    slack: float = 1.0,
) -> Float[Tensor, ""]:
    """Pair margin loss (paper Eq. 8): true pairs below margin - slack, wrong ones above margin + slack.

    The mean over true pairs plus the mean over wrong pairs; with one of each an item, that is the
    paper's mean over items of positive + negative term. A kind that is absent adds nothing.
    """
    near = F.relu(distance[is_positive] - (margin - slack))
    far = F.relu((margin + slack) - distance[~is_positive])
    zero = distance.sum() * 0.0
    return (near.mean() if len(near) else zero) + (far.mean() if len(far) else zero)


def active_share(
    distance: Float[Tensor, " m"],
    is_positive: Bool[Tensor, " m"],
    margin: float = 25.0,
    slack: float = 1.0,
) -> float:
    """Share of pairs that still pull or push: the rest have met the margin and teach nothing."""
    active = torch.where(is_positive, distance > margin - slack, distance < margin + slack)
    return float(active.float().mean())


def contrastive_softmax(
    descriptors: Float[Tensor, "b d"],
    is_positive: Bool[Tensor, "b b"],
    is_negative: Bool[Tensor, "b b"],
    temperature: float = 0.1,
) -> Float[Tensor, ""]:
    """Softmax over cosine similarities: each true match against all wrong ones in the batch.

    The easier loss to begin with: unlike a margin it never stops pushing, and it does not ask for a
    scale. Diagonal entries of both masks must be False; frames without a positive are left out.
    """
    unit = F.normalize(descriptors, dim=1)
    similarity = unit @ unit.T / temperature
    wrong = similarity.masked_fill(~is_negative, float("-inf")).logsumexp(dim=1, keepdim=True)
    log_ratio = similarity - torch.logaddexp(similarity, wrong)
    count = is_positive.sum(dim=1)
    loss = -(log_ratio.masked_fill(~is_positive, 0.0).sum(dim=1) / count.clamp(min=1))
    return loss[count > 0].mean() if bool((count > 0).any()) else descriptors.sum() * 0.0
