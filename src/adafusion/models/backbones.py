# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The two feature branches (paper Fig. 4): 2-D over the image, 3-D over the voxel grid.

Both are the same class; what differs between pixels and voxels (the layers, the pools, the widths)
comes in as an argument, so a fix can never reach only one of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from adafusion.models.pooling import Clusters, Mean

Conv = nn.Conv2d | nn.Conv3d


class Conv3d(nn.Conv3d):
    """`nn.Conv3d` that describes a single frame on a CPU up to four times faster.

    Eager torch sends a small 3-D input of batch one to a plain loop; oneDNN, which it takes for
    every larger one, is asked for here by name. Only under inference mode: it records no gradient.
    """

    def forward(self, input: Float[Tensor, "b c x y z"]) -> Float[Tensor, "b out x2 y2 z2"]:
        """Convolve; the same numbers within float rounding."""
        if not (
            torch.is_inference_mode_enabled()
            and input.device.type == "cpu"
            and len(input) == 1
            and torch.backends.mkldnn.is_available()
        ):
            return super().forward(input)
        assert not isinstance(self.padding, str)
        return torch.mkldnn_convolution(
            input, self.weight, self.bias, self.padding, self.stride, self.dilation, self.groups
        )


class Backbone(nn.Module):
    """Three blocks of convolutions; `pool` makes the feature of the last one's cells: their mean.

    Returns the feature (B, C) and the three stages, shallow to deep, that the weight branch reads.
    The feature is signed and not normalised: batch norm is the last thing before the last pool.
    """

    def __init__(self, blocks: Sequence[nn.Sequential]) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(blocks)
        self.pool: nn.Module = Mean()

    @property
    def stage_channels(self) -> tuple[int, ...]:
        """Channels of each stage, shallow to deep."""
        return tuple(
            [m.out_channels for m in block.modules() if isinstance(m, Conv)][-1]
            for block in self.blocks
        )

    @property
    def last_norm(self) -> nn.BatchNorm2d | nn.BatchNorm3d:
        """The batch norm before the last pool, where there is one: it scales the feature."""
        layers = self.blocks[-1].children()
        (norm,) = (m for m in layers if isinstance(m, nn.BatchNorm2d | nn.BatchNorm3d))
        return norm

    def forward(
        self, x: Float[Tensor, "b c *cells"]
    ) -> tuple[Float[Tensor, "b out"], list[Tensor]]:
        """Give the pooled feature and the stages."""
        stages = []
        for block in self.blocks:
            x = block(x)
            stages.append(x)
        return self.pool(x), stages

    @torch.no_grad()
    def scale(self, factor: float) -> None:
        """Multiply the feature, by the last norm; behind VLAD, which sees no scale."""
        if isinstance(self.pool, Clusters):
            self.pool.projection.weight.mul_(factor)
        else:
            self.last_norm.weight.mul_(factor)
            self.last_norm.bias.mul_(factor)


def image_backbone(half: int = 128, width: float = 1.0, last_norm: bool = True) -> Backbone:
    """Branch over (B, 3, H, W): stages of /4, /8 and /16 of the image's size.

    `half` is the length of the feature and `width` scales every other layer (1.0: the paper's).
    Without `last_norm` the feature is never negative.
    """
    c1, c2 = _scaled(64, width), _scaled(128, width)
    norm = [nn.BatchNorm2d(half)] if last_norm else []
    return Backbone(
        [
            nn.Sequential(
                *_convs(nn.Conv2d, 3, c1, c1),
                nn.MaxPool2d(2),
                *_convs(nn.Conv2d, c1, c1, c1),
                nn.MaxPool2d(2),
            ),
            nn.Sequential(*_convs(nn.Conv2d, c1, c1, c1, c2, c2), nn.MaxPool2d(2)),
            nn.Sequential(*_convs(nn.Conv2d, c2, c2, c2, half, half), *norm, nn.MaxPool2d(2)),
        ]
    )


def voxel_backbone(half: int = 128, width: float = 1.0, last_norm: bool = True) -> Backbone:
    """Branch over (B, 1, X, Y, Z): stages of 1/2, 1/4 and 1/8 of the grid's size."""
    c1, c2 = _scaled(32, width), _scaled(64, width)
    norm = [nn.BatchNorm3d(half)] if last_norm else []
    return Backbone(
        [
            nn.Sequential(*_convs(Conv3d, 1, c1, c1), nn.AvgPool3d(2)),
            nn.Sequential(*_convs(Conv3d, c1, c2, c2, c2, c2), nn.AvgPool3d(2)),
            nn.Sequential(*_convs(Conv3d, c2, half, half), *norm, nn.AvgPool3d(2)),
        ]
    )


def _convs(conv: type[Conv], *channels: int) -> list[nn.Module]:
    """Convolutions of kernel 3, stride 1, padding 1 through `channels`, each with a ReLU."""
    return [
        layer
        for c_in, c_out in pairwise(channels)
        for layer in (conv(c_in, c_out, kernel_size=3, padding=1), nn.ReLU(inplace=True))
    ]


def _scaled(channels: int, width: float) -> int:
    return max(1, round(channels * width))


def initialise_he(module: nn.Module, generator: torch.Generator) -> None:
    """Draw every convolution's weights so that the signal keeps its size through the ReLUs.

    The framework's default shrinks it by a factor of about 2.4 a layer; ten layers deep the image
    says nothing above the rounding of the biases, and the branch does not begin to learn.
    """
    for layer in module.modules():
        if isinstance(layer, Conv):
            fan_in = layer.weight[0].numel()
            with torch.no_grad():
                layer.weight.normal_(0.0, math.sqrt(2.0 / fan_in), generator=generator)
                if layer.bias is not None:
                    layer.bias.zero_()


def add_norms(backbone: Backbone) -> None:
    """Put a batch norm between every convolution and its ReLU, for training only.

    `fold_norms` takes them out again without changing what the trained network computes. A
    convolution without a bias has a norm of its own behind it, and gets none.
    """
    for block in backbone.blocks:
        for name, layer in list(block.named_children()):
            if isinstance(layer, Conv) and layer.bias is None:
                continue
            if isinstance(layer, nn.Conv2d):
                setattr(block, name, nn.Sequential(layer, nn.BatchNorm2d(layer.out_channels)))
            elif isinstance(layer, nn.Conv3d):
                setattr(block, name, nn.Sequential(layer, nn.BatchNorm3d(layer.out_channels)))


def fold_norms(backbone: Backbone) -> None:
    """Fold what `add_norms` added into the convolutions: the paper's network, with its parameters.

    Exact for the network in eval mode; running statistics become weights.
    """
    for block in backbone.blocks:
        for name, layer in list(block.named_children()):
            if isinstance(layer, nn.Sequential):
                conv, norm = layer[0], layer[1]
                assert isinstance(conv, Conv)
                assert isinstance(norm, nn.BatchNorm2d | nn.BatchNorm3d)
                setattr(block, name, fuse_conv_bn_eval(conv.eval(), norm.eval()))
