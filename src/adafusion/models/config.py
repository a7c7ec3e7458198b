# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a model is, as data: enough to build it again and to feed it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

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

LEVELS = 3  # of the paper's branches
IMAGE_SYSTEMS, LIDAR_SYSTEMS = ("image", "netvlad"), ("lidar", "pointnetvlad")  # of one sensor


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
    attention_levels: int = 3  # adafusion: the n deepest; 0: weights from the pooled features
    attention: Attention = "released"
    preprocess: Preprocess = field(default_factory=Preprocess)

    def __post_init__(self) -> None:
        if self.system not in get_args(System):
            raise ValueError(f"system {self.system!r}: choose {', '.join(get_args(System))}")
        if self.system in ("adafusion", "concat", "image", "lidar", "oertel") and (
            self.dim < 2 or self.dim % 2
        ):
            raise ValueError(f"dim {self.dim} must be even: each sensor gives one half")
        if self.dim < 0 or self.clusters < 2:
            raise ValueError(f"dim {self.dim} and clusters {self.clusters}: not so few")
        if not 0 < self.width <= 4:
            raise ValueError(f"width {self.width} must be in (0, 4]")
        if not 0 <= self.attention_levels <= LEVELS:
            raise ValueError(f"attention_levels {self.attention_levels} must be 0 to {LEVELS}")
        if self.attention not in ("released", "paper"):
            raise ValueError(f"attention {self.attention!r}: choose released or paper")

    @property
    def sensors(self) -> tuple[str, ...]:
        """Which sensors the system looks at, in the order of `SENSORS`."""
        if self.system in IMAGE_SYSTEMS:
            return ("image",)
        return ("lidar",) if self.system in LIDAR_SYSTEMS else ("image", "lidar")

    @property
    def p(self) -> int:
        """The distance that the system is trained and searched by: 1 for L1, 2 for L2."""
        return 1 if self.system in ("adafusion", "concat", "image", "lidar", "oertel") else 2
