# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a training is: every choice, with the value it has when nobody chooses."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from adafusion.models import ModelConfig
from adafusion.models.config import STAGED, System

PAPER_LENGTH = 256  # numbers in the descriptor that the released margins were chosen for


@dataclass(frozen=True, kw_only=True)
class Mining:
    """Wrong matches that the network finds hard, by descriptors of all frames taken now and then.

    Mode `tuples`: of `candidates` frames far from a query the `hardest` nearest ones in descriptor
    space, then others by chance. Mode `pairs`: of `candidates` wrong pairs the `hardest` nearest
    ones join every batch. What describing costs is counted apart from training's frame passes.
    """

    after: int = 0  # batches before the first
    every: int = 700  # batches
    candidates: int = 4000
    hardest: int = 10

    def __post_init__(self) -> None:
        if self.after < 0 or min(self.every, self.hardest) < 1 or self.candidates < self.hardest:
            raise ValueError("mining: after >= 0, every >= 1 and 1 <= hardest <= candidates")

    def is_due(self, done: int) -> bool:
        """Whether all frames are described anew after so many batches."""
        return done >= self.after and (done - self.after) % self.every == 0


@dataclass(frozen=True, kw_only=True)
class Growth:
    """How a batch grows once it is easy, as MinkLoc++'s does.

    After an epoch in which fewer than `below` of the triplets (of the pairs, where the loss looks
    at those) still taught the descriptor, and each half, the next batches have `factor` times as
    many frames, up to `limit` or to what the world has room for: places in a batch lie `d_neg_m`
    apart, as 15 to 18 do in the training region of world-v1-small.
    """

    factor: float = 1.4
    below: float = 0.7
    limit: int = 160  # frames

    def __post_init__(self) -> None:
        if self.factor <= 1 or not 0 < self.below <= 1:
            raise ValueError("growth: factor > 1 and below in (0, 1]")

    def after(self, frames: int, room: int) -> int:
        """Frames of the batches that follow those of so many, where the world has room for some."""
        return max(frames, min(int(frames * self.factor), self.limit, room))


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """Which frames meet in a batch.

    `pairs` is the paper's: `items` true pairs, each with one wrong pair. `batch` shows `places`
    places in `views` frames each and lets every pair inside the batch count. `tuples` shows as many
    queries, each with `positives` true and `negatives` wrong matches and one frame far from all.
    """

    mode: Literal["pairs", "batch", "tuples"] = "batch"
    items: int = 16
    places: int = 16
    views: int = 2
    tuples: int = 2
    positives: int = 2
    negatives: int = 18
    mining: Mining | None = None  # None: all by chance
    growth: Growth | None = None  # of mode `batch`, from `places`; None: all of one size
    d_pos_m: float = 10.0
    d_neg_m: float = 50.0

    def __post_init__(self) -> None:
        if self.items < 1 or self.places < 2 or self.views < 2:
            raise ValueError("a batch needs at least 1 item, or 2 places in 2 views")
        if min(self.tuples, self.positives, self.negatives) < 1:
            raise ValueError("a tuple needs at least 1 true and 1 wrong match")
        if self.mining is not None and self.mode == "batch":
            raise ValueError("mining: mode batch finds its hard matches within the batch")
        if self.growth is not None and self.mode != "batch":
            raise ValueError(f"growth: mode {self.mode} has batches of one size")
        if not 0 < self.d_pos_m <= self.d_neg_m:
            raise ValueError(f"need 0 < d_pos_m <= d_neg_m, not {self.d_pos_m} and {self.d_neg_m}")


# 16-mixed scales losses by a state that no resume keeps
Precision = Literal["32-true", "bf16-mixed", "64-true"]

# losses that look at whole tuples, and those that look at whole batches
TUPLE_LOSSES = ("triplet", "lazy-triplet", "lazy-quadruplet", "hard-quadruplet")
LossKind = Literal[
    "margin",
    "softmax",
    "contrastive",
    "batch-hard",
    "triplet",
    "lazy-triplet",
    "lazy-quadruplet",
    "hard-quadruplet",
]


@dataclass(frozen=True, kw_only=True)
class Loss:
    """What true and wrong matches do to the network; perhaps to each half as well.

    `margin` is the paper's pair margin loss on L1 distances; its `margin` and `slack` are meant for
    a descriptor of 256 numbers and scale with its length, since an L1 distance does. `softmax` is
    the easier loss to begin with. The others are those of the compared systems, on L2 distances of
    descriptors whose length is given (`margin`, and `other_margin` of the quadruplets, are taken as
    they are): `contrastive`, `batch-hard` (MinkLoc++), `triplet` (NetVLAD), `lazy-triplet` and
    `lazy-quadruplet` (PointNetVLAD), `hard-quadruplet` (CORAL).
    """

    kind: LossKind = "softmax"
    margin: float = 25.0
    slack: float = 1.0
    other_margin: float = 0.2
    similarity: Literal["cosine", "l1"] = "cosine"  # what the softmax compares
    temperature: float = 0.1  # of the softmax: in cosine, or for l1 as a share of the margin
    half_weight: float = 0.0  # weight of the same loss on each sensor's half alone
    lidar_half_weight: float | None = None  # where the LiDAR's half has another weight

    def __post_init__(self) -> None:
        if not self.margin > 0 or self.slack < 0 or self.other_margin < 0:
            raise ValueError("margin must be positive, slack and other_margin not negative")
        if self.kind == "margin" and self.slack >= self.margin:
            raise ValueError(f"need slack < margin, not {self.slack} and {self.margin}")
        if self.temperature <= 0 or min(self.half_weight, self.lidar_half_weight or 0.0) < 0:
            raise ValueError("temperature must be positive and half weights not negative")

    def margins(self, length: int) -> tuple[float, float]:
        """Margin and slack of the pair margin loss for a descriptor of `length` numbers."""
        share = length / PAPER_LENGTH
        return self.margin * share, self.slack * share

    @property
    def half_weights(self) -> tuple[float, float]:
        """Weights of the loss on the image's half and on the LiDAR's."""
        lidar = self.half_weight if self.lidar_half_weight is None else self.lidar_half_weight
        return self.half_weight, lidar


@dataclass(frozen=True, kw_only=True)
class Optimiser:
    """Adam or stochastic gradient descent, and how the rate falls.

    `plateau` multiplies the rate by `factor` after `patience` evaluations without a better
    validation recall@1 (the paper's); `cosine` rises for `warmup` batches, then falls to zero;
    `step` cuts the training in `steps` equal parts, or after the shares of it in `milestones`, and
    multiplies the rate by `factor` between them, down to a share of `floor`. `image_share` scales
    the rate of the image network, which may come trained; `weights_share` that of the weight
    branch, which never does.
    """

    kind: Literal["adam", "sgd"] = "adam"
    learning_rate: float = 8e-4
    weight_decay: float = 0.0
    amsgrad: bool = False
    momentum: float = 0.9  # of sgd
    schedule: Literal["plateau", "cosine", "step"] = "plateau"
    factor: float = 0.9
    patience: int = 20
    warmup: int = 200
    steps: int = 2
    milestones: tuple[float, ...] = ()
    floor: float = 0.0
    image_share: float = 1.0
    weights_share: float = 1.0

    def __post_init__(self) -> None:
        if self.learning_rate <= 0 or self.weight_decay < 0 or not 0 < self.factor < 1:
            raise ValueError("need learning_rate > 0, weight_decay >= 0 and 0 < factor < 1")
        if self.steps < 1 or not 0 <= self.floor <= 1:
            raise ValueError("need steps >= 1 and floor in [0, 1]")
        if any(not 0 < share < 1 for share in self.milestones):
            raise ValueError(f"milestones are shares of a training, not {list(self.milestones)}")
        if min(self.image_share, self.weights_share) <= 0:
            raise ValueError("image_share and weights_share must be positive")


@dataclass(frozen=True, kw_only=True)
class Augment:
    """Changes that keep the place: 0 switches one off."""

    color: float = 0.2  # brightness, contrast and saturation, each by up to this share
    hue: float = 0.0  # by up to this share of the colour circle
    erase: float = 0.0  # share of images in which a box is blackened, see `erase_boxes`
    jitter_m: float = 0.0  # standard deviation of each point's shift; reads raw clouds, so slower
    jitter_clip_m: float = 0.05
    points: bool = False  # MinkLoc++'s changes of point sets, see `augment_points`
    blank: float = 0.0  # share of frames that lose one of two sensors: what makes weights move

    def __post_init__(self) -> None:
        if not 0 <= self.color <= 1 or min(self.jitter_m, self.jitter_clip_m) < 0:
            raise ValueError("color is a share in [0, 1]; jitter is not negative")
        if not 0 <= self.hue <= 0.5:
            raise ValueError(f"hue is a share of the colour circle in [0, 0.5], not {self.hue}")
        for name, share in (("blank", self.blank), ("erase", self.erase)):
            if not 0 <= share <= 1:
                raise ValueError(f"{name} is a share in [0, 1], not {share}")

    @property
    def changes_inputs(self) -> bool:
        """Whether anything is switched on."""
        images = self.color or self.hue or self.erase
        return bool(images or self.jitter_m or self.points or self.blank)


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
    passes: int | None = None  # frame passes, or up to a batch more; takes the place of `epochs`
    batches: int | None = None  # takes the place of both
    evaluate_every: int = 2000  # batches; frame passes where `passes` says how long
    checkpoint_every: int = 500  # batches: what a killed training loses at most
    keep: Literal["best", "last"] = "best"  # on validation: what becomes model.safetensors
    initialisation: Literal["framework", "he"] = "he"
    imagenet: str | None = None  # weights for the image network: a file, or efficientnet-lite0
    precision: Precision = "32-true"  # of the arithmetic while learning
    norms: bool = True  # batch norm after every convolution, folded away in what is saved
    init: tuple[str, ...] = ()  # model files whose branches this training starts from
    take_weights: bool = False  # from those files, what fuses the branches as well
    balance: bool = False  # first scale each branch to the margin: see `balance_branches`
    stage: Literal["end-to-end", "weights"] = "end-to-end"  # weights: branches frozen
    cache_branches: bool = False  # frozen: run over each frame once, without augmentation
    schedule: Literal["joint", "staged"] = "staged"  # staged: each branch alone, then together
    branch_batches: int | None = None  # of each branch alone, where staged; default: as `batches`
    joint_rate: float = 0.15  # learning rate of the staged branches together, as a share

    def __post_init__(self) -> None:
        if (self.loss.kind in TUPLE_LOSSES) != (self.sampling.mode == "tuples"):
            raise ValueError(f"loss {self.loss.kind} does not fit sampling {self.sampling.mode}")
        if self.loss.kind == "batch-hard" and self.sampling.mode != "batch":
            raise ValueError("loss batch-hard looks at whole batches: set sampling.mode=batch")
        if self.stage == "weights" and self.model.system != "adafusion":
            raise ValueError(f"stage weights: {self.model.system} has no weight branch")
        if self.stage == "weights" and not self.init and self.schedule == "joint":
            raise ValueError("stage weights freezes the branches: name trained ones in init")
        if self.take_weights and self.model.system != "adafusion":
            raise ValueError(f"take_weights: {self.model.system} has no weight branch")
        if self.take_weights and not self.init and self.schedule == "joint":
            raise ValueError("take_weights: name a trained adafusion in init")
        if self.cache_branches and (self.stage != "weights" or self.norms):
            raise ValueError("cache_branches keeps what frozen branches give: set stage=weights")
        if self.cache_branches and self.augment.changes_inputs:
            raise ValueError("cache_branches sees each frame as it is: switch augment off")
        if self.init and self.norms:
            raise ValueError("branches named in init have their norms folded away: set norms=false")
        if self.balance and not self.model.last_norm:
            raise ValueError("balance scales the last norm: the model must have one")
        if self.sampling.growth and self.passes is None and self.batches is None:
            raise ValueError("growth: epochs change with the batch; give passes or batches instead")
        counts = (self.epochs, self.evaluate_every, self.checkpoint_every)
        if min(*counts, self.batches or 1, self.branch_batches or 1) < 1 or self.batches == 0:
            raise ValueError("epochs, batches and what happens every so many of them: at least 1")
        if self.passes is not None and self.passes < 1:
            raise ValueError("passes: at least 1")

    @property
    def counts_passes(self) -> bool:
        """Whether length and evaluations are counted in frame passes and not in batches."""
        return self.batches is None and self.passes is not None


@dataclass(frozen=True)
class Phase:
    """One run of the training loop within a schedule."""

    name: str
    config: TrainConfig
    out: Path


def phases(config: TrainConfig, out: Path) -> list[Phase]:
    """Unfold the schedule: `joint` is one phase; `staged` is three, the last from the first two.

    Where the branches come from `init`, and in the compared systems, there is nothing to stage; a
    system of one branch is that branch alone.
    """
    if config.schedule == "joint" or config.init or config.model.system not in STAGED:
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
        imagenet=None,  # the image branch has learnt on from there
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
        imagenet=config.imagenet if system == "image" else None,
        batches=config.branch_batches or config.batches,
        schedule="joint",
        stage="end-to-end",
        cache_branches=False,
    )
