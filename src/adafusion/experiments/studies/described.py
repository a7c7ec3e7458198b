# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What the models of one row say of the test frames, seed by seed, and under other weights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from adafusion.experiments.describing import describe_frames, load_trained
from adafusion.experiments.study import Trained
from adafusion.models import ModelConfig
from adafusion.types import Descriptions

WEIGHED = "AdaFusion"  # the row that has weights


def described_by_seed(trained: Trained, label: str) -> Iterator[tuple[Descriptions, ...]]:
    """Of each seed's model the descriptions of every test dataset, one row a frame."""
    for job in trained.rows[label]:
        model = load_trained(job.name, job.model)
        yield tuple(
            describe_frames(model, exam.dataset, trained.cache, trained.out, trained.progress)
            for exam in trained.exams
        )


def at_weights(
    seen: Descriptions, alpha: Sequence[float] | Float[np.ndarray, " 2"], config: ModelConfig
) -> Float[np.ndarray, "n dim"]:
    """Descriptors as the model would join them if alpha, (image, LiDAR), were that of every frame.

    ValueError where a frame lacks a sensor.
    """
    if seen.image_half is None or seen.lidar_half is None:
        raise ValueError("weights join two halves")
    image, lidar = np.asarray(alpha, np.float32)
    joined = np.concatenate([image * seen.image_half, lidar * seen.lidar_half], axis=1)
    if not config.unit_length:
        return joined
    return joined / np.linalg.norm(joined, axis=1, keepdims=True)
