# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""From the last map of a branch to its feature: the paper's mean over cells, and others for it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from adafusion.models.vlad import SoftVLAD

Pooling = Literal["gap", "gem", "fc", "vlad"]

POWER = 3.0  # of the generalised mean, before training moves it
LEAST = 1e-6  # a value in the generalised mean


def mean_over_cells(x: Float[Tensor, "b c *cells"]) -> Float[Tensor, "b c"]:
    """Average each channel."""
    return x.flatten(2).mean(dim=2)


class Mean(nn.Module):
    """The paper's: global average pooling (`gap`). Maps of any size."""

    def forward(self, x: Float[Tensor, "b c *cells"]) -> Float[Tensor, "b c"]:
        """Pool."""
        return mean_over_cells(x)


class GeneralisedMean(nn.Module):
    """The mean of powers, and the root of it; training moves the power (Radenovic et al., 2018).

    1 gives the mean of what is positive; a large power gives the greatest. Maps of any size.

    A power asks for what is not negative, and the paper's last map is signed. What lies below zero
    counts as `LEAST`, as in MinkLoc++: the norm before it learns an offset for each channel and so
    where to cut, and the map stays the one that the weight branch reads and that others pool.
    """

    def __init__(self) -> None:
        super().__init__()
        self.power = nn.Parameter(torch.empty(1))
        self.initialise()

    def forward(
        self, x: Tensor, mean: Callable[[Tensor], Tensor] = mean_over_cells
    ) -> Float[Tensor, "b c"]:
        """Pool x by `mean`, which says over what."""
        pooled: Tensor = mean(x.clamp(min=LEAST).pow(self.power)).pow(1.0 / self.power)
        return pooled

    def initialise(self) -> None:
        """Let the power be the one that most begin with."""
        nn.init.constant_(self.power, POWER)


class AllCells(nn.Module):
    """A linear layer over every cell of every channel (`fc`): bound to maps of one size.

    Without a bias: what scales the map scales the feature.
    """

    def __init__(self, channels: int, cells: tuple[int, ...]) -> None:
        super().__init__()
        self.projection = nn.Linear(channels * math.prod(cells), channels, bias=False)

    def forward(self, x: Float[Tensor, "b c *cells"]) -> Float[Tensor, "b c"]:
        """Pool; RuntimeError for a map of another size."""
        feature: Tensor = self.projection(x.flatten(1))
        return feature


class Clusters(nn.Module):
    """Cells gathered by the cluster they belong to (`vlad`), then a linear layer. Maps of any size.

    The assignment has a batch norm: a branch that learns from nothing moves its cells far from
    wherever centroids would have been started.
    """

    def __init__(self, channels: int, clusters: int) -> None:
        super().__init__()
        self.vlad = SoftVLAD(channels, clusters, normalised_assignment=True)
        self.projection = nn.Linear(self.vlad.length, channels, bias=False)

    def forward(self, x: Float[Tensor, "b c *cells"]) -> Float[Tensor, "b c"]:
        """Pool."""
        feature: Tensor = self.projection(self.vlad(x.flatten(2)))
        return feature


def build_pool(kind: Pooling, channels: int, cells: tuple[int, ...], clusters: int) -> nn.Module:
    """Build what makes a feature of `channels` numbers from a map of as many channels."""
    if kind == "fc":
        return AllCells(channels, cells)
    if kind == "vlad":
        return Clusters(channels, clusters)
    return GeneralisedMean() if kind == "gem" else Mean()
