# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Ground removal: the road looks the same everywhere and says little about the place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, kw_only=True)
class Ground:
    """How ground points are found; `height` drops what lies below `height_m` in the body frame."""

    method: Literal["none", "height"] = "none"
    height_m: float = 0.3

    def __post_init__(self) -> None:
        if self.method not in ("none", "height"):
            raise ValueError(f"unknown ground method {self.method!r}; choose none or height")
        if not math.isfinite(self.height_m):
            raise ValueError(f"ground height_m {self.height_m} must be finite")
        object.__setattr__(self, "height_m", float(self.height_m) + 0.0)


def remove_ground(
    points_body: Float[np.ndarray, "n 3"], ground: Ground
) -> Float[np.ndarray, "m 3"]:
    """Points (metres, body frame, where the ground is z = 0) that are not ground.

    `height` is the paper's height threshold: a point stays when z >= `height_m`.
    """
    if ground.method == "none":
        return points_body
    return points_body[points_body[:, 2] >= ground.height_m]
