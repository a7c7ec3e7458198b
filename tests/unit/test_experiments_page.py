# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The table ranks only what converged."""

from __future__ import annotations

from typing import Any

import pytest

from adafusion.experiments.page import page, ranking


def row(label: str, value: float, converged: bool) -> dict[str, Any]:
    estimate = {"value": value, "interval": [value - 0.01, value + 0.01]}
    return {
        "label": label,
        "system": "concat",
        "reconstruction": label == "guessed",
        "pretrained": label == "good",
        "published_oxford_percent": {"at_1": 97.1, "at_1_percent": None},
        "parameters": 1234567,
        "length": 256,
        "frame_passes": {"image": 1000},
        "validation_passes": 10,
        "kept_after": [0.5],
        "mining_passes": 0,
        "converged": converged,
        "why_not_ranked": "" if converged else "not converged",
        "alpha": [None],
        "recall": {"cross-run": {"AR@1": estimate, "AR@1%": estimate}},
        "recall@1_by_seed": [value],
        "rate_falls_to_zero": True,
    }


@pytest.fixture
def results() -> dict[str, Any]:
    rows = [row("rising", 0.9, False), row("guessed", 0.5, True), row("good", 0.7, True)]
    data = {"name": "w", "version": "1", "fingerprint": "f", "synthetic": True, "frames": 3}
    return {
        "experiment": "headline",
        "words": "Words.",
        "date": "2026-01-01",
        "command": "adafusion experiment headline",
        "commit": None,
        "software": {"platform": "p", "python": "3", "torch": "2"},
        "machine": {"processors": 2, "device": "cpu"},
        "seeds": [0],
        "budget": 1000,
        "training_seconds": 3600.0,
        "training_data": [data],
        "test_data": [{**data, "runs": ["a", "b"], "left_out_for_lack_of_a_sensor": 0}],
        "validation_answers": 100,
        "protocols": {"cross-run": "Words of it."},
        "draws": 10,
        "rows": rows,
        "verdicts": [],
        "study": {},
    }


def test_a_row_that_still_rises_is_below_the_others_and_never_bold(
    results: dict[str, Any],
) -> None:
    order = [row["label"] for row in ranking(results["rows"], "cross-run")]
    assert order == ["good", "guessed", "rising"]
    lines = {line.split(" ")[1]: line for line in page(results).splitlines() if "1,234,567" in line}
    assert list(lines) == order
    assert "**70.0 [69.0, 71.0]**" in lines["good"]
    assert "**" not in lines["rising"] + lines["guessed"]
    assert "(not converged)" in lines["rising"]
    assert "(reconstruction)" in lines["guessed"]
    assert "(from ImageNet)" in lines["good"]


def test_the_page_says_what_its_numbers_are_worth(results: dict[str, Any]) -> None:
    text = page(results)
    assert "Exploratory: one seed, which decides nothing." in text
    assert "SYNTHETIC data" in text
    assert "97.10 / -" in text
    assert "rising 50 %; guessed 50 %; good 50 %." in text
    assert "1,000 / -" in text  # passes through the image's network; it has no other
    assert "Exploratory" not in page({**results, "seeds": [0, 1]})
    assert "Rates fall to zero, which" in text
    results["rows"][0]["rate_falls_to_zero"] = False
    assert "Rates fall to zero (but not those of rising), which" in page(results)
