# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What holds for every cloud, every grid and every setting."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from adafusion.config import from_plain, to_plain
from adafusion.preprocess import Crop, Ground, ImageSettings, Preprocess, VoxelGrid
from adafusion.preprocess.augment import color_jitter
from adafusion.preprocess.image import to_unit
from adafusion.preprocess.voxels import pack, to_float, unpack, voxelize

OCCUPANCIES = st.sampled_from(["binary", "count", "soft", "tdf"])
INDICES = st.sampled_from(["floor", "round"])
SHAPES = st.tuples(*[st.integers(1, 7)] * 3)
SEEDS = st.integers(0, 2**32 - 1)

unhurried = settings(deadline=None)  # the first call of a kernel compiles it


@st.composite
def grids(draw: st.DrawFn, **fixed: Any) -> VoxelGrid:
    lower = draw(st.tuples(*[st.floats(-5, 5)] * 3))
    extent = draw(st.tuples(*[st.floats(0.1, 9)] * 3))
    upper = tuple(lo + e for lo, e in zip(lower, extent, strict=True))
    free = {"shape": draw(SHAPES), "index": draw(INDICES), "occupancy": draw(OCCUPANCIES)}
    return VoxelGrid(lower_m=lower, upper_m=upper, **{**free, **fixed})


def cloud(seed: int, n: int = 60) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-7, 9, (n, 3)).astype(np.float32)


@unhurried
@given(grids(), SEEDS)
def test_the_order_of_points_changes_not_even_the_last_bit(grid: VoxelGrid, seed: int) -> None:
    points = cloud(seed)
    shuffled = np.random.default_rng(seed + 1).permutation(points)
    np.testing.assert_array_equal(voxelize(points, grid), voxelize(shuffled, grid))


@unhurried
@given(grids(), SEEDS)
def test_every_cell_lies_between_zero_and_one(grid: VoxelGrid, seed: int) -> None:
    values = to_float(voxelize(cloud(seed), grid), grid)
    assert values.dtype == np.float32
    assert values.shape == grid.shape
    assert values.min() >= 0
    assert values.max() <= 1


@unhurried
@given(grids(), SEEDS)
def test_more_points_empty_no_cell(grid: VoxelGrid, seed: int) -> None:
    points = cloud(seed)
    fewer = to_float(voxelize(points[:20], grid), grid)
    assert (to_float(voxelize(points, grid), grid) >= fewer).all()


@unhurried
@given(grids(occupancy="binary"), SEEDS)
def test_repeated_points_change_no_binary_grid(grid: VoxelGrid, seed: int) -> None:
    points = cloud(seed)
    twice = np.concatenate([points, points])
    np.testing.assert_array_equal(voxelize(points, grid), voxelize(twice, grid))


@unhurried
@given(grids(index="floor", occupancy="count"), SEEDS)
def test_every_point_inside_the_box_is_counted_once(grid: VoxelGrid, seed: int) -> None:
    points = cloud(seed).astype(np.float64)
    lower, upper = np.array(grid.lower_m), np.array(grid.upper_m)
    margin = 1e-9  # a point on the very edge may go either way by a rounding
    inside = ((points >= lower + margin) & (points < upper - margin)).all(axis=1)
    near = ((points >= lower - margin) & (points < upper + margin)).all(axis=1)
    assert inside.sum() <= voxelize(points, grid).sum(dtype=int) <= near.sum()


@unhurried
@given(SHAPES, SEEDS)
def test_packing_goes_there_and_back(shape: tuple[int, int, int], seed: int) -> None:
    occupied = np.random.default_rng(seed).random((3, *shape)) < 0.3
    packed = np.stack([pack(grid) for grid in occupied])
    assert packed.shape == (3, math.ceil(math.prod(shape) / 8))
    np.testing.assert_array_equal(unpack(packed, shape), occupied)


@unhurried
@given(SEEDS, st.integers(1, 5))
def test_a_row_of_a_batch_of_images_equals_a_batch_of_one(seed: int, n: int) -> None:
    images = torch.randint(
        0, 256, (n, 4, 5, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(seed)
    )
    batch = to_unit(images)
    assert all(torch.equal(batch[i : i + 1], to_unit(images[i : i + 1])) for i in range(n))


@unhurried
@given(SEEDS, *[st.floats(0, 1)] * 3)
def test_jittered_colours_stay_colours(
    seed: int, brightness: float, contrast: float, saturation: float
) -> None:
    generator = torch.Generator().manual_seed(seed)
    images = torch.rand(3, 3, 4, 5, generator=generator) * 2 - 1
    changed = color_jitter(
        images, generator, brightness=brightness, contrast=contrast, saturation=saturation
    )
    assert changed.shape == images.shape
    assert changed.abs().max() <= 1


@st.composite
def preprocesses(draw: st.DrawFn) -> Preprocess:
    share = st.floats(0, 0.49)
    return Preprocess(
        image=ImageSettings(
            size=draw(st.tuples(st.integers(1, 999), st.integers(1, 999))),
            crop=Crop(top=draw(share), bottom=draw(share), left=draw(share), right=draw(share)),
        ),
        ground=Ground(
            method=draw(st.sampled_from(["none", "height"])), height_m=draw(st.floats(-9, 9))
        ),
        voxels=draw(grids()),
    )


@unhurried
@given(preprocesses(), preprocesses())
def test_settings_survive_json_and_fingerprints_tell_them_apart(
    a: Preprocess, b: Preprocess
) -> None:
    back = from_plain(Preprocess, json.loads(json.dumps(to_plain(a))))
    assert back == a
    assert back.fingerprint == a.fingerprint
    assert (a == b) == (a.fingerprint == b.fingerprint)
