# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np

from adafusion.datasets.splits import region_of

REGIONS = {
    "test": [[0.0, 0.0, 10.0, 10.0], [50.0, 0.0, 60.0, 10.0]],
    "validation": [[10.0, 0.0, 20.0, 10.0]],
}


def test_a_place_belongs_to_the_box_that_holds_it() -> None:
    positions = np.array([[5.0, 5.0], [55.0, 5.0], [15.0, 5.0], [30.0, 5.0], [5.0, -5.0]])
    expected = ["test", "test", "validation", "train", "train"]
    assert region_of(positions, REGIONS).tolist() == expected


def test_a_box_owns_its_lower_edges_only() -> None:
    positions = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [5.0, 10.0]])
    assert region_of(positions, REGIONS).tolist() == ["test", "validation", "train", "train"]


def test_the_region_named_first_owns_an_overlap() -> None:
    overlapping = {"a": [[0.0, 0.0, 2.0, 2.0]], "b": [[1.0, 1.0, 3.0, 3.0]]}
    positions = np.array([[1.5, 1.5], [2.5, 2.5]])
    assert region_of(positions, overlapping).tolist() == ["a", "b"]


def test_without_regions_all_is_for_training() -> None:
    assert region_of(np.zeros((3, 2)), {}).tolist() == ["train"] * 3
    assert region_of(np.zeros((0, 2)), REGIONS).tolist() == []
