# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""PointNetVLAD (Uy and Lee, CVPR 2018): PointNet's features of each point, gathered by NetVLAD.

This is the authors' network, not the port to PyTorch that most comparisons run. The port differs in
seven places, each of which a test holds to the original here:

1. the MLP shared by all points has no batch norm;
2. the two transform nets have one after every layer but the last;
3. the widest layer of the MLP ends in a ReLU too;
4. the feature of each point is given length 1 before it is gathered;
5. the descriptor is given length 1;
6. the loss takes the nearest true match, not the farthest (`losses.lazy_quadruplet`);
7. the learning rate is 5e-5, not a tenth of it (configs/pointnetvlad.yaml).

One thing is simpler than in the original: batch norms follow their batches at one pace throughout,
where its own become slower from epoch to epoch.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from adafusion.models.base import PlaceModel
from adafusion.models.config import ModelConfig
from adafusion.models.vlad import EPSILON, NORM_EPSILON, SoftVLAD
from adafusion.types import Description, UserError

NATIVE_DIM = 256


class PointNetVLAD(PlaceModel):
    """A set of points in, in any order; one descriptor of length 1 out."""

    def __init__(self, config: ModelConfig, name: str = "") -> None:
        super().__init__(config, name)
        if config.preprocess.lidar != "points":
            raise UserError(
                f"pointnetvlad looks at points, not at {config.preprocess.lidar}: "
                "set preprocess.lidar=points"
            )
        dim = config.dim or NATIVE_DIM
        self.point_net = PointFeatures(config.width)
        self.vlad = SoftVLAD(self.point_net.channels, config.clusters, normalised_assignment=True)
        self.reduce = nn.Linear(self.vlad.length, dim, bias=False)
        self.norm = nn.BatchNorm1d(dim, eps=NORM_EPSILON)
        self.gate = ContextGating(dim)
        self.initialise()

    def forward(
        self, image: Float[Tensor, "b 3 h w"] | None, lidar: Float[Tensor, "b n 3"] | None
    ) -> Description:
        """Describe a batch by its points; an image is not looked at."""
        self.check_sizes(image, lidar)
        assert lidar is not None
        gathered = self.vlad(self.point_net(lidar))
        reduced = self.gate(self.norm(self.reduce(gathered)))
        descriptor = F.normalize(reduced, dim=1, eps=EPSILON)
        return Description(descriptor, None, descriptor, None)

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw all weights as the original does."""
        self.point_net.initialise(generator)
        self.vlad.initialise(generator)
        nn.init.normal_(self.reduce.weight, 0.0, self.config.clusters**-0.5, generator=generator)
        self.norm.reset_parameters()
        self.gate.initialise(generator)


class PointFeatures(nn.Module):
    """A feature for each point: PointNet (Qi et al., CVPR 2017) up to its pooling.

    `width` scales all its layers; 1.0 gives `channels` = 1024 numbers a point.
    """

    def __init__(self, width: float = 1.0) -> None:
        super().__init__()
        c1, c2, c3 = (_scaled(channels, width) for channels in (64, 128, 1024))
        self.channels = c3
        self.align_points = TransformNet(3, width)
        self.low = nn.Sequential(
            nn.Linear(3, c1), nn.ReLU(inplace=True), nn.Linear(c1, c1), nn.ReLU(inplace=True)
        )
        self.align_features = TransformNet(c1, width)
        self.high = nn.Sequential(
            *(nn.Linear(c1, c1), nn.ReLU(inplace=True)),
            *(nn.Linear(c1, c2), nn.ReLU(inplace=True)),
            *(nn.Linear(c2, c3), nn.ReLU(inplace=True)),
        )
        self.initialise()

    def forward(self, points: Float[Tensor, "b n 3"]) -> Float[Tensor, "b c n"]:
        """Give the features, not negative and of no particular length."""
        low = self.low(points @ self.align_points(points))
        return self.high(low @ self.align_features(low)).mT

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw the weights as the original does, without offsets.

        The framework's own offsets would drown the points in a net this deep without batch norms.
        """
        _initialise_glorot(self, generator)
        self.align_points.begin_with_identity()
        self.align_features.begin_with_identity()


class TransformNet(nn.Module):
    """A K x K matrix from all points together, to align what they are given as."""

    def __init__(self, k: int, width: float = 1.0) -> None:
        super().__init__()
        c1, c2, c3 = (_scaled(channels, width) for channels in (64, 128, 1024))
        f1, f2 = _scaled(512, width), _scaled(256, width)
        self.k = k
        self.each = nn.Sequential(*_normed(k, c1), *_normed(c1, c2), *_normed(c2, c3))
        self.whole = nn.Sequential(*_normed(c3, f1), *_normed(f1, f2))
        self.matrix = nn.Linear(f2, k * k)
        self.begin_with_identity()

    def forward(self, x: Float[Tensor, "b n k"]) -> Float[Tensor, "b k k"]:
        """Give the matrix that rows of x are to be multiplied by."""
        b, n, _ = x.shape
        each = self.each(x.flatten(0, 1)).unflatten(0, (b, n))  # norms count every point alike
        return self.matrix(self.whole(each.amax(dim=1))).unflatten(1, (self.k, self.k))

    @torch.no_grad()
    def begin_with_identity(self) -> None:
        """Let the matrix be the identity whatever the points are, until training moves it."""
        self.matrix.weight.zero_()
        self.matrix.bias.copy_(torch.eye(self.k).flatten())


class ContextGating(nn.Module):
    """Let the descriptor as a whole say how much of each of its numbers passes (Miech et al.)."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.linear = nn.Linear(dim, dim, bias=False)
        self.norm = nn.BatchNorm1d(dim, eps=NORM_EPSILON)
        self.initialise()

    def forward(self, x: Float[Tensor, "b d"]) -> Float[Tensor, "b d"]:
        """Multiply each number by its gate, in (0, 1)."""
        return x * self.norm(self.linear(x)).sigmoid()

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw the weights as the original does."""
        std = self.linear.in_features**-0.5
        nn.init.normal_(self.linear.weight, 0.0, std, generator=generator)
        self.norm.reset_parameters()


def _normed(c_in: int, c_out: int) -> tuple[nn.Module, ...]:
    norm = nn.BatchNorm1d(c_out, eps=NORM_EPSILON)
    return nn.Linear(c_in, c_out), norm, nn.ReLU(inplace=True)


def _initialise_glorot(module: nn.Module, generator: torch.Generator | None) -> None:
    for layer in module.modules():
        if isinstance(layer, nn.Linear):
            nn.init.xavier_uniform_(layer.weight, generator=generator)
            nn.init.zeros_(layer.bias)
        elif isinstance(layer, nn.BatchNorm1d):
            layer.reset_parameters()


def _scaled(channels: int, width: float) -> int:
    return max(1, round(channels * width))
