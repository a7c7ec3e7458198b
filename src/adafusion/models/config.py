# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a model is, as data: enough to build it again and to feed it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from adafusion.models.pooling import Pooling
from adafusion.preprocess import Preprocess

System = Literal[
    "adafusion",
    "concat",
    "image",
    "lidar",
    "netvlad",
    "pointnetvlad",
    "minkloc",
    "coral",
    "pic-net",
    "oertel",
]
Attention = Literal["released", "paper"]
ImageBackbone = Literal["paper", "efficientnet-lite0"]
Fusion = Literal["weights", "one-stage-weights", "linear"]

LEVELS = 3  # of the paper's branches
STAGED = ("adafusion", "concat", "image", "lidar")  # systems whose branches can be trained alone
OF_BRANCHES = (*STAGED, "oertel")  # systems made of the paper's branches
IMAGE_SYSTEMS, LIDAR_SYSTEMS = ("image", "netvlad"), ("lidar", "pointnetvlad")  # of one sensor

# settings that change what becomes of the branches' outputs, and not the branches
FUSION_SETTINGS = (
    "system",
    "attention_levels",
    "attention",
    "fusion",
    "attend_features",
    "normalise_halves",
    "unit_length",
)


@dataclass(frozen=True, kw_only=True)
class ModelConfig:
    """Which system, how large, and how its input is made.

    `adafusion` weighs two branches, `concat` joins them unweighted, `image` and `lidar` are one
    branch alone, whose descriptor is its half: `dim // 2` numbers. The others are the systems of
    the paper's comparison, each in the module of its name.
    """

    system: System = "adafusion"
    dim: int = 256  # length of the fused descriptor; 0: as long as the compared system's own is
    width: float = 1.0  # channels, as a share of the paper's
    clusters: int = 64  # of systems that gather local features by VLAD
    image_backbone: ImageBackbone = "paper"  # adafusion, concat, image: `width` scales the paper's
    last_norm: bool = True  # the paper's batch norm before each branch's last pool
    pooling: Pooling = "gap"  # of each branch's last map, see `models/pooling.py`
    unit_length: bool = False  # the descriptor has L2 length 1, and is searched by L2
    attention_levels: int = 3  # adafusion: the n deepest; 0: weights from the pooled features
    attention: Attention = "released"
    fusion: Fusion = "weights"  # adafusion: see there
    attend_features: bool = False  # adafusion: attention joins the features, not the weights alone
    normalise_halves: bool = False  # adafusion, concat and branches: see `unit_scale`
    preprocess: Preprocess = field(default_factory=Preprocess)

    def __post_init__(self) -> None:
        if self.system not in get_args(System):
            raise ValueError(f"system {self.system!r}: choose {', '.join(get_args(System))}")
        if self.system in OF_BRANCHES and (self.dim < 2 or self.dim % 2):
            raise ValueError(f"dim {self.dim} must be even: each sensor gives one half")
        if self.dim < 0 or self.clusters < 2:
            raise ValueError(f"dim {self.dim} and clusters {self.clusters}: not so few")
        if not 0 < self.width <= 4:
            raise ValueError(f"width {self.width} must be in (0, 4]")
        if not 0 <= self.attention_levels <= LEVELS:
            raise ValueError(f"attention_levels {self.attention_levels} must be 0 to {LEVELS}")
        if self.attention not in ("released", "paper"):
            raise ValueError(f"attention {self.attention!r}: choose released or paper")
        if self.pooling not in get_args(Pooling):
            raise ValueError(f"pooling {self.pooling!r}: choose {', '.join(get_args(Pooling))}")
        if (self.pooling != "gap" or self.unit_length) and self.system not in OF_BRANCHES:
            raise ValueError(f"pooling and unit_length: {self.system} has its own way")
        if self.fusion not in get_args(Fusion):
            raise ValueError(f"fusion {self.fusion!r}: choose {', '.join(get_args(Fusion))}")
        if self.attention_levels == 0 and self.fusion == "one-stage-weights":
            raise ValueError("one-stage-weights come from attention: set attention_levels")
        if self.attend_features and (self.attention_levels == 0 or self.fusion == "linear"):
            raise ValueError("attend_features needs attention_levels, and weights as the fusion")
        if self.image_backbone not in get_args(ImageBackbone):
            choices = ", ".join(get_args(ImageBackbone))
            raise ValueError(f"image_backbone {self.image_backbone!r}: choose {choices}")
        if self.image_backbone != "paper" and self.system not in STAGED:
            raise ValueError(f"image_backbone {self.image_backbone}: {self.system} has its own")

    @property
    def branches(self) -> ModelConfig:
        """The same branches under the default fusion: what two fusions of them have in common."""
        plain = ModelConfig()
        return replace(self, **{name: getattr(plain, name) for name in FUSION_SETTINGS})

    @property
    def sensors(self) -> tuple[str, ...]:
        """Which sensors the system looks at, in the order of `SENSORS`."""
        if self.system in IMAGE_SYSTEMS:
            return ("image",)
        return ("lidar",) if self.system in LIDAR_SYSTEMS else ("image", "lidar")

    @property
    def p(self) -> int:
        """The distance that the system is trained and searched by: 1 for L1, 2 for L2."""
        return 1 if self.system in OF_BRANCHES and not self.unit_length else 2
