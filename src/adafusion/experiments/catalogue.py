# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""All comparisons, as data.

On two cores the branches are trained once a seed, and what fuses them starts from there; a
one-sensor row goes on alone for the passes that the others spend together. Then nothing but the
fusion tells VL from V and L, and nothing but the weights AdaFusion from VL.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from adafusion.config import configs_folder, load_config
from adafusion.experiments.plan import Experiment, Published, Recipe, Row, Training
from adafusion.experiments.studies.cost import COST
from adafusion.experiments.studies.recall import RECALL
from adafusion.models.config import System
from adafusion.preprocess.voxels import Occupancy
from adafusion.training import TrainConfig
from adafusion.types import UserError

# Frame passes through each sensor's network of every row. On world-v1-small, 10 for each of its
# 1,200 training frames: what three seeds of the headline learn from in an hour on two cores. It is
# less than the branches can use (the shipped LiDAR branch levelled off after 22,000, the image
# branch took 100,000), so a row that still rises is marked and never ranked. world-v1 is for a GPU:
# 80 for each of its 4,800 training frames. world-v1-tiny is for tests.
BUDGETS = {"world-v1-tiny": 512, "world-v1-small": 12_000, "world-v1": 400_000}
PASSES_A_FRAME = 40  # on any other data

TOGETHER = 0.1  # share of a staged row's passes after its branches were joined
COARSE = 0.8  # share of the image branch's own passes at a quarter of the pixels (docs/adr/0004)

ALL_PROTOCOLS = ("cross-run", "union", "pointnetvlad")
AGAINST_EACH = (("AdaFusion", "VL"), ("AdaFusion", "V"), ("AdaFusion", "L"))


def headline(recipe: Recipe, passes: int) -> Experiment:
    """V, L, VL and AdaFusion from the same branches."""
    return Experiment(
        name="headline",
        words="Each branch alone, both joined, and both weighed: does weighing gain?",
        rows=_staged_rows(recipe, passes),
        protocols=ALL_PROTOCOLS,
        seeds=(0, 1, 2),
        verdicts=AGAINST_EACH,
    )


def figure_recall(recipe: Recipe, passes: int) -> Experiment:
    """The headline's rows over the number of candidates."""
    return Experiment(
        name="figure-recall",
        words="Recall@N for N = 1 to 25: is the gain of weighing larger at small N?",
        rows=_staged_rows(recipe, passes),
        protocols=("cross-run",),
        seeds=(0, 1, 2),
        verdicts=AGAINST_EACH,
        study=RECALL,
    )


def table_systems(recipe: Recipe, passes: int) -> Experiment:
    """All systems of the paper's comparison at their small sizes."""

    def row(label: str, system: System, *numbers: float | None, guess: bool = False) -> Row:
        training = Training(name=system, config=recipe(f"{system}-s"), passes=passes)
        return Row(
            label=label, training=training, published=Published(at_1=numbers[0],
            at_1_percent=numbers[1]), reconstruction=guess,
        )  # fmt: skip

    _, _, concat, adafusion = _staged_rows(recipe, passes)
    rows = (
        row("NetVLAD", "netvlad", 51.52, 63.19),
        row("PointNetVLAD", "pointnetvlad", 63.87, 81.29),
        row("Oertel et al.", "oertel", 98.00, None, guess=True),
        row("PIC-Net", "pic-net", None, 98.22, guess=True),
        row("MinkLoc++", "minkloc", 96.70, 99.10),
        row("CORAL", "coral", 88.93, 96.13),
        replace(concat, label="VL-concat"),
        adafusion,
    )
    return Experiment(
        name="table-systems",
        words="Every system of the paper's comparison under the same protocols: a small size of "
        "each, all trained from scratch, each with its own input, loss, mining and optimiser.",
        rows=rows,
        protocols=ALL_PROTOCOLS,
        seeds=(0,),
    )


def _staged_rows(recipe: Recipe, passes: int) -> tuple[Row, Row, Row, Row]:
    """V, L, VL and AdaFusion, all from one image branch and one LiDAR branch."""
    together = round(TOGETHER * passes)
    coarse = round(COARSE * (passes - together))
    image = Training(
        name="image",
        config=recipe("image-s"),
        passes=passes - together - coarse,
        starts_from=(
            Training(name="image-coarse", config=recipe("image-s-coarse"), passes=coarse),
        ),
    )
    lidar = Training(name="lidar", config=recipe("lidar-s"), passes=passes - together)

    def last(system: System, config: TrainConfig, *branches: Training) -> Training:
        return Training(name=f"{system}-last", config=config, passes=together, starts_from=branches)

    def alone(system: System, branch: Training) -> Training:
        config = recipe("adafusion-s")
        model = replace(config.model, system=system)
        return last(system, replace(config, model=model, balance=False), branch)

    return (
        Row(label="V", training=alone("image", image), published=Published(at_1=87.68,
            at_1_percent=None)),
        Row(label="L", training=alone("lidar", lidar), published=Published(at_1=93.12,
            at_1_percent=None)),
        Row(label="VL", training=last("concat", recipe("concat-s"), image, lidar),
            published=Published(at_1=97.10, at_1_percent=None)),
        Row(label="AdaFusion", training=last("adafusion", recipe("adafusion-s"), image, lidar),
            published=Published(at_1=98.18, at_1_percent=99.21)),
    )  # fmt: skip


# the paper's Table III, AR@1 on Oxford RobotCar in percent
PUBLISHED_BY_DIM = {
    "V": {128: 83.57, 192: 86.87, 256: 87.68, 512: 88.91},
    "L": {128: 89.47, 192: 91.45, 256: 93.12, 512: 93.27},
    "VL": {128: 96.35, 192: 96.59, 256: 97.10, 512: 97.32},
    "AdaFusion": {128: 97.42, 192: 97.72, 256: 98.18, 512: 98.24},
}


def table_dimensions(recipe: Recipe, passes: int) -> Experiment:
    """What weighing gains at two lengths of the descriptor."""
    return _by_dimension("table-dimensions", recipe, passes, (128, 256), ("VL", "AdaFusion"))


def table_dimensions_full(recipe: Recipe, passes: int) -> Experiment:
    """The paper's Table III whole, for a GPU."""
    lengths = tuple(PUBLISHED_BY_DIM["V"])
    return _by_dimension("table-dimensions-full", recipe, passes, lengths, tuple(PUBLISHED_BY_DIM))


def _by_dimension(
    name: str, recipe: Recipe, passes: int, lengths: tuple[int, ...], systems: tuple[str, ...]
) -> Experiment:
    def of_length(dim: int) -> Recipe:
        def changed(training: str) -> TrainConfig:
            config = recipe(training)
            return replace(config, model=replace(config.model, dim=dim))

        return changed

    rows = tuple(
        replace(
            row,
            label=f"{row.label} D-{dim}",
            published=Published(at_1=PUBLISHED_BY_DIM[row.label][dim], at_1_percent=None),
        )
        for dim in lengths
        for row in _staged_rows(of_length(dim), passes)
        if row.label in systems
    )
    return Experiment(
        name=name,
        words="What does weighing gain at each length of the descriptor, and what does it cost?",
        rows=rows,
        protocols=("cross-run",),
        seeds=(0, 1, 2),
        verdicts=tuple((f"AdaFusion D-{dim}", f"VL D-{dim}") for dim in lengths),
        study=COST,
    )


def ablation_input(recipe: Recipe, passes: int) -> Experiment:
    """What the branches are given, and what steadies them: each one alone.

    L learns as long as in the headline before the branches are joined, V as long as there at a
    quarter of the pixels, so that the first row of each is the headline's own training.
    """
    alone = passes - round(TOGETHER * passes)
    lidar, image = recipe("lidar-s"), recipe("image-s-coarse")

    def row(label: str, of: TrainConfig, **changes: Any) -> Row:
        name, share = ("lidar", 1.0) if of is lidar else ("image-coarse", COARSE)
        return Row(
            label=label,
            training=Training(
                name=name, config=replace(of, **changes), passes=round(share * alone)
            ),
        )

    def holding(occupancy: Occupancy) -> Row:
        model, preprocess = lidar.model, lidar.model.preprocess
        voxels = replace(preprocess.voxels, occupancy=occupancy)
        model = replace(model, preprocess=replace(preprocess, voxels=voxels))
        return row(f"L {occupancy}", lidar, model=model)

    def without_norm(label: str, of: TrainConfig) -> Row:
        return row(label, of, norms=False, model=replace(of.model, last_norm=False))

    rows = (
        row("L", lidar),
        holding("count"),
        holding("soft"),
        holding("tdf"),
        row("L last norm alone", lidar, norms=False),
        without_norm("L no norm", lidar),
        row("L points jittered", lidar, augment=replace(lidar.augment, jitter_m=0.02)),
        row("V", image),
        row("V last norm alone", image, norms=False),
        without_norm("V no norm", image),
        row("V no colour jitter", image, augment=replace(image.augment, color=0.0)),
    )
    return Experiment(
        name="ablation-input",
        words="One branch alone: what a cell holds (L: binary), batch norm (L and V: after every "
        "convolution while training; the paper: the last alone) and augmentation. V sees a quarter "
        "of the pixels.",
        rows=rows,
        protocols=("cross-run",),
        seeds=(0, 1, 2),
        verdicts=tuple((row.label, row.label[0]) for row in rows if row.label not in ("V", "L")),
    )


EXPERIMENTS: dict[str, Callable[[Recipe, int], Experiment]] = {
    "headline": headline,
    "table-systems": table_systems,
    "table-dimensions": table_dimensions,
    "table-dimensions-full": table_dimensions_full,
    "figure-recall": figure_recall,
    "ablation-input": ablation_input,
}


def build_experiment(name: str, recipe: Recipe, passes: int) -> Experiment:
    """Look an experiment up; a name that is none raises UserError with the choices."""
    if name not in EXPERIMENTS:
        raise UserError(f"unknown experiment {name!r}: choose from {', '.join(EXPERIMENTS)}")
    return EXPERIMENTS[name](recipe, passes)


def packaged_recipe(name: str, changes: tuple[str, ...] = ()) -> TrainConfig:
    """Read a training that comes with the package, with keys changed as `train --set` does."""
    return load_config(TrainConfig, configs_folder() / f"{name}.yaml", changes)
