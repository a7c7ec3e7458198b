# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""All experiments by name, and the budgets of the named worlds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from adafusion.config import change_config, configs_folder, load_config
from adafusion.experiments.ablations import (
    ablation_input,
    ablation_loss,
    ablation_pooling,
    ablation_weights,
    remedies,
)
from adafusion.experiments.comparisons import (
    end_to_end,
    figure_idea,
    figure_recall,
    figure_weights,
    headline,
    pilot,
    table_dimensions,
    table_dimensions_full,
    table_systems,
)
from adafusion.experiments.plan import Experiment, Recipe
from adafusion.training import TrainConfig
from adafusion.types import UserError

# Frame passes through each sensor's network of every row. On world-v1-small, 10 for each of its
# 1,200 training frames: what three seeds of the headline learn from in an hour on two cores. It is
# less than the branches can use (the shipped LiDAR branch levelled off after 22,000, the image
# branch took 100,000), so a row that still rises is marked and never ranked. world-v1 is for a GPU:
# 83 for each of its 4,800 training frames. world-v1-tiny is for tests.
BUDGETS = {"world-v1-tiny": 512, "world-v1-small": 12_000, "world-v1": 400_000}
PASSES_A_FRAME = 40  # on any other data

EXPERIMENTS: dict[str, Callable[[Recipe, int], Experiment]] = {
    "headline": headline,
    "end-to-end": end_to_end,
    "pilot": pilot,
    "table-systems": table_systems,
    "table-dimensions": table_dimensions,
    "table-dimensions-full": table_dimensions_full,
    "figure-recall": figure_recall,
    "figure-weights": figure_weights,
    "figure-idea": figure_idea,
    "ablation-weights": ablation_weights,
    "ablation-input": ablation_input,
    "remedies": remedies,
    "ablation-loss": ablation_loss,
    "ablation-pooling": ablation_pooling,
}


def build_experiment(name: str, recipe: Recipe, passes: int) -> Experiment:
    """Look an experiment up; a name that is none raises UserError with the choices."""
    if name not in EXPERIMENTS:
        raise UserError(f"unknown experiment {name!r}: choose from {', '.join(EXPERIMENTS)}")
    return EXPERIMENTS[name](recipe, passes)


def packaged_recipe(
    name: str, changes: tuple[str, ...] = (), *, full_size: bool = False
) -> TrainConfig:
    """Read a training that comes with the package, with keys changed as `train --set` does.

    At full size a compared system `NAME-s` is that of NAME.yaml, with its paper's settings; the
    trainings of AdaFusion and its branches keep theirs, with networks and inputs of the paper's.
    """
    small = configs_folder() / f"{name}.yaml"
    whole = small.with_name(f"{name.removesuffix('-s')}.yaml")
    if not full_size:
        config = load_config(TrainConfig, small)
    elif whole != small and whole.exists():
        config = load_config(TrainConfig, whole)
    else:
        config = _grown(load_config(TrainConfig, small))
    return change_config(config, changes)


def _grown(small: TrainConfig) -> TrainConfig:
    """As wide as the paper's networks, on inputs as much finer."""
    model = small.model
    times = round(1 / model.width)
    height, width = model.preprocess.image.size
    x, y, z = model.preprocess.voxels.shape
    preprocess = replace(
        model.preprocess,
        image=replace(model.preprocess.image, size=(times * height, times * width)),
        voxels=replace(model.preprocess.voxels, shape=(times * x, times * y, times * z)),
    )
    return replace(small, model=replace(model, width=1.0, preprocess=preprocess))
