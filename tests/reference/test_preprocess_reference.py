# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled and composed forms against slow, obvious ones of the same formulas."""

from __future__ import annotations

import itertools
import math
from typing import Literal

import numpy as np
import pytest
import torch

from adafusion.preprocess import Crop, ImageSettings, VoxelGrid
from adafusion.preprocess.augment import GREY, color_jitter
from adafusion.preprocess.image import resize
from adafusion.preprocess.voxels import to_float, voxelize

BOX = {"lower_m": (-2.0, -1.0, 0.0), "upper_m": (2.0, 2.0, 1.0), "shape": (5, 4, 3)}


def cloud(n: int = 80) -> np.ndarray:
    return np.random.default_rng(5).uniform((-3, -2, -1), (3, 3, 2), (n, 3)).astype(np.float32)


def slow_counts(points: np.ndarray, grid: VoxelGrid) -> np.ndarray:
    counts = np.zeros(grid.shape)
    for point in points.astype(float):
        cell = []
        for p, lower, upper, n in zip(point, grid.lower_m, grid.upper_m, grid.shape, strict=True):
            u = (p - lower) * n / (upper - lower)
            cell.append(math.floor(u) if grid.index == "floor" else round(u))
        if all(0 <= i < n for i, n in zip(cell, grid.shape, strict=True)):
            counts[tuple(cell)] += 1
    return counts


def slow_values(points: np.ndarray, grid: VoxelGrid) -> np.ndarray:
    counts = slow_counts(points, grid)
    if grid.occupancy == "binary":
        return (counts > 0).astype(float)
    if grid.occupancy == "count":
        return np.log(1 + np.minimum(counts, 15)) / np.log(16)
    values = np.zeros(grid.shape)
    cell_m = np.subtract(grid.upper_m, grid.lower_m) / grid.shape
    first_centre = np.array(grid.lower_m) + (0.5 if grid.index == "floor" else 0.0) * cell_m
    for cell in itertools.product(*map(range, grid.shape)):
        centre = first_centre + cell * cell_m
        if grid.occupancy == "soft":
            away = np.abs(points - centre) / cell_m
            values[cell] = min(1.0, np.prod(np.maximum(0, 1 - away), axis=1).sum())
        else:
            occupied = first_centre + np.argwhere(counts) * cell_m
            truncation = 2 * cell_m.max()
            nearest = np.linalg.norm(occupied - centre, axis=1).min()
            values[cell] = 1 - min(nearest, truncation) / truncation
    return values


@pytest.mark.parametrize("index", ["floor", "round"])
@pytest.mark.parametrize("occupancy", ["binary", "count", "soft", "tdf"])
@pytest.mark.parametrize("n", [1, 12, 80])
def test_voxels_equal_a_plain_loop(
    n: int,
    occupancy: Literal["binary", "count", "soft", "tdf"],
    index: Literal["floor", "round"],
) -> None:
    grid = VoxelGrid(**BOX, occupancy=occupancy, index=index)
    points = np.concatenate([cloud(n), [[0.1, 0.1, 0.5]]]).astype(np.float32)  # one inside, surely
    tolerance = 0 if occupancy == "binary" else 6e-4  # soft and tdf are kept as float16
    values = to_float(voxelize(points, grid), grid)
    np.testing.assert_allclose(values, slow_values(points, grid), rtol=0, atol=tolerance)


def test_round_gives_the_voxels_of_the_released_formula() -> None:
    points = np.random.default_rng(0).normal(0, 9, (20_000, 3)).astype(np.float32)
    grid = VoxelGrid(index="round")
    lower, upper = np.array(grid.lower_m), np.array(grid.upper_m)
    cells = np.round((points - lower) * grid.shape / (upper - lower)).astype(int)
    cells = cells[((cells >= 0) & (cells < grid.shape)).all(axis=1)]
    expected = np.zeros(grid.shape, dtype=bool)
    expected[tuple(cells.T)] = True
    np.testing.assert_array_equal(voxelize(points, grid), expected)


@pytest.mark.parametrize("shape", [(96, 128), (37, 122), (10, 12), (20, 128)])
def test_resize_agrees_with_pillow_to_one_grey_level(shape: tuple[int, int]) -> None:
    pillow = pytest.importorskip("PIL.Image")
    image = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
    cropped = np.ascontiguousarray(image[: shape[0] - round(shape[0] * 0.2)])
    expected = np.asarray(pillow.fromarray(cropped).resize((40, 30), pillow.Resampling.BILINEAR))
    ours = resize(image, ImageSettings(size=(30, 40), crop=Crop(bottom=0.2)))
    assert np.abs(ours.astype(int) - expected).max() <= 1


def test_color_jitter_equals_one_change_after_the_other() -> None:
    images = torch.rand(12, 3, 5, 7, generator=torch.Generator().manual_seed(0)) * 2 - 1
    strength = (0.5, 0.4, 0.9)
    draws = torch.rand(12, 6, generator=torch.Generator().manual_seed(1))
    expected = []
    for image, draw in zip(images, draws, strict=True):
        x = (image + 1) / 2
        for change in draw[3:].argsort().tolist():
            f = 1 + strength[change] * (2 * draw[change] - 1)
            grey = sum(weight * channel for weight, channel in zip(GREY, x, strict=True))
            blended_with = (torch.zeros(()), grey.mean(), grey)[change]
            x = f * x + (1 - f) * blended_with
        expected.append((2 * x - 1).clamp(-1, 1))
    changed = color_jitter(
        images,
        torch.Generator().manual_seed(1),
        brightness=strength[0],
        contrast=strength[1],
        saturation=strength[2],
    )
    torch.testing.assert_close(changed, torch.stack(expected), rtol=0, atol=3e-6)
