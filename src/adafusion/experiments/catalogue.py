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
from pathlib import Path
from typing import Any, get_args

from adafusion.config import change_config, configs_folder, load_config
from adafusion.experiments.plan import Experiment, Published, Recipe, Row, Training
from adafusion.experiments.studies.cost import COST
from adafusion.experiments.studies.idea import IDEA
from adafusion.experiments.studies.recall import RECALL
from adafusion.experiments.studies.remedies import REMEDIED
from adafusion.experiments.studies.sizes import SIZES
from adafusion.experiments.studies.speed_to_recall import SPEED
from adafusion.experiments.studies.weighting import WEIGHTING
from adafusion.experiments.studies.weights import WEIGHTS
from adafusion.models import efficientnet
from adafusion.models.config import System
from adafusion.models.pooling import Pooling
from adafusion.preprocess.voxels import Occupancy
from adafusion.training import TrainConfig, phases
from adafusion.training.settings import Loss, Sampling
from adafusion.types import UserError

# Frame passes through each sensor's network of every row. On world-v1-small, 10 for each of its
# 1,200 training frames: what three seeds of the headline learn from in an hour on two cores. It is
# less than the branches can use (the shipped LiDAR branch levelled off after 22,000, the image
# branch took 100,000), so a row that still rises is marked and never ranked. world-v1 is for a GPU:
# 80 for each of its 4,800 training frames. world-v1-tiny is for tests.
BUDGETS = {"world-v1-tiny": 512, "world-v1-small": 12_000, "world-v1": 400_000}
PASSES_A_FRAME = 40  # on any other data

TOGETHER = 0.1  # share of a staged row's passes after its branches were joined
FROZEN = 1.0  # share of a row's passes that a fusion of frozen branches is shown: it costs little
FROZEN_RATE = 1e-3  # learning rate where nothing that was trained before moves
COARSE = 0.8  # share of the image branch's own passes at a quarter of the pixels (docs/adr/0004)

FOR_SPEED = 0.5  # share of the LiDAR branch's own passes in which losses race
FEW_CLUSTERS = 8  # of VLAD, over last maps of 24 and 48 cells

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


def figure_weights(recipe: Recipe, passes: int) -> Experiment:
    """The headline's AdaFusion where one sensor should be trusted more than elsewhere."""
    return Experiment(
        name="figure-weights",
        words="Do the weights rise and fall where the paper says they do?",
        rows=_staged_rows(recipe, passes)[-1:],
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
        rows=_staged_rows(recipe, passes)[-1:],
        protocols=("cross-run",),
        seeds=(0, 1, 2),
        study=IDEA,
    )


def table_systems(recipe: Recipe, passes: int) -> Experiment:
    """All systems of the paper's comparison at their small sizes.

    And AdaFusion with an image branch from ImageNet, where its weights are installed.
    """

    def row(label: str, system: System, *numbers: float | None, guess: bool = False) -> Row:
        training = Training(name=system, config=recipe(f"{system}-s"), passes=passes)
        return Row(
            label=label, training=training, published=Published(at_1=numbers[0],
            at_1_percent=numbers[1]), reconstruction=guess,
        )  # fmt: skip

    _, _, concat, adafusion = _staged_rows(recipe, passes)
    rows: tuple[Row, ...] = (
        row("NetVLAD", "netvlad", 51.52, 63.19),
        row("PointNetVLAD", "pointnetvlad", 63.87, 81.29),
        row("Oertel et al.", "oertel", 98.00, None, guess=True),
        row("PIC-Net", "pic-net", None, 98.22, guess=True),
        row("MinkLoc++", "minkloc", 96.70, 99.10),
        row("CORAL", "coral", 88.93, 96.13),
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
        words="Every system of the paper's comparison under the same protocols: a small size of "
        f"each, {scratch}, each with its own input, loss, mining and optimiser.{left_out}",
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
        if changes:
            name = label.lower().replace(" ", "-")
        config = replace(of, **changes)
        return Row(
            label=label, training=Training(name=name, config=config, passes=round(share * alone))
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


def ablation_loss(recipe: Recipe, passes: int) -> Experiment:
    """How soon each loss brings the LiDAR branch to a recall: does the pair margin converge faster?

    All of it learns from batches of about 32 frames, half as long as in the headline; wrong matches
    are drawn by chance, for mining is another question. The pair margin's is the L1 distance of
    descriptors of any length, the others' the L2 distance, or the cosine, of descriptors of length
    1; each is searched by its own. Margins are those that a loss was published with, where it was.
    """
    lidar = recipe("lidar-s")
    unit = replace(lidar.model, unit_length=True)
    pairs = Sampling(mode="pairs", items=11)
    batch = Sampling(mode="batch", places=16, views=2)
    tuples = Sampling(mode="tuples", tuples=2, positives=2, negatives=12)

    def row(label: str, loss: Loss, sampling: Sampling) -> Row:
        model = lidar.model if loss.kind == "margin" else unit
        training = Training(
            name=f"lidar-{loss.kind}",
            config=replace(lidar, model=model, loss=loss, sampling=sampling),
            passes=round(FOR_SPEED * (passes - round(TOGETHER * passes))),
            evaluations=16,
        )
        return Row(label=label, training=training)

    rows = (
        row("margin on pairs", Loss(kind="margin"), pairs),
        row("margin", Loss(kind="margin"), batch),
        row("softmax", lidar.loss, batch),
        row("contrastive", Loss(kind="contrastive", margin=0.5, slack=0.5), batch),
        row("batch-hard", Loss(kind="batch-hard", margin=0.2), batch),
        row("triplet", Loss(kind="triplet", margin=0.1), tuples),
        row("lazy-triplet", Loss(kind="lazy-triplet", margin=0.5), tuples),
        row("lazy-quadruplet", Loss(kind="lazy-quadruplet", margin=0.5, other_margin=0.2), tuples),
        row("hard-quadruplet", Loss(kind="hard-quadruplet", margin=0.5, other_margin=0.2), tuples),
    )
    return Experiment(
        name="ablation-loss",
        words="The LiDAR branch under each loss, all else alike: which brings it to a validation "
        "recall in the fewest frame passes? The pair margin (the paper's pairs, or all pairs of a "
        "batch) is trained and searched by the L1 distance of descriptors of any length, the "
        "others by L2 of descriptors of length 1, whose order the softmax's cosine shares; "
        "contrastive draws true pairs to 0 and pushes wrong ones beyond 1. Nothing is mined.",
        rows=rows,
        protocols=("cross-run",),
        seeds=(0,),
        study=SPEED,
    )


def ablation_pooling(recipe: Recipe, passes: int) -> Experiment:
    """How a branch's last map becomes its feature, at the size of training and at others.

    L and V learn as long as in `ablation_input`: the rows of the mean are the headline's own
    trainings.
    """
    alone = passes - round(TOGETHER * passes)

    def row(sensor: str, pooling: Pooling) -> Row:
        name, share = ("lidar", 1.0) if sensor == "L" else ("image-coarse", COARSE)
        config = recipe("lidar-s" if sensor == "L" else "image-s-coarse")
        model = replace(config.model, pooling=pooling)
        if pooling == "vlad":
            model = replace(model, clusters=FEW_CLUSTERS)
        return Row(
            label=f"{sensor} {pooling.upper()}",
            training=Training(
                name=name if pooling == "gap" else f"{name}-{pooling}",
                config=replace(config, model=model),
                passes=round(share * alone),
            ),
        )

    rows = tuple(row(sensor, pooling) for sensor in "LV" for pooling in get_args(Pooling))
    return Experiment(
        name="ablation-pooling",
        words="One branch alone: the mean over the cells of its last map (GAP, the paper's), a "
        "generalised mean (GEM), a linear layer over all cells (FC), and NetVLAD's core of "
        f"{FEW_CLUSTERS} clusters with a linear layer (VLAD). V sees a quarter of the pixels.",
        rows=rows,
        protocols=("cross-run",),
        seeds=(0,),
        study=SIZES,
    )


# each row's changes of AdaFusion, all with the same frozen branches
WEIGHTINGS = {
    "MLP only": ("model.attention_levels=0",),
    "1 level": ("model.attention_levels=1",),
    "2 levels": ("model.attention_levels=2",),
    "3 levels": (),
    "paper attention": ("model.attention=paper",),
    "one stage": ("model.fusion=one-stage-weights",),
    "linear": ("model.fusion=linear",),
    "attended features": ("model.attend_features=true",),
}


def ablation_weights(recipe: Recipe, passes: int) -> Experiment:
    """What the parts of the weight branch do, on one pair of frozen branches a seed."""
    _, _, concat, adafusion = _staged_rows(recipe, passes)
    frozen = change_config(
        adafusion.training.config,
        (
            "stage=weights",
            "cache_branches=true",
            "augment.color=0",
            f"optimiser.learning_rate={FROZEN_RATE}",
        ),
    )

    def row(label: str, changes: tuple[str, ...]) -> Row:
        training = Training(
            name=f"frozen-{label.lower().replace(' ', '-')}",
            config=change_config(frozen, changes),
            passes=round(FROZEN * passes),
            starts_from=adafusion.training.starts_from,
        )
        return Row(label=label, training=training)

    rows = tuple(row(label, changes) for label, changes in WEIGHTINGS.items())
    return Experiment(
        name="ablation-weights",
        words="The weight branch on frozen branches, those that AdaFusion and VL start from: "
        "weights of the features alone (MLP only) or of attention at the n deepest levels; the "
        "paper's attention beside the released code's; the maps of both sensors joined at once "
        "(one stage); a linear layer over both features and no weights (linear); attention that "
        "joins the features too. What frozen branches give of a frame is computed once, so nothing "
        f"is augmented, and these rows see {FROZEN / TOGETHER:.0f} times the frames that AdaFusion "
        "and VL, trained end to end, see in their last phase; no frame passes a network for it.",
        rows=(*rows, adafusion, concat),
        protocols=("cross-run",),
        seeds=(0, 1, 2),
        verdicts=(
            ("1 level", "MLP only"),
            ("2 levels", "1 level"),
            ("3 levels", "2 levels"),
            ("3 levels", "MLP only"),
            ("3 levels", "paper attention"),
            ("3 levels", "one stage"),
            ("3 levels", "linear"),
            ("attended features", "3 levels"),
            ("AdaFusion", "3 levels"),
            ("3 levels", "VL"),
        ),
        study=WEIGHTING,
    )


# each one change of AdaFusion's last phase, but for the pair margin: on a half alone it would ask
# for a length that weighing then takes from it, so it comes without the halves' terms
REMEDIES = {
    "blanked sensors": ("augment.blank=0.3",),
    "no half terms": ("loss.half_weight=0",),
    "full half terms": ("loss.half_weight=1",),
    "normalised halves": ("model.normalise_halves=true",),
    "faster weights": ("optimiser.weights_share=10",),
    "trained in L1": ("loss.similarity=l1",),
    "pair margin": ("loss.kind=margin", "loss.half_weight=0"),
}


def remedies(recipe: Recipe, passes: int) -> Experiment:
    """What may make the weights gain: each remedy from the headline's branches."""
    _, _, concat, adafusion = _staged_rows(recipe, passes)

    def changed(label: str, row: Row, changes: tuple[str, ...]) -> Row:
        config = change_config(row.training.config, changes)
        name = label.lower().replace(" ", "-")
        return Row(label=label, training=replace(row.training, name=name, config=config))

    together = adafusion.training
    alone = replace(
        together,
        name="weights-alone",
        config=replace(together.config, stage="weights"),
        passes=together.passes // 2,
    )
    then = replace(
        together,
        name="weights-first",
        config=replace(together.config, balance=False, take_weights=True),
        passes=together.passes - alone.passes,
        starts_from=(alone,),
    )
    tried = (
        *(changed(label, adafusion, changes) for label, changes in REMEDIES.items()),
        Row(label="weights first", training=then),
    )
    normalised = changed("VL normalised", concat, REMEDIES["normalised halves"])
    return Experiment(
        name="remedies",
        words="If weighing gains nothing: sensors blanked while training (a share of 0.3); more "
        "or none of the loss on each half alone; halves of one length (VL as well); the weight "
        "branch at ten times the rate; the searched distance as the trained one, by a softmax or "
        "by the paper's pair margin; the weight branch alone for the first half of the last phase. "
        "Everything else is AdaFusion's. A remedy that is above VL may owe it to what VL would "
        "gain as well: what the weights themselves gain stands below, against equal ones.",
        rows=(concat, adafusion, *tried, normalised),
        protocols=("cross-run",),
        seeds=(0, 1, 2),
        verdicts=(
            ("AdaFusion", "VL"),
            *((row.label, other) for row in tried for other in ("VL", "AdaFusion")),
            ("normalised halves", "VL normalised"),
        ),
        study=REMEDIED,
    )


EXPERIMENTS: dict[str, Callable[[Recipe, int], Experiment]] = {
    "headline": headline,
    "ablation-weights": ablation_weights,
    "table-systems": table_systems,
    "table-dimensions": table_dimensions,
    "table-dimensions-full": table_dimensions_full,
    "figure-recall": figure_recall,
    "figure-weights": figure_weights,
    "figure-idea": figure_idea,
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


def packaged_recipe(name: str, changes: tuple[str, ...] = ()) -> TrainConfig:
    """Read a training that comes with the package, with keys changed as `train --set` does."""
    return load_config(TrainConfig, configs_folder() / f"{name}.yaml", changes)
