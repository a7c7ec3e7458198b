# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Regions cut by themselves keep their distance, whatever was driven."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from adafusion.datasets.blocks import cut_region
from adafusion.datasets.splits import GUARD, region_of
from adafusion.types import UserError


@settings(max_examples=100, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    num_runs=st.integers(1, 4),
    buffer_m=st.floats(0.0, 150.0),
    block_m=st.floats(20.0, 300.0),
    origin=st.sampled_from([(0.0, 0.0), (620084.4, 5735712.8)]),
    shares=st.tuples(st.floats(0.05, 0.6), st.floats(0.05, 0.4)),
)
def test_no_frame_of_a_region_is_within_the_buffer_of_another(
    seed: int,
    num_runs: int,
    buffer_m: float,
    block_m: float,
    origin: tuple[float, float],
    shares: tuple[float, float],
) -> None:
    rng = np.random.default_rng(seed)
    turns = rng.normal(0.0, 0.25, 150).cumsum()  # a way that wanders, with noise for each run
    way = 10.0 * np.column_stack([np.cos(turns), np.sin(turns)]).cumsum(axis=0) + origin
    parts = [way[rng.integers(60) :] + rng.normal(0.0, 3.0, 2) for _ in range(num_runs)]
    xy = np.concatenate(parts)
    runs = [str(run) for run, part in enumerate(parts) for _ in part]
    regions: dict[str, list[list[float]]] = {}
    try:
        for name, share in zip(("test", "validation"), shares, strict=True):
            regions, chosen = cut_region(
                name, share, regions, xy, runs, rng, block_m=block_m, buffer_m=buffer_m
            )
            assert 0 < chosen.blocks <= chosen.eligible <= chosen.visited
    except UserError:
        return  # nowhere do two runs meet, or no room is left
    names = region_of(xy, regions)
    for name in ("test", "validation"):
        by = {run for run, where in zip(runs, names, strict=True) if where == name}
        assert len(by) > 1
    for a, b in combinations(sorted(set(names) - {GUARD}), 2):
        gap = cKDTree(xy[names == a]).query(xy[names == b])[0].min()
        assert gap >= buffer_m - 1e-6
