# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adafusion.evaluation import PROTOCOLS, evaluate_splits, make_splits
from adafusion.types import Frame


def world(seed: int) -> tuple:
    """Three runs of twelve places, 15 m apart, that look a little alike from run to run."""
    rng = np.random.default_rng(seed)
    place = np.tile(np.arange(12), 3)
    descriptors = rng.normal(size=(12, 4))[place] + rng.normal(size=(36, 4))
    positions = np.column_stack([place * 15.0, rng.normal(0.0, 3.0, 36)])
    frames = [
        Frame(run=f"run{i // 12}", timestamp_us=i, position_m=(0.0, 0.0, 0.0)) for i in range(36)
    ]
    return descriptors.astype(np.float32), positions, frames


@given(st.sampled_from(list(PROTOCOLS)), st.integers(0, 999))
@settings(deadline=None, max_examples=30)
def test_the_order_of_frames_changes_no_recall(protocol: str, seed: int) -> None:
    descriptors, positions, frames = world(seed)
    test = np.full(36, "test")
    plain = evaluate_splits(descriptors, positions, make_splits(protocol, frames, test))
    order = np.random.default_rng(seed).permutation(36)
    mixed = evaluate_splits(
        descriptors[order],
        positions[order],
        make_splits(protocol, [frames[i] for i in order], test),
    )
    assert mixed.recall == pytest.approx(plain.recall)
    assert mixed.num_unanswerable == plain.num_unanswerable


@given(st.sampled_from(list(PROTOCOLS)), st.integers(0, 999))
@settings(deadline=None, max_examples=30)
def test_recall_never_falls_with_n_and_intervals_hold_it(protocol: str, seed: int) -> None:
    descriptors, positions, frames = world(seed)
    e = evaluate_splits(
        descriptors, positions, make_splits(protocol, frames, np.full(36, "test")), ks=range(1, 25)
    )
    curve = [e.recall[f"AR@{k}"] for k in e.ks]
    assert curve == sorted(curve)
    assert curve[-1] == 1.0  # at most 23 others may answer
    for estimate in e.estimates(seed=seed, num_draws=200).values():
        assert 0.0 <= estimate.interval[0] <= estimate.interval[1] <= 1.0
