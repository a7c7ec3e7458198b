# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Residual networks over images (He et al., CVPR 2016), named in torchvision's way.

The names are what lets weights that others have trained on ImageNet be loaded where a user has
them; without, every layer is trained from scratch.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from adafusion.types import UserError

CHANNELS_18 = (64, 128, 256, 512)  # of the four stages of ResNet-18


class BasicBlock(nn.Module):
    """Two convolutions whose result is added to what came in.

    What came in goes through a 1x1 convolution where its channels or cells are not those that go
    out.
    """

    def __init__(self, c_in: int, c_out: int, stride: int = 1) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(c_in, c_out, 3, stride, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(c_out)
        self.conv2 = nn.Conv2d(c_out, c_out, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(c_out)
        self.downsample: nn.Sequential | None = None
        if stride != 1 or c_in != c_out:
            self.downsample = nn.Sequential(
                Thinned(c_in, c_out, 1, stride, bias=False), nn.BatchNorm2d(c_out)
            )

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b out h2 w2"]:
        """Give the sum, without what is negative in it."""
        change = self.bn2(self.conv2(F.relu(self.bn1(self.conv1(x)))))
        return F.relu(change + (x if self.downsample is None else self.downsample(x)))


class Thinned(nn.Conv2d):
    """A 1x1 convolution with a stride, which first takes every so many cells and then convolves.

    The same numbers. With a stride, torch's 1x1 convolution of few channels, laid out channels
    last, writes beyond its memory on a CPU when gradients are asked for (seen with torch 2.13).
    """

    def forward(self, input: Float[Tensor, "b c h w"]) -> Float[Tensor, "b out h2 w2"]:
        """Convolve the cells that are kept."""
        down, right = self.stride
        return F.conv2d(input[:, :, ::down, ::right], self.weight, self.bias)


def stage(c_in: int, c_out: int, blocks: int, stride: int) -> nn.Sequential:
    """Blocks one after the other; the first one changes channels and cells."""
    first = BasicBlock(c_in, c_out, stride)
    return nn.Sequential(first, *(BasicBlock(c_out, c_out) for _ in range(blocks - 1)))


def stages(
    c_in: int, channels: Sequence[int], blocks: Sequence[int], strides: Sequence[int]
) -> list[nn.Sequential]:
    """Stages one after the other, the first one fed with `c_in` channels."""
    sizes = zip([c_in, *channels[:-1]], channels, blocks, strides, strict=True)
    return [stage(*size) for size in sizes]


class ResNet(nn.Module):
    """A stem and up to four stages of two blocks each, of which all maps are given.

    The stem is a 7x7 convolution of stride 2 and, unless `pool` is off, a max-pool of stride 2.
    """

    def __init__(self, channels: Sequence[int], *, padding: int = 3, pool: bool = True) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, channels[0], 7, stride=2, padding=padding, bias=False)
        self.bn1 = nn.BatchNorm2d(channels[0])
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1) if pool else nn.Identity()
        strides = [1, *(2 for _ in channels[1:])]
        made = stages(channels[0], channels, [2 for _ in channels], strides)
        for number, layer in enumerate(made, start=1):
            self.add_module(f"layer{number}", layer)
        self.channels = tuple(channels)
        self.initialise()

    def forward(self, image: Float[Tensor, "b 3 h w"]) -> list[Float[Tensor, "b _ _ _"]]:
        """Give the map of each stage, shallow to deep; none has anything negative."""
        x = self.maxpool(F.relu(self.bn1(self.conv1(image))))
        maps = []
        for number in range(1, len(self.channels) + 1):
            x = self.get_submodule(f"layer{number}")(x)
            maps.append(x)
        return maps

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw the weights as those were drawn that ImageNet networks start from."""
        initialise_residual(self, generator)


def resnet18(layers: int = 4, width: float = 1.0) -> ResNet:
    """ResNet-18 up to one of its four stages; `width` scales the channels of all.

    Maps of 1/4, 1/8, 1/16 and 1/32 of the image's size, of 64, 128, 256 and 512 channels.
    """
    return ResNet([max(1, round(c * width)) for c in CHANNELS_18[:layers]])


def initialise_residual(module: nn.Module, generator: torch.Generator | None = None) -> None:
    """Draw every convolution that a batch norm follows so that gradients keep their size."""
    for layer in module.modules():
        if isinstance(layer, nn.Conv2d):
            nn.init.kaiming_normal_(
                layer.weight, mode="fan_out", nonlinearity="relu", generator=generator
            )
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)
        elif isinstance(layer, nn.BatchNorm2d):
            layer.reset_parameters()


def load_imagenet_resnet18(net: ResNet, path: str | Path) -> None:
    """Put torchvision's ResNet-18 weights into the stages that the network has.

    Raises UserError where the file is no such weights, or the network is not of their width.
    """
    load_part(net, read_weights(path), path)


def read_weights(path: str | Path) -> dict[str, Tensor]:
    """Read named tensors from a .safetensors file or one of `torch.save`, running no code of it."""
    path = Path(path)
    if not path.is_file():
        raise UserError(f"{path} is missing: give the file of the network's public weights")
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        weights: Any = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError, SafetensorError) as error:
        raise UserError(
            f"{path}: cannot be read as weights ({error}); download it again"
        ) from error
    if not isinstance(weights, Mapping) or not all(isinstance(v, Tensor) for v in weights.values()):
        raise UserError(f"{path}: holds no named tensors; save the network's state_dict() alone")
    return dict(weights)


def load_part(net: nn.Module, weights: Mapping[str, Tensor], path: str | Path) -> None:
    """Put those of the weights into the network that it has a place for, and into every place.

    Weights of layers that the network does not have are left out. Batch norms' counts of batches,
    which torchvision's older files lack and nothing reads, may be missing.
    """
    own = {k: v for k, v in net.state_dict().items() if not k.endswith("num_batches_tracked")}
    for key, value in own.items():
        if key not in weights:
            raise UserError(f"{path}: has no {key}; these are the weights of another network")
        if weights[key].shape != value.shape:
            raise UserError(
                f"{path}: {key} has shape {tuple(weights[key].shape)}, not {tuple(value.shape)}; "
                "weights from ImageNet fit the full size alone: set model.width=1"
            )
    net.load_state_dict({key: weights[key] for key in own}, strict=False)
