# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The network that a training starts from, and as what it leaves."""

from __future__ import annotations

import copy
import logging
from collections.abc import Iterable
from dataclasses import replace

import torch

from adafusion.losses import pair_distance
from adafusion.models import (
    AdaFusion,
    PlaceModel,
    build_system,
    load_model,
)
from adafusion.models.backbones import add_norms, fold_norms
from adafusion.preprocess.cache import PreparedSet
from adafusion.training.inputs import batch_inputs
from adafusion.training.pairs import Batch
from adafusion.training.settings import Augment, Loss, TrainConfig
from adafusion.types import UserError

log = logging.getLogger(__name__)

FUSING = ("weight_net", "linear", "image_add", "voxel_add")  # parts of AdaFusion, not all in each


def build_model(config: TrainConfig) -> PlaceModel:
    """Build the network that a training starts from, as a function of the configuration alone."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        model = build_system(config.model)
    if config.initialisation == "he":
        model.initialise(torch.Generator().manual_seed(config.seed))
    if config.imagenet is not None:
        model.load_imagenet(config.imagenet)
    for file in config.init:
        take_branches(model, load_model(file), with_weights=config.take_weights)
    if config.norms:
        for net in model.backbones:
            add_norms(net)
    if config.stage == "weights" and isinstance(model, AdaFusion):
        model.freeze_backbones()
    return model


def untrained_twin(model: PlaceModel, seed: int = 0) -> PlaceModel:
    """The network that a training of this model would start from: what training has to beat."""
    twin = build_model(TrainConfig(model=model.config, norms=False, seed=seed)).eval()
    twin.name = f"{model.name}, untrained"
    return twin


def take_branches(model: PlaceModel, source: PlaceModel, *, with_weights: bool = False) -> None:
    """Copy the branches that `source` has into `model`; what fuses them only where asked to."""
    for name in ("image_net", "voxel_net", *(FUSING if with_weights else ())):
        ours, theirs = getattr(model, name, None), getattr(source, name, None)
        if ours is None or theirs is None:
            continue
        try:
            ours.load_state_dict(theirs.state_dict())
        except RuntimeError as error:
            raise UserError(
                f"the {name} of {source.name} is of another size than this training's: {error}"
            ) from error


def folded(model: PlaceModel) -> PlaceModel:
    """Copy a network in training as the paper's network that it computes in eval mode."""
    model = copy.deepcopy(model).eval()
    for net in model.backbones:
        fold_norms(net)
    return model


@torch.inference_mode()
def balance_branches(
    model: AdaFusion,
    data: PreparedSet,
    batches: Iterable[Batch],
    loss: Loss,
    *,
    weighted: bool = True,
) -> None:
    """Scale each branch so that the distances of its half lie around the margin.

    A branch trained by a cosine has no scale, and one trained alone has its own; joined as they
    are, the longer half would drown the other and the margin would first have to undo that. The
    middle between true and wrong pairs' mean L1 distance comes to lie at the margin for a half,
    divided by the weight that the model gives the half now (about 0.5 before the weights learn).
    Scaling the last batch norm scales the feature, and with it the deepest stage that the weight
    branch reads, which has not learnt anything yet. Without `weighted` that division is left out,
    and branches come out the same whatever is to fuse them.
    """
    model.eval()
    scaled = copy.copy(model)  # the same layers, whose halves keep the scale that is measured
    scaled.config = replace(model.config, normalise_halves=False)
    described = [
        (scaled(*batch_inputs(model, data, batch, Augment(color=0.0), None, (0, 0))), batch)
        for batch in batches
    ]
    for i, (part, net) in enumerate(
        (("image_half", model.image_net), ("lidar_half", model.voxel_net))
    ):
        if net is None:
            continue
        middles, weights = [], []
        for description, batch in described:
            half = getattr(description, part)
            distance = pair_distance(half, torch.from_numpy(batch.pair).to(half.device))
            is_positive = torch.from_numpy(batch.is_positive).to(half.device)
            middles.append(0.5 * (distance[is_positive].mean() + distance[~is_positive].mean()))
            alpha = description.alpha if weighted else None
            weights.append(1.0 if alpha is None else alpha[:, i].mean())
        margin, _ = loss.margins(model.config.dim // 2)
        factor = margin / float(sum(middles) / len(middles)) / float(sum(weights) / len(weights))
        net.scale(factor)
        log.info("%s scaled by %.3f to the margin", part, factor)
