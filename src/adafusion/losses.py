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


def l2_distances(descriptors: Float[Tensor, "b d"]) -> Float[Tensor, "b b"]:
    """L2 distance of every pair of rows, with a gradient of zero where two rows are equal."""
    squared = squared_l2(descriptors[:, None], descriptors[None])
    return torch.where(squared > 0, squared, 1.0).sqrt() * (squared > 0)


def squared_l2(a: Float[Tensor, "*a d"], b: Float[Tensor, "*b d"]) -> Float[Tensor, ...]:
    """Squared L2 distance along the last axis; the others are broadcast."""
    return (a - b).square().sum(dim=-1)


def batch_hard_triplet(
    distance: Float[Tensor, "b b"],
    is_positive: Bool[Tensor, "b b"],
    is_negative: Bool[Tensor, "b b"],
    margin: float = 0.2,
) -> tuple[Float[Tensor, ""], float]:
    """MinkLoc++'s loss: each frame's farthest true match against its nearest wrong one.

    The wrong match may be as near to the true match as to the frame itself (anchor and positive
    swapped). Averaged over the triplets that are not met yet; also gives their share.
    """
    usable = is_positive.any(dim=1) & is_negative.any(dim=1)
    if not bool(usable.any()):
        return distance.sum() * 0.0, 0.0
    d, pos, neg = distance[usable], is_positive[usable], is_negative[usable]
    far, positive = d.masked_fill(~pos, float("-inf")).max(dim=1)
    near, negative = d.masked_fill(~neg, float("inf")).min(dim=1)
    near = torch.minimum(near, distance[positive, negative])
    violation = F.relu(far - near + margin)
    active = violation > 0
    return violation.sum() / active.sum().clamp(min=1), float(active.float().mean())


def lazy_triplet(
    to_positive: Float[Tensor, "t p"], to_negative: Float[Tensor, "t n"], margin: float = 0.5
) -> Float[Tensor, ""]:
    """PointNetVLAD's lazy triplet: the nearest true match against the most violating wrong one.

    Squared L2 distances of each query to its true and its wrong matches.
    """
    violation = F.relu(margin + to_positive.amin(dim=1, keepdim=True) - to_negative)
    return violation.amax(dim=1).mean()


def lazy_quadruplet(
    to_positive: Float[Tensor, "t p"],
    to_negative: Float[Tensor, "t n"],
    other_to_negative: Float[Tensor, "t n"],
    margin: float = 0.5,
    other_margin: float = 0.2,
) -> Float[Tensor, ""]:
    """PointNetVLAD's loss: its lazy triplet, and the same against one frame far from all others."""
    near = to_positive.amin(dim=1, keepdim=True)
    other = F.relu(other_margin + near - other_to_negative).amax(dim=1).mean()
    return lazy_triplet(to_positive, to_negative, margin) + other


def hard_quadruplet(
    to_positive: Float[Tensor, "t p"],
    to_negative: Float[Tensor, "t n"],
    other_to_negative: Float[Tensor, "t n"],
    margin: float = 0.5,
    other_margin: float = 0.2,
) -> Float[Tensor, ""]:
    """CORAL's loss: the farthest true match against the nearest wrong one; plain L2 distances."""
    far = to_positive.amax(dim=1)
    first = F.relu(margin + far - to_negative.amin(dim=1))
    return (first + F.relu(other_margin + far - other_to_negative.amin(dim=1))).mean()


def ranking_triplet(
    to_positive: Float[Tensor, "t p"], to_negative: Float[Tensor, "t n"], margin: float = 0.1
) -> Float[Tensor, ""]:
    """NetVLAD's loss: the nearest true match against every wrong one, averaged over these.

    Squared L2 distances.
    """
    return F.relu(margin + to_positive.amin(dim=1, keepdim=True) - to_negative).mean()
