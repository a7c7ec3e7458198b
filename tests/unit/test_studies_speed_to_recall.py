# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Frame passes to a recall, from records made by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from adafusion.experiments.studies.speed_to_recall import (
    LEVELS,
    curve_of,
    draw_speed,
    passes_to,
    speed_section,
)

RECORD = {
    "batches": 20,
    "frame_passes": 610,  # 30.5 a batch
    "curve": [
        {"batch": batch, "frame_passes": passes, "recall@1": recall}
        for batch, passes, recall in (
            (0, 0, 0.3),
            (8, 244, 0.52),
            (16, 488, 0.49),
            (20, 610, 0.61),
        )
    ],
}


def test_a_level_is_reached_at_the_first_evaluation_that_shows_it() -> None:
    curve = curve_of(RECORD)
    assert curve == [(0, 0.3), (244, 0.52), (488, 0.49), (610, 0.61)]
    assert passes_to(0.3, curve) == 0
    assert passes_to(0.5, curve) == 244  # though the next one shows less
    assert passes_to(0.6, curve) == 610
    assert passes_to(0.65, curve) is None


def study() -> dict[str, object]:
    curve = curve_of(RECORD)
    curves = {"margin": [curve], "softmax": [curve[:2], curve]}
    return {
        "levels": list(LEVELS),
        "curves": curves,
        "passes": {
            label: [[passes_to(level, one) for level in LEVELS] for one in of_seeds]
            for label, of_seeds in curves.items()
        },
        "batches": {label: {"batches": 20, "frame_passes": 610} for label in curves},
    }


def test_the_table_has_passes_and_batches_or_never_by_seed() -> None:
    lines = speed_section(study())
    assert "| margin | 30.0 | 244 (8) | 244 (8) | 610 (20) | 610 (20) | never | 61.0 |" in lines
    assert any("244 (8), 244 (8) | never, 610 (20)" in line for line in lines)
    assert any("every 244 passes" in line for line in lines)


def test_the_picture_is_drawn(tmp_path: Path, heading: dict[str, Any]) -> None:
    results = {
        "study": study(),
        **heading,
    }
    draw_speed(results, tmp_path / "speed.png")
    assert (tmp_path / "speed.png").stat().st_size > 5_000
