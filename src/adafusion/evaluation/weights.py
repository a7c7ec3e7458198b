# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""How far a model trusts each sensor, and how far each sensor decided an answer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Float64

from adafusion.types import AlphaSummary


def summarize_alpha(
    alpha: Float[np.ndarray, "n 2"], labels: Sequence[str | None] | None = None
) -> dict[str, AlphaSummary]:
    """Summarise the weights of the frames of each label; frames labelled None are left out.

    Label by run, or by zone (`Frame.zone`). Without labels all frames go under "all". Labels are in
    the order of their names.
    """
    if labels is None:
        labels = ["all"] * len(alpha)
    if len(labels) != len(alpha):
        raise ValueError(f"{len(labels)} labels for {len(alpha)} frames")
    label_of = np.array(labels, dtype=object)
    names = sorted({label for label in labels if label is not None})
    return {name: _summary(alpha, label_of == name) for name in names}


def _summary(alpha: Float[np.ndarray, "n 2"], chosen: Bool[np.ndarray, " n"]) -> AlphaSummary:
    rows = alpha[chosen].astype(np.float64)
    image, lidar = rows.mean(axis=0).tolist()
    image_std, lidar_std = rows.std(axis=0).tolist()
    return AlphaSummary(len(rows), (image, lidar), (image_std, lidar_std))


def contribution_shares(
    query: Float[np.ndarray, "q d"], match: Float[np.ndarray, "q d"]
) -> Float64[np.ndarray, "q 2"]:
    """Share of each sensor in the L1 distance between fused descriptors, (image, LiDAR), sum 1.

    The fused descriptor is [alpha_I f_I; alpha_L f_L], so its L1 distance is the sum over both
    sensors S of |alpha_S f_S - alpha'_S f'_S|_1, each half under its own frame's weight. Rows of
    distance 0 have no shares: NaN.
    """
    if query.shape[1] % 2:
        raise ValueError(f"a fused descriptor has two halves, not {query.shape[1]} numbers")
    difference = np.abs(query.astype(np.float64) - match)
    halves = difference.reshape(len(query), 2, -1).sum(axis=2)
    total = halves.sum(axis=1, keepdims=True)
    return np.divide(halves, total, out=np.full_like(halves, np.nan), where=total > 0)
