# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""NetVLAD (Arandjelovic et al., CVPR 2016): an image to its local features, these to clusters."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.linalg
import torch
import torch.nn.functional as F
from jaxtyping import Float, Float64
from torch import Tensor, nn

from adafusion.models.backbones import initialise_he
from adafusion.models.base import PlaceModel
from adafusion.models.config import ModelConfig
from adafusion.models.resnet import load_part, read_weights
from adafusion.models.vlad import SoftVLAD
from adafusion.types import Description, UserError

VGG16_CHANNELS = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))
CONV5 = 24  # where the last five of VGG-16's blocks begins in `features`
PLACES = 100  # local features of an image that the clusters are started from


class NetVLAD(PlaceModel):
    """One image in, one descriptor of length 1 out; the LiDAR is not looked at.

    With `dim` 0 the descriptor is the paper's, `clusters` times 512 numbers at width 1. Otherwise a
    linear layer reduces it to `dim`, and it is given length 1 again. That layer is either trained
    with the rest or, as in the paper, whitens the descriptors of a model trained without it: see
    `reduce_by_pca`. Both are one graph, and model files of both load alike.
    """

    def __init__(self, config: ModelConfig, name: str = "") -> None:
        super().__init__(config, name)
        self.image_net = VGG16(config.width)
        self.vlad = SoftVLAD(self.image_net.out_channels, config.clusters)
        self.reduction = nn.Linear(self.vlad.length, config.dim) if config.dim else None

    def forward(self, image: Float[Tensor, "b 3 h w"] | None, lidar: Tensor | None) -> Description:
        """Describe a batch of images. Raises ValueError for another size than the model's own."""
        self.check_sizes(image, lidar)
        assert image is not None  # the only sensor it looks at
        x_BCN = self.image_net(image).flatten(2)  # N: 18 x 25 cells of an image of 300 x 400
        descriptor = self.vlad(x_BCN)
        if self.reduction is not None:
            descriptor = F.normalize(self.reduction(descriptor), dim=1)
        return Description(descriptor, descriptor, None, None)

    def initialise(self, generator: torch.Generator) -> None:
        """Draw everything; the convolutions so that the signal keeps its size."""
        initialise_he(self.image_net, generator)
        self.vlad.initialise(generator)
        if self.reduction is not None:
            with torch.no_grad():
                spread = self.reduction.in_features**-0.5
                self.reduction.weight.normal_(0.0, spread, generator=generator)
                self.reduction.bias.zero_()

    def begin(
        self, batches: Iterable[tuple[Tensor | None, Tensor | None]], generator: torch.Generator
    ) -> None:
        """Start the clusters from what the images of some training frames hold."""
        self.initialise_clusters((image for image, _ in batches if image is not None), generator)

    @torch.no_grad()
    def initialise_clusters(
        self, images: Iterable[Float[Tensor, "_ 3 _ _"]], generator: torch.Generator
    ) -> None:
        """Start the clusters from the k-means of local features, `PLACES` of each image.

        The authors take 500 training images. Depends on the convolutions: draw or load them first.
        """
        local = []
        for batch in images:
            for x_CN in self.image_net(batch.to(self.vlad.centroids.device)).flatten(2):
                places = torch.randperm(x_CN.shape[1], generator=generator)[:PLACES]
                local.append(x_CN[:, places.to(x_CN.device)].T)
        self.vlad.initialise_from(torch.cat(local), generator)

    def load_imagenet(self, path: str | Path) -> None:
        """Take torchvision's VGG-16 and let only conv5 and what follows learn, as the authors do.

        Without them every layer learns. Raises UserError for a file that does not hold every
        convolution in our size, and where the image comes in other colours than ImageNet's.
        """
        if self.config.preprocess.image.colours != "imagenet":
            raise UserError(
                f"{path}: these weights expect the colours of ImageNet; "
                "set model.preprocess.image.colours=imagenet"
            )
        load_part(self.image_net, read_weights(path), path)
        for layer in list(self.image_net.features)[:CONV5]:
            layer.requires_grad_(False)


class VGG16(nn.Module):
    """The convolutions of VGG-16 (Simonyan and Zisserman, ICLR 2015), called as in torchvision.

    Cut after the last one, conv5_3, before its ReLU and pool: (B, 512, h / 16, w / 16), signed.
    """

    def __init__(self, width: float = 1.0) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        c_in = 3
        for block in VGG16_CHANNELS:
            for channels in block:
                c_out = max(1, round(channels * width))
                layers += [nn.Conv2d(c_in, c_out, kernel_size=3, padding=1), nn.ReLU(inplace=True)]
                c_in = c_out
            layers.append(nn.MaxPool2d(2))
        self.out_channels = c_in
        self.features = nn.Sequential(*layers[:-2])

    def forward(self, image: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b c h2 w2"]:
        """Give the map of local features."""
        return self.features(image)


def reduce_by_pca(model: NetVLAD, descriptors: Float[np.ndarray, "n d"], dim: int) -> NetVLAD:
    """A copy of a model of `dim` 0 that whitens its descriptor and keeps `dim` numbers of it.

    The authors keep 4096. `descriptors` are what the model gives of frames it was trained on; of
    test frames they would leak the test. The copy is ready to describe places, not to learn.
    """
    if model.reduction is not None:
        raise ValueError(f"model {model.name!r} is reduced already: train one with model.dim=0")
    mean, projection = fit_whitening(descriptors, dim)
    layer = nn.utils.skip_init(nn.Linear, model.vlad.length, dim)
    layer.load_state_dict(
        {"weight": torch.from_numpy(projection), "bias": torch.from_numpy(-projection @ mean)}
    )
    reduced = copy.deepcopy(model)
    reduced.config = replace(model.config, dim=dim)
    reduced.reduction = layer.to(model.vlad.centroids)
    return reduced.eval().requires_grad_(False)


def fit_whitening(
    descriptors: Float[np.ndarray, "n d"], dim: int
) -> tuple[Float64[np.ndarray, " d"], Float64[np.ndarray, "dim d"]]:
    """The mean, and the projection on the `dim` directions of most spread, a spread of 1 in each.

    (descriptors - mean) @ projection.T has the identity as its covariance. Raises UserError where
    the descriptors do not spread in so many directions.
    """
    x = descriptors.astype(np.float64)
    n, length = x.shape
    if not 1 <= dim <= length:
        raise ValueError(f"cannot keep {dim} of {length} numbers")
    if dim >= n:
        raise UserError(f"{n} descriptors spread in fewer than {dim} directions: give more frames")
    mean = x.mean(axis=0)
    x -= mean
    # Both products have the same eigenvalues, and the smaller one is found far sooner: a thousand
    # frames of 32,768 numbers need not be turned into a matrix of 32,768 by 32,768.
    few = n < length
    product = x @ x.T if few else x.T @ x
    size = len(product)
    values, vectors = scipy.linalg.eigh(product, subset_by_index=[size - dim, size - 1])
    values, vectors = values[::-1], vectors[:, ::-1]  # most spread first
    if values[-1] <= values[0] * size * np.finfo(np.float64).eps:
        raise UserError(f"{n} descriptors spread in fewer than {dim} directions: give more frames")
    directions = x.T @ vectors / np.sqrt(values) if few else vectors
    return mean, (directions * np.sqrt((n - 1) / values)).T
