# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Every compared system goes the whole way: train, evaluate, map, locate, by the same commands."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from adafusion.datasets import Dataset
from adafusion.models import SYSTEMS, load_model

TINY = {
    "netvlad": ["model.width=0.0625", "model.clusters=4", "sampling.negatives=4"],
    "pointnetvlad": ["model.width=0.0625", "model.clusters=4", "sampling.negatives=4"],
    "minkloc": ["model.width=0.125", "sampling.places=4"],
    "coral": ["model.width=0.0625", "model.clusters=4", "sampling.negatives=4"],
    "pic-net": ["model.width=0.0625", "model.clusters=4", "sampling.negatives=4"],
    "oertel": ["model.width=0.125", "sampling.items=4", "sampling.mining=null"],
}


def test_every_compared_system_is_tried() -> None:
    assert set(TINY) == set(SYSTEMS) - {"adafusion", "concat", "image", "lidar"}


@pytest.mark.slow
@pytest.mark.parametrize("system", TINY)
def test_it_trains_is_evaluated_maps_and_is_located(
    type_in, tiny_world: Dataset, tmp_path: Path, system: str
) -> None:
    run, world = tmp_path / system, str(tiny_world.root)
    changes = [*TINY[system], "batches=2", "evaluate_every=2", "checkpoint_every=1"]
    said = type_in(
        "train", run, world, "--model", f"{system}-s", *(w for c in changes for w in ("--set", c))
    )
    assert said.code == 0, said.err
    file = run / "model.safetensors"
    assert load_model(file).config.system == system

    said = type_in("evaluate", world, tmp_path / "result", "--model", str(file), "--no-report")
    assert said.code == 0, said.err
    result = json.loads((tmp_path / "result" / "result.json").read_text(encoding="utf-8"))
    distance = result["results"][0]["protocol"]["descriptor_distance"]
    assert distance == ("L1" if system == "oertel" else "L2")

    place_map = str(tmp_path / "tiny.map")
    said = type_in("map", "build", world, place_map, "--model", str(file), "--frames", "::12")
    assert said.code == 0, said.err
    said = type_in(
        "locate", place_map, "--dataset", world, "--frames", "::12", "--model", str(file)
    )
    assert said.code == 0, said.err
    assert "median 0.0 m off" in said.out  # places that are on the map themselves
