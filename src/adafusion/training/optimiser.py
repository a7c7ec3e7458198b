# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What moves the weights, and at which rate."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch

from adafusion.models import (
    PlaceModel,
)
from adafusion.training.settings import Optimiser, TrainConfig


def build_optimizer(settings: Optimiser, model: PlaceModel) -> torch.optim.Optimizer:
    """What moves the parameters that may move; image network and weight branch at their rates."""
    image, rest, weights = [], [], []  # an optimiser's state is kept in this order
    for name, p in model.named_parameters():
        if not p.requires_grad:
            continue
        if settings.image_share != 1.0 and name.startswith("image_net."):
            image.append(p)
        elif settings.weights_share != 1.0 and name.startswith("weight_net."):
            weights.append(p)
        else:
            rest.append(p)
    rate = settings.learning_rate
    groups: list[dict[str, Any]] = [
        {"params": image, "lr": settings.image_share * rate},
        {"params": rest, "lr": rate},
        {"params": weights, "lr": settings.weights_share * rate},
    ]
    groups = [group for group in groups if group["params"]]
    decay = settings.weight_decay
    if settings.kind == "sgd":
        return torch.optim.SGD(groups, momentum=settings.momentum, weight_decay=decay)
    return torch.optim.Adam(groups, weight_decay=decay, amsgrad=settings.amsgrad)


def build_scheduler(
    config: TrainConfig,
    optimizer: torch.optim.Optimizer,
    progress: Callable[[], tuple[int, int]],
) -> Any:
    """What lets the rate fall; `progress` says how much of the training is behind, and of what."""
    o = config.optimiser
    if o.schedule == "plateau":
        return torch.optim.lr_scheduler.ReduceLROnPlateau(
            optimizer, mode="max", factor=o.factor, patience=o.patience
        )

    def share(batch: int) -> float:
        gone, length = progress()
        if o.schedule == "step":
            falls = sum(gone >= at * length for at in o.milestones)
            return max(o.floor, o.factor ** (falls if o.milestones else gone * o.steps // length))
        rise = min(1.0, (batch + 1) / max(1, o.warmup))
        return rise * 0.5 * (1.0 + math.cos(math.pi * min(1.0, gone / length)))

    return torch.optim.lr_scheduler.LambdaLR(optimizer, share)
