# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Camera + LiDAR place recognition with adaptive weights.

>>> model = adafusion.load_model("adafusion-s")
>>> place_map = adafusion.PlaceMap.open("campus.map")
>>> answer = adafusion.Localizer(model, place_map).locate(image_u8, points_m)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from adafusion.datasets import open_dataset
    from adafusion.mapping import Answer, Localizer, Place, PlaceMap
    from adafusion.models import AdaFusion, ModelConfig, load_model
    from adafusion.readers import prepare
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
    "open_dataset",
    "prepare",
]

# Imported on first use: `adafusion --help` shall not wait for torch.
_HOMES = {
    "datasets": ("open_dataset",),
    "mapping": ("Answer", "Localizer", "Place", "PlaceMap"),
    "models": ("AdaFusion", "ModelConfig", "load_model"),
    "readers": ("prepare",),
    "types": ("Description", "Frame", "Observation", "UserError"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
