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
    """L1 distance of each pair of rows, 1e-6 added to each difference as the released code does."""
    a, b = descriptors[pair[:, 0]], descriptors[pair[:, 1]]
    return (a - b + 1e-6).abs().sum(dim=1)


def pair_margin(
    distance: Float[Tensor, " m"],
    is_positive: Bool[Tensor, " m"],
    margin: float = 25.0,
    slack: float = 1.0,
) -> Float[Tensor, ""]:
    """Pair margin loss of the paper: true pairs below margin - slack, wrong ones above the sum.

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
    similarity: Float[Tensor, "b b"],
    is_positive: Bool[Tensor, "b b"],
    is_negative: Bool[Tensor, "b b"],
) -> Float[Tensor, ""]:
    """Softmax of each true match against all wrong ones in the batch, averaged over frames.

    The easier loss to begin with: unlike a margin it never stops pushing and asks for no scale.
    `similarity` is already divided by its temperature. The diagonal of both masks must be False;
    frames without a true match in the batch are left out.
    """
    wrong = similarity.masked_fill(~is_negative, float("-inf")).logsumexp(dim=1, keepdim=True)
    log_ratio = similarity - torch.logaddexp(similarity, wrong)
    count = is_positive.sum(dim=1)
    loss = -log_ratio.masked_fill(~is_positive, 0.0).sum(dim=1) / count.clamp(min=1)
    return loss[count > 0].mean() if bool((count > 0).any()) else similarity.sum() * 0.0


def cosine_similarity(descriptors: Float[Tensor, "b d"]) -> Float[Tensor, "b b"]:
    """Cosine of every pair of rows."""
    unit = F.normalize(descriptors, dim=1)
    return unit @ unit.T
