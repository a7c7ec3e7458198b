# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A map to a feature in four ways, alone and within the branches."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import pytest
import torch
from torch import nn

from adafusion.models import AdaFusion, ModelConfig, load_model, save_model
from adafusion.models.backbones import Backbone, add_norms, fold_norms, initialise_he
from adafusion.models.pooling import LEAST, AllCells, Clusters, GeneralisedMean, Mean, Pooling
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid

TINY = ModelConfig(
    width=0.125,
    dim=16,
    clusters=3,
    preprocess=Preprocess(image=ImageSettings(size=(50, 64)), voxels=VoxelGrid(shape=(17, 16, 8))),
)
every_pooling = pytest.mark.parametrize("pooling", get_args(Pooling))


def build(**changes: object) -> AdaFusion:
    torch.manual_seed(0)
    model = AdaFusion(replace(TINY, **changes))
    model.initialise(torch.Generator().manual_seed(0))
    return model


def batch(n: int = 2) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(n, 3, 50, 64, generator=generator) * 2 - 1
    return image, (torch.rand(n, 1, 17, 16, 8, generator=generator) < 0.1).float()


def branches(model: AdaFusion) -> list[tuple[Backbone, torch.Tensor]]:
    assert model.image_net is not None
    assert model.voxel_net is not None
    return list(zip((model.image_net, model.voxel_net), batch(4), strict=True))


def test_each_pools_a_map_as_its_name_says() -> None:
    x = torch.tensor([[[[1.0, 3.0], [2.0, 2.0]], [[-1.0, 2.0], [-3.0, -2.0]]]])  # (1, 2, 2, 2)
    assert Mean()(x).tolist() == [[2.0, -1.0]]

    gem = GeneralisedMean()
    cubes = [(1 + 27 + 8 + 8) / 4, (8 + 3 * LEAST**3) / 4]  # below zero nothing is left
    assert torch.allclose(gem(x), torch.tensor([[c ** (1 / 3) for c in cubes]]))
    with torch.no_grad():
        gem.power.fill_(1.0)
    assert torch.allclose(gem(x), torch.tensor([[2.0, 0.5]]), atol=1e-5)

    fc = AllCells(2, (2, 2))
    expected = [sum(w * v for w, v in zip(row, x.flatten().tolist(), strict=True))
                for row in fc.projection.weight.tolist()]  # fmt: skip
    assert torch.allclose(fc(x), torch.tensor([expected]), atol=1e-6)

    vlad = Clusters(2, 3).eval()
    swapped = x.flip(2)  # which cell is where is of no matter
    assert torch.allclose(vlad(x), vlad(swapped), atol=1e-6)
    assert not torch.allclose(fc(x), fc(swapped), atol=1e-3)


def test_the_mean_adds_nothing_to_a_model_file_and_changes_no_bit() -> None:
    model = build().eval()
    assert not [name for name in model.state_dict() if ".pool." in name]
    for net, x in branches(model):
        feature, stages = net(x)
        assert torch.equal(feature, stages[-1].flatten(2).mean(dim=2))


@every_pooling
def test_every_parameter_learns(pooling: Pooling) -> None:
    model = build(pooling=pooling, attention_levels=0)  # weights from what was pooled
    model(*batch(4)).fused.pow(3).sum().backward()
    stuck = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()]
    assert not stuck


@every_pooling
@pytest.mark.parametrize("system", ["adafusion", "concat", "image", "lidar"])
def test_a_model_file_brings_it_back(pooling: Pooling, system: str, tmp_path) -> None:
    model = build(pooling=pooling, system=system).eval()
    save_model(model, tmp_path / "model.safetensors")
    again = load_model(tmp_path / "model.safetensors")
    image, voxels = batch()
    inputs = (None if system == "lidar" else image, None if system == "image" else voxels)
    fused = again(*inputs).fused
    assert torch.allclose(fused, model(*inputs).fused, atol=1e-5)
    assert fused.shape == (2, 16 if system in ("adafusion", "concat") else 8)


@every_pooling
def test_norms_for_training_fold_away(pooling: Pooling) -> None:
    for net, x in branches(build(pooling=pooling)):
        names = set(net.state_dict())
        add_norms(net)
        initialise_he(net, torch.Generator().manual_seed(3))
        net.train()
        for _ in range(3):
            net(x)
        before = net.eval()(x)[0]
        fold_norms(net)
        assert set(net.state_dict()) == names
        assert torch.allclose(net(x)[0], before, atol=1e-4)


@every_pooling
def test_a_branch_is_scaled_by_a_factor(pooling: Pooling) -> None:
    for net, x in branches(build(pooling=pooling).eval()):
        before = net(x)[0]
        net.scale(2.5)
        assert torch.allclose(net(x)[0], 2.5 * before, rtol=1e-3, atol=1e-4)


def test_only_a_layer_over_all_cells_asks_for_their_number() -> None:
    larger = replace(TINY.preprocess, image=ImageSettings(size=(96, 128)))
    for pooling in get_args(Pooling):
        model, other = build(pooling=pooling), build(pooling=pooling, preprocess=larger)
        if pooling == "fc":
            with pytest.raises(RuntimeError, match="size mismatch"):
                other.load_state_dict(model.state_dict())
        else:
            other.load_state_dict(model.state_dict())


def test_a_layer_over_all_cells_fits_a_branch_that_rounds_up() -> None:
    model = build(pooling="fc", system="image", image_backbone="efficientnet-lite0").eval()
    assert model(batch()[0], None).fused.shape == (2, 8)


def test_a_descriptor_of_length_one_points_where_it_pointed_and_is_searched_by_l2() -> None:
    plain, unit = build(system="lidar").eval(), build(system="lidar", unit_length=True).eval()
    assert (plain.config.p, unit.config.p) == (1, 2)
    voxels = batch()[1]
    raw, fused = plain(None, voxels).fused, unit(None, voxels).fused
    assert torch.allclose(fused.norm(dim=1), torch.ones(2))
    assert torch.allclose(nn.functional.cosine_similarity(raw, fused), torch.ones(2), atol=1e-5)


def test_systems_with_a_way_of_their_own_refuse_another() -> None:
    for changes in ({"pooling": "gem"}, {"unit_length": True}):
        with pytest.raises(ValueError, match="netvlad has its own"):
            ModelConfig(system="netvlad", **changes)
