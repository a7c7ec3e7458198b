# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from adafusion.evaluation import compare, evaluate_splits, make_splits, result_record
from adafusion.files import write_json
from adafusion.types import Estimate, Frame, Split, UserError


def split(query: list[int], database: list[int], **options: object) -> Split:
    return Split(
        name="q->d",
        protocol="cross-run",
        radius_m=20.0,
        query_rows=np.array(query, int),
        database_rows=np.array(database, int),
        **options,
    )


# four places 100 m apart, seen twice: frames 0-3 and 4-7; the last view of the last place is wrong
POSITIONS = np.array([[100.0 * i, 0.0] for i in (0, 1, 2, 3)] * 2)
DESCRIPTORS = np.array([[0], [1], [2], [3], [0.1], [1.1], [2.1], [0.2]], np.float32)


def test_it_counts_who_finds_a_true_match() -> None:
    e = evaluate_splits(DESCRIPTORS, POSITIONS, [split([4, 5, 6, 7], [0, 1, 2, 3])], ks=(1, 2, 4))
    assert e.recall == {"AR@1%": 0.75, "AR@1": 0.75, "AR@2": 0.75, "AR@4": 1.0}
    assert e.pooled_recall == e.recall
    (result,) = e.results
    assert result.first_hit.tolist() == [1, 1, 1, 4]
    assert result.top_row.tolist() == [0, 1, 2, 0]
    assert result.hit_row.tolist() == [0, 1, 2, 3]
    assert (e.num_queries, e.num_unanswerable, e.num_places) == (4, 0, 4)


def test_it_leaves_out_and_counts_queries_without_a_true_match() -> None:
    e = evaluate_splits(DESCRIPTORS, POSITIONS, [split([4, 7], [0, 1, 2])])
    assert (e.num_queries, e.num_unanswerable) == (2, 1)
    assert e.results[0].first_hit.tolist() == [1, 0]
    assert e.results[0].hit_row.tolist() == [0, -1]
    assert e.recall["AR@1"] == 1.0


def test_it_searches_a_database_smaller_than_n_whole() -> None:
    e = evaluate_splits(DESCRIPTORS, POSITIONS, [split([7], [0, 3])])
    assert e.recall["AR@1"] == 0.0
    assert e.recall["AR@2"] == e.recall["AR@25"] == 1.0


def test_nobody_answers_from_an_empty_database() -> None:
    e = evaluate_splits(DESCRIPTORS, POSITIONS, [split([4], []), split([4], [0])])
    assert e.results[0].first_hit.tolist() == [0]
    assert e.results[0].top_row.tolist() == e.results[0].hit_row.tolist() == [-1]


def test_it_averages_splits_without_weights_and_pools_beside() -> None:
    splits = [split([4, 5, 6], [0, 1, 2]), split([7], [0, 3]), split([7], [0])]
    e = evaluate_splits(DESCRIPTORS, POSITIONS, splits, ks=(1,))
    assert e.recall["AR@1"] == 0.5  # the third split has no answerable query
    assert e.pooled_recall["AR@1"] == 0.75


def test_it_lets_no_frame_answer_itself() -> None:
    everyone = list(range(8))
    free = evaluate_splits(DESCRIPTORS, POSITIONS, [split(everyone, everyone)])
    assert free.results[0].top_row.tolist() == everyone
    e = evaluate_splits(DESCRIPTORS, POSITIONS, [split(everyone, everyone, exclude_self=True)])
    assert e.results[0].top_row.tolist() == [4, 5, 6, 6, 0, 1, 2, 4]
    assert e.results[0].first_hit.tolist() == [1, 1, 1, 5, 1, 1, 1, 7]


def test_it_lets_no_frame_of_the_querys_run_answer() -> None:
    everyone = list(range(8))
    strict = split(everyone, everyone, exclude_query_run=True, run_ids=np.array([0] * 4 + [1] * 4))
    e = evaluate_splits(DESCRIPTORS, POSITIONS, [strict])
    assert e.results[0].top_row.tolist() == [4, 5, 6, 6, 0, 1, 2, 0]
    with pytest.raises(ValueError, match="excludes runs and does not say"):
        evaluate_splits(DESCRIPTORS, POSITIONS, [split(everyone, everyone, exclude_query_run=True)])


def test_height_does_not_decide_what_a_true_match_is() -> None:
    lifted = np.column_stack([POSITIONS, np.arange(8) * 1000.0])
    e = evaluate_splits(DESCRIPTORS, lifted, [split([4], [0])])
    assert e.num_unanswerable == 0


def test_union_is_easier_than_union_strict_where_runs_look_different() -> None:
    rng = np.random.default_rng(0)
    place = np.tile(np.arange(40), 2)
    night = np.repeat([0.0, 3.0], 40)[:, None]
    descriptors = np.cumsum(rng.normal(size=(40, 16)), axis=0)[place] + night
    descriptors = (descriptors + rng.normal(size=(80, 16))).astype(np.float32)
    positions = np.column_stack([place * 10.0, np.zeros(80)])
    frames = [
        Frame(run="night" if i >= 40 else "day", timestamp_us=i, position_m=(0.0, 0.0, 0.0))
        for i in range(80)
    ]
    score = {
        name: evaluate_splits(
            descriptors, positions, make_splits(name, frames, np.full(80, "test"))
        ).recall["AR@1"]
        for name in ("union", "union-strict", "cross-run")
    }
    assert score["union"] > score["union-strict"]
    assert score["union-strict"] == pytest.approx(score["cross-run"])  # two runs of one size


def two_systems() -> tuple:
    """A system that misses every fifth place, and one that misses those and every seventh."""
    n = 105
    positions = np.column_stack([np.arange(n) * 60.0, np.zeros(n)])
    positions = np.concatenate([positions, positions])
    splits = [split(list(range(n, 2 * n)), list(range(n)))]
    good = np.concatenate([np.arange(n), np.arange(n)]).astype(np.float32)
    good[n::5] += 2.0
    worse = good.copy()
    worse[n::7] = good[n::7] + 2.0
    return (
        evaluate_splits(good[:, None], positions, splits),
        evaluate_splits(worse[:, None], positions, splits),
    )


def test_intervals_hold_the_value_and_repeat_with_the_seed() -> None:
    good, _ = two_systems()
    estimates = good.estimates(seed=0)
    assert {name: e.value for name, e in estimates.items()} == good.recall
    assert all(e.interval[0] <= e.value <= e.interval[1] for e in estimates.values())
    assert estimates == good.estimates(seed=0)
    assert estimates["AR@1"] != good.estimates(seed=1)["AR@1"]
    # 105 places, each its own block: near the binomial 1.96 sqrt(p (1 - p) / n)
    low, high = estimates["AR@1"].interval
    assert high - low == pytest.approx(2 * 1.96 * np.sqrt(0.8 * 0.2 / 105), rel=0.1)


def test_a_paired_comparison_sees_what_two_intervals_do_not() -> None:
    good, worse = two_systems()
    a, b = good.estimates(seed=0)["AR@1"], worse.estimates(seed=0)["AR@1"]
    assert b.interval[1] > a.interval[0]  # they overlap
    gap = compare(good, worse, seed=0)["AR@1"]
    assert gap.value == pytest.approx(a.value - b.value)
    assert gap.interval[0] > 0
    same = compare(good, good, seed=0)["AR@1"]
    assert (same.value, same.interval) == (0.0, (0.0, 0.0))


def test_only_answers_to_the_same_questions_are_compared() -> None:
    one = evaluate_splits(DESCRIPTORS, POSITIONS, [split([4, 5], [0, 1])])
    two = evaluate_splits(DESCRIPTORS, POSITIONS, [split([4, 6], [0, 2])])
    with pytest.raises(ValueError, match="same queries"):
        compare(one, two, seed=0)


def test_one_place_alone_says_nothing() -> None:
    e = evaluate_splits(DESCRIPTORS, POSITIONS, [split([4], [0, 1])])
    assert e.estimates(seed=0)["AR@1"].interval == (0.0, 1.0)
    assert compare(e, e, seed=0)["AR@1"].interval == (-1.0, 1.0)


def test_it_says_when_no_query_has_a_true_match() -> None:
    with pytest.raises(UserError, match="no query has a true match within 20 m"):
        evaluate_splits(DESCRIPTORS, POSITIONS, [split([7], [0])])


def test_it_refuses_what_makes_no_evaluation() -> None:
    with pytest.raises(ValueError, match="one protocol"):
        evaluate_splits(DESCRIPTORS, POSITIONS, [])
    with pytest.raises(ValueError, match="ks must hold 1"):
        evaluate_splits(DESCRIPTORS, POSITIONS, [split([4], [0])], ks=(5, 10))
    with pytest.raises(ValueError, match="finite"):
        evaluate_splits(DESCRIPTORS * np.nan, POSITIONS, [split([4], [0])])


def test_an_estimate_is_printed_in_percent_with_its_interval() -> None:
    assert Estimate(0.75, (0.5, 1.0)).in_percent() == "75.0 [50.0, 100.0]"
    assert Estimate(0.0312, (-0.01, 0.05)).in_percent("+") == "+3.1 [-1.0, +5.0]"
    assert Estimate(0.75).in_percent() == "75.0"


def test_the_record_holds_what_a_repetition_needs(tmp_path: Path) -> None:
    splits = [split([4, 5, 6, 7], [0, 1, 2, 3]), split([7], [0])]
    e = evaluate_splits(DESCRIPTORS, POSITIONS, splits, ks=(1, 5))
    record = result_record(e, model={"fingerprint": "abc"}, data={"name": "toy"}, seed=7)
    write_json(tmp_path / "result.json", record)
    read = json.loads((tmp_path / "result.json").read_text())
    assert read["protocol"]["name"] == "cross-run"
    assert "20 m" in read["protocol"]["words"]
    assert read["protocol"]["descriptor_distance"] == "L1"
    assert read["counts"] == {
        "splits": 2,
        "splits_without_answerable_query": 1,
        "queries": 5,
        "unanswerable": 1,
        "places": 4,
    }
    assert read["recall"]["AR@1"]["value"] == 0.75
    assert len(read["recall"]["AR@1"]["interval"]) == 2
    assert read["splits"][0]["recall@1"] == 0.75
    assert read["splits"][1]["recall@1"] is None
    assert read["intervals"]["seed"] == 7
    assert (read["model"], read["data"]) == ({"fingerprint": "abc"}, {"name": "toy"})
    assert "numpy" in read["software"]
    assert "commit" in read
