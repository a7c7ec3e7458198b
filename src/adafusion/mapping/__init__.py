# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Maps of described places, and finding a place again on one."""

from adafusion.mapping.localizer import Answer, Localizer, Place
from adafusion.mapping.place_map import MapHeader, MapInfo, PlaceMap, compact, info, require_free

__all__ = [
    "Answer",
    "Localizer",
    "MapHeader",
    "MapInfo",
    "Place",
    "PlaceMap",
    "compact",
    "info",
    "require_free",
]
