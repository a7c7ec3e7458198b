# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The weight branch's attention written the obvious way: every cell, every map, then a resize.

What `attention.py` computes at the surviving cells only, this computes everywhere, as the paper
draws it and the released code does it. Tests compare the two, and `benchmarks/describe.py` measures
what the shortcut is worth. It reads the parameters of a model; it has none of its own.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from adafusion.models.adafusion import AdaFusion, MultiScaleAttention, unit_scale
from adafusion.models.attention import KEY_CHANNELS, ChannelAttention, SpatialAttention
from adafusion.models.config import LEVELS
from adafusion.types import Description


def plain_forward(
    model: AdaFusion, image: Float[Tensor, "b 3 h w"], voxels: Float[Tensor, "b 1 x y z"]
) -> Description:
    """Compute `model(image, voxels)` for the `adafusion` system without any shortcut."""
    if model.weight_net is None or model.image_net is None or model.voxel_net is None:
        raise ValueError(f"{model.config.system} has no weight branch to compute plainly")
    f_I, image_stages = model.image_net(image)
    f_P, voxel_stages = model.voxel_net(voxels)
    a_I, a_P = f_I, f_P
    if model.weight_net.levels:
        a_I = plain_multi_scale(model.weight_net.image_attention, image_stages)
        a_P = plain_multi_scale(model.weight_net.voxel_attention, voxel_stages)
    alpha = model.weight_net.head(torch.cat([a_I, a_P], dim=1)).sigmoid()
    if model.image_add is not None and model.voxel_add is not None:
        f_I, f_P = f_I + model.image_add(a_I), f_P + model.voxel_add(a_P)
    if model.config.normalise_halves:
        f_I, f_P = unit_scale(f_I), unit_scale(f_P)
    fused = torch.cat([alpha[:, :1] * f_I, alpha[:, 1:] * f_P], dim=1)
    if model.config.unit_length:
        fused = F.normalize(fused, dim=1)
    return Description(fused, f_I, f_P, alpha)


def plain_multi_scale(
    attention: MultiScaleAttention, stages: list[Tensor]
) -> Float[Tensor, "b width"]:
    """Attend everywhere at each level, resize all maps to the deepest level, fuse and pool."""
    kept = stages[LEVELS - attention.levels :]
    layers = [*attention.spatial, *attention.channel]
    maps = [plain_attention(layer, x) for layer, x in zip(layers, kept + kept, strict=True)]
    cells = stages[-1].shape[2:]
    resized = [F.interpolate(m, size=cells, mode="nearest") for m in maps]
    return attention.fuse(torch.cat(resized, dim=1)).flatten(2).mean(dim=2)


def plain_attention(layer: nn.Module, x: Float[Tensor, "b c *cells"]) -> Tensor:
    """Either kind of attention, plainly."""
    if isinstance(layer, SpatialAttention):
        return plain_spatial(layer, x)
    assert isinstance(layer, ChannelAttention)
    return plain_channel(layer, x)


def plain_spatial(
    layer: SpatialAttention, x: Float[Tensor, "b c *cells"]
) -> Float[Tensor, "b value *out"]:
    """softmax(scale Q K^T) V with every cell a query, as one map of cells against cells."""
    qkv = layer.qkv(x)
    q_BKN, k_BKN, v_BVN = qkv.flatten(2).split(
        [KEY_CHANNELS, KEY_CHANNELS, qkv.shape[1] - 2 * KEY_CHANNELS], dim=1
    )
    weight_BNN = (layer.scale * q_BKN.mT @ k_BKN).softmax(dim=-1)
    return (weight_BNN @ v_BVN.mT).mT.unflatten(2, qkv.shape[2:])


def plain_channel(
    layer: ChannelAttention, x: Float[Tensor, "b c *cells"]
) -> Float[Tensor, "b value *cells"]:
    """softmax(Q K^T) V with channels as tokens, at every cell, then the narrowing convolution."""
    q, k, v = (x, x, x) if layer.qkv is None else layer.qkv(x).chunk(3, dim=1)
    weight_BCC = (q.flatten(2) @ k.flatten(2).mT).softmax(dim=-1)
    return layer.narrow((weight_BCC @ v.flatten(2)).unflatten(2, x.shape[2:]))
