# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The gate out of torch: batches of tensors in, descriptions as arrays out."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor, nn

from adafusion.models.adafusion import AdaFusion
from adafusion.types import Description, Descriptions


@torch.inference_mode()
def describe(
    model: AdaFusion, batches: Iterable[tuple[Tensor | None, Tensor | None]]
) -> Descriptions:
    """Describe (image (B, 3, H, W), voxels (B, 1, X, Y, Z)) batches, one row a frame.

    The model is left in the mode it was in. A part that the system does not have is None.
    """
    was_training = model.training
    use_channels_last(model.eval())
    device = next(model.parameters()).device
    try:
        parts = [model(*(None if x is None else x.to(device) for x in batch)) for batch in batches]
    finally:
        model.train(was_training)
    if not parts:
        raise ValueError("no batch to describe")
    return Descriptions(*(_stack(parts, i) for i in range(len(Description._fields))))


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
