# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a batch looks like to the network: its frames, augmented as the seed and its number say."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from adafusion.models import (
    PlaceModel,
)
from adafusion.preprocess.augment import (
    augment_points,
    blank_sensors,
    color_jitter,
    erase_boxes,
    hue_jitter,
    jitter_points,
)
from adafusion.preprocess.cache import PreparedSet
from adafusion.preprocess.image import from_unit, to_unit
from adafusion.training.pairs import Batch
from adafusion.training.settings import Augment

Points = Callable[[int], Float[np.ndarray, "n 3"]]  # a row's raw cloud, body frame, metres


def batch_inputs(
    model: PlaceModel,
    data: PreparedSet,
    batch: Batch,
    augment: Augment,
    points: Points | None,
    key: tuple[int, int],
    part: slice = slice(None),
) -> tuple[Tensor | None, Tensor | None]:
    """The augmented tensors of a batch, only those that the system looks at.

    Those of a `part` are what they would be among the whole batch.
    """
    rows, among = batch.rows[part], (len(batch.rows), part)
    image = lidar = None
    if "image" in model.sensors:
        image = to_unit(data.images_u8(rows))
        if c := augment.color:
            generator = _generator(*key)
            image = color_jitter(
                image, generator, brightness=c, contrast=c, saturation=c, among=among
            )
        if augment.hue:
            image = hue_jitter(image, _generator(*key, 3), augment.hue, among)
        if augment.erase:
            image = erase_boxes(image, _generator(*key, 4), augment.erase, among)
    if "lidar" in model.sensors:
        if points is not None and augment.jitter_m:
            rng = np.random.default_rng(key)
            clouds = (points(int(row)) for row in batch.rows)
            lidar = torch.stack(
                [
                    data.settings.lidar_tensor(
                        jitter_points(cloud, rng, augment.jitter_m, augment.jitter_clip_m)
                    )
                    for cloud in clouds
                ][part]
            )
        else:
            lidar = data.lidar(rows)
        if augment.points and data.settings.lidar == "points":
            lidar = augment_points(lidar, _generator(*key, 2), among)
        if lidar.ndim == 5:
            lidar = lidar.contiguous(memory_format=torch.channels_last_3d)
    if image is not None and lidar is not None and augment.blank:
        blank_sensors(image, lidar, augment.blank, np.random.default_rng((*key, 1)), among)
    if image is not None:
        image = from_unit(image, data.settings.image)
        image = image.contiguous(memory_format=torch.channels_last)
    return image, lidar


def _generator(*key: int) -> torch.Generator:
    return torch.Generator().manual_seed(int(np.random.SeedSequence(key).generate_state(1)[0]))
