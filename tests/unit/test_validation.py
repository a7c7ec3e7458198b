# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from adafusion.evaluation import validation_recall
from adafusion.models import AdaFusion, ModelConfig
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid
from adafusion.preprocess.cache import PreparedSet, prepare_cache
from adafusion.types import Frame, Observation, UserError

SETTINGS = Preprocess(image=ImageSettings(size=(48, 64)), voxels=VoxelGrid(shape=(16, 16, 8)))
PLACES = 4


class Street:
    """Places 100 m apart, driven twice; `look[i]` is the view of place i in the second run."""

    def __init__(self, name: str, look: list[int]) -> None:
        self.root, self.fingerprint = Path(name), name
        self.view = list(range(PLACES)) + look
        self.frames = [
            Frame(
                run=run,
                timestamp_us=i,
                position_m=(100.0 * i, 0.0, 0.0),
                image="image",
                cloud="cloud",
            )
            for run in ("first", "second")
            for i in range(PLACES)
        ]

    def load(self, frame: Frame) -> Observation:
        rng = np.random.default_rng(self.view[self.frames.index(frame)])
        return Observation(
            image=rng.integers(0, 255, (48, 64, 3), dtype=np.uint8),
            points_body=rng.uniform((-15, -15, 0.5), (15, 15, 4), (300, 3)).astype(np.float32),
        )


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> PreparedSet:
    """A street that looks the same twice, and one whose views have moved on by a place."""
    cache = tmp_path_factory.mktemp("cache")
    streets = Street("same", [0, 1, 2, 3]), Street("moved", [1, 2, 3, 0])
    return PreparedSet(tuple(prepare_cache(street, SETTINGS, cache) for street in streets))


def model(system: str) -> AdaFusion:
    torch.manual_seed(0)
    return AdaFusion(ModelConfig(system=system, width=0.125, dim=16, preprocess=SETTINGS)).eval()


def test_it_averages_recall_over_worlds_and_judges_each_half(data: PreparedSet) -> None:
    values = validation_recall(data, np.arange(4 * PLACES))(model("adafusion"))
    assert values["recall@1"] == values["image_recall@1"] == values["lidar_recall@1"] == 0.5
    for sensor in ("image", "lidar"):
        assert 0.0 < values[f"alpha_{sensor}_mean"] < 1.0
        assert values[f"alpha_{sensor}_std"] >= 0.0


@pytest.mark.parametrize(("first", "recall"), [(0, 1.0), (2 * PLACES, 0.0)])
def test_it_looks_at_the_rows_it_was_given_alone(
    data: PreparedSet, first: int, recall: float
) -> None:
    rows = np.arange(first, first + 2 * PLACES)
    assert validation_recall(data, rows)(model("image")) == {"recall@1": recall}


def test_one_run_cannot_judge(data: PreparedSet) -> None:
    with pytest.raises(UserError, match="fewer than two of first"):
        validation_recall(data, np.arange(PLACES))
