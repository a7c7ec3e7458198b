# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Attention at the surviving cells against slow forms that ask for every cell."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from adafusion.models import AdaFusion, ModelConfig
from adafusion.models.attention import ChannelAttention, SpatialAttention, surviving_cells
from adafusion.models.plain import plain_forward
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid

CONFIG = ModelConfig(
    width=0.125,
    dim=16,
    preprocess=Preprocess(image=ImageSettings(size=(70, 90)), voxels=VoxelGrid(shape=(20, 16, 24))),
)


@pytest.mark.parametrize(
    ("cells", "out"),
    [((38, 50), (18, 25)), ((18, 18, 12), (9, 9, 6)), ((75, 100), (18, 25)), ((5, 7), (5, 7))],
)
def test_surviving_cells_are_those_of_a_nearest_neighbour_resize(
    cells: tuple[int, ...], out: tuple[int, ...]
) -> None:
    numbered = torch.arange(torch.tensor(cells).prod().item()).float().reshape(1, 1, *cells)
    resized = F.interpolate(numbered, size=out, mode="nearest").flatten().long()
    assert torch.equal(surviving_cells(cells, out), resized)


@pytest.mark.parametrize("attention", ["released", "paper"])
@pytest.mark.parametrize("levels", [0, 1, 2, 3])
@torch.inference_mode()
def test_the_network_equals_its_plain_form(attention: str, levels: int) -> None:
    torch.manual_seed(0)
    model = AdaFusion(replace(CONFIG, attention=attention, attention_levels=levels)).eval()
    image, voxels = torch.randn(2, 3, 70, 90), (torch.rand(2, 1, 20, 16, 24) < 0.2).float()
    for fast, plain in zip(model(image, voxels), plain_forward(model, image, voxels), strict=True):
        assert torch.allclose(fast, plain, atol=1e-5)


@torch.inference_mode()
def test_spatial_attention_is_the_papers_equation_cell_by_cell() -> None:
    torch.manual_seed(0)
    layer = SpatialAttention(nn.Conv2d, channels=3, stride=1, scaled=False)
    x = torch.randn(1, 3, 4, 5)
    q, k, v = layer.qkv(x)[0].flatten(1).split([4, 4, 16])
    expected = torch.zeros(16, 20)
    for i in range(20):
        scores = [float(q[:, i] @ k[:, j]) for j in range(20)]
        weights = torch.tensor(scores).exp() / torch.tensor(scores).exp().sum()
        for j in range(20):
            expected[:, i] += weights[j] * v[:, j]
    assert torch.allclose(layer(x, (4, 5))[0].flatten(1), expected, atol=1e-5)


@pytest.mark.parametrize("projected", [True, False])
@torch.inference_mode()
def test_channel_attention_is_the_papers_equation_channel_by_channel(projected: bool) -> None:
    torch.manual_seed(0)
    layer = ChannelAttention(nn.Conv3d, channels=3, projected=projected)
    x = torch.randn(1, 3, 2, 3, 2)
    flat = x[0].flatten(1)
    q = k = v = flat
    if layer.qkv is not None:
        q, k, v = layer.qkv(x)[0].flatten(1).split([3, 3, 3])
    attended = torch.zeros(3, 12)
    for c in range(3):
        scores = [float(q[c] @ k[other]) for other in range(3)]
        weights = torch.tensor(scores).exp() / torch.tensor(scores).exp().sum()
        for other in range(3):
            attended[c] += weights[other] * v[other]
    expected = layer.narrow.weight.flatten(1) @ attended + layer.narrow.bias[:, None]
    assert torch.allclose(layer(x, (2, 3, 2))[0].flatten(1), expected, atol=1e-5)


def test_paper_attention_strides_nothing_and_released_strides_the_shallow_levels() -> None:
    strides = {
        name: [
            layer.qkv.stride[0]
            for layer in AdaFusion(
                replace(CONFIG, attention=name)
            ).weight_net.image_attention.spatial
        ]
        for name in ("released", "paper")
    }
    assert strides == {"released": [2, 2, 1], "paper": [1, 1, 1]}
