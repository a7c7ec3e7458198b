# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What every system is to the rest of the package: a network with its own preprocessing."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from adafusion.config import identity
from adafusion.files import fingerprint
from adafusion.models.backbones import Backbone
from adafusion.models.config import ModelConfig
from adafusion.types import Description, UserError


class PlaceModel(nn.Module, ABC):
    """A network that describes places. `name` tells it from others in tables and maps."""

    def __init__(self, config: ModelConfig, name: str = "") -> None:
        super().__init__()
        self.config = config
        self.name = name or config.system

    @abstractmethod
    def forward(self, image: Tensor | None, lidar: Tensor | None) -> Description:
        """Describe a batch: images (B, 3, H, W), and the LiDAR as `preprocess` gives it."""

    def initialise(self, generator: torch.Generator) -> None:
        """Draw the weights that training starts from, where the framework's do not serve."""
        del generator

    def begin(
        self, batches: Iterable[tuple[Tensor | None, Tensor | None]], generator: torch.Generator
    ) -> None:
        """Look at some of the training's frames once, before it begins; most systems need not."""
        del batches, generator

    def load_imagenet(self, path: str | Path) -> None:
        """Take the image network's public ImageNet weights; UserError where there is none such."""
        raise UserError(f"{path}: {self.config.system} has no network that ImageNet weights fit")

    @property
    def backbones(self) -> list[Backbone]:
        """Branches to which training adds batch norms that are folded away in what is saved."""
        return []

    @property
    def sensors(self) -> tuple[str, ...]:
        """Which sensors it looks at."""
        return self.config.sensors

    def preprocess(
        self,
        image_u8: UInt8[np.ndarray, "h w 3"] | None,
        points_m: Float[np.ndarray, "n 3"] | None,
    ) -> tuple[Float[Tensor, "3 h2 w2"] | None, Float[Tensor, ...] | None]:
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
        return fingerprint(identity(self.config), *weights)

    @property
    def preprocess_fingerprint(self) -> str:
        """Identity of the preprocessing alone."""
        return self.config.preprocess.fingerprint

    def check_sizes(self, image: Tensor | None, lidar: Tensor | None) -> None:
        """ValueError where nothing is given that the model looks at, or of another size.

        Most networks would accept other sizes, and match worse without a word.
        """
        settings = self.config.preprocess
        given = {"image": image, "lidar": lidar}
        if all(given[sensor] is None for sensor in self.sensors):
            raise ValueError(f"model {self.name!r} was given nothing that it looks at")
        if image is not None and tuple(image.shape[2:]) != settings.image.size:
            raise ValueError(
                f"image of {tuple(image.shape[2:])} (height, width); model {self.name!r} takes "
                f"{settings.image.size}: make it with model.preprocess"
            )
        if lidar is not None and tuple(lidar.shape[1:]) != settings.lidar_shape:
            raise ValueError(
                f"{settings.lidar} of shape {tuple(lidar.shape[1:])}; model {self.name!r} takes "
                f"{settings.lidar_shape}: make them with model.preprocess"
            )
