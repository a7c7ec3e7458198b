# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The number that a training chooses its checkpoint by."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from adafusion.evaluation.evaluate import evaluate_splits
from adafusion.evaluation.protocols import make_splits
from adafusion.models import PlaceModel, describe, prepared_batches
from adafusion.preprocess.cache import PreparedSet
from adafusion.types import Descriptions

DescribeRows = Callable[[PlaceModel, Int[np.ndarray, " n"]], Descriptions]


def validation_recall(
    data: PreparedSet, rows: Int[np.ndarray, " n"], describe_rows: DescribeRows | None = None
) -> Callable[[PlaceModel], dict[str, float]]:
    """Make the function that judges a model on `rows` of the data: {"recall@1": 0.8, ...}.

    Recall is that of protocol cross-run in each world, averaged over the worlds. Beside the fused
    descriptor's it gives that of each unweighted half ("image_recall@1") and the mean and spread of
    the weights ("alpha_image_mean"), where the model has them. `describe_rows` describes rows of
    the data by another way than through the whole model.
    """
    recall = region_recall(data, rows)

    def validate(model: PlaceModel) -> dict[str, float]:
        if describe_rows is None:
            d = describe(model, prepared_batches(data, rows, batch_size=32))
        else:
            d = describe_rows(model, rows)
        assert d.fused is not None
        values = {"recall@1": recall(d.fused, model.config.p)}
        if d.image_half is not None and d.lidar_half is not None:
            values["image_recall@1"] = recall(d.image_half, model.config.p)
            values["lidar_recall@1"] = recall(d.lidar_half, model.config.p)
        if d.alpha is not None:
            for i, sensor in enumerate(("image", "lidar")):
                values[f"alpha_{sensor}_mean"] = float(d.alpha[:, i].mean())
                values[f"alpha_{sensor}_std"] = float(d.alpha[:, i].std())
        return values

    return validate


def region_recall(
    data: PreparedSet, rows: Int[np.ndarray, " n"]
) -> Callable[[Float[np.ndarray, "n d"], int], float]:
    """Make the function that gives recall@1 of those rows' descriptors under the distance p.

    Protocol cross-run in each world, averaged over the worlds.
    """
    frames = [data.frames[row] for row in rows]
    positions = data.positions[rows]
    worlds = data.worlds[rows]
    splits_of = {}
    for world in np.unique(worlds):
        here = np.flatnonzero(worlds == world)
        region = np.full(len(here), "validation")
        splits_of[int(world)] = (
            here,
            make_splits("cross-run", [frames[i] for i in here], region, region="validation"),
        )

    def recall(descriptors: Float[np.ndarray, "n d"], p: int) -> float:
        values = [
            evaluate_splits(descriptors[here], positions[here], splits, ks=[1], p=p).recall["AR@1"]
            for here, splits in splits_of.values()
        ]
        return float(np.mean(values))

    return recall
