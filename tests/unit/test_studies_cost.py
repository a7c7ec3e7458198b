# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a row costs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from adafusion.experiments.studies.cost import cost_section, draw_cost, time_in_turns
from adafusion.models import ModelConfig, build_system
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid

SMALL = Preprocess(image=ImageSettings(size=(48, 64)), voxels=VoxelGrid(shape=(16, 16, 8)))
LARGE = Preprocess(image=ImageSettings(size=(192, 256)), voxels=VoxelGrid(shape=(48, 48, 32)))


def test_a_larger_model_takes_longer_and_each_is_timed_by_its_own_sensors() -> None:
    small, large = (
        build_system(ModelConfig(system="adafusion", dim=16, width=0.25, preprocess=size))
        for size in (SMALL, LARGE)
    )
    image = build_system(ModelConfig(system="image", dim=16, width=0.125, preprocess=SMALL))
    cloud = build_system(ModelConfig(system="lidar", dim=16, width=0.125, preprocess=SMALL))
    ms = time_in_turns([small, large, image, cloud], rounds=3)
    assert len(ms) == 4
    assert 0 < ms[0] < ms[1]


def test_the_table_has_the_ratio_and_the_picture_a_mark_a_row(
    tmp_path: Path, heading: dict[str, Any]
) -> None:
    study = {"ms": {"VL D-128": 10.0, "AdaFusion D-128": 15.0}, "threads": 2, "rounds": 3}
    lines = cost_section(study)
    assert "| VL D-128 | 10.0 | 1.00 |" in lines
    assert "| AdaFusion D-128 | 15.0 | 1.50 |" in lines
    assert "0.40 / 0.60 at 256, 0.32 / 0.68 at 128" in lines[-1]
    rows = [
        {
            "label": label,
            "system": system,
            "parameters": 1_000_000,
            "converged": system == "concat",
            "why_not_ranked": "" if system == "concat" else "not converged",
            "recall": {"cross-run": {"AR@1": {"value": 0.5, "interval": interval}}},
        }
        for label, system, interval in (
            ("VL D-128", "concat", None),
            ("AdaFusion D-128", "adafusion", [0.4, 0.7]),
        )
    ]
    results = {
        "rows": rows,
        "study": study,
        "protocols": {"cross-run": ""},
        **heading,
    }
    draw_cost(results, tmp_path / "cost.png")
    assert (tmp_path / "cost.png").stat().st_size > 5_000
