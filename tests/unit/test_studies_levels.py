# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where more frame passes bring no more, from recalls made by hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from adafusion.experiments.studies.levels import draw_levels, levels_off_at, levels_section

# of 2400 answers the half-width is 2.0 points at a recall of 0.5
STUDY = {
    "answers": 2400,
    "systems": {"V": "image", "L": "lidar"},
    "best": {
        "V": {"1000": 0.30, "2000": 0.34, "4000": 0.40},
        "L": {"1000": 0.45, "2000": 0.50, "4000": 0.51},
    },
}


@pytest.mark.parametrize(
    ("recalls", "budget"),
    [
        ((0.50, 0.51, 0.51), 1000),
        ((0.45, 0.50, 0.51), 2000),
        ((0.45, 0.50, 0.53), None),
        ((0.50, 0.51, 0.53), 2000),  # each step is small, and both together are not
        ((0.50, 0.40, 0.51), 1000),
        ((0.50,), None),
    ],
)
def test_a_row_levels_off_where_no_larger_budget_brings_more(
    recalls: tuple[float, ...], budget: int | None
) -> None:
    best = {str(1000 * 2**i): recall for i, recall in enumerate(recalls)}
    assert levels_off_at(best, 2400) == budget


def test_the_table_says_what_each_doubling_brought() -> None:
    lines = levels_section(STUDY)
    assert "| V | 30.0 | 34.0 (+4.0) | 40.0 (+6.0) | 2.0 | above 4,000, or there |" in lines
    assert "| L | 45.0 | 50.0 (+5.0) | 51.0 (+1.0) | 2.0 | 2,000 |" in lines


def test_the_picture_is_drawn(tmp_path: Path) -> None:
    draw_levels({"study": STUDY, "test_data": [{"synthetic": True}]}, tmp_path / "levels.png")
    assert (tmp_path / "levels.png").stat().st_size > 5_000
