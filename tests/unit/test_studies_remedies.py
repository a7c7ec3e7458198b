# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What keeps weights from gaining, by numbers made by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from adafusion.experiments.studies.remedies import REMEDIED
from adafusion.experiments.studies.remedy_facts import (
    _pull,
    lengths,
    look,
    nearest_matches,
    spread,
    under_fixed_weights,
)
from adafusion.models import ModelConfig
from adafusion.types import Descriptions, Split


def described(image: list, lidar: list, alpha: list | None) -> Descriptions:
    halves = [np.array(half, np.float32) for half in (image, lidar)]
    weights = None if alpha is None else np.array(alpha, np.float32)
    weighed = [h if weights is None else weights[:, i, None] * h for i, h in enumerate(halves)]
    return Descriptions(np.concatenate(weighed, axis=1), *halves, weights)


def test_spread_and_saturation_of_each_sensor() -> None:
    found = spread(np.array([[0.5, 0.02], [0.7, 0.98], [0.5, 0.5], [0.7, 0.5]], np.float32))
    assert found["mean"] == pytest.approx([0.6, 0.5])
    assert found["std"] == pytest.approx([0.1, 0.48 / 2**0.5])
    assert found["saturated"] == [0.0, 0.5]


def test_length_of_the_halves_before_and_after_the_weights() -> None:
    one = described([[1, -1], [2, 0]], [[3, 3], [0, 0]], [[0.5, 0.1], [0.25, 0.9]])
    found = lengths([one])
    assert found["unweighed"] == [2.0, 3.0]
    assert found["weighed"] == pytest.approx([(1.0 + 0.5) / 2, 0.3])
    assert lengths([one._replace(alpha=None)])["weighed"] == [2.0, 3.0]


# two places, 100 m apart, each seen by both runs; frames 0 and 1 ask, 2 to 4 answer
POSITIONS = np.array([[0.0, 0.0], [100.0, 0.0], [5.0, 0.0], [8.0, 0.0], [95.0, 0.0]])
SPLIT = Split(
    name="a->b",
    protocol="cross-run",
    radius_m=20.0,
    query_rows=np.array([0, 1]),
    database_rows=np.array([2, 3, 4]),
)
WORLDS = [(POSITIONS, [SPLIT])]
# the image tells the places apart; the LiDAR takes frame 0 for frame 4
IMAGE = [[0.0], [9.0], [2.0], [1.0], [8.0]]
LIDAR = [[0.0], [5.0], [6.0], [6.0], [0.0]]


def test_the_nearest_true_and_the_nearest_wrong_match() -> None:
    fused = described(IMAGE, LIDAR, None).fused
    # frame 0: 8 and 7 to its true ones, 8 to the wrong one; frame 1: 8 and 9 to wrong ones, 6 true
    assert nearest_matches(fused, POSITIONS, SPLIT).tolist() == [[0, 1], [3, 4], [4, 2]]


def test_a_query_without_a_true_match_has_no_pair() -> None:
    fused = described(IMAGE, LIDAR, None).fused
    away = POSITIONS + np.array([[0.0, 500.0], *[[0.0, 0.0]] * 4])
    assert nearest_matches(fused, away, SPLIT)[0].tolist() == [1]


def test_a_frame_that_may_not_answer_is_no_match() -> None:
    fused = np.array([[0.0], [9.0], [0.5], [1.0], [8.0]], np.float32)
    union = Split(
        name="a+b",
        protocol="union",
        radius_m=20.0,
        query_rows=np.array([2]),
        database_rows=np.arange(5),
        exclude_self=True,
    )
    found = nearest_matches(fused, POSITIONS, union)
    assert found[0].tolist() == [2]
    assert found[1, 0] in (0, 3)  # both 0.5 away, and not frame 2 itself
    assert found[2].tolist() == [4]


def test_the_images_share_of_the_distance_to_true_and_wrong_matches() -> None:
    found = look([described(IMAGE, LIDAR, None)], WORLDS)
    # true: 1 of 7 and 1 of 6; wrong: 8 of 8 and 7 of 8
    assert found["image_share"]["true"] == pytest.approx((1 / 7 + 1 / 6) / 2)
    assert found["image_share"]["wrong"] == pytest.approx((8 / 8 + 7 / 8) / 2)
    assert found["alpha"] is None


def test_fixed_weights_are_each_sensors_mean() -> None:
    # alpha hides the image where it matters; its mean over frames does not
    alpha = [[0.0, 0.2], [1.0, 0.2], [0.0, 0.2], [1.0, 0.2], [1.0, 0.2]]
    learnt = described(IMAGE, LIDAR, alpha)
    # image 0.6, LiDAR 0.2 all over: 0 -> 3 at 0.6 + 1.2 beats 0 -> 4 at 4.8
    assert under_fixed_weights([learnt], WORLDS, ModelConfig()).tolist() == [1, 1]
    # and with the image as good as gone, both find the other place first
    blind = [[0.01, 0.9]] * 5
    found = under_fixed_weights([described(IMAGE, LIDAR, blind)], WORLDS, ModelConfig())
    assert found.tolist() == [2, 3]


def test_batches_that_pull_alike_agree_and_those_that_pull_apart_do_not() -> None:
    alike = _pull(torch.tensor([[3.0, 4.0], [3.0, 4.0]]))
    assert alike == {"norm": pytest.approx(5.0), "agreement": pytest.approx(1.0)}
    apart = _pull(torch.tensor([[3.0, 4.0], [-3.0, -4.0]]))
    assert apart == {"norm": pytest.approx(5.0), "agreement": pytest.approx(0.0)}
    across = _pull(torch.tensor([[2.0, 0.0], [0.0, 2.0]]))
    assert across["agreement"] == pytest.approx(0.5**0.5)
    assert _pull(torch.zeros(2, 3)) == {"norm": 0.0, "agreement": 0.0}


def study() -> dict:
    pull = {"norm": 0.5, "agreement": 0.7}
    alpha = {"mean": [0.4, 0.6], "std": [0.05, 0.02], "saturated": [0.0, 0.25]}
    gain = {
        "verdict": "above",
        "difference": {"value": 0.02, "interval": [0.01, 0.03]},
        "by_seed": [0.02],
        "queries": 9,
    }
    recall = {"learnt": 0.82, "fixed": 0.80, "gain": gain}
    facts = {
        "alpha": alpha,
        "length": {"unweighed": [20.0, 30.0], "weighed": [8.0, 18.0]},
        "image_share": {"true": 0.4, "wrong": None},
        "gradient": {"image": pull, "lidar": pull, "weights": pull},
        "kept": 0.5,
    }
    bare = {**facts, "alpha": None, "gradient": {"image": pull, "lidar": pull}}
    recalls = {"all pairs": recall, "with night": recall, "zone alley": recall}
    return {
        "rows": {
            "VL": {"seeds": [bare, bare], "recall": recalls},
            "AdaFusion": {"seeds": [facts, facts], "recall": recalls},
        }
    }


def test_the_section_has_a_line_a_row_and_gaps_where_there_are_no_weights() -> None:
    lines = REMEDIED.section(study())
    assert "| VL | 50 50 | - / - | - / - | - / - | 20.0 / 30.0 | 8.0 / 18.0 | 40.0 | - |" in lines
    assert (
        "| AdaFusion | 50 50 | 0.40 / 0.60 | 0.050 / 0.020 | 0.0 / 25.0 | 20.0 / 30.0 | 8.0 / 18.0 "
        "| 40.0 | - |" in lines
    )
    assert "| VL | 0.500 (0.70) | 0.500 (0.70) | - (-) |" in lines
    (recall,) = [line for line in lines if line.startswith("| AdaFusion | 82.0")]
    assert "82.0 (+2.0)" in recall
    assert "above" in recall
    assert not any("zone" in line for line in lines)
    tables = [line for line in lines if line.startswith("|---")]
    heads = [lines[i - 1] for i, line in enumerate(lines) if line.startswith("|---")]
    for head, rule in zip(heads, tables, strict=True):
        assert head.count("|") == rule.count("|")


def test_the_picture_is_drawn(tmp_path: Path, heading: dict[str, Any]) -> None:
    results = {
        "study": study(),
        "rows": [
            {"label": "VL", "converged": True},
            {"label": "AdaFusion", "converged": False, "why_not_ranked": "rising"},
        ],
        **heading,
    }
    assert REMEDIED.draw is not None
    REMEDIED.draw(results, tmp_path / "remedies.png")
    assert (tmp_path / "remedies.png").stat().st_size > 10_000
