# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from adafusion.training.pairs import epoch_rng, find_pairs, place_batches, sample_negatives
from adafusion.types import UserError

# whole metres: some pairs lie at exactly 10 m or 50 m
frames = st.lists(
    st.tuples(st.integers(0, 1000), st.integers(0, 200), st.integers(0, 2)), min_size=1, max_size=40
)


@given(frames)
@settings(deadline=None)
def test_pairs_are_those_of_a_double_loop(frames: list[tuple[int, int, int]]) -> None:
    positions = np.array([(x, y) for x, y, _ in frames], float)
    world = np.array([w for _, _, w in frames])
    pairs = find_pairs(positions, world)
    positive, negatives = [], 0
    for i in range(len(frames)):
        for j in range(i + 1, len(frames)):
            squared = float(np.square(positions[i] - positions[j]).sum())
            if world[i] == world[j] and squared <= 100.0:
                positive.append([i, j])
            if world[i] != world[j] or squared > 2500.0:
                negatives += 1
    assert pairs.positive.tolist() == positive
    assert pairs.num_negatives == negatives


@given(frames, st.integers(2, 6), st.integers(2, 5), st.integers(0, 99))
@settings(deadline=None)
def test_a_batch_holds_true_and_wrong_pairs_and_no_others(
    frames: list[tuple[int, int, int]], places: int, views: int, seed: int
) -> None:
    positions = np.array([(x, y) for x, y, _ in frames], float)
    world = np.array([w for _, _, w in frames])
    pairs = find_pairs(positions, world)
    try:
        batches = list(place_batches(pairs, places, views, epoch_rng(seed, 0), run=world))
    except UserError:
        return
    for batch in batches:
        assert len(batch.rows) <= places * views
        a, b = batch.rows[batch.pair].T
        gap = np.hypot(*(positions[a] - positions[b]).T)
        same = world[a] == world[b]
        assert (batch.is_positive == (same & (gap <= 10.0))).all()
        assert (~batch.is_positive == (~same | (gap > 50.0))).all()


@given(frames, st.integers(0, 99))
@settings(deadline=None)
def test_a_drawn_negative_is_always_far(frames: list[tuple[int, int, int]], seed: int) -> None:
    positions = np.array([(x, y) for x, y, _ in frames], float)
    world = np.array([w for _, _, w in frames])
    pairs = find_pairs(positions, world)
    anchors = np.arange(len(frames))
    try:
        drawn = sample_negatives(pairs, anchors, epoch_rng(seed, 0))
    except UserError:
        gap = np.hypot(*(positions[:, None] - positions[None]).transpose(2, 0, 1))
        far = (gap > 50.0) | (world[:, None] != world[None])
        assert not far.any(axis=1).all()
        return
    gap = np.hypot(*(positions - positions[drawn]).T)
    assert ((gap > 50.0) | (world != world[drawn])).all()
