# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from adafusion.evaluation import summarize_alpha
from adafusion.experiments.judging import pooled_alpha
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


def test_weights_of_several_worlds_are_those_of_all_their_frames() -> None:
    rng = np.random.default_rng(0)
    worlds = [rng.random((n, 2)).astype(np.float32) for n in (3, 11)]
    zones = [["hall", "park", "park"], ["park"] * 11]
    records = [
        {"model": {"alpha": {k: asdict(v) for k, v in summaries.items()}}}
        for summaries in (
            summarize_alpha(alpha) | summarize_alpha(alpha, zone)
            for alpha, zone in zip(worlds, zones, strict=True)
        )
    ]
    found = pooled_alpha(records)
    assert found is not None
    together = np.concatenate(worlds)
    whole = summarize_alpha(together) | summarize_alpha(together, [*zones[0], *zones[1]])
    assert found.keys() == whole.keys()
    for name, summary in whole.items():
        assert found[name]["num_frames"] == summary.num_frames
        assert found[name]["mean"] == pytest.approx(summary.mean)
        assert found[name]["std"] == pytest.approx(summary.std)
    assert pooled_alpha(records[:1]) == records[0]["model"]["alpha"]
    assert pooled_alpha([{"model": {"alpha": None}}] * 2) is None
