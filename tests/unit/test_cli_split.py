# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from adafusion.cli.split import _by_hand, _table
from adafusion.datasets.splits import Published, load_split
from adafusion.evaluation.split_counts import SplitCounts
from adafusion.types import UserError

COUNTS = SplitCounts(
    frames={"train": 5000, "validation": 0, "guard": 0, "test": 2400},
    true_pairs=65_100,
    wrong_pairs=12_000_000,
    queries=21_600,
    answerable=21_500,
    nearest_m=1.25,
)


def test_boxes_by_hand_are_gathered_by_region_and_guarded() -> None:
    texts = ["test=0,0,10,10", "validation=-50,-50,-40.5,-40", "test=100,0,110,10"]
    regions, about = _by_hand(texts, 5.0)
    assert list(regions) == ["test", "validation", "guard"]
    assert regions["test"] == [[0.0, 0.0, 10.0, 10.0], [100.0, 0.0, 110.0, 10.0]]
    assert regions["validation"] == [[-50.0, -50.0, -40.5, -40.0]]
    assert regions["guard"][0] == [-5.0, -5.0, 15.0, 15.0]
    assert about == "boxes by hand, guard 5 m"


@pytest.mark.parametrize(
    "text",
    ["test", "test=", "test=1,2,3", "test=0,0,0,1", "test=0,0,nan,1", "0,0,1,1", "train=0,0,1,1"],
)
def test_a_box_that_is_none_is_told_how_to_write_one(text: str) -> None:
    with pytest.raises(UserError, match="write test=XMIN,YMIN,XMAX,YMAX"):
        _by_hand([text], 0.0)


def test_boxes_that_leave_the_guard_no_room_are_refused() -> None:
    with pytest.raises(UserError, match=r"2 m apart, less than the 5 m .*--buffer-m"):
        _by_hand(["test=0,0,10,10", "validation=12,0,20,10"], 5.0)


def test_a_table_stands_beside_the_paper_and_says_what_cannot_be() -> None:
    text = _table("x", COUNTS, load_split("robotcar-boxes").published)
    rows = {line.strip().split("  ")[0]: line.split()[-3:] for line in text.splitlines() if line}
    assert rows["train frames"] == ["5,000", "5,155", "-3.0%"]
    assert rows["queries, cross-run"] == ["21,600", "21,000", "+2.9%"]
    assert "1.2 m" in text
    # 5155 x 5154 / 2
    assert "5,155 frames make 13,284,435 pairs in all" in text
    assert max(map(len, text.splitlines())) <= 90


def test_a_paper_that_can_be_right_is_not_told_otherwise() -> None:
    paper = Published(
        source="p", train_frames=4, test_frames=1, true_pairs=1, wrong_pairs=6, queries=1
    )
    assert "cannot" not in _table("x", COUNTS, paper)
    assert "paper" not in _table("x", COUNTS, None)
