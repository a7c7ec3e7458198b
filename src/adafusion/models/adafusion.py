# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The network of AdaFusion (Lai, Yin, Scherer, RA-L 2022), and its ablations of the same parts."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from adafusion.config import to_plain
from adafusion.files import fingerprint
from adafusion.models.attention import VALUE_CHANNELS, ChannelAttention, SpatialAttention
from adafusion.models.backbones import Backbone, Conv, Conv3d, image_backbone, voxel_backbone
from adafusion.preprocess import Preprocess
from adafusion.types import Description

System = Literal["adafusion", "concat", "image", "lidar"]
Attention = Literal["released", "paper"]

LEVELS = 3
ATTENTION_WIDTH = 128  # length of a_I and a_P


@dataclass(frozen=True, kw_only=True)
class ModelConfig:
    """What a model is: enough to build it again and to feed it.

    `adafusion` weighs two branches, `concat` joins them unweighted, `image` and `lidar` are one
    branch alone, whose descriptor is its half: `dim // 2` numbers.
    """

    system: System = "adafusion"
    dim: int = 256  # length of the fused descriptor
    width: float = 1.0  # channels of the branches, as a share of the paper's
    attention_levels: int = 3  # the n deepest; 0: the weights come from the pooled features
    attention: Attention = "released"
    preprocess: Preprocess = field(default_factory=Preprocess)

    def __post_init__(self) -> None:
        if self.system not in ("adafusion", "concat", "image", "lidar"):
            raise ValueError(f"system {self.system!r}: choose adafusion, concat, image or lidar")
        if self.dim < 2 or self.dim % 2:
            raise ValueError(f"dim {self.dim} must be even: each sensor gives one half")
        if not 0 < self.width <= 4:
            raise ValueError(f"width {self.width} must be in (0, 4]")
        if not 0 <= self.attention_levels <= LEVELS:
            raise ValueError(f"attention_levels {self.attention_levels} must be 0 to {LEVELS}")
        if self.attention not in ("released", "paper"):
            raise ValueError(f"attention {self.attention!r}: choose released or paper")


class AdaFusion(nn.Module):
    """One image and one voxel grid in, one descriptor and two weights out.

    Nothing is detached: the loss on the fused descriptor reaches every parameter, as the paper
    says and unlike the released code.
    """

    def __init__(self, config: ModelConfig, name: str = "") -> None:
        super().__init__()
        self.config = config
        self.name = name or config.system
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
        self, image: Float[Tensor, "b 3 h w"] | None, voxels: Float[Tensor, "b 1 x y z"] | None
    ) -> Description:
        """Describe a batch. With one sensor None, only the other's half is given.

        Raises ValueError for tensors of another size than the model's own: the network is fully
        convolutional and would accept them, and match worse without a word.
        """
        self._check_sizes(image, voxels)
        f_I = f_P = fused = alpha = None
        if image is not None and self.image_net is not None:
            f_I, image_stages = self.image_net(image)
        if voxels is not None and self.voxel_net is not None:
            f_P, voxel_stages = self.voxel_net(voxels)

        if f_I is not None and f_P is not None:
            if self.weight_net is None:
                fused = torch.cat([f_I, f_P], dim=1)
            else:  # how far to trust each sensor, here and now
                alpha = self.weight_net(f_I, image_stages, f_P, voxel_stages)
                fused = torch.cat([alpha[:, :1] * f_I, alpha[:, 1:] * f_P], dim=1)
        elif self.config.system in ("image", "lidar"):
            fused = f_I if f_I is not None else f_P
        return Description(fused, f_I, f_P, alpha)

    def preprocess(
        self,
        image_u8: UInt8[np.ndarray, "h w 3"] | None,
        points_m: Float[np.ndarray, "n 3"] | None,
    ) -> tuple[Float[Tensor, "3 h2 w2"] | None, Float[Tensor, "1 x y z"] | None]:
        """Turn a raw RGB image and a cloud (body frame, metres) into the model's own tensors."""
        return self.config.preprocess(image_u8, points_m)

    @property
    def fingerprint(self) -> str:
        """Identity of what the model computes: its weights, its graph, its preprocessing."""
        weights = [
            part
            for name, tensor in sorted(self.state_dict().items())
            for part in (name, tensor.detach().cpu().contiguous().numpy().tobytes())
        ]
        return fingerprint(json.dumps(to_plain(self.config), sort_keys=True), *weights)

    @property
    def preprocess_fingerprint(self) -> str:
        """Identity of the preprocessing alone."""
        return self.config.preprocess.fingerprint

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

    def _check_sizes(self, image: Tensor | None, voxels: Tensor | None) -> None:
        settings = self.config.preprocess
        if (image is None or self.image_net is None) and (voxels is None or self.voxel_net is None):
            raise ValueError(f"model {self.name!r} was given nothing that it looks at")
        if image is not None and tuple(image.shape[2:]) != settings.image.size:
            raise ValueError(
                f"image of {tuple(image.shape[2:])} (height, width); model {self.name!r} takes "
                f"{settings.image.size}: make it with model.preprocess"
            )
        if voxels is not None and tuple(voxels.shape[2:]) != settings.voxels.shape:
            raise ValueError(
                f"voxels of {tuple(voxels.shape[2:])} cells; model {self.name!r} takes "
                f"{settings.voxels.shape}: make them with model.preprocess"
            )


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
