# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Ours against what the authors' released code computed from the same weights and inputs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from adafusion.models import AdaFusion, import_released, load_model, save_model
from adafusion.models.plain import plain_forward, plain_multi_scale
from adafusion.types import Description

TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def released(reference_data: Path) -> AdaFusion:
    return import_released(reference_data / "adafusion_released.weights.safetensors")


@pytest.fixture(scope="module")
def recorded(reference_data: Path) -> dict[str, np.ndarray]:
    with np.load(reference_data / "adafusion_released.npz") as file:
        return {name: file[name] for name in file.files}


@pytest.fixture(scope="module")
def inputs(recorded: dict[str, np.ndarray]) -> tuple[torch.Tensor, torch.Tensor]:
    image = torch.from_numpy(recorded["image_u8"]).float() / 255.0
    return (image - 0.5) / 0.5, torch.from_numpy(recorded["voxels"]).float()


@torch.inference_mode()
@pytest.mark.parametrize("path", ["fast", "plain"])
def test_every_recorded_value_agrees(
    released: AdaFusion,
    recorded: dict[str, np.ndarray],
    inputs: tuple[torch.Tensor, torch.Tensor],
    path: str,
) -> None:
    d: Description = released(*inputs) if path == "fast" else plain_forward(released, *inputs)
    ours = {
        "f_image": d.image_half,
        "f_voxel": d.lidar_half,
        "alpha": d.alpha,
        "descriptor": d.fused,
    }
    for name, value in ours.items():
        assert value is not None
        difference = np.abs(value.numpy() - recorded[name]).max()
        assert difference < TOLERANCE, f"{name} differs by {difference}"


@torch.inference_mode()
def test_the_pooled_attention_agrees(
    released: AdaFusion,
    recorded: dict[str, np.ndarray],
    inputs: tuple[torch.Tensor, torch.Tensor],
) -> None:
    assert released.image_net is not None
    assert released.voxel_net is not None
    assert released.weight_net is not None
    _, image_stages = released.image_net(inputs[0])
    _, voxel_stages = released.voxel_net(inputs[1])
    for attention, stages, name in (
        (released.weight_net.image_attention, image_stages, "a_image"),
        (released.weight_net.voxel_attention, voxel_stages, "a_voxel"),
    ):
        for form in (attention, lambda s, a=attention: plain_multi_scale(a, s)):
            difference = np.abs(form(stages).numpy() - recorded[name]).max()
            assert difference < TOLERANCE, f"{name} differs by {difference}"


def test_an_imported_model_rounds_its_voxels_and_survives_its_file(
    released: AdaFusion, tmp_path: Path, inputs: tuple[torch.Tensor, torch.Tensor]
) -> None:
    save_model(released, tmp_path / "released.safetensors")
    again = load_model(tmp_path / "released.safetensors")
    assert again.config.preprocess.voxels.index == "round"
    assert again.fingerprint == released.fingerprint
