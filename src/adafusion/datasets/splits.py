# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Regions: which part of the world a frame is in, so that training and test never share one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Shaped

TRAIN = "train"  # the region of every place that no box holds

Regions = Mapping[str, Sequence[Sequence[float]]]  # name -> boxes [xmin, ymin, xmax, ymax], metres


def region_of(positions_xy: Float[np.ndarray, "n 2"], regions: Regions) -> Shaped[np.ndarray, " n"]:
    """Name of the region of each position (world frame, metres); "train" where no box holds it.

    A box owns its lower edges and not its upper ones (xmin <= x < xmax), so boxes that touch share
    no place. Where boxes of two regions overlap, the region named first owns the place.
    """
    names = np.full(len(positions_xy), TRAIN, dtype=object)
    x, y = positions_xy.T
    for name in reversed(list(regions)):
        for xmin, ymin, xmax, ymax in regions[name]:
            names[(xmin <= x) & (x < xmax) & (ymin <= y) & (y < ymax)] = name
    return names.astype(np.str_)
