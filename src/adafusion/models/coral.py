# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""CORAL (Pan et al., ICRA 2021): an elevation map coloured by what the camera sees of each cell.

Two faults of the authors' release are mended here. Their projection has no intrinsics of its own;
ours is `preprocess.elevation.lift`. And what is out of sight takes the image's upper left corner
there; here it takes nothing.

Their four MLPs and one lateral layer that no data pass through are left out. The clusters begin as
`SoftVLAD` has them, not as theirs do.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from adafusion.models.base import PlaceModel
from adafusion.models.config import ModelConfig
from adafusion.models.resnet import CHANNELS_18, ResNet, initialise_residual, stages
from adafusion.models.vlad import SoftVLAD
from adafusion.types import Description, UserError

CELL_CHANNELS = (32, 64)  # of a cell of the map, until its residual stages
STAGE_CHANNELS = (64, 128, 192, 256)  # of these stages, each of half the size of the one before
STAGE_BLOCKS = (1, 2, 3, 3)


class Coral(PlaceModel):
    """One image and one elevation map in, one descriptor of length 1 out.

    With `dim` 0 the descriptor is the paper's, `clusters` times 256 numbers at width 1. Otherwise a
    linear layer reduces it to `dim`, and it is given length 1 again. The sensors meet in the cells
    of the map, so there are no halves, and with one sensor None there is nothing to give.
    """

    def __init__(self, config: ModelConfig, name: str = "") -> None:
        super().__init__(config, name)
        if config.preprocess.lidar != "elevation":
            raise UserError(
                f"coral looks at an elevation map, not at {config.preprocess.lidar}: "
                "set preprocess.lidar=elevation"
            )
        c1, c = (_scaled(channels, config.width) for channels in CELL_CHANNELS)
        self.image_net = ImageStream(config.width)
        self.colour = nn.Sequential(*_layer(self.image_net.channels, c, 1), *_layer(c, c, 1))
        self.structure = nn.Sequential(*_layer(1, c1, 3), *_layer(c1, c, 3))
        self.map_net = MapStream(c, config.width)
        self.vlad = SoftVLAD(self.map_net.channels, config.clusters, bias=True)
        self.reduction = nn.Linear(self.vlad.length, config.dim) if config.dim else None

    def forward(
        self,
        image: Float[Tensor, "b 3 h w"] | None,
        lidar: Float[Tensor, "b 3 rows columns"] | None,
    ) -> Description:
        """Describe a batch. Raises ValueError for tensors of another size than the model's own."""
        self.check_sizes(image, lidar)
        if image is None or lidar is None:
            return Description(None, None, None, None)
        height, where = lidar[:, :1], lidar[:, 1:]
        seen = (height > 0.0) & (where.abs() <= 1.0).all(dim=1, keepdim=True)
        lifted = sample(self.image_net(image), where) * seen
        cells = self.map_net(self.structure(height) + self.colour(lifted))
        descriptor = self.vlad(cells.flatten(2))
        if self.reduction is not None:
            descriptor = F.normalize(self.reduction(descriptor), dim=1)
        return Description(descriptor, None, None, None)

    def initialise(self, generator: torch.Generator) -> None:
        """Draw everything; the convolutions so that gradients keep their size."""
        initialise_residual(self, generator)
        self.vlad.initialise(generator)
        if self.reduction is not None:
            spread = self.reduction.in_features**-0.5
            nn.init.normal_(self.reduction.weight, 0.0, spread, generator=generator)
            nn.init.zeros_(self.reduction.bias)


class ImageStream(nn.Module):
    """ResNet-18 without its max-pool, all of its maps brought to half the image's size.

    The stem's narrow padding leaves out a cell at each side, and the padding of `smooth` puts it
    back, so that the map covers what the image covers: 56 x 56 cells of 112 x 112 pixels.
    """

    def __init__(self, width: float = 1.0) -> None:
        super().__init__()
        self.resnet = ResNet([_scaled(c, width) for c in CHANNELS_18], padding=1, pool=False)
        self.channels = self.resnet.channels[-1]
        self.top_down = TopDown(self.resnet.channels, self.channels, padding=1)

    def forward(self, image: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b c h2 w2"]:
        """Give the map of features."""
        return self.top_down(self.resnet(image))


class MapStream(nn.Module):
    """Residual stages over the cells; the last three, brought to a quarter of the map's size."""

    def __init__(self, c_in: int, width: float = 1.0) -> None:
        super().__init__()
        channels = [_scaled(c, width) for c in STAGE_CHANNELS]
        self.stages = nn.ModuleList(stages(c_in, channels, STAGE_BLOCKS, (2, 2, 2, 2)))
        self.channels = channels[-1]
        self.top_down = TopDown(channels[1:], self.channels)

    def forward(self, cells: Float[Tensor, "b c rows columns"]) -> Float[Tensor, "b c2 r2 k2"]:
        """Give the local features: 20 x 20 of 80 x 80 cells."""
        maps = []
        for stage in self.stages:
            cells = stage(cells)
            maps.append(cells)
        return self.top_down(maps[1:])


class TopDown(nn.Module):
    """Maps of falling size, each enlarged and added to the one before, at the size of the first."""

    def __init__(self, channels: Sequence[int], c_out: int, padding: int = 0) -> None:
        super().__init__()
        self.laterals = nn.ModuleList(nn.Conv2d(c_in, c_out, 1) for c_in in channels)
        self.smooth = nn.Conv2d(c_out, c_out, 1, padding=padding)

    def forward(self, maps: Sequence[Float[Tensor, "b _ _ _"]]) -> Float[Tensor, "b c h w"]:
        """Give one map; `maps` are shallow to deep."""
        *shallow, x = [lateral(x) for lateral, x in zip(self.laterals, maps, strict=True)]
        for y in reversed(shallow):
            x = F.interpolate(x, size=y.shape[2:], mode="bilinear", align_corners=False) + y
        return self.smooth(x)


def sample(
    features: Float[Tensor, "b c h w"], where: Float[Tensor, "b 2 rows columns"]
) -> Float[Tensor, "b c rows columns"]:
    """What a map of the image has at each cell's x and y, from -1 at one edge to 1 at the other."""
    return F.grid_sample(
        features, where.movedim(1, 3), mode="bilinear", padding_mode="border", align_corners=False
    )


def _layer(c_in: int, c_out: int, size: int) -> tuple[nn.Module, ...]:
    convolution = nn.Conv2d(c_in, c_out, size, padding=size // 2, bias=False)
    return convolution, nn.BatchNorm2d(c_out), nn.ReLU(inplace=True)


def _scaled(channels: int, width: float) -> int:
    return max(1, round(channels * width))
