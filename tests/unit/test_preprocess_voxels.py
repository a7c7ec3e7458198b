# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Voxel grids and ground removal on numbers that can be checked by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from adafusion.preprocess import Ground, VoxelGrid
from adafusion.preprocess.ground import remove_ground
from adafusion.preprocess.voxels import pack, to_float, unpack, voxelize


def grid(**settings: Any) -> VoxelGrid:
    """4 x 4 x 4 cells of 1 m, from the origin."""
    return VoxelGrid(
        **{"lower_m": (0.0, 0.0, 0.0), "upper_m": (4.0, 4.0, 4.0), "shape": (4, 4, 4), **settings}
    )


def cloud(*points: tuple[float, float, float]) -> np.ndarray:
    return np.array(points, dtype=np.float32).reshape(-1, 3)


def values(points: np.ndarray, box: VoxelGrid) -> np.ndarray:
    return to_float(voxelize(points, box), box)


def cells(values: np.ndarray) -> dict[tuple[int, ...], float]:
    """What each cell that is not empty holds."""
    return {tuple(map(int, i)): float(values[tuple(i)]) for i in np.argwhere(values)}


def test_a_cell_owns_its_lower_face_but_not_its_upper() -> None:
    inside = cloud((0, 0, 0), (1, 2.5, 3.999))
    outside = cloud((4, 1, 1), (-0.001, 1, 1), (1, 1, 4))
    both = np.concatenate([inside, outside])
    assert cells(values(both, grid())) == {(0, 0, 0): 1.0, (1, 2, 3): 1.0}


def test_round_goes_to_the_nearest_index_and_half_to_even() -> None:
    points = cloud((0.5, 1.5, 2.5), (-0.5, 0.4, 0.6), (3.4, 3, 3), (3.5, 3, 3), (-0.6, 1, 1))
    # 3.5 rounds to 4, outside; -0.5 rounds to -0, inside
    expected = {(0, 2, 2): 1.0, (0, 0, 1): 1.0, (3, 3, 3): 1.0}
    assert cells(values(points, grid(index="round"))) == expected


def test_cells_follow_the_box_and_not_the_metre() -> None:
    box = VoxelGrid(lower_m=(-20.0, -20.0, 0.0), upper_m=(20.0, 20.0, 5.0), shape=(72, 72, 48))
    # (0 + 20) * 72 / 40 = 36; (-19.9 + 20) * 1.8 = 0.18; 2.6 * 48 / 5 = 24.96
    assert cells(values(cloud((0, -19.9, 2.6)), box)) == {(36, 0, 24): 1.0}
    assert box.cell_m == pytest.approx((40 / 72, 40 / 72, 5 / 48))


def test_count_grows_with_the_logarithm_and_ends_at_one() -> None:
    points = cloud(*[(0.5, 0.5, 0.5)] * 3, *[(1.5, 0.5, 0.5)] * 15, *[(2.5, 0.5, 0.5)] * 1000)
    held = cells(values(points, grid(occupancy="count")))
    assert held == {(0, 0, 0): pytest.approx(0.5), (1, 0, 0): 1.0, (2, 0, 0): 1.0}
    one = cells(values(points[:1], grid(occupancy="count")))
    assert one == {(0, 0, 0): pytest.approx(math.log(2) / math.log(16))}


def test_soft_leaves_a_point_at_a_centre_whole() -> None:
    assert cells(values(cloud((1.5, 2.5, 0.5)), grid(occupancy="soft"))) == {(1, 2, 0): 1.0}
    nearest = grid(occupancy="soft", index="round")  # whose centres are the whole numbers
    assert cells(values(cloud((1, 2, 3)), nearest)) == {(1, 2, 3): 1.0}


def test_soft_shares_a_point_between_the_centres_around_it() -> None:
    held = cells(values(cloud((1.75, 2.0, 1.5)), grid(occupancy="soft")))
    # a quarter of the way from x centre 1.5 to 2.5, half way from y centre 1.5 to 2.5
    expected = {(1, 1, 1): 0.375, (1, 2, 1): 0.375, (2, 1, 1): 0.125, (2, 2, 1): 0.125}
    assert held == expected


def test_soft_is_clipped_at_one_and_loses_what_falls_outside() -> None:
    assert cells(values(cloud(*[(0.5, 0.5, 0.5)] * 9), grid(occupancy="soft"))) == {(0, 0, 0): 1.0}
    assert cells(values(cloud((0.25, 0.5, 0.5)), grid(occupancy="soft"))) == {(0, 0, 0): 0.75}


def test_tdf_falls_linearly_with_the_distance_and_ends_at_two_cells() -> None:
    held = values(cloud((0.5, 0.5, 0.5)), grid(occupancy="tdf"))
    assert held[0, 0, 0] == 1.0
    assert held[1, 0, 0] == 0.5
    assert held[2, 0, 0] == 0.0
    assert held[1, 1, 0] == pytest.approx(1 - math.sqrt(2) / 2, abs=1e-3)  # kept as float16


def test_tdf_measures_in_metres_where_cells_are_flat() -> None:
    box = grid(upper_m=(4.0, 4.0, 1.0), occupancy="tdf")  # cells of 1 x 1 x 0.25 m, t = 2 m
    held = values(cloud((0.5, 0.5, 0.1)), box)
    assert held[0, 0, 3] == 1 - 0.75 / 2


@pytest.mark.parametrize("occupancy", ["binary", "count", "soft", "tdf"])
def test_an_empty_cloud_gives_an_empty_grid(occupancy: str) -> None:
    assert not values(cloud(), grid(occupancy=occupancy)).any()


@pytest.mark.parametrize("index", ["floor", "round"])
@pytest.mark.parametrize("occupancy", ["binary", "count", "soft", "tdf"])
def test_points_that_are_not_finite_or_far_away_touch_nothing(occupancy: str, index: str) -> None:
    odd = [np.nan, np.inf, -np.inf, 3e38, -3e38, 1e10, -1e10]
    points = np.array(np.meshgrid(odd, odd, [*odd, 1.0]), dtype=np.float32).reshape(3, -1).T
    assert not values(points, grid(occupancy=occupancy, index=index)).any()


def test_packs_eight_cells_in_a_byte_and_back() -> None:
    occupied = voxelize(cloud((0.5, 0.5, 0.5), (3.5, 3.5, 3.5)), grid(shape=(3, 3, 3)))
    packed = pack(occupied)
    assert packed.tolist() == [0b10000000, 0, 0, 0b00100000]  # 27 cells in 4 bytes
    np.testing.assert_array_equal(unpack(packed, (3, 3, 3)), occupied)
    batch = np.stack([packed, 0 * packed])
    np.testing.assert_array_equal(
        unpack(batch, (3, 3, 3)), np.stack([occupied, np.zeros_like(occupied)])
    )


def test_takes_float64_points_and_views() -> None:
    points = np.random.default_rng(0).uniform(-1, 5, (50, 4)).astype(np.float32)
    expected = voxelize(np.ascontiguousarray(points[:, :3]), grid())
    np.testing.assert_array_equal(voxelize(points[:, :3], grid()), expected)
    np.testing.assert_array_equal(voxelize(points[:, :3].astype(np.float64), grid()), expected)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"upper_m": (4.0, 0.0, 4.0)}, "must exceed"),
        ({"lower_m": (0.0, math.nan, 0.0)}, "must exceed"),
        ({"upper_m": (4.0, math.inf, 4.0)}, "must exceed"),
        ({"shape": (4, 0, 4)}, "positive"),
    ],
)
def test_refuses_a_box_without_cells(bad: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        grid(**bad)


def test_equal_grids_are_equal_as_text() -> None:
    assert str(grid(lower_m=(-0.0, 0.0, 0.0))) == str(grid())


def test_ground_is_what_lies_below_the_height() -> None:
    points = cloud((1, 1, 0.29), (1, 1, 0.31), (5, 5, -1), (5, 5, 2))
    ground = Ground(method="height", height_m=0.3)
    np.testing.assert_array_equal(remove_ground(points, ground), points[[1, 3]])
    np.testing.assert_array_equal(remove_ground(points, Ground(height_m=0.3)), points)


def test_refuses_a_ground_height_that_is_no_number() -> None:
    with pytest.raises(ValueError, match="finite"):
        Ground(height_m=math.nan)
