# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from adafusion.datasets.splits import region_of, rows_in

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


def test_rows_of_the_regions_share_none_and_miss_none() -> None:
    positions = np.random.default_rng(0).uniform(-20.0, 80.0, (500, 2))
    rows = [rows_in(region, positions, REGIONS) for region in ("train", "test", "validation")]
    assert sorted(np.concatenate(rows).tolist()) == list(range(500))
    assert all(len(some) > 0 for some in rows)


def test_a_region_that_nobody_defined_is_refused() -> None:
    with pytest.raises(ValueError, match=r"unknown region 'tset'.*train.*test.*validation"):
        rows_in("tset", np.zeros((1, 2)), REGIONS)
