# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What the parts of the system are worth: the headline's rows with one thing changed at a time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

from adafusion.config import change_config
from adafusion.experiments.comparisons import (
    COARSE,
    TOGETHER,
    staged_rows,
)
from adafusion.experiments.plan import Experiment, Recipe, Row, Training
from adafusion.experiments.studies.remedies import REMEDIED
from adafusion.experiments.studies.sizes import SIZES
from adafusion.experiments.studies.speed_to_recall import SPEED
from adafusion.experiments.studies.weighting import WEIGHTING
from adafusion.models.pooling import Pooling
from adafusion.preprocess.voxels import Occupancy
from adafusion.training import TrainConfig
from adafusion.training.settings import Loss, Sampling

FROZEN = 1.0  # share of a row's passes that a fusion of frozen branches is shown: it costs little
FROZEN_RATE = 1e-3  # learning rate where nothing that was trained before moves
FOR_SPEED = 0.5  # share of the LiDAR branch's own passes in which losses race
FEW_CLUSTERS = 8  # of VLAD, over last maps of 24 and 48 cells


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
    _, _, concat, adafusion = staged_rows(recipe, passes)
    frozen = change_config(
        adafusion.training.config,
        (
            "stage=weights",
            "cache_branches=true",
            *(f"augment.{name}=0" for name in ("color", "hue", "erase", "jitter_m", "blank")),
            "augment.points=false",
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
        studied=tuple(label for label in WEIGHTINGS if label != "attended features"),
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
    _, _, concat, adafusion = staged_rows(recipe, passes)

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
        "gain as well: what the weights themselves gain stands below, against fixed ones.",
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
