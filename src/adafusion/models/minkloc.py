# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""MinkLoc++ (Komorowski, Wysoczanska, Trzcinski, IJCNN 2021): an image and a sparse cloud, joined.

Each branch is a feature pyramid and a generalised mean of its last map; the descriptor is the two
means side by side, of no particular length. What keeps one sensor from taking over is the loss: the
cloud's half has one of its own and the image's has none (`loss.lidar_half_weight`).
"""

from __future__ import annotations

from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from adafusion.models.base import PlaceModel
from adafusion.models.config import ModelConfig
from adafusion.models.pooling import GeneralisedMean
from adafusion.models.resnet import load_imagenet_resnet18, resnet18
from adafusion.models.sparse import Double, Halve, Sites, SparseConv3d, initialise_fan_out, occupied
from adafusion.types import Description, UserError

NATIVE_DIM = 256


class MinkLoc(PlaceModel):
    """One image and one set of points in; the cloud's half and the image's, in this order, out."""

    def __init__(self, config: ModelConfig, name: str = "") -> None:
        super().__init__(config, name)
        if config.preprocess.lidar != "points":
            raise UserError(
                f"minkloc looks at points, not at {config.preprocess.lidar}: "
                "set preprocess.lidar=points"
            )
        dim = config.dim or NATIVE_DIM
        if dim % 2:
            raise UserError(f"dim {dim} must be even: each sensor gives one half")
        self.image_net = ImageBranch(dim // 2, config.width)
        self.cloud_net = CloudBranch(dim // 2, config.width)

    def forward(
        self, image: Float[Tensor, "b 3 h w"] | None, lidar: Float[Tensor, "b n 3"] | None
    ) -> Description:
        """Describe a batch. With one sensor None, only the other's half is given."""
        self.check_sizes(image, lidar)
        image_half = cloud_half = fused = None
        if image is not None:
            image_half = self.image_net(image)
        if lidar is not None:
            cloud_half = self.cloud_net(occupied(lidar, self.config.preprocess.points.quantum))
        if image_half is not None and cloud_half is not None:
            fused = torch.cat([cloud_half, image_half], dim=1)
        return Description(fused, image_half, cloud_half, None)

    def initialise(self, generator: torch.Generator) -> None:
        """Draw all weights as the original does where no ImageNet weights are at hand."""
        self.image_net.initialise(generator)
        self.cloud_net.initialise(generator)

    def load_imagenet(self, path: str | Path) -> None:
        """Start the image's stages from torchvision's ResNet-18, as the original does.

        Raises UserError for a file that holds no such weights, at another `width` than 1, and where
        the image comes in other colours than ImageNet's.
        """
        if self.config.preprocess.image.colours != "imagenet":
            raise UserError(
                f"{path}: these weights expect the colours of ImageNet; "
                "set model.preprocess.image.colours=imagenet"
            )
        load_imagenet_resnet18(self.image_net.resnet, path)


class ImageBranch(nn.Module):
    """ResNet-18 without its last stage, and a generalised mean over maps of 1/16 of the size."""

    def __init__(self, half: int, width: float = 1.0) -> None:
        super().__init__()
        self.resnet = resnet18(3, width)
        self.lateral = nn.Conv2d(self.resnet.channels[-1], half, 1)
        self.pool = GeneralisedMean()

    def forward(self, image: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b half"]:
        """Describe images by the image alone."""
        x = self.lateral(self.resnet(image)[-1])
        return self.pool(x, lambda cells: cells.mean(dim=(2, 3)))

    def initialise(self, generator: torch.Generator) -> None:
        """Draw all weights."""
        self.resnet.initialise(generator)
        _initialise_evenly(self.lateral, generator)
        self.pool.initialise()


class CloudBranch(nn.Module):
    """Three stages that halve the grid, one step back up, and a generalised mean at 1/4 of it.

    All that is known of an occupied cell is that it is occupied.
    """

    def __init__(self, half: int, width: float = 1.0) -> None:
        super().__init__()
        c1, c2 = _scaled(32, width), _scaled(64, width)
        self.stem = SparseConv3d(1, c1, 5)
        self.norm = nn.BatchNorm1d(c1)
        self.stages = nn.ModuleList([Stage(c1, c1), Stage(c1, c2), Stage(c2, c2)])
        self.deep_lateral = nn.Linear(c2, half, bias=False)
        self.up = Double(half, half)
        self.lateral = nn.Linear(c2, half, bias=False)
        self.pool = GeneralisedMean()

    def forward(self, sites: Sites) -> Float[Tensor, "b half"]:
        """Describe grids by which of their cells are occupied."""
        x = F.relu(self.norm(self.stem(self.stem.weight.new_ones(len(sites.cells), 1), sites)))
        maps = []
        for stage in self.stages:
            x = stage(x, sites)
            sites = sites.halved[0]
            maps.append((x, sites))
        (x, sites), (deep, _) = maps[-2:]
        return self.pool(self.lateral(x) + self.up(self.deep_lateral(deep), sites), sites.mean)

    def initialise(self, generator: torch.Generator) -> None:
        """Draw all weights."""
        for layer in self.modules():
            if isinstance(layer, SparseConv3d | Halve | Double):
                layer.initialise(generator)
            elif isinstance(layer, nn.Linear):  # a convolution of size 1
                initialise_fan_out(layer.weight.mT[None], generator)
            elif isinstance(layer, nn.Conv1d):
                _initialise_evenly(layer, generator)
            elif isinstance(layer, nn.BatchNorm1d):
                layer.reset_parameters()
        self.pool.initialise()


class Stage(nn.Module):
    """To cells twice as large, and a residual block there, whose channels weigh each other."""

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__()
        self.halve = Halve(c_in, c_in)
        self.norm = nn.BatchNorm1d(c_in)
        self.conv1 = SparseConv3d(c_in, c_out, 3)
        self.norm1 = nn.BatchNorm1d(c_out)
        self.conv2 = SparseConv3d(c_out, c_out, 3)
        self.norm2 = nn.BatchNorm1d(c_out)
        self.channels = ChannelWeights()
        self.shortcut: nn.Sequential | None = None
        if c_in != c_out:
            self.shortcut = nn.Sequential(nn.Linear(c_in, c_out, bias=False), nn.BatchNorm1d(c_out))

    def forward(self, x: Float[Tensor, "n c"], sites: Sites) -> Float[Tensor, "m out"]:
        """Go from rows of `sites` to rows of `sites.halved`."""
        x = F.relu(self.norm(self.halve(x, sites)))
        coarse = sites.halved[0]
        change = F.relu(self.norm1(self.conv1(x, coarse)))
        change = self.channels(self.norm2(self.conv2(change, coarse)), coarse)
        return F.relu(change + (x if self.shortcut is None else self.shortcut(x)))


class ChannelWeights(nn.Module):
    """Each item's channels times weights in (0, 1) that a channel's mean and its neighbours' set.

    Efficient channel attention (Wang et al., CVPR 2020), of size 3.
    """

    def __init__(self) -> None:
        super().__init__()
        self.conv = nn.Conv1d(1, 1, 3, padding=1, bias=False)

    def forward(self, x: Float[Tensor, "n c"], sites: Sites) -> Float[Tensor, "n c"]:
        """Weigh the rows of x."""
        return sites.scale(x, self.conv(sites.mean(x)[:, None])[:, 0].sigmoid())


def _initialise_evenly(layer: nn.Conv1d | nn.Conv2d, generator: torch.Generator) -> None:
    """Draw weights and offsets as the framework does by itself."""
    bound = layer.weight[0].numel() ** -0.5
    for parameter in layer.parameters():
        nn.init.uniform_(parameter, -bound, bound, generator=generator)


def _scaled(channels: int, width: float) -> int:
    return max(1, round(channels * width))
