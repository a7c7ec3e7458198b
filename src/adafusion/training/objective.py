# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a described batch costs: every loss by its name, on the whole descriptor and its halves."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from adafusion.losses import (
    active_share,
    batch_hard_triplet,
    contrastive_softmax,
    cosine_similarity,
    hard_quadruplet,
    l2_distances,
    lazy_quadruplet,
    lazy_triplet,
    pair_distance,
    pair_margin,
    ranking_triplet,
    squared_l2,
)
from adafusion.training.pairs import Batch, Tuples
from adafusion.training.settings import TUPLE_LOSSES, Loss
from adafusion.types import Description


def batch_loss(
    description: Description, batch: Batch, loss: Loss
) -> tuple[Float[Tensor, ""], float]:
    """Loss of a described batch, and the share of its pairs that have not met the fused margin.

    For losses without a pair margin, the share of triplets that are violated.
    """
    assert description.fused is not None
    image, lidar = description.image_half, description.lidar_half
    parts: list[tuple[Tensor, float]] = []
    if image is not None and lidar is not None:
        parts = list(zip((image, lidar), loss.half_weights, strict=True))
    total, active = term_of(description.fused, batch, loss)
    for half, weight in parts:
        if weight:
            total = total + weight * term_of(half, batch, loss)[0]
    return total, active


@torch.no_grad()
def most_active(description: Description, batch: Batch, loss: Loss) -> float:
    """Share that still pulls or pushes, of the descriptor or the half where it is largest."""
    heads = (description.fused, description.image_half, description.lidar_half)
    return max(term_of(head, batch, loss)[1] for head in heads if head is not None)


def term_of(
    descriptors: Float[Tensor, "b d"], batch: Batch, loss: Loss
) -> tuple[Float[Tensor, ""], float]:
    """The loss of one descriptor of each frame, and the share that still pulls or pushes."""
    if loss.kind in TUPLE_LOSSES:
        if batch.tuples is None:
            raise ValueError(f"loss {loss.kind} needs tuples: sampling.mode=tuples")
        return _tuple_term(descriptors, batch.tuples, loss)
    pair = torch.from_numpy(batch.pair).to(descriptors.device)
    is_positive = torch.from_numpy(batch.is_positive).to(descriptors.device)
    if loss.kind == "batch-hard":
        masks = _masks(len(descriptors), pair, is_positive)
        return batch_hard_triplet(l2_distances(descriptors), *masks, loss.margin)
    if loss.kind == "contrastive":
        distance = squared_l2(descriptors[pair[:, 0]], descriptors[pair[:, 1]]).clamp(min=1e-12)
        return (
            pair_margin(distance.sqrt(), is_positive, loss.margin, loss.slack),
            active_share(distance.detach().sqrt(), is_positive, loss.margin, loss.slack),
        )
    margin, slack = loss.margins(descriptors.shape[1])
    distance = pair_distance(descriptors, pair)
    active = active_share(distance.detach(), is_positive, margin, slack)
    if loss.kind == "margin":
        return pair_margin(distance, is_positive, margin, slack), active
    return _softmax_term(descriptors, pair, is_positive, loss, margin), active


def _tuple_term(
    descriptors: Float[Tensor, "b d"], tuples: Tuples, loss: Loss
) -> tuple[Float[Tensor, ""], float]:
    query, positive, negative, other = (
        descriptors[torch.from_numpy(rows).to(descriptors.device)]
        for rows in (tuples.query, tuples.positive, tuples.negative, tuples.other)
    )
    to_positive = squared_l2(query[:, None], positive)
    to_negative = squared_l2(query[:, None], negative)
    other_to_negative = squared_l2(other[:, None], negative)
    if loss.kind == "hard-quadruplet":  # plain distances: the root of zero has no slope
        to_positive, to_negative, other_to_negative = (
            d.clamp(min=1e-12).sqrt() for d in (to_positive, to_negative, other_to_negative)
        )
    with torch.no_grad():
        near = to_positive.amin(dim=1, keepdim=True)
        active = float((to_negative < near + loss.margin).float().mean())
    if loss.kind == "triplet":
        return ranking_triplet(to_positive, to_negative, loss.margin), active
    if loss.kind == "lazy-triplet":
        return lazy_triplet(to_positive, to_negative, loss.margin), active
    quadruplet = hard_quadruplet if loss.kind == "hard-quadruplet" else lazy_quadruplet
    margins = (loss.margin, loss.other_margin)
    return quadruplet(to_positive, to_negative, other_to_negative, *margins), active


def _masks(
    n: int, pair: Int[Tensor, "m 2"], is_positive: Bool[Tensor, " m"]
) -> tuple[Bool[Tensor, "n n"], Bool[Tensor, "n n"]]:
    """Who is a true and who is a wrong match of whom in the batch."""
    positive, negative = (torch.zeros(n, n, dtype=torch.bool, device=pair.device) for _ in range(2))
    for mask, chosen in ((positive, is_positive), (negative, ~is_positive)):
        a, b = pair[chosen].T
        mask[a, b] = mask[b, a] = True
    return positive, negative


def _softmax_term(
    descriptors: Float[Tensor, "b d"],
    pair: Int[Tensor, "m 2"],
    is_positive: Bool[Tensor, " m"],
    loss: Loss,
    margin: float,
) -> Float[Tensor, ""]:
    if loss.similarity == "cosine":
        similarity = cosine_similarity(descriptors) / loss.temperature
    else:
        distance = (descriptors[:, None] - descriptors[None]).abs().sum(dim=2)
        similarity = -distance / (loss.temperature * margin)
    return contrastive_softmax(similarity, *_masks(len(descriptors), pair, is_positive))
