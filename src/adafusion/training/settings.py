# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a training is: every choice, with the value it has when nobody chooses."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from adafusion.models import ModelConfig
from adafusion.models.adafusion import System

PAPER_LENGTH = 256  # numbers in the descriptor that the released margins were chosen for


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """Which frames meet in a batch.

    `pairs` is the paper's: `items` true pairs, each with one wrong pair. `batch` shows `places`
    places in `views` frames each and lets every pair inside the batch count.
    """

    mode: Literal["pairs", "batch"] = "batch"
    items: int = 16
    places: int = 16
    views: int = 2
    d_pos_m: float = 10.0
    d_neg_m: float = 50.0

    def __post_init__(self) -> None:
        if self.items < 1 or self.places < 2 or self.views < 2:
            raise ValueError("a batch needs at least 1 item, or 2 places in 2 views")
        if not 0 < self.d_pos_m <= self.d_neg_m:
            raise ValueError(f"need 0 < d_pos_m <= d_neg_m, not {self.d_pos_m} and {self.d_neg_m}")


@dataclass(frozen=True, kw_only=True)
class Loss:
    """The paper's pair margin loss, or a contrastive softmax; perhaps on each half as well.

    `margin` and `slack` are meant for a descriptor of 256 numbers and scale with its length, since
    an L1 distance does.
    """

    kind: Literal["margin", "softmax"] = "softmax"
    margin: float = 25.0
    slack: float = 1.0
    similarity: Literal["cosine", "l1"] = "cosine"  # what the softmax compares
    temperature: float = 0.1  # of the softmax: in cosine, or for l1 as a share of the margin
    half_weight: float = 0.0  # weight of the same loss on each sensor's half alone

    def __post_init__(self) -> None:
        if not 0 <= self.slack < self.margin:
            raise ValueError(f"need 0 <= slack < margin, not {self.slack} and {self.margin}")
        if self.temperature <= 0 or self.half_weight < 0:
            raise ValueError("temperature must be positive and half_weight not negative")

    def margins(self, length: int) -> tuple[float, float]:
        """Margin and slack for a descriptor of `length` numbers."""
        share = length / PAPER_LENGTH
        return self.margin * share, self.slack * share


@dataclass(frozen=True, kw_only=True)
class Optimiser:
    """Adam, and how its rate falls.

    `plateau` multiplies the rate by `factor` after `patience` evaluations without a better
    validation recall@1 (the paper's); `cosine` rises for `warmup` batches, then falls to zero.
    """

    learning_rate: float = 8e-4
    weight_decay: float = 0.0
    schedule: Literal["plateau", "cosine"] = "plateau"
    factor: float = 0.9
    patience: int = 20
    warmup: int = 200

    def __post_init__(self) -> None:
        if self.learning_rate <= 0 or self.weight_decay < 0 or not 0 < self.factor < 1:
            raise ValueError("need learning_rate > 0, weight_decay >= 0 and 0 < factor < 1")


@dataclass(frozen=True, kw_only=True)
class Augment:
    """Changes that keep the place: 0 switches one off."""

    color: float = 0.2  # brightness, contrast and saturation, each by up to this share
    jitter_m: float = 0.0  # standard deviation of each point's shift; reads raw clouds, so slower
    jitter_clip_m: float = 0.05
    blank: float = 0.0  # share of frames that lose one of two sensors: what makes weights move

    def __post_init__(self) -> None:
        if not 0 <= self.color <= 1 or min(self.jitter_m, self.jitter_clip_m) < 0:
            raise ValueError("color is a share in [0, 1]; jitter is not negative")
        if not 0 <= self.blank <= 1:
            raise ValueError(f"blank is a share in [0, 1], not {self.blank}")


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """One training, whole. `adafusion config show train` prints it; every key can be overridden.

    The defaults are what won on validation (docs/adr/0004 and 0005); configs/paper.yaml is the
    paper's training.
    """

    model: ModelConfig = field(default_factory=ModelConfig)
    sampling: Sampling = field(default_factory=Sampling)
    loss: Loss = field(default_factory=Loss)
    optimiser: Optimiser = field(default_factory=Optimiser)
    augment: Augment = field(default_factory=Augment)
    seed: int = 0
    epochs: int = 50
    batches: int | None = None  # takes the place of `epochs`
    evaluate_every: int = 2000  # batches
    checkpoint_every: int = 500  # batches: what a killed training loses at most
    keep: Literal["best", "last"] = "best"  # on validation: what becomes model.safetensors
    initialisation: Literal["framework", "he"] = "he"
    norms: bool = True  # batch norm after every convolution, folded away in what is saved
    init: tuple[str, ...] = ()  # model files whose branches this training starts from
    balance: bool = False  # first scale each branch to the margin: see `balance_branches`
    stage: Literal["end-to-end", "weights"] = "end-to-end"  # weights: branches frozen
    schedule: Literal["joint", "staged"] = "staged"  # staged: each branch alone, then together
    branch_batches: int | None = None  # of each branch alone, where staged; default: as `batches`
    joint_rate: float = 0.15  # learning rate of the staged branches together, as a share

    def __post_init__(self) -> None:
        if self.stage == "weights" and self.model.system != "adafusion":
            raise ValueError(f"stage weights: {self.model.system} has no weight branch")
        if self.stage == "weights" and not self.init and self.schedule == "joint":
            raise ValueError("stage weights freezes the branches: name trained ones in init")
        if self.init and self.norms:
            raise ValueError("branches named in init have their norms folded away: set norms=false")
        counts = (self.epochs, self.evaluate_every, self.checkpoint_every)
        if min(*counts, self.batches or 1, self.branch_batches or 1) < 1 or self.batches == 0:
            raise ValueError("epochs, batches and what happens every so many of them: at least 1")


@dataclass(frozen=True)
class Phase:
    """One run of the training loop within a schedule."""

    name: str
    config: TrainConfig
    out: Path


def phases(config: TrainConfig, out: Path) -> list[Phase]:
    """Unfold the schedule: `joint` is one phase; `staged` is three, the last from the first two.

    Where the branches come from `init` there is nothing to stage, and a system of one branch is
    that branch alone.
    """
    if config.schedule == "joint" or config.init:
        return [Phase(config.model.system, config, out)]
    if config.model.system in ("image", "lidar"):
        return [Phase(config.model.system, _branch(config, config.model.system), out)]
    branches = [
        Phase(system, _branch(config, system), out / system) for system in ("image", "lidar")
    ]
    together = replace(
        config,
        schedule="joint",
        init=tuple(str(phase.out / "model.safetensors") for phase in branches),
        norms=False,  # the branches come with theirs folded
        balance=True,
        optimiser=replace(
            config.optimiser, learning_rate=config.joint_rate * config.optimiser.learning_rate
        ),
    )
    return [*branches, Phase(config.model.system, together, out)]


def _branch(config: TrainConfig, system: System) -> TrainConfig:
    """The training of one branch alone within a staged one."""
    return replace(
        config,
        model=replace(config.model, system=system),
        batches=config.branch_batches or config.batches,
        schedule="joint",
        stage="end-to-end",
    )
