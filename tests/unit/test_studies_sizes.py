# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Models at another size of input than they were trained at."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from adafusion.experiments.studies.sizes import at_size, resized, sizes_section
from adafusion.models import ModelConfig, build_system
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid

OWN = Preprocess(image=ImageSettings(size=(150, 200)), voxels=VoxelGrid(shape=(36, 36, 24)))


def test_another_size_has_more_pixels_and_cells_and_looks_as_far() -> None:
    smaller, larger = resized(OWN, 0.75), resized(OWN, 1.25)
    assert (smaller.image.size, smaller.voxels.shape) == ((112, 150), (27, 27, 18))
    assert (larger.image.size, larger.voxels.shape) == ((188, 250), (45, 45, 30))
    for other in (smaller, larger):
        assert (other.voxels.lower_m, other.voxels.upper_m) == (
            OWN.voxels.lower_m,
            OWN.voxels.upper_m,
        )
        assert other.image.crop == OWN.image.crop
    assert resized(OWN, 1.0) == OWN


@pytest.mark.parametrize("pooling", ["gap", "gem", "vlad"])
def test_the_same_weights_describe_another_size_and_refuse_their_own(pooling: str) -> None:
    small = replace(OWN, image=ImageSettings(size=(48, 64)), voxels=VoxelGrid(shape=(16, 16, 8)))
    config = ModelConfig(
        system="lidar", dim=16, width=0.125, clusters=2, pooling=pooling, preprocess=small
    )
    model = build_system(config).eval()
    other = at_size(model, 1.25)
    assert other is not None
    assert other.config.preprocess.voxels.shape == (20, 20, 10)
    assert other.fingerprint != model.fingerprint
    for name, value in model.state_dict().items():
        assert torch.equal(value, other.state_dict()[name])
    assert other(None, torch.rand(2, 1, 20, 20, 10)).fused.shape == (2, 8)
    with pytest.raises(ValueError, match=r"takes \(1, 20, 20, 10\)"):
        other(None, torch.rand(2, 1, 16, 16, 8))


def test_a_layer_over_all_cells_takes_no_other_size() -> None:
    assert (
        at_size(build_system(ModelConfig(system="lidar", pooling="fc", preprocess=OWN)), 1.25)
        is None
    )


def test_a_size_too_small_for_the_branch_is_no_size() -> None:
    assert at_size(build_system(ModelConfig(system="lidar", preprocess=OWN)), 0.25) is None


def test_the_table_shows_recall_and_its_change() -> None:
    def found(recall: float, change: float) -> dict[str, object]:
        return {
            "AR@1": {"value": recall, "interval": [recall - 0.1, recall + 0.1]},
            "change": {"value": change, "interval": None},
        }

    study = {
        "times": [0.75, 1.0, 1.25],
        "rows": {
            "L GAP": [found(0.5, -0.25), found(0.75, 0.0), found(0.7, -0.05)],
            "L FC": [None, found(0.6, 0.0), None],
        },
    }
    *_, gap, fc = sizes_section(study)
    assert gap.count("|") == fc.count("|") == 7
    assert "-25.0" in gap
    assert "75.0" in gap
    assert fc.split(" | ")[1] == fc.split(" | ")[3] == "-"
    assert fc.endswith("| - | - |")
