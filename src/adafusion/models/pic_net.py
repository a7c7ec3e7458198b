# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A reconstruction of PIC-Net (Lu et al., 2020): image and points, weighed within and joined.

The network's code is not public. Known are an attention within each branch, an attention that joins
the two, equal shares of both sensors, and the PointNetVLAD benchmark. The parts, the sizes and the
training are ours, of what other systems here are made of. Night images are not translated into
daylight, as they are there. Tables should call it "PIC-Net (re-implementation)".
"""

from __future__ import annotations

from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from adafusion.models.base import PlaceModel
from adafusion.models.config import ModelConfig
from adafusion.models.pointnetvlad import PointFeatures
from adafusion.models.resnet import load_imagenet_resnet18, resnet18
from adafusion.models.vlad import SoftVLAD
from adafusion.types import Description, UserError

NATIVE_DIM = 256
SQUEEZE = 16  # how many channels the channel attention makes one of


class PicNet(PlaceModel):
    """One image and one set of points in; the descriptor and each sensor's half are of length 1.

    Each half is as long as the descriptor.
    """

    def __init__(self, config: ModelConfig, name: str = "") -> None:
        super().__init__(config, name)
        if config.preprocess.lidar != "points":
            raise UserError(
                f"pic-net looks at points, not at {config.preprocess.lidar}: "
                "set preprocess.lidar=points"
            )
        dim = config.dim or NATIVE_DIM
        self.image_net = resnet18(width=config.width)
        c_image = self.image_net.channels[-1]
        self.image_attention = PixelAttention()
        self.image_half = Gather(SoftVLAD(c_image, config.clusters), dim)
        self.point_net = PointFeatures(config.width)
        c_point = self.point_net.channels
        self.point_attention = PointAttention(c_point)
        self.lidar_half = Gather(
            SoftVLAD(c_point, config.clusters, normalised_assignment=True), dim
        )
        self.channel_attention = ChannelAttention(2 * dim)
        self.fuse = nn.Linear(2 * dim, dim)

    def forward(
        self, image: Float[Tensor, "b 3 h w"] | None, lidar: Float[Tensor, "b n 3"] | None
    ) -> Description:
        """Describe a batch. With one sensor None, only the other's half is given."""
        self.check_sizes(image, lidar)
        v_BD = l_BD = fused = None
        if image is not None:
            pixels_BCHW = self.image_net(image)[-1]
            v_BD = self.image_half(pixels_BCHW.flatten(2), self.image_attention(pixels_BCHW))
        if lidar is not None:
            points_BCN = self.point_net(lidar)
            l_BD = self.lidar_half(points_BCN, self.point_attention(points_BCN))
        if v_BD is not None and l_BD is not None:
            fused = _unit(self.fuse(self.channel_attention(torch.cat([v_BD, l_BD], dim=1))))
        return Description(
            fused,
            None if v_BD is None else _unit(v_BD),
            None if l_BD is None else _unit(l_BD),
            None,
        )

    def initialise(self, generator: torch.Generator) -> None:
        """Draw everything: both networks as their authors do, what joins them without offsets."""
        for part in (self.image_net, self.point_net, self.image_half, self.lidar_half):
            part.initialise(generator)
        joins = (self.image_attention, self.point_attention, self.channel_attention, self.fuse)
        for join in joins:
            for layer in join.modules():
                if isinstance(layer, nn.Linear | nn.Conv2d):
                    nn.init.xavier_uniform_(layer.weight, generator=generator)
                    assert layer.bias is not None
                    nn.init.zeros_(layer.bias)

    def load_imagenet(self, path: str | Path) -> None:
        """Start the image network from torchvision's ResNet-18, all of which learns on.

        Raises UserError for a file that does not hold every layer in our size, and where the image
        comes in other colours than ImageNet's.
        """
        if self.config.preprocess.image.colours != "imagenet":
            raise UserError(
                f"{path}: these weights expect the colours of ImageNet; "
                "set model.preprocess.image.colours=imagenet"
            )
        load_imagenet_resnet18(self.image_net, path)


class Gather(nn.Module):
    """Local features by their weights to VLAD's vector, and this to one sensor's numbers.

    The batch norm makes the numbers of both sensors vary alike: neither takes over where they join.
    """

    def __init__(self, vlad: SoftVLAD, dim: int) -> None:
        super().__init__()
        self.vlad = vlad
        self.reduce = nn.Linear(vlad.length, dim, bias=False)
        self.norm = nn.BatchNorm1d(dim)
        self.initialise()

    def forward(
        self, x: Float[Tensor, "b c n"], weight: Float[Tensor, "b n"]
    ) -> Float[Tensor, "b dim"]:
        """Give numbers of mean 0 and spread 1 over a batch."""
        return self.norm(self.reduce(self.vlad(x, weight)))

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw the weights as PointNetVLAD does.

        What comes in has length 1. The framework would draw weights so small that the norm divides
        by little more than its epsilon.
        """
        self.vlad.initialise(generator)
        spread = len(self.vlad.centroids) ** -0.5
        nn.init.normal_(self.reduce.weight, 0.0, spread, generator=generator)
        self.norm.reset_parameters()


class PixelAttention(nn.Module):
    """How much each cell of a map counts, by its mean and greatest channel and its neighbours'.

    The spatial half of CBAM (Woo et al., ECCV 2018).
    """

    def __init__(self) -> None:
        super().__init__()
        self.conv = nn.Conv2d(2, 1, 7, padding=3)

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b hw"]:
        """Give weights in (0, 1), row after row."""
        summary = torch.stack([x.mean(dim=1), x.amax(dim=1)], dim=1)
        return self.conv(summary).flatten(1).sigmoid()


class PointAttention(nn.Module):
    """How much each point counts, by its own feature."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        hidden = max(1, channels // 4)
        self.mlp = nn.Sequential(
            nn.Linear(channels, hidden), nn.ReLU(inplace=True), nn.Linear(hidden, 1)
        )

    def forward(self, x: Float[Tensor, "b c n"]) -> Float[Tensor, "b n"]:
        """Give weights in (0, 1)."""
        return self.mlp(x.mT)[:, :, 0].sigmoid()


class ChannelAttention(nn.Module):
    """How much of each number of both halves passes, by all of them (Hu et al., CVPR 2018)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        squeezed = max(1, channels // SQUEEZE)
        self.mlp = nn.Sequential(
            nn.Linear(channels, squeezed), nn.ReLU(inplace=True), nn.Linear(squeezed, channels)
        )

    def forward(self, x: Float[Tensor, "b c"]) -> Float[Tensor, "b c"]:
        """Multiply each number by its weight, in (0, 1)."""
        return x * self.mlp(x).sigmoid()


def _unit(x: Float[Tensor, "b d"]) -> Float[Tensor, "b d"]:
    return F.normalize(x, dim=1)
