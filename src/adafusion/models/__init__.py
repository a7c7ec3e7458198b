# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Networks that describe a place, their files, and the gate from tensors back to arrays."""

from adafusion.models.adafusion import AdaFusion
from adafusion.models.base import PlaceModel
from adafusion.models.config import ModelConfig
from adafusion.models.describe import (
    describe,
    frame_batches,
    prepared_batches,
    use_channels_last,
)
from adafusion.models.released import import_released
from adafusion.models.store import SHIPPED, load_model, read_header, save_model
from adafusion.models.systems import SYSTEMS, build_system

__all__ = [
    "SHIPPED",
    "SYSTEMS",
    "AdaFusion",
    "ModelConfig",
    "PlaceModel",
    "build_system",
    "describe",
    "frame_batches",
    "import_released",
    "load_model",
    "prepared_batches",
    "read_header",
    "save_model",
    "use_channels_last",
]
