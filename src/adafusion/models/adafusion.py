# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The network of AdaFusion (Lai, Yin, Scherer, RA-L 2022), and its ablations of the same parts."""

from __future__ import annotations

from pathlib import Path

import torch
import torch.nn.functional as F
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
from adafusion.models.efficientnet import efficientnet_backbone, load_efficientnet
from adafusion.models.pooling import build_pool
from adafusion.types import Description, UserError

ATTENTION_WIDTH = 128  # length of a_I and a_P

Seen = tuple[Tensor, list[Tensor]]  # what a branch gives: feature (B, C), stages shallow to deep


class AdaFusion(PlaceModel):
    """One image and one voxel grid in, one descriptor and two weights out.

    Nothing is detached: the loss on the fused descriptor reaches every parameter, as the paper
    says and unlike the released code.

    `fusion: weights` is the paper's: the attention of each sensor is joined within it (a kernel-1
    convolution over its maps), then across both. `one-stage-weights` leaves the first step out: the
    pooled maps of both sensors go to the weights' layers at once. `linear` has no weights: one
    linear layer over both features, the identity before it learns. With `attend_features` the
    attention reaches the descriptor too: projected to its length, it is added to its sensor's
    feature before the weighing; the projection is zero before it learns.
    """

    def __init__(self, config: ModelConfig, name: str = "") -> None:
        super().__init__(config, name)
        check_room(config)
        half = config.dim // 2
        size = (half, config.width, config.last_norm)
        self.image_net: Backbone | None = None
        if config.system != "lidar" and config.image_backbone == "paper":
            self.image_net = image_backbone(*size)
        elif config.system != "lidar":
            self.image_net = efficientnet_backbone(half, config.last_norm)
        self.voxel_net = voxel_backbone(*size) if config.system != "image" else None
        for net, cells in zip((self.image_net, self.voxel_net), last_cells(config), strict=True):
            if net is not None:
                net.pool = build_pool(config.pooling, half, cells, config.clusters)
        self.weight_net: WeightBranch | None = None
        self.linear: nn.Linear | None = None
        self.image_add: nn.Linear | None = None
        self.voxel_add: nn.Linear | None = None
        if config.system == "adafusion" and config.fusion == "linear":
            self.linear = nn.Linear(config.dim, config.dim)
            nn.init.eye_(self.linear.weight)
            nn.init.zeros_(self.linear.bias)
        elif config.system == "adafusion":
            assert self.image_net is not None
            assert self.voxel_net is not None
            self.weight_net = WeightBranch(
                self.image_net.stage_channels,
                self.voxel_net.stage_channels,
                config.attention_levels,
                config.attention,
                joined_first=config.fusion == "weights",
            )
            if config.attend_features:
                self.image_add = _nothing_yet(self.weight_net.width, half)
                self.voxel_add = _nothing_yet(self.weight_net.width, half)
        self._backbones_frozen = False

    def forward(
        self, image: Float[Tensor, "b 3 h w"] | None, lidar: Float[Tensor, "b 1 x y z"] | None
    ) -> Description:
        """Describe a batch. With one sensor None, only the other's half is given.

        Raises ValueError for tensors of another size than the model's own: the network is fully
        convolutional and would accept them, and match worse without a word.
        """
        self.check_sizes(image, lidar)
        image_seen = voxels_seen = None
        if image is not None and self.image_net is not None:
            image_seen = self.image_net(image)
        if lidar is not None and self.voxel_net is not None:
            voxels_seen = self.voxel_net(lidar)
        return self.fuse(image_seen, voxels_seen)

    def fuse(self, image: Seen | None, voxels: Seen | None) -> Description:
        """Describe a batch by what each branch gave: its feature and its stages."""
        f_I = f_P = a_I = a_P = fused = alpha = None
        if image is not None:
            f_I = image[0]
        if voxels is not None:
            f_P = voxels[0]
        both = f_I is not None and f_P is not None
        if self.weight_net is not None and (both or self.config.attend_features):
            a_I, a_P = self.weight_net.attend(image, voxels)
            if a_I is not None and a_P is not None:  # how far to trust each sensor, here and now
                alpha = self.weight_net(a_I, a_P)
        if self.image_add is not None and f_I is not None:
            f_I = f_I + self.image_add(a_I)
        if self.voxel_add is not None and f_P is not None:
            f_P = f_P + self.voxel_add(a_P)
        if self.config.normalise_halves:  # what the weights were made of had its own scale
            f_I = None if f_I is None else unit_scale(f_I)
            f_P = None if f_P is None else unit_scale(f_P)
        if f_I is not None and f_P is not None:
            if alpha is None:
                fused = torch.cat([f_I, f_P], dim=1)
                fused = fused if self.linear is None else self.linear(fused)
            else:
                fused = torch.cat([alpha[:, :1] * f_I, alpha[:, 1:] * f_P], dim=1)
        elif self.config.system in ("image", "lidar"):
            fused = f_I if f_I is not None else f_P
        if fused is not None and self.config.unit_length:
            fused = F.normalize(fused, dim=1)
        return Description(fused, f_I, f_P, alpha)

    def initialise(self, generator: torch.Generator) -> None:
        """Draw the branches so that the signal keeps its size: see `initialise_he`."""
        for net in self.backbones:
            initialise_he(net, generator)

    def load_imagenet(self, path: str | Path) -> None:
        """Start an image branch of `image_backbone: efficientnet-lite0` from its public weights.

        All of it learns on. Raises UserError for another branch, a file that does not hold every
        layer, and where the image comes in other colours than the weights expect.
        """
        if self.image_net is None or self.config.image_backbone == "paper":
            raise UserError(
                f"{path}: the paper's branches have no ImageNet weights; set "
                "model.image_backbone=efficientnet-lite0 in a system that looks at images"
            )
        if self.config.preprocess.image.colours != "unit":
            raise UserError(
                f"{path}: these weights expect colours in [-1, 1]; "
                "set model.preprocess.image.colours=unit"
            )
        load_efficientnet(self.image_net, path)

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


def _nothing_yet(inputs: int, outputs: int) -> nn.Linear:
    """A linear layer that gives zeros until it has learnt."""
    layer = nn.Linear(inputs, outputs)
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


def check_room(config: ModelConfig) -> None:
    """UserError for an input that has not a cell left when the branch has halved it."""
    image, voxels = config.preprocess.image.size, config.preprocess.voxels.shape
    for sensor, key, size, halvings in (
        ("image", "image.size", image, 4),
        ("lidar", "voxels.shape", voxels, 3),
    ):
        if sensor in config.sensors and min(size) < 2**halvings:
            raise UserError(
                f"{key} {size}: the branch halves it {halvings} times, so every axis must have at "
                f"least {2**halvings}"
            )


def last_cells(config: ModelConfig) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Cells of the last map of the image's branch, (height, width), and of the LiDAR's."""
    settings, rounded_up = config.preprocess, config.image_backbone != "paper"
    image = tuple(-(-n // 16) if rounded_up else n // 16 for n in settings.image.size)
    return image, tuple(n // 8 for n in settings.voxels.shape)


def unit_scale(half: Float[Tensor, "b half"]) -> Float[Tensor, "b half"]:
    """Bring each frame's half to a mean absolute value of 1, so that alpha alone says the trust.

    By the L1 norm, since places are searched by L1: the half's part of a distance is then at most
    the sum of both frames' weights times its length, the same bound for both sensors. Halves of one
    L2 length would still differ in L1, by up to the root of their length, between a sensor that
    speaks in few numbers and one that speaks in all. A half of zeros stays one.
    """
    return half.shape[1] * F.normalize(half, p=1.0, dim=1)


class WeightBranch(nn.Module):
    """Two weights in (0, 1) from both sensors' features (paper Fig. 4, lower half)."""

    def __init__(
        self,
        image_channels: tuple[int, ...],
        voxel_channels: tuple[int, ...],
        levels: int,
        attention: Attention,
        joined_first: bool = True,
    ) -> None:
        super().__init__()
        if levels:
            how = (levels, attention, joined_first)
            self.image_attention = MultiScaleAttention(nn.Conv2d, image_channels, *how)
            self.voxel_attention = MultiScaleAttention(Conv3d, voxel_channels, *how)
            self.width = self.image_attention.width  # of a_I and of a_P
            joined = 2 * self.width
        else:
            joined = image_channels[-1] + voxel_channels[-1]
        self.levels = levels
        self.head = nn.Sequential(
            nn.Linear(joined, 64), nn.ReLU(), nn.Linear(64, 32), nn.ReLU(), nn.Linear(32, 2)
        )

    def attend(
        self, image: Seen | None, voxels: Seen | None
    ) -> tuple[Float[Tensor, "b width"] | None, Float[Tensor, "b width2"] | None]:
        """Give a_I and a_P, each of its sensor alone; without levels they are f_I and f_P."""
        a_I = a_P = None
        if image is not None:
            a_I = self.image_attention(image[1]) if self.levels else image[0]
        if voxels is not None:
            a_P = self.voxel_attention(voxels[1]) if self.levels else voxels[0]
        return a_I, a_P

    def forward(
        self, a_I: Float[Tensor, "b width"], a_P: Float[Tensor, "b width2"]
    ) -> Float[Tensor, "b 2"]:
        """Give alpha: column 0 for the image, column 1 for the LiDAR."""
        return self.head(torch.cat([a_I, a_P], dim=1)).sigmoid()


class MultiScaleAttention(nn.Module):
    """Spatial and channel attention at the n deepest levels, joined at the deepest one's cells.

    The join is a kernel-1 convolution; without it (`joined=False`) the maps stand side by side.
    """

    def __init__(
        self,
        conv: type[Conv],
        channels: tuple[int, ...],
        levels: int,
        attention: Attention,
        joined: bool = True,
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
        maps = 2 * levels * VALUE_CHANNELS
        self.width = ATTENTION_WIDTH if joined else maps
        fuse: list[nn.Module] = [conv(maps, ATTENTION_WIDTH, kernel_size=1)] if joined else []
        if joined and released:
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
