# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a model says of a dataset is kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adafusion.datasets import Dataset
from adafusion.experiments import describing
from adafusion.experiments.describing import describe_frames
from adafusion.models import ModelConfig, build_system
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid
from adafusion.types import UserError

SIZE = Preprocess(image=ImageSettings(size=(48, 64)), voxels=VoxelGrid(shape=(16, 16, 8)))


def test_a_dataset_is_described_once_and_a_damaged_file_is_named(
    tiny_world: Dataset, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = ModelConfig(system="concat", dim=16, width=0.125, preprocess=SIZE)
    model = build_system(config).eval()
    first = describe_frames(model, tiny_world, cache, tmp_path)
    assert first.fused is not None
    assert first.fused.shape == (len(tiny_world.frames), 16)

    monkeypatch.setattr(describing, "describe", None)  # it would be called to describe again
    again = describe_frames(model, tiny_world, cache, tmp_path)
    assert again.alpha is None
    np.testing.assert_array_equal(again.fused, first.fused)
    np.testing.assert_array_equal(again.lidar_half, first.lidar_half)

    (file,) = (tmp_path / "descriptions").iterdir()
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(UserError, match=file.name):
        describe_frames(model, tiny_world, cache, tmp_path)
