# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from adafusion.experiments.studies.weighting import EQUAL, SHARES, FixedShares, at_share
from adafusion.types import Descriptions


def test_a_share_weighs_the_image_and_the_rest_the_lidar() -> None:
    seen = Descriptions(
        None, np.array([[4.0, 8.0]], np.float32), np.array([[40.0, 80.0]], np.float32), None
    )
    assert at_share(seen, 0.25).tolist() == [[1.0, 2.0, 30.0, 60.0]]


@pytest.mark.parametrize(
    ("tops", "best"), [((3,), 3), ((0, 9), 9), ((2, 12, 20), 12), (range(21), EQUAL)]
)
def test_the_best_share_is_the_most_even_of_equals(tops: tuple[int, ...], best: int) -> None:
    validation = np.zeros(len(SHARES))
    validation[list(tops)] = 0.5
    assert FixedShares(validation, np.zeros((len(SHARES), 1), np.int64)).best == best
