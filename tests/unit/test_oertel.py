# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest
import torch

from adafusion.config import load_config
from adafusion.models import ModelConfig
from adafusion.models.oertel import Oertel
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid
from adafusion.training import TrainConfig

CONFIGS = Path(__file__).parents[2] / "configs"
TINY = ModelConfig(
    system="oertel",
    width=0.125,
    dim=16,
    preprocess=Preprocess(
        image=ImageSettings(size=(48, 64)),
        voxels=VoxelGrid(lower_m=(0.0, -20.0, 0.0), upper_m=(40.0, 20.0, 5.0), shape=(16, 16, 8)),
    ),
)


def build() -> Oertel:
    torch.manual_seed(0)
    model = Oertel(TINY)
    model.initialise(torch.Generator().manual_seed(0))
    return model


def batch(n: int = 2) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(n, 3, 48, 64, generator=generator) * 2 - 1
    return image, (torch.rand(n, 1, 16, 16, 8, generator=generator) < 0.1).float()


def count(model: Oertel) -> int:
    return sum(p.numel() for p in model.parameters())


def test_it_has_the_parameters_of_the_two_branches_alone() -> None:
    assert count(Oertel(ModelConfig(system="oertel"))) == 2_078_432


def test_the_descriptor_is_both_means_joined_and_has_no_weights_nor_length_1() -> None:
    model = build().eval()
    image, voxels = batch()
    d = model(image, voxels)
    means = [model.image_net(image)[1][-1], model.voxel_net(voxels)[1][-1]]
    joined = torch.cat([x.flatten(2).mean(dim=2) for x in means], dim=1)
    assert torch.equal(d.fused, joined)
    assert torch.equal(d.fused, torch.cat([d.image_half, d.lidar_half], dim=1))
    assert d.alpha is None
    assert not torch.allclose(d.fused.norm(dim=1), torch.ones(2), atol=0.01)


def test_without_a_sensor_the_other_half_alone_is_given() -> None:
    model = build().eval()
    image, voxels = batch()
    whole, no_cloud, no_image = model(image, voxels), model(image, None), model(None, voxels)
    assert no_cloud.fused is None
    assert no_image.fused is None
    assert torch.equal(no_cloud.image_half, whole.image_half)
    assert torch.equal(no_image.lidar_half, whole.lidar_half)


def test_every_parameter_learns() -> None:
    model = build()
    fused = model(*batch(4)).fused
    (fused * torch.randn(fused.shape, generator=torch.Generator().manual_seed(2))).sum().backward()
    assert not [n for n, p in model.named_parameters() if p.grad is None or not p.grad.any()]


@pytest.mark.parametrize(("name", "parameters"), [("oertel", 2_078_432), ("oertel-s", 1_055_856)])
def test_the_configurations_look_ahead_and_mine(name: str, parameters: int) -> None:
    path = CONFIGS / f"{name}.yaml"
    config = load_config(TrainConfig, path)
    assert count(Oertel(config.model)) == parameters
    assert f"{parameters:,} parameters" in path.read_text(encoding="utf-8")
    grid = config.model.preprocess.voxels
    assert (grid.lower_m, grid.upper_m) == ((0, -20, 0), (40, 20, 5))
    mining = config.sampling.mining
    assert mining is not None
    assert (mining.candidates, mining.hardest) == (384, 16)
    assert (config.optimiser.kind, config.optimiser.amsgrad) == ("adam", False)
    assert config.model.p == 1


def test_a_point_behind_the_vehicle_is_not_seen() -> None:
    ahead, behind = torch.tensor([[[10.0, 0.0, 1.0]], [[-10.0, 0.0, 1.0]]]).numpy()
    assert TINY.preprocess.lidar_tensor(ahead).sum() == 1
    assert TINY.preprocess.lidar_tensor(behind).sum() == 0
