# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from adafusion.datasets.splits import Published, region_of
from adafusion.evaluation.split_counts import count_split, possible_pairs
from adafusion.types import Frame

REGIONS = {"test": [[0.0, 0.0, 100.0, 100.0]], "guard": [[-10.0, -10.0, 110.0, 110.0]]}


def drive(**runs: list[tuple[float, float]]) -> tuple[list[Frame], np.ndarray]:
    frames = [
        Frame(run=run, timestamp_us=t, position_m=(*xy, 7.0))
        for run, way in runs.items()
        for t, xy in enumerate(way)
    ]
    return frames, np.array([frame.position_m for frame in frames])


def test_it_counts_by_hand() -> None:
    counts = count_split(
        *drive(
            a=[(50.0, 50.0), (90.0, 50.0), (105.0, 50.0), (200.0, 50.0), (210.0, 50.0)],
            b=[(50.0, 70.0), (260.0, 50.0)],
            c=[(300.0, 50.0)],
        ),
        REGIONS,
    )
    assert counts.frames == {"train": 4, "validation": 0, "guard": 1, "test": 3}
    assert counts.true_pairs == 1  # 200 and 210, exactly 10 m
    # of the six pairs of 200, 210, 260, 300 all but (200, 210) and (260, 300); 50 m is apart
    assert counts.wrong_pairs == 4
    assert counts.queries == 3  # a's two ask b's map, b's one asks a's; c has no test frame
    assert counts.answerable == 2  # (50, 50) and (50, 70) are exactly 20 m apart
    assert counts.nearest_m == 110.0


def test_it_agrees_with_a_slow_count_of_all_pairs() -> None:
    rng = np.random.default_rng(2)
    ways = {run: [tuple(xy) for xy in rng.uniform(-200, 200, (150, 2))] for run in "abc"}
    frames, positions = drive(**ways)
    counts = count_split(frames, positions, REGIONS)
    names = region_of(positions[:, :2], REGIONS)
    train, test = (np.flatnonzero(names == name) for name in ("train", "test"))

    def apart(i: int, j: int) -> float:
        return float(np.hypot(*(positions[i] - positions[j])[:2]))

    pairs = [apart(i, j) for i in train for j in train if i < j]
    assert counts.true_pairs == sum(d <= 10.0 for d in pairs)
    assert counts.wrong_pairs == sum(d >= 50.0 for d in pairs)
    queries = [
        any(apart(i, j) <= 20.0 for j in test if frames[j].run == run)
        for i in test
        for run in ways
        if run != frames[i].run
    ]
    assert (counts.queries, counts.answerable) == (len(queries), sum(queries))
    assert counts.nearest_m == pytest.approx(min(apart(i, j) for i in train for j in test))


@pytest.mark.parametrize("regions", [{}, {"test": [[-1e9, -1e9, 1e9, 1e9]]}])
def test_a_part_that_is_empty_counts_nothing(regions: dict[str, list[list[float]]]) -> None:
    counts = count_split(*drive(a=[(0.0, 0.0), (60.0, 0.0)]), regions)
    assert (counts.true_pairs, counts.wrong_pairs) == (0, 0 if regions else 1)
    assert (counts.queries, counts.answerable, counts.nearest_m) == (0, 0, np.inf)


def test_it_says_how_far_a_paper_is() -> None:
    paper = Published(
        source="p", train_frames=5, test_frames=2, true_pairs=1, wrong_pairs=4, queries=2
    )
    counts = count_split(
        *drive(a=[(50.0, 50.0), (200.0, 0.0), (209.0, 0.0)], b=[(50.0, 60.0), (300.0, 0.0)]),
        REGIONS,
    )
    off = counts.differences(paper)
    assert off == pytest.approx(
        {
            "train_frames": -0.4,
            "test_frames": 0.0,
            "true_pairs": 0.0,
            "wrong_pairs": -0.5,
            "queries": 0.0,
        }
    )
    assert counts.distance(paper) == pytest.approx(0.2)


def test_so_many_frames_make_so_many_pairs() -> None:
    assert [possible_pairs(n) for n in (0, 1, 2, 4)] == [0, 0, 1, 6]
