# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Recall over the number of candidates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from adafusion.experiments.studies.recall import draw_recall, gains_section


@pytest.mark.parametrize("others", [(), ("VL",)])
def test_page_and_picture_are_made_whatever_rows_were_left(
    tmp_path: Path, others: tuple[str, ...], heading: dict[str, Any]
) -> None:
    recall = {f"AR@{n}": {"value": 0.5, "interval": [0.4, 0.6]} for n in range(1, 26)}
    row = {"converged": True, "why_not_ranked": "", "recall": {"cross-run": recall}}
    more = {"difference": recall["AR@1"], "verdict": "above"}
    study = {"gains": {other: {"at": recall, "first_minus_last": more} for other in others}}
    results = {
        "study": study,
        "protocols": {"cross-run": ""},
        "rows": [row | {"label": name, "system": "concat"} for name in ("VL", "AdaFusion")],
        **heading,
    }
    assert sum(line.startswith("| VL |") for line in gains_section(study)) == len(others)
    draw_recall(results, tmp_path / "recall.png")
    assert (tmp_path / "recall.png").stat().st_size > 10_000
