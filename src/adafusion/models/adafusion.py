# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The network of AdaFusion (Lai, Yin, Scherer, RA-L 2022), and its ablations of the same parts."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from adafusion.models.attention import VALUE_CHANNELS, ChannelAttention, SpatialAttention
from adafusion.models.backbones import (
    Backbone,
    Conv,
    Conv3d,
    image_backbone,
    initialise_he,
    voxel_backbone,
)
from adafusion.models.base import PlaceModel
from adafusion.models.config import LEVELS, Attention, ModelConfig
from adafusion.types import Description

ATTENTION_WIDTH = 128  # length of a_I and a_P


class AdaFusion(PlaceModel):
    """One image and one voxel grid in, one descriptor and two weights out.

    Nothing is detached: the loss on the fused descriptor reaches every parameter, as the paper
    says and unlike the released code.
    """

    def __init__(self, config: ModelConfig, name: str = "") -> None:
        super().__init__(config, name)
        half = config.dim // 2
        self.image_net = image_backbone(half, config.width) if config.system != "lidar" else None
        self.voxel_net = voxel_backbone(half, config.width) if config.system != "image" else None
        self.weight_net: WeightBranch | None = None
        if config.system == "adafusion":
            assert self.image_net is not None
            assert self.voxel_net is not None
            self.weight_net = WeightBranch(
                self.image_net.stage_channels,
                self.voxel_net.stage_channels,
                config.attention_levels,
                config.attention,
            )
        self._backbones_frozen = False

    def forward(
        self, image: Float[Tensor, "b 3 h w"] | None, lidar: Float[Tensor, "b 1 x y z"] | None
    ) -> Description:
        """Describe a batch. With one sensor None, only the other's half is given.

        Raises ValueError for tensors of another size than the model's own: the network is fully
        convolutional and would accept them, and match worse without a word.
        """
        self.check_sizes(image, lidar)
        f_I = f_P = fused = alpha = None
        if image is not None and self.image_net is not None:
            f_I, image_stages = self.image_net(image)
        if lidar is not None and self.voxel_net is not None:
            f_P, voxel_stages = self.voxel_net(lidar)

        if f_I is not None and f_P is not None:
            if self.weight_net is None:
                fused = torch.cat([f_I, f_P], dim=1)
            else:  # how far to trust each sensor, here and now
                alpha = self.weight_net(f_I, image_stages, f_P, voxel_stages)
                fused = torch.cat([alpha[:, :1] * f_I, alpha[:, 1:] * f_P], dim=1)
        elif self.config.system in ("image", "lidar"):
            fused = f_I if f_I is not None else f_P
        return Description(fused, f_I, f_P, alpha)

    def initialise(self, generator: torch.Generator) -> None:
        """Draw the branches so that the signal keeps its size: see `initialise_he`."""
        for net in self.backbones:
            initialise_he(net, generator)

    def freeze_backbones(self) -> None:
        """Let the weight branch alone learn (`stage="weights"`).

        The branches stay in eval mode whatever `train` says. In the released code's second stage
        their batch-norm statistics keep moving although their weights do not; here they do not.
        """
        self._backbones_frozen = True
        for net in self.backbones:
            net.requires_grad_(False)
        self.train(self.training)

    @property
    def backbones(self) -> list[Backbone]:
        """The feature branches this system has."""
        return [net for net in (self.image_net, self.voxel_net) if net is not None]

    def train(self, mode: bool = True) -> AdaFusion:
        """Switch to training mode, leaving frozen branches in eval mode."""
        super().train(mode)
        if self._backbones_frozen:
            for net in self.backbones:
                net.eval()
        return self


class WeightBranch(nn.Module):
    """Two weights in (0, 1) from both sensors' features (paper Fig. 4, lower half)."""

    def __init__(
        self,
        image_channels: tuple[int, ...],
        voxel_channels: tuple[int, ...],
        levels: int,
        attention: Attention,
    ) -> None:
        super().__init__()
        if levels:
            self.image_attention = MultiScaleAttention(nn.Conv2d, image_channels, levels, attention)
            self.voxel_attention = MultiScaleAttention(Conv3d, voxel_channels, levels, attention)
            joined = 2 * ATTENTION_WIDTH
        else:
            joined = image_channels[-1] + voxel_channels[-1]
        self.levels = levels
        self.head = nn.Sequential(
            nn.Linear(joined, 64), nn.ReLU(), nn.Linear(64, 32), nn.ReLU(), nn.Linear(32, 2)
        )

    def forward(
        self,
        f_I: Float[Tensor, "b half"],
        image_stages: list[Tensor],
        f_P: Float[Tensor, "b half"],
        voxel_stages: list[Tensor],
    ) -> Float[Tensor, "b 2"]:
        """Give alpha: column 0 for the image, column 1 for the LiDAR."""
        if self.levels:
            a_I, a_P = self.image_attention(image_stages), self.voxel_attention(voxel_stages)
        else:
            a_I, a_P = f_I, f_P
        return self.head(torch.cat([a_I, a_P], dim=1)).sigmoid()


class MultiScaleAttention(nn.Module):
    """Spatial and channel attention at the n deepest levels, joined at the deepest one's cells."""

    def __init__(
        self, conv: type[Conv], channels: tuple[int, ...], levels: int, attention: Attention
    ) -> None:
        super().__init__()
        released = attention == "released"
        kept = range(LEVELS - levels, LEVELS)
        strides = [2 if released and level < LEVELS - 1 else 1 for level in kept]
        self.levels = levels
        self.spatial = nn.ModuleList(
            SpatialAttention(conv, channels[level], stride, scaled=released)
            for level, stride in zip(kept, strides, strict=True)
        )
        self.channel = nn.ModuleList(
            ChannelAttention(conv, channels[level], projected=not released) for level in kept
        )
        fuse: list[nn.Module] = [conv(2 * levels * VALUE_CHANNELS, ATTENTION_WIDTH, kernel_size=1)]
        if released:
            norm = nn.BatchNorm2d if conv is nn.Conv2d else nn.BatchNorm3d
            fuse += [norm(ATTENTION_WIDTH), nn.ReLU()]
        self.fuse = nn.Sequential(*fuse)

    def forward(self, stages: list[Tensor]) -> Float[Tensor, "b width"]:
        """Give the pooled attention a_I or a_P of one sensor's stages (shallow to deep)."""
        out_cells = tuple(stages[-1].shape[2:])
        kept = stages[LEVELS - self.levels :]
        maps = [attend(x, out_cells) for attend, x in zip(self.spatial, kept, strict=True)]
        maps += [attend(x, out_cells) for attend, x in zip(self.channel, kept, strict=True)]
        return self.fuse(torch.cat(maps, dim=1)).flatten(2).mean(dim=2)
