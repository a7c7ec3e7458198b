# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where more frame passes bring no more, from recalls made by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from adafusion.experiments.studies.levels import draw_levels, levels_off_at, levels_section


def tried(*recalls: float, rising: tuple[int, ...] = ()) -> list[dict[str, Any]]:
    """Budgets of 1000, 2000, 4000, ... passes."""
    return [
        {"passes": 1000 * 2**i, "best": recall, "rising": i in rising}
        for i, recall in enumerate(recalls)
    ]


# of 2400 answers the half-width is 2.0 points at a recall of 0.5
STUDY = {
    "answers": 2400,
    "rows": {
        "V": {"system": "image", "tried": tried(0.30, 0.34, 0.40, rising=(0,))},
        "L": {"system": "lidar", "tried": tried(0.45, 0.50, 0.51)},
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
    assert levels_off_at(tried(*recalls), 2400) == budget


def test_a_budget_at_whose_end_the_row_still_rose_is_no_answer() -> None:
    assert levels_off_at(tried(0.50, 0.50, 0.50, rising=(0,)), 2400) == 2000


def test_the_table_says_what_each_doubling_brought() -> None:
    lines = levels_section(STUDY)
    assert "| V | 30.0^ | 34.0 (+4.0) | 40.0 (+6.0) | 4,000 or above |" in lines
    assert "| L | 45.0 | 50.0 (+5.0) | 51.0 (+1.0) | 2,000 |" in lines


def test_the_picture_is_drawn(tmp_path: Path, heading: dict[str, Any]) -> None:
    draw_levels(
        {
            "study": STUDY,
            **heading,
        },
        tmp_path / "levels.png",
    )
    assert (tmp_path / "levels.png").stat().st_size > 5_000
