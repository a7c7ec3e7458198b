# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Many local features to one vector: NetVLAD (Arandjelovic et al., CVPR 2016) and its variants."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

EPSILON = 1e-6  # least length that is divided by
NORM_EPSILON = 1e-3  # Miech's: logits of features of length 1 vary by about a thousandth
SECOND_BEST = 0.01  # k-means start: what the second nearest cluster is to get of the nearest one's


class SoftVLAD(nn.Module):
    """Sum, for each cluster, how the local features that belong to it differ from its centroid.

    Features (B, C, N) of N pixels, cells or points, in any order, become (B, clusters * C) of
    length 1. Each is given length 1 first, and belongs to all clusters, by a softmax.

    Assignment and centroids are tensors of their own from the start, as in the first NetVLAD.
    `bias` gives the assignment one number a cluster more. `normalised_assignment` puts a batch norm
    on it instead, as Miech et al. do (2017) and PointNetVLAD after them.
    """

    def __init__(
        self, dim: int, clusters: int, *, normalised_assignment: bool = False, bias: bool = False
    ) -> None:
        super().__init__()
        if bias and normalised_assignment:
            raise ValueError("a batch norm takes a bias away again: choose one of them")
        self.assignment = nn.Linear(dim, clusters, bias=bias)
        self.norm = nn.BatchNorm1d(clusters, eps=NORM_EPSILON) if normalised_assignment else None
        self.centroids = nn.Parameter(torch.empty(clusters, dim))
        self.initialise()

    @property
    def length(self) -> int:
        """Numbers in what it gives."""
        return self.centroids.numel()

    def forward(
        self, x: Float[Tensor, "b c n"], weight: Float[Tensor, "b n"] | None = None
    ) -> Float[Tensor, "b kc"]:
        """Gather the features; `weight` says how much each counts, equally if None."""
        x = F.normalize(x, dim=1, eps=EPSILON)
        belongs = self.belonging(x)
        if weight is not None:
            belongs = belongs * weight[:, None]
        sums = belongs @ x.mT - belongs.sum(dim=2)[:, :, None] * self.centroids
        return F.normalize(F.normalize(sums, dim=2, eps=EPSILON).flatten(1), dim=1, eps=EPSILON)

    def belonging(self, x: Float[Tensor, "b c n"]) -> Float[Tensor, "b k n"]:
        """How far each feature of length 1 belongs to each cluster: sums to 1 over clusters."""
        logits = self.assignment(x.mT).mT
        return (logits if self.norm is None else self.norm(logits)).softmax(dim=1)

    @torch.no_grad()
    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw random centroids, about as long as a feature, and an assignment.

        With a batch norm both are drawn apart, as Miech et al. do. Without one the assignment
        points along the centroids, so long that the logits vary by about 1, as the norm's would.
        """
        dim = self.centroids.shape[1]
        self.centroids.normal_(0.0, dim**-0.5, generator=generator)
        if self.norm is None:
            unit = F.normalize(self.centroids, dim=1, eps=EPSILON)
            self.assignment.weight.copy_(unit * dim**0.5)
        else:
            self.assignment.weight.normal_(0.0, dim**-0.5, generator=generator)
            self.norm.reset_parameters()
        if self.assignment.bias is not None:
            self.assignment.bias.zero_()

    @torch.no_grad()
    def initialise_from(
        self, descriptors: Float[Tensor, "m c"], generator: torch.Generator
    ) -> None:
        """Start from the k-means of local features, as the first NetVLAD does.

        The assignment points along each centroid, as steeply as gives the second nearest cluster a
        hundredth of what the nearest gets, for a feature whose two nearest lie an average gap
        apart. Raises ValueError where the features are too few, or too alike for that.
        """
        if self.norm is not None:
            raise ValueError("with a batch norm on it the assignment's steepness means nothing")
        local = F.normalize(descriptors.to(self.centroids), dim=1, eps=EPSILON)
        centroids = k_means(local, len(self.centroids), generator)
        unit = F.normalize(centroids, dim=1, eps=EPSILON)
        best = (local @ unit.T).topk(2, dim=1).values
        gap = float((best[:, 0] - best[:, 1]).mean())
        if gap < EPSILON:
            raise ValueError(f"{len(local)} local features, too alike for {len(unit)} clusters")
        self.centroids.copy_(centroids)
        self.assignment.weight.copy_(unit * (-math.log(SECOND_BEST) / gap))
        if self.assignment.bias is not None:
            self.assignment.bias.zero_()


def k_means(
    points: Float[Tensor, "m c"], clusters: int, generator: torch.Generator, iterations: int = 100
) -> Float[Tensor, "k c"]:
    """Centroids of Lloyd's algorithm, from points drawn far apart (k-means++).

    A cluster that loses all its points takes the point that lies farthest from its own centroid.
    Stops when no point changes cluster. Raises ValueError for fewer points than clusters.
    """
    if len(points) < clusters:
        raise ValueError(f"{len(points)} points cannot make {clusters} clusters")
    centroids = _far_apart(points, clusters, generator)
    nearest = None
    for _ in range(iterations):
        distance, before = _squared(points, centroids), nearest
        nearest = distance.argmin(dim=1)
        if before is not None and torch.equal(nearest, before):
            break
        members = torch.bincount(nearest, minlength=clusters)
        sums = torch.zeros_like(centroids).index_add_(0, nearest, points)
        centroids = sums / members.clamp(min=1)[:, None]
        lost = (members == 0).nonzero().flatten()
        centroids[lost] = points[distance.amin(dim=1).topk(len(lost)).indices]
    return centroids


def _far_apart(
    points: Float[Tensor, "m c"], clusters: int, generator: torch.Generator
) -> Float[Tensor, "k c"]:
    """Points drawn one by one, each by its squared distance from the nearest one before."""
    chosen = [int(torch.randint(len(points), (1,), generator=generator))]
    distance = _squared(points, points[chosen]).flatten()
    for _ in range(clusters - 1):
        mass = distance.double().cpu().cumsum(dim=0)
        mark = torch.rand(1, generator=generator, dtype=torch.float64) * mass[-1]
        chosen.append(min(int(torch.searchsorted(mass, mark, right=True)), len(points) - 1))
        distance = torch.minimum(distance, _squared(points, points[chosen[-1:]]).flatten())
    return points[chosen]


def _squared(a: Float[Tensor, "m c"], b: Float[Tensor, "k c"]) -> Float[Tensor, "m k"]:
    """Squared distances by one product: thousands of points leave no room for the differences."""
    squares = a.square().sum(dim=1)[:, None] + b.square().sum(dim=1)
    return (squares - 2 * (a @ b.T)).clamp(min=0.0)
