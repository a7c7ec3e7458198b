# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a model's weights are, what they work on, how they are taught, and what fixed ones find."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from adafusion.evaluation import answer_groups, contribution_shares, evaluate_splits
from adafusion.experiments.studies.described import at_weights
from adafusion.models import ModelConfig, PlaceModel
from adafusion.preprocess.cache import PreparedSet
from adafusion.search import pairwise_distances
from adafusion.training import TrainConfig
from adafusion.training.objective import batch_loss
from adafusion.training.sampler import Sampler
from adafusion.types import Descriptions, Split, UserError

SATURATED = 0.05  # this near to 0 or 1 a sigmoid hardly moves any more
GRADIENT_BATCHES, GRADIENT_SEED = 4, 0
NETS = {"image": "image_net", "lidar": "voxel_net", "weights": "weight_net"}

# where the frames of one test dataset were taken, in metres, and who asks whom
World = tuple[Float[np.ndarray, "n xy_or_xyz"], Sequence[Split]]


def look(described: Sequence[Descriptions], worlds: Sequence[World], p: int = 1) -> dict[str, Any]:
    """What one model's weights are and what they work on, over all frames of the test data.

    Pairs of numbers are (image, LiDAR); `alpha` is None where the model has none. The image's share
    of the L1 distance is the mean over answerable queries, to the nearest true and wrong match by
    the distance of `p`.
    """
    share: dict[str, list[Float[np.ndarray, " q"]]] = {"true": [], "wrong": []}
    for one, (positions, splits) in zip(described, worlds, strict=True):
        assert one.fused is not None  # every test frame has both sensors
        for split in splits:
            rows = nearest_matches(one.fused, positions, split, p)
            for kind, match in zip(share, rows[1:], strict=True):
                shares = contribution_shares(one.fused[rows[0]], one.fused[match])
                share[kind].append(shares[:, 0])
    alpha = _alpha(described)
    return {
        "alpha": None if alpha is None else spread(alpha),
        "length": lengths(described),
        "image_share": {kind: _mean(np.concatenate(parts)) for kind, parts in share.items()},
    }


def spread(alpha: Float[np.ndarray, "n 2"]) -> dict[str, list[float]]:
    """Mean and standard deviation over frames, and the share of frames that is saturated."""
    saturated = (alpha < SATURATED) | (alpha > 1.0 - SATURATED)
    return {
        "mean": alpha.mean(axis=0, dtype=np.float64).tolist(),
        "std": alpha.std(axis=0, dtype=np.float64).tolist(),
        "saturated": saturated.mean(axis=0).tolist(),
    }


def lengths(described: Sequence[Descriptions]) -> dict[str, list[float]]:
    """Mean L1 length of both halves, before and after the weights."""
    parts = [(_halves(one), one.alpha) for one in described]
    long = np.concatenate([np.abs(halves).sum(axis=2, dtype=np.float64) for halves, _ in parts])
    weight = np.concatenate(
        [np.ones(halves.shape[:2]) if alpha is None else alpha for halves, alpha in parts]
    )
    return {"unweighed": long.mean(axis=0).tolist(), "weighed": (weight * long).mean(0).tolist()}


def nearest_matches(
    fused: Float[np.ndarray, "n d"],
    positions: Float[np.ndarray, "n xy_or_xyz"],
    split: Split,
    p: int = 1,
) -> Int64[np.ndarray, "3 q"]:
    """Rows of each query, of its nearest true match and of its nearest wrong one.

    By L1, or L2 where p is 2. Queries that lack one of the two are left out.
    """
    query, database = split.query_rows.astype(np.int64), split.database_rows.astype(np.int64)
    groups = answer_groups(split, query)
    gap = positions[query, None, :2] - positions[None, database, :2]
    is_near = np.square(gap).sum(axis=2) <= split.radius_m**2
    distance = pairwise_distances(fused[query], fused[database], p=p)
    distance[groups[0][:, None] == groups[1]] = np.inf  # may not answer
    to_true, to_wrong = (np.where(kind, distance, np.inf) for kind in (is_near, ~is_near))
    found = np.stack([query, database[to_true.argmin(axis=1)], database[to_wrong.argmin(axis=1)]])
    has_both = np.isfinite(to_true.min(axis=1)) & np.isfinite(to_wrong.min(axis=1))
    return found[:, has_both]


def under_fixed_weights(
    described: Sequence[Descriptions], worlds: Sequence[World], config: ModelConfig
) -> Int64[np.ndarray, " q"]:
    """Rank of each query's best true match (0: none may answer) if the weights never changed.

    Each sensor's weight is its mean over all frames here, so that the scale which the halves were
    trained to have in the distance stays. In the order of `Questions`.
    """
    alpha = _alpha(described)
    constant = np.ones(2, np.float32) if alpha is None else alpha.mean(axis=0)
    ranks = []
    for one, world in zip(described, worlds, strict=True):
        answered = evaluate_splits(at_weights(one, constant, config), *world, p=config.p)
        ranks += [result.first_hit for result in answered.results]
    return np.concatenate(ranks)


def gradients(
    model: PlaceModel, config: TrainConfig, data: PreparedSet, rows: Int64[np.ndarray, " n"]
) -> dict[str, dict[str, float]]:
    """How the row's own loss pulls at each part of the trained network, on frames it never saw.

    `norm` is the mean L2 norm of a batch's gradient. Adam divides it away; what it cannot make up
    for are batches that pull apart. `agreement` is the norm of the mean gradient over the mean
    norm: 1 where all batches pull alike, about 1 / sqrt(batches) where they pull at random. Empty
    where the rows are of too small a place to make a batch of.
    """
    try:
        sampler = Sampler(config.sampling, data, rows, GRADIENT_SEED)
        batches = list(sampler.batches(0, GRADIENT_BATCHES))
    except UserError:
        return {}
    nets = {part: getattr(model, name, None) for part, name in NETS.items()}
    parts = {part: list(net.parameters()) for part, net in nets.items() if net is not None}
    flat = [p.requires_grad_() for parameters in parts.values() for p in parameters]
    pulls: dict[str, list[Tensor]] = {part: [] for part in parts}
    for batch in batches:
        loss, _ = batch_loss(model(*data.tensors(batch.rows)), batch, config.loss)
        found = iter(torch.autograd.grad(loss, flat))
        for part, parameters in parts.items():
            pulls[part].append(torch.cat([next(found).flatten() for _ in parameters]))
    return {part: _pull(torch.stack(each)) for part, each in pulls.items()}


def _pull(batches: Float[Tensor, "batch parameter"]) -> dict[str, float]:
    norm = float(batches.norm(dim=1).mean())
    agreement = float(batches.mean(dim=0).norm()) / norm if norm else 0.0
    return {"norm": norm, "agreement": agreement}


def _alpha(described: Sequence[Descriptions]) -> Float[np.ndarray, "n 2"] | None:
    """The weights of all frames; None where the model has none."""
    parts = [one.alpha for one in described if one.alpha is not None]
    return np.concatenate(parts) if parts else None


def _halves(one: Descriptions) -> Float[np.ndarray, "n 2 half"]:
    assert one.image_half is not None  # the rows look at both sensors
    assert one.lidar_half is not None
    return np.stack([one.image_half, one.lidar_half], axis=1)


def _mean(shares: Float[np.ndarray, " q"]) -> float | None:
    """The mean over pairs that are any distance apart; None where there is no such pair."""
    apart = shares[np.isfinite(shares)]
    return float(apart.mean()) if len(apart) else None
