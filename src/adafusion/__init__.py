# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Camera + LiDAR place recognition with adaptive weights.

>>> model = adafusion.load_model("adafusion-s")
>>> place_map = adafusion.PlaceMap.open("campus.map")
>>> answer = adafusion.Localizer(model, place_map).locate(image_u8, points_m)
"""

from adafusion.mapping import Answer, Localizer, Place, PlaceMap
from adafusion.models import AdaFusion, ModelConfig, load_model
from adafusion.types import Description, Frame, Observation, UserError

__version__ = "0.1.0"

__all__ = [
    "AdaFusion",
    "Answer",
    "Description",
    "Frame",
    "Localizer",
    "ModelConfig",
    "Observation",
    "Place",
    "PlaceMap",
    "UserError",
    "load_model",
]
