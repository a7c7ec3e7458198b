# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's tables and figures: systems against each other.

On two cores the branches are trained once a seed, and what fuses them starts from there; a
one-sensor row goes on alone for the passes that the others spend together. Then nothing but the
fusion tells VL from V and L, and nothing but the weights AdaFusion from VL.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from adafusion.experiments.plan import Experiment, Published, Recipe, Row, Training
from adafusion.experiments.studies.cost import COST
from adafusion.experiments.studies.idea import IDEA
from adafusion.experiments.studies.levels import LEVELS_OFF
from adafusion.experiments.studies.recall import RECALL
from adafusion.experiments.studies.weights import WEIGHTS
from adafusion.models import efficientnet
from adafusion.models.config import System
from adafusion.training import TrainConfig, phases
from adafusion.types import UserError

# the paper's Table III, AR@1 on Oxford RobotCar in percent, by length of the descriptor
PUBLISHED = {
    "V": {128: 83.57, 192: 86.87, 256: 87.68, 512: 88.91},
    "L": {128: 89.47, 192: 91.45, 256: 93.12, 512: 93.27},
    "VL": {128: 96.35, 192: 96.59, 256: 97.10, 512: 97.32},
    "AdaFusion": {128: 97.42, 192: 97.72, 256: 98.18, 512: 98.24},
}
LENGTH = 256  # of the descriptors in the paper's Table II
PUBLISHED_1_PERCENT = {("AdaFusion", LENGTH): 99.21}  # AR@1%, of its Table II

TOGETHER = 0.1  # share of a staged row's passes after its branches were joined
COARSE = 0.8  # share of the image branch's own passes at a quarter of the pixels (docs/adr/0004)

PILOT_TIMES = (1, 2, 4, 8)  # the budget
ALL_PROTOCOLS = ("cross-run", "union", "pointnetvlad")
AGAINST_EACH = (("AdaFusion", "VL"), ("AdaFusion", "V"), ("AdaFusion", "L"))


def headline(recipe: Recipe, passes: int) -> Experiment:
    """V, L, VL and AdaFusion from the same branches."""
    return Experiment(
        name="headline",
        words="Each branch alone, both joined, and both weighed: does weighing gain?",
        rows=staged_rows(recipe, passes),
        protocols=ALL_PROTOCOLS,
        seeds=(0, 1, 2),
        verdicts=AGAINST_EACH,
    )


def end_to_end(recipe: Recipe, passes: int) -> Experiment:
    """The headline with every row from scratch: one training, all networks together.

    At the branches' rates and with the loss of those that are joined, for nothing has learnt before
    that could be spoilt. AdaFusion once more without attention, and as the paper trains it, whose
    rate falls only after 20 evaluations without a better recall: here it never does.
    """
    both = recipe("adafusion-s")
    scratch = replace(recipe("lidar-s"), model=both.model, loss=both.loss)
    paper = replace(recipe("paper"), model=both.model)

    def row(label: str, of: TrainConfig, **changes: Any) -> Row:
        config = replace(of, model=replace(of.model, **changes))
        name = f"scratch-{label.lower().replace(' ', '-')}"
        return _row(label, Training(name=name, config=config, passes=passes))

    rows = (
        row("V", scratch, system="image"),
        row("L", scratch, system="lidar"),
        row("VL", scratch, system="concat"),
        row("AdaFusion", scratch),
        row("AdaFusion MLP only", scratch, attention_levels=0),
        row("AdaFusion as in the paper", paper),
    )
    staged = (replace(one, label=f"{one.label} staged") for one in staged_rows(recipe, passes)[2:])
    return Experiment(
        name="end-to-end",
        words="The headline from scratch, each row one training of all its networks: do weights "
        "gain where the branches learn with them? AdaFusion also with weights of the features "
        "alone (MLP only), and with the paper's own loss, pairs and optimiser. Beside them, "
        "staged: VL and AdaFusion of the headline, whose branches learnt alone.",
        rows=(*rows, *staged),
        protocols=("cross-run",),
        seeds=(0, 1, 2),
        verdicts=(
            *AGAINST_EACH,
            ("AdaFusion", "AdaFusion MLP only"),
            ("AdaFusion", "AdaFusion as in the paper"),
            ("AdaFusion staged", "AdaFusion"),
            ("VL staged", "VL"),
        ),
    )


def pilot(recipe: Recipe, passes: int) -> Experiment:
    """The headline's rows at rising budgets: how many frame passes does the slowest need?"""
    rows = tuple(
        replace(row, label=f"{row.label} x{times}", published=None)
        for times in PILOT_TIMES
        for row in staged_rows(recipe, times * passes, "" if times == 1 else f"-x{times}")
    )
    return Experiment(
        name="pilot",
        words="At which multiple of the budget do the rows of the headline level off on "
        "validation? Where the slowest does is the budget to compare them by.",
        rows=rows,
        protocols=(),
        seeds=(0,),
        study=LEVELS_OFF,
    )


def figure_recall(recipe: Recipe, passes: int) -> Experiment:
    """The headline's rows over the number of candidates."""
    return Experiment(
        name="figure-recall",
        words="Recall@N for N = 1 to 25: is the gain of weighing larger at small N?",
        rows=staged_rows(recipe, passes),
        protocols=("cross-run",),
        seeds=(0, 1, 2),
        verdicts=AGAINST_EACH,
        study=RECALL,
    )


def figure_weights(recipe: Recipe, passes: int) -> Experiment:
    """The headline's AdaFusion where one sensor should be trusted more than elsewhere."""
    return Experiment(
        name="figure-weights",
        words="Do the weights rise and fall where the paper says they do?",
        rows=staged_rows(recipe, passes)[-1:],
        protocols=("cross-run",),
        seeds=(0, 1, 2),
        study=WEIGHTS,
    )


def figure_idea(recipe: Recipe, passes: int) -> Experiment:
    """The headline's AdaFusion, and how its weights differ between right and wrong matches."""
    return Experiment(
        name="figure-idea",
        words="Do the weights of a query and a wrong match differ more than those of a query and "
        "its true match?",
        rows=staged_rows(recipe, passes)[-1:],
        protocols=("cross-run",),
        seeds=(0, 1, 2),
        study=IDEA,
    )


def table_systems(recipe: Recipe, passes: int) -> Experiment:
    """All systems of the paper's comparison.

    Those whose own descriptor is longer than `LENGTH` once more with that one, and AdaFusion
    with an image branch from ImageNet, where its weights are installed.
    """

    def row(label: str, system: System, *numbers: float | None, guess: bool = False) -> Row:
        config = recipe(f"{system}-s")
        if config.imagenet is None:  # nothing was learnt before that a lower rate would keep
            config = replace(config, optimiser=replace(config.optimiser, image_share=1.0))
        config = replace(config, model=replace(config.model, dim=config.model.dim or LENGTH))
        training = Training(name=system, config=config, passes=passes)
        known = Published(at_1=numbers[0], at_1_percent=numbers[1])
        return Row(label=label, training=training, published=known, reconstruction=guess)

    def native(of: Row) -> Row:
        training = of.training
        config = replace(training.config, model=replace(training.config.model, dim=0))
        training = replace(training, name=f"{training.name}-native", config=config)
        return Row(label=f"{of.label} native", training=training)

    _, _, concat, adafusion = staged_rows(recipe, passes)
    netvlad = row("NetVLAD", "netvlad", 51.52, 63.19)
    coral = row("CORAL", "coral", 88.93, 96.13)
    rows: tuple[Row, ...] = (
        netvlad,
        native(netvlad),
        row("PointNetVLAD", "pointnetvlad", 63.87, 81.29),
        row("Oertel et al.", "oertel", 98.00, None, guess=True),
        row("PIC-Net", "pic-net", None, 98.22, guess=True),
        row("MinkLoc++", "minkloc", 96.70, 99.10),
        coral,
        native(coral),
        replace(concat, label="VL-concat"),
        adafusion,
    )
    scratch = "all trained from scratch"
    left_out = ""
    try:
        efficientnet.weight_file(efficientnet.WEIGHTS)
    except UserError as error:
        left_out = f" AdaFusion-lite is left out: {error}."
    else:
        rows += (_lite_row(recipe, passes, adafusion),)
        scratch = "all but AdaFusion-lite trained from scratch"
    return Experiment(
        name="table-systems",
        words="Every system of the paper's comparison under the same protocols, "
        f"{scratch}, each with its own input, loss, mining and optimiser.{left_out}",
        rows=rows,
        protocols=ALL_PROTOCOLS,
        seeds=(0,),
    )


def _lite_row(recipe: Recipe, passes: int, adafusion: Row) -> Row:
    """AdaFusion whose image branch starts from ImageNet, with the other's LiDAR branch.

    Its image branch needs no images of a quarter of the pixels to begin with, and sees as many of
    full size as the other's of both.
    """
    image, _, both = (phase.config for phase in phases(recipe("adafusion-lite-s"), Path()))
    together = adafusion.training.passes
    _, lidar = adafusion.training.starts_from
    branch = Training(name="image-lite", config=image, passes=passes - together)
    last = Training(
        name="adafusion-lite-last", config=both, passes=together, starts_from=(branch, lidar)
    )
    return Row(label="AdaFusion-lite", training=last, pretrained=True)


def staged_rows(recipe: Recipe, passes: int, tag: str = "") -> tuple[Row, Row, Row, Row]:
    """V, L, VL and AdaFusion, all from one image branch and one LiDAR branch.

    `tag` ends the trainings' names, where a table holds several sets of them.
    """
    together = round(TOGETHER * passes)
    coarse = round(COARSE * (passes - together))
    image = Training(
        name=f"image{tag}",
        config=recipe("image-s"),
        passes=passes - together - coarse,
        starts_from=(
            Training(name=f"image-coarse{tag}", config=recipe("image-s-coarse"), passes=coarse),
        ),
    )
    lidar = Training(name=f"lidar{tag}", config=recipe("lidar-s"), passes=passes - together)

    def last(system: System, config: TrainConfig, *branches: Training) -> Training:
        name = f"{system}-last{tag}"
        return Training(name=name, config=config, passes=together, starts_from=branches)

    def alone(system: System, branch: Training) -> Training:
        config = recipe("adafusion-s")
        model = replace(config.model, system=system)
        return last(system, replace(config, model=model, balance=False), branch)

    return (
        _row("V", alone("image", image)),
        _row("L", alone("lidar", lidar)),
        _row("VL", last("concat", recipe("concat-s"), image, lidar)),
        _row("AdaFusion", last("adafusion", recipe("adafusion-s"), image, lidar)),
    )


def _row(label: str, training: Training) -> Row:
    """With the paper's numbers where it has such a row at this length of the descriptor.

    Of one sensor alone that is half of the fused one's.
    """
    model = training.config.model
    length = model.dim if len(model.sensors) == 2 else model.dim // 2
    at_1 = PUBLISHED.get(label, {}).get(length)
    at_1_percent = PUBLISHED_1_PERCENT.get((label, length))
    known = None if at_1 is None else Published(at_1=at_1, at_1_percent=at_1_percent)
    return Row(label=label, training=training, published=known)


def table_dimensions(recipe: Recipe, passes: int) -> Experiment:
    """What weighing gains at two lengths of the descriptor."""
    return _by_dimension("table-dimensions", recipe, passes, (128, 256), ("VL", "AdaFusion"))


def table_dimensions_full(recipe: Recipe, passes: int) -> Experiment:
    """The paper's Table III whole, for a GPU: a row has as many numbers as its label says."""
    lengths = tuple(PUBLISHED["V"])
    return _by_dimension("table-dimensions-full", recipe, passes, lengths, tuple(PUBLISHED))


def _by_dimension(
    name: str, recipe: Recipe, passes: int, lengths: tuple[int, ...], systems: tuple[str, ...]
) -> Experiment:
    def of_length(dim: int) -> Recipe:
        def changed(training: str) -> TrainConfig:
            config = recipe(training)
            return replace(config, model=replace(config.model, dim=dim))

        return changed

    headlines = recipe("adafusion-s").model.dim  # whose trainings are shared, so named alike

    def of_system(label: str, length: int) -> Row:
        dim = 2 * length if label in ("V", "L") else length  # they are half of a fused descriptor
        staged = staged_rows(of_length(dim), passes, "" if dim == headlines else f"-d{dim}")
        row = next(row for row in staged if row.label == label)
        return replace(row, label=f"{label} D-{length}")

    rows = tuple(of_system(label, length) for length in lengths for label in systems)
    return Experiment(
        name=name,
        words="What does weighing gain at each length of the descriptor, and what does it cost?",
        rows=rows,
        protocols=("cross-run",),
        seeds=(0, 1, 2),
        verdicts=tuple((f"AdaFusion D-{dim}", f"VL D-{dim}") for dim in lengths),
        study=COST,
    )
