# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Fixed shares and those chosen by condition, on a handful of queries."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from adafusion.evaluation import summarize_alpha
from adafusion.experiments.judging import Questions, pooled_alpha
from adafusion.experiments.studies.described import at_weights
from adafusion.experiments.studies.weighting import (
    EQUAL,
    SHARES,
    FixedShares,
    far_from_blocks,
    shares_by_condition,
)
from adafusion.experiments.verdict import Asked
from adafusion.models import ModelConfig
from adafusion.types import Descriptions

# three shares; queries 0 to 3 of one condition, 4 and 5 of another; two blocks, far from each other
HITS = np.array(
    [
        [1, 1, 0, 0, 0, 0],
        [0, 0, 1, 0, 1, 1],
        [0, 0, 1, 1, 0, 0],
    ]
)
CONDITION = np.array([0, 0, 0, 0, 1, 1])
BLOCK = np.array([0, 0, 1, 1, 0, 1])


def test_a_share_is_chosen_where_it_is_far() -> None:
    # block 0 takes share 2 of block 1 and block 1 takes share 0 of block 0: both are wrong there
    is_far = np.stack([block != BLOCK for block in (0, 1)])
    said = shares_by_condition(HITS, 1, CONDITION, BLOCK, is_far)
    assert said.tolist() == [0, 0, 0, 0, 1, 1]


def test_with_nothing_far_and_among_equals_the_nearest_to_the_fixed_share_answers() -> None:
    for otherwise in range(3):
        said = shares_by_condition(HITS, otherwise, CONDITION, BLOCK, np.zeros((2, 6), np.bool_))
        assert said.tolist() == HITS[otherwise].tolist()


def test_far_is_a_hundred_metres_from_all_of_a_block_or_another_world() -> None:
    x = np.array([0.0, 30.0, 99.0, 131.0, 0.0])
    asked = Asked(np.zeros(5, np.int64), np.array([0, 0, 1, 2, 3]), np.array([0, 0, 0, 0, 1]))
    is_far = far_from_blocks(asked, np.column_stack([x, np.zeros(5)]))
    assert is_far.astype(int).tolist() == [
        [0, 0, 0, 1, 1],
        [0, 0, 0, 0, 1],
        [1, 1, 0, 0, 1],
        [1, 1, 1, 1, 0],
    ]


def test_conditions_are_zones_and_kinds_of_pairs() -> None:
    split = np.array([0, 0, 1, 2, 2])
    asked = Asked(split, np.zeros(5, np.int64), np.zeros(5, np.int64))
    kinds = (frozenset({"with night"}), frozenset({"none of these"}), frozenset({"with night"}))
    zone = np.array(["hall", "street", "hall", "hall", "street"])
    night_hall, night_street, hall, *rest = (
        Questions(asked, np.zeros((5, 2)), zone, kinds).conditions().tolist()
    )
    assert len({night_hall, night_street, hall}) == 3
    assert rest == [night_hall, night_street]


def test_weights_of_our_choice_join_the_halves_as_the_models_own_do() -> None:
    seen = Descriptions(
        None, np.array([[4.0, 8.0]], np.float32), np.array([[40.0, 80.0]], np.float32), None
    )
    joined = [1.0, 2.0, 30.0, 60.0]
    assert at_weights(seen, (0.25, 0.75), ModelConfig()).tolist() == [joined]
    of_length_1 = at_weights(seen, (0.25, 0.75), ModelConfig(unit_length=True))
    np.testing.assert_allclose(of_length_1, [np.array(joined) / np.linalg.norm(joined)], rtol=1e-6)
    with pytest.raises(ValueError, match="two halves"):
        at_weights(seen._replace(lidar_half=None), (0.25, 0.75), ModelConfig())


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
