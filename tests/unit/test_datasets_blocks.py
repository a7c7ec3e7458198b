# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from adafusion.datasets.blocks import choose_blocks, cut_region
from adafusion.datasets.splits import region_of
from adafusion.types import UserError

# two runs along x from 5 m to 995 m, ten frames a block of 100 m; a third one alone in the north
LINE = np.column_stack([np.arange(5.0, 1000.0, 10.0), np.full(100, 50.0)])
XY = np.concatenate([LINE, LINE + np.array([0.0, 1.0]), LINE + np.array([0.0, 500.0])])
RUNS = ["a"] * 100 + ["b"] * 100 + ["c"] * 100


def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def test_blocks_lie_where_two_runs_go_and_hang_together() -> None:
    chosen = choose_blocks(XY, RUNS, 0.2, rng())
    assert (chosen.blocks, chosen.eligible, chosen.visited) == (3, 10, 20)
    ((xmin, ymin, xmax, ymax),) = chosen.boxes  # 60 of 300 frames: three blocks, in a row
    assert (ymin, ymax, xmax - xmin) == (0.0, 100.0, 300.0)
    assert 0.0 <= xmin <= 700.0


def test_the_same_seed_chooses_the_same_blocks_and_others_others() -> None:
    first = {
        str(choose_blocks(XY, RUNS, 0.2, np.random.default_rng(seed)).boxes)
        for seed in [0, 0, 1, 2, 3, 4, 5]
    }
    assert 1 < len(first) < 7
    again = [choose_blocks(XY, RUNS, 0.2, np.random.default_rng(1)) for _ in range(2)]
    assert again[0] == again[1]


def test_a_block_where_a_vehicle_stood_for_long_is_passed_over() -> None:
    stood = np.full((500, 2), 550.0) - np.array([0.0, 500.0])  # in a block of both runs
    chosen = choose_blocks(np.concatenate([XY, stood]), [*RUNS, *["a"] * 500], 0.1, rng())
    names = region_of(stood, {"test": chosen.boxes})
    assert set(names) == {"train"}
    assert chosen.blocks == 4  # 80 of 800 frames


def test_blocks_keep_off_other_regions() -> None:
    near = ([0.0, 0.0, 450.0, 100.0], 60.0)
    chosen = choose_blocks(XY, RUNS, 0.9, rng(), keep_off=[near])
    assert chosen.boxes == [[600.0, 0.0, 1000.0, 100.0]]  # 500 is 50 m away


def test_rows_of_the_same_reach_make_one_box() -> None:
    square = np.array([(x, y) for x in (50.0, 150.0, 250.0) for y in (-50.0, 50.0)])
    lone = np.array([[-950.0, 950.0]])
    xy = np.concatenate([square, lone])
    chosen = choose_blocks(np.concatenate([xy, xy]), ["a"] * 7 + ["b"] * 7, 0.99, rng())
    assert sorted(chosen.boxes) == [[-1000.0, 900.0, -900.0, 1000.0], [0.0, -100.0, 300.0, 100.0]]


def test_a_region_is_cut_out_of_training_with_a_guard_and_the_rest_stays() -> None:
    test = {"test": [[0.0, 0.0, 200.0, 100.0]], "guard": [[-10.0, -10.0, 210.0, 110.0]]}
    regions, _ = cut_region("validation", 0.1, test, XY, RUNS, rng(), buffer_m=25.0)
    assert list(regions) == ["test", "validation", "guard"]
    assert regions["test"] == test["test"]
    assert regions["guard"][0] == test["guard"][0]
    ((xmin, ymin, xmax, ymax),) = regions["validation"]
    assert regions["guard"][1] == [xmin - 25.0, ymin - 25.0, xmax + 25.0, ymax + 25.0]
    assert xmin >= 300.0  # the block from 200 m touches the test
    before, after = region_of(XY, test), region_of(XY, regions)
    assert (before[before != after] == "train").all()


def test_a_region_that_is_there_is_not_cut_again() -> None:
    with pytest.raises(UserError, match="there is a test region already"):
        cut_region("test", 0.1, {"test": [[0.0, 0.0, 1.0, 1.0]]}, XY, RUNS, rng())


@pytest.mark.parametrize(
    ("share", "block_m", "message"),
    [(0.0, 100.0, "share of 0"), (1.5, 100.0, "share"), (0.2, 0.0, "0 m"), (np.nan, 1.0, "share")],
)
def test_shares_and_blocks_that_mean_nothing_are_refused(
    share: float, block_m: float, message: str
) -> None:
    with pytest.raises(UserError, match=message):
        choose_blocks(XY, RUNS, share, rng(), block_m=block_m)


def test_a_route_that_is_driven_once_cannot_be_cut() -> None:
    with pytest.raises(UserError, match=r"none of 10 blocks .* two runs .*drive the route twice"):
        choose_blocks(LINE, ["a"] * 100, 0.2, rng())
