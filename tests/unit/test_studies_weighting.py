# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Shares chosen by condition, on a handful of queries."""

from __future__ import annotations

import numpy as np

from adafusion.experiments.judging import Questions
from adafusion.experiments.studies.weighting import shares_by_condition
from adafusion.experiments.verdict import Asked

# three shares; queries 0 to 3 of one condition, 4 and 5 of another; halves of two queries each
HITS = np.array(
    [
        [1, 1, 0, 0, 0, 0],
        [0, 0, 1, 0, 1, 1],
        [0, 0, 1, 1, 0, 0],
    ]
)
CONDITION = np.array([0, 0, 0, 0, 1, 1])
HALF = np.array([0, 0, 1, 1, 0, 1])


def test_a_share_is_chosen_on_the_other_half() -> None:
    # half 0 takes share 2 of half 1 and half 1 takes share 0 of half 0: both are wrong there
    said = shares_by_condition(HITS, 1, CONDITION, HALF)
    assert said.tolist() == [0, 0, 0, 0, 1, 1]


def test_without_the_other_half_and_among_equals_the_nearest_to_the_fixed_share_answers() -> None:
    alone = np.zeros(6, np.int64)
    for otherwise in range(3):
        said = shares_by_condition(HITS, otherwise, CONDITION, alone)
        assert said.tolist() == HITS[otherwise].tolist()


def test_conditions_are_zones_and_kinds_of_pairs() -> None:
    split = np.array([0, 0, 1, 2, 2])
    asked = Asked(split, np.zeros(5, np.int64), np.zeros(5, np.int64))
    kinds = (frozenset({"with night"}), frozenset({"none of these"}), frozenset({"with night"}))
    zone = np.array(["hall", "street", "hall", "hall", "street"])
    night_hall, night_street, hall, *rest = Questions(asked, zone, kinds).conditions().tolist()
    assert len({night_hall, night_street, hall}) == 3
    assert rest == [night_hall, night_street]
