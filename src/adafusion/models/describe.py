# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The gate out of torch: batches of tensors in, descriptions as arrays out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor, nn

from adafusion.models.base import PlaceModel
from adafusion.preprocess.cache import PreparedFrames, PreparedSet
from adafusion.types import (
    Description,
    Descriptions,
    Frame,
    Observation,
    UserError,
    lacking,
)

Inputs = tuple[Tensor | None, Tensor | None]  # images (B, 3, H, W), LiDAR as the model has it


def describe(model: nn.Module, batches: Iterable[tuple[Tensor | None, ...]]) -> Descriptions:
    """Describe batches of tensors, one row a frame.

    The model is left in the mode it was in. A part that the system does not have is None.
    """
    was_training = model.training
    use_channels_last(model.eval())
    like = next(model.parameters())

    def moved(x: Tensor | None) -> Tensor | None:
        if x is None or not x.is_floating_point():
            return x if x is None else x.to(like.device)
        return x.to(like)  # its precision too, which a training may double

    try:
        with torch.inference_mode():
            parts = [model(*map(moved, batch)) for batch in batches]
    finally:
        model.train(was_training)
    if not parts:
        raise ValueError("no batch to describe")
    return Descriptions(*(_stack(parts, i) for i in range(len(Description._fields))))


def frame_batches(
    model: PlaceModel,
    frames: Sequence[Frame],
    load: Callable[[Frame], Observation],
    batch_size: int = 8,
) -> Iterator[Inputs]:
    """Load and preprocess frames, a batch at a time, with the sensors that the model looks at.

    Raises UserError for a frame that lacks one of them.
    """
    if poor := next((f for f in frames if lacking(f, model.sensors)), None):
        raise UserError(
            f"frame {poor.key} lacks a sensor that model {model.name!r} needs: leave it out, or "
            "take a model of the other sensor"
        )
    for start in range(0, len(frames), batch_size):
        images: list[Tensor] = []
        clouds: list[Tensor] = []
        for frame in frames[start : start + batch_size]:
            seen = load(frame)
            image, lidar = model.preprocess(
                seen.image if "image" in model.sensors else None,
                seen.points_body if "lidar" in model.sensors else None,
            )
            images += [] if image is None else [image]
            clouds += [] if lidar is None else [lidar]
        yield (torch.stack(images) if images else None, torch.stack(clouds) if clouds else None)


def prepared_batches(
    prepared: PreparedFrames | PreparedSet, rows: Int[np.ndarray, " n"], batch_size: int = 8
) -> Iterator[Inputs]:
    """Read rows of a cache, a batch at a time."""
    for start in range(0, len(rows), batch_size):
        yield prepared.tensors(rows[start : start + batch_size])


def use_channels_last(model: nn.Module) -> nn.Module:
    """Lay the convolutions' weights out channels last, which CPUs and GPUs compute faster.

    2-D and 3-D weights need a memory format each, so `Module.to` cannot do both at once.
    """
    formats = {4: torch.channels_last, 5: torch.channels_last_3d}
    for parameter in model.parameters():
        if parameter.ndim in formats:
            parameter.data = parameter.data.contiguous(memory_format=formats[parameter.ndim])
    return model


def _stack(parts: list[Description], index: int) -> np.ndarray | None:
    values = [value for part in parts if (value := part[index]) is not None]
    if not values:
        return None
    if len(values) < len(parts):
        raise ValueError("batches must all have the same sensors")
    return torch.cat(values).float().cpu().numpy()
