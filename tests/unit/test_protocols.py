# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import logging

import numpy as np
import pytest

from adafusion.evaluation import PROTOCOLS, answer_groups, describe_protocol, make_splits
from adafusion.types import Frame, UserError


def frames_of(*runs: str) -> list[Frame]:
    return [
        Frame(run=run, timestamp_us=i, position_m=(0.0, 0.0, 0.0)) for i, run in enumerate(runs)
    ]


FRAMES = frames_of("b", "b", "a", "a", "a", "c")
REGIONS = np.array(["test", "train", "test", "test", "validation", "test"])


def rows(splits: list) -> dict[str, tuple[list[int], list[int]]]:
    return {s.name: (s.query_rows.tolist(), s.database_rows.tolist()) for s in splits}


def test_cross_run_asks_every_run_of_every_other() -> None:
    splits = make_splits("cross-run", FRAMES, REGIONS)
    assert rows(splits) == {
        "a->b": ([2, 3], [0]),
        "a->c": ([2, 3], [5]),
        "b->a": ([0], [2, 3]),
        "b->c": ([0], [5]),
        "c->a": ([5], [2, 3]),
        "c->b": ([5], [0]),
    }
    assert {s.radius_m for s in splits} == {20.0}
    assert not any(s.exclude_self or s.exclude_query_run for s in splits)


def test_union_pools_both_runs_and_leaves_the_query_out() -> None:
    splits = make_splits("union", FRAMES, REGIONS)
    assert rows(splits) == {
        "a+b": ([2, 3, 0], [2, 3, 0]),
        "a+c": ([2, 3, 5], [2, 3, 5]),
        "b+c": ([0, 5], [0, 5]),
    }
    assert all(s.exclude_self and not s.exclude_query_run for s in splits)


def test_union_strict_leaves_the_run_of_the_query_out() -> None:
    splits = make_splits("union-strict", FRAMES, REGIONS)
    assert rows(splits) == rows(make_splits("union", FRAMES, REGIONS))
    assert all(s.exclude_query_run for s in splits)
    assert all(s.run_ids is not None and s.run_ids.tolist() == [1, 1, 0, 0, 0, 2] for s in splits)


def test_pointnetvlad_searches_the_whole_other_run_at_25_m() -> None:
    splits = make_splits("pointnetvlad", FRAMES, REGIONS)
    assert rows(splits)["a->b"] == ([2, 3], [0, 1])
    assert rows(splits)["b->a"] == ([0], [2, 3, 4])
    assert {s.radius_m for s in splits} == {25.0}


def test_ten_runs_make_90_directed_pairs_or_45_pools() -> None:
    frames = frames_of(*(f"run{i}" for i in range(10)))
    regions = np.full(10, "test")
    counts = {name: len(make_splits(name, frames, regions)) for name in PROTOCOLS}
    assert counts == {"cross-run": 90, "union": 45, "union-strict": 45, "pointnetvlad": 90}


def test_runs_region_and_radius_can_be_chosen() -> None:
    (there, back) = make_splits("cross-run", FRAMES, REGIONS, runs=["c", "a"], radius_m=5.0)
    assert (there.name, back.name) == ("c->a", "a->c")
    assert there.radius_m == 5.0
    with pytest.raises(UserError, match="fewer than two of a, b, c have frames in the validation"):
        make_splits("cross-run", FRAMES, REGIONS, region="validation")


def test_a_run_outside_the_region_asks_nothing_and_is_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    regions = np.array(["test", "test", "test", "test", "test", "train"])
    with caplog.at_level(logging.WARNING):
        splits = make_splits("cross-run", FRAMES, regions)
    assert set(rows(splits)) == {"a->b", "b->a"}
    assert "no frame in the test region: c" in caplog.text
    # in this protocol it still answers, with its whole route
    assert set(rows(make_splits("pointnetvlad", FRAMES, regions))) == {
        "a->b", "b->a", "a->c", "b->c",
    }  # fmt: skip


def test_it_says_which_protocols_and_runs_there_are() -> None:
    with pytest.raises(UserError, match="choose from cross-run, union, union-strict, pointnetvlad"):
        make_splits("crossrun", FRAMES, REGIONS)
    with pytest.raises(UserError, match="no run d here: choose from a, b, c"):
        make_splits("union", FRAMES, REGIONS, runs=["a", "d"])


@pytest.mark.parametrize("radius_m", [0.0, -20.0, float("nan"), float("inf")])
def test_it_refuses_a_radius_that_is_no_length(radius_m: float) -> None:
    with pytest.raises(UserError, match="finite radius above 0"):
        make_splits("cross-run", FRAMES, REGIONS, radius_m=radius_m)


def test_it_says_who_may_not_answer_whom() -> None:
    groups = {}
    for name in ("cross-run", "union", "union-strict"):
        split = make_splits(name, FRAMES, REGIONS)[0]
        asking, answering = answer_groups(split, split.query_rows)
        groups[name] = (asking[:, None] == answering).tolist()
    assert groups["cross-run"] == [[False], [False]]  # a's frames 2 and 3 ask b's 0
    assert groups["union"] == [[True, False, False], [False, True, False], [False, False, True]]
    assert groups["union-strict"] == [
        [True, True, False],
        [True, True, False],
        [False, False, True],
    ]


def test_it_refuses_regions_that_do_not_fit_the_frames() -> None:
    with pytest.raises(ValueError, match="2 regions for 6 frames"):
        make_splits("union", FRAMES, REGIONS[:2])


@pytest.mark.parametrize("name", list(PROTOCOLS))
def test_every_protocol_speaks(name: str) -> None:
    words = describe_protocol(name, radius_m=12.5, region="validation")
    assert "12.5 m" in words
    assert "validation region" in words
    assert "{" not in words
