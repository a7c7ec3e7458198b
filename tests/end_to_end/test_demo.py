# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The demonstration on the smallest world, with models that know nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from adafusion.cli import demo as module
from adafusion.mapping import PlaceMap
from adafusion.models import AdaFusion, ModelConfig, load_model, save_model

PLACES = 6


def test_a_demo_answers_from_the_map_of_its_own_world_and_model(
    tiny_model: ModelConfig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    weights = tmp_path / "tiny.safetensors"
    monkeypatch.setattr(module, "SYSTEMS", (str(weights),))
    out = tmp_path / "demo"

    def demo(seed: int, places: int = PLACES, weights_seed: int = 0) -> tuple[str, PlaceMap]:
        torch.manual_seed(weights_seed)
        save_model(AdaFusion(tiny_model), weights)
        module.demo(out, seed=seed, places=places, profile="tiny", workers=1)
        said = capsys.readouterr()
        assert said.err.startswith("1. Simulate")
        *_, path, _, _, report = said.out.splitlines()
        assert report == str(out / "report.html")
        assert Path(report).is_file()
        place_map = PlaceMap.open(path)
        assert len(place_map) == places
        assert place_map.header.model_fingerprint == load_model(weights).fingerprint
        assert f"SYNTHETIC world {seed}, {2 * places} frames" in said.out
        return said.out, place_map

    said, first = demo(seed=7)
    assert f"of {PLACES} frames placed within 20 m" in said
    _, other_weights = demo(seed=7, weights_seed=1)
    assert other_weights.keys == first.keys
    assert other_weights.fingerprint != first.fingerprint
    _, other_world = demo(seed=8)
    assert set(other_world.datasets) != set(first.datasets)
    demo(seed=8, places=PLACES - 1)
