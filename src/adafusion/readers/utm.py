# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Latitude and longitude on WGS 84 as easting and northing of a UTM zone, metres.

By Krueger's series to the third order of the flattening, below a millimetre off within a zone.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64
from scipy.spatial.transform import Rotation

_FARTHEST_DEG = 9.0  # from the middle of a zone, which is 3 degrees wide to either side


def zone_of(latitude_deg: float, longitude_deg: float) -> str:
    """Zone as "30N", by longitude alone: Norway and Svalbard get no exception."""
    if not (abs(latitude_deg) <= 84 and abs(longitude_deg) <= 180):
        raise ValueError(f"{latitude_deg}, {longitude_deg} is no latitude and longitude of UTM")
    number = int((longitude_deg + 180) // 6) % 60 + 1
    return f"{number}{'N' if latitude_deg >= 0 else 'S'}"


def to_utm(
    latitude_deg: Float[np.ndarray, " n"], longitude_deg: Float[np.ndarray, " n"], zone: str
) -> Float64[np.ndarray, "n 2"]:
    """Easting and northing in `zone`; ValueError for a place that is not in it or near to it."""
    off_deg = longitude_deg - (6.0 * int(zone[:-1]) - 183.0)
    off_deg = (off_deg + 180) % 360 - 180
    wrong = (np.abs(latitude_deg) > 84) | (np.abs(longitude_deg) > 180)
    wrong |= np.abs(off_deg) > _FARTHEST_DEG
    if wrong.any():
        at = int(np.argmax(wrong))
        raise ValueError(
            f"{latitude_deg[at]}, {longitude_deg[at]} is no place near UTM zone {zone}"
        )
    n = 1 / (2 * 298.257223563 - 1)  # third flattening
    radius_m = 0.9996 * 6_378_137.0 / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
    e = 2 * np.sqrt(n) / (1 + n)
    sine, off = np.sin(np.radians(latitude_deg)), np.radians(off_deg)
    t = np.sinh(np.arctanh(sine) - e * np.arctanh(e * sine))  # tangent of the conformal latitude
    xi, eta = np.arctan2(t, np.cos(off)), np.arctanh(np.sin(off) / np.sqrt(1 + t**2))
    series = (
        n / 2 - 2 * n**2 / 3 + 5 * n**3 / 16,
        13 * n**2 / 48 - 3 * n**3 / 5,
        61 * n**3 / 240,
    )
    waves = [(2 * j, a) for j, a in enumerate(series, start=1)]
    east = eta + sum(a * np.cos(j * xi) * np.sinh(j * eta) for j, a in waves)
    north = xi + sum(a * np.sin(j * xi) * np.cosh(j * eta) for j, a in waves)
    start_m = 0.0 if zone.endswith("N") else 10_000_000.0
    return np.stack([500_000.0 + radius_m * east, start_m + radius_m * north], axis=1)


def grid_from_north(
    latitude_deg: Float[np.ndarray, " n"], longitude_deg: Float[np.ndarray, " n"], zone: str
) -> Float64[np.ndarray, "n 3 3"]:
    """R_grid_enu: how east, north, up lie on the grid at some places; up to 5 degrees turned."""
    south, north = (
        to_utm(np.clip(latitude_deg + step, -84, 84), longitude_deg, zone) for step in (-1e-4, 1e-4)
    )
    way = north - south
    turn_rad = np.arctan2(-way[:, 0], way[:, 1])
    return Rotation.from_rotvec(np.outer(turn_rad, (0.0, 0.0, 1.0))).as_matrix()
