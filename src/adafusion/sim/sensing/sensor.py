# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A camera's sensor: it meters, counts electrons (after EMVA 1288) and makes 8 bits of them.

A night is noisy because it is dark: exposure and gain have their ends.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from adafusion.sim.numeric import hashed, inlined, kernel

BAYER = ("", "RGGB", "GBRG")
_STEPS = 16384  # of the tone table, per unit of exposure
_WHITE = 2.0  # where it ends


class Sensor(NamedTuple):
    """The part of a camera that counts electrons."""

    full_well: float  # electrons at white, at gain 1
    sensitivity: float  # electrons a second and unit of radiance
    shortest_s: float
    longest_s: float
    largest_gain: float
    read_noise: float  # electrons
    key: float  # where the meter wants the picture's mean, as a share of white


class Exposure(NamedTuple):
    """What the meter chose; the last two are the white balance."""

    seconds: float
    gain: float
    red: float
    blue: float


@kernel
def meter(light: Float32[np.ndarray, "h w 3"], sensor: Sensor, bias: float) -> Exposure:
    """Choose exposure, gain and white balance; `bias` times as bright as the key asks."""
    h, w = light.shape[:2]
    # a mean of roots, so that one lamp does not turn the night black
    mean, red, green, blue = 0.0, 0.0, 0.0, 0.0
    for i in range(h):
        for j in range(w):
            r, g, b = light[i, j, 0], light[i, j, 1], light[i, j, 2]
            mean += math.sqrt(max(0.25 * r + 0.6 * g + 0.15 * b, 0.0))
            top = 1.0 / max(max(r, g), max(b, np.float32(1e-12)))
            # each pixel votes for the colour of the light, however bright it is
            red, green, blue = red + r * top, green + g * top, blue + b * top
    mean = (mean / (h * w)) ** 2
    key = sensor.key * sensor.full_well * bias
    wanted = key / (sensor.sensitivity * max(mean, 1e-9))  # seconds times gain
    seconds = min(max(wanted, sensor.shortest_s), sensor.longest_s)
    gain = min(max(wanted / seconds, 1.0), sensor.largest_gain)
    # most of the way to grey: an evening stays warm but is not pink
    red = (green / max(red, 1e-9)) ** 0.65 if green > 0.0 else 1.0
    blue = (green / max(blue, 1e-9)) ** 0.65 if green > 0.0 else 1.0
    return Exposure(seconds, gain, red, blue)


def develop(
    light: Float32[np.ndarray, "h w 3"], exposure: Exposure, sensor: Sensor, seed: int
) -> UInt8[np.ndarray, "h w 3"]:
    """Vignette, count electrons with their noise, balance the white, bend the tone, quantise."""
    out = np.empty(light.shape, np.uint8)
    _develop(light, exposure, sensor, seed, _tone_table(), out)
    return out


@cache
def _tone_table() -> UInt8[np.ndarray, " n"]:
    """The 8-bit value of each exposure in steps of 1 / `_STEPS`; not to be written to."""
    x = (np.arange(int(_STEPS * _WHITE) + 1) + 0.5) / _STEPS
    x = np.minimum(x * (1.0 + x / 16.0) / (1.0 + 0.75 * x) * 1.15, 1.0)  # a shoulder, then sRGB
    x = np.where(x < 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)
    return np.round(255.0 * x).astype(np.uint8)


@kernel
def _develop(
    light: Float32[np.ndarray, "h w 3"],
    exposure: Exposure,
    sensor: Sensor,
    seed: int,
    tone: UInt8[np.ndarray, " n"],
    out: UInt8[np.ndarray, "h w 3"],
) -> None:
    h, w = light.shape[:2]
    scale = sensor.sensitivity * exposure.seconds
    dark = sensor.read_noise**2
    to_tone = exposure.gain / sensor.full_well * _STEPS
    balance = exposure.red * to_tone, to_tone, exposure.blue * to_tone
    inverse_size = 1.0 / (0.25 * (w * w + h * h))
    last = len(tone) - 1
    for i in range(h):
        for j in range(w):
            away = ((j - 0.5 * w) ** 2 + (i - 0.5 * h) ** 2) * inverse_size
            collected = scale * (1.0 - 0.28 * away)
            for c in range(3):
                electrons = light[i, j, c] * collected
                electrons += math.sqrt(electrons + dark) * _noise(seed, i * w + j, c)
                out[i, j, c] = tone[int(min(max(electrons * balance[c], 0.0), last))]


@inlined
def _noise(a: int, b: int, c: int) -> float:
    """Hash three integers to a number that is normal enough: a sum of four random bytes."""
    h = hashed(a, b, c)
    total = (h & 0xFF) + ((h >> 8) & 0xFF) + ((h >> 16) & 0xFF) + (h >> 24)
    return (total - 510.0) * (1.0 / 147.8)


def mosaic(rgb: UInt8[np.ndarray, "h w 3"], pattern: str) -> UInt8[np.ndarray, "h w"]:
    """Keep the one colour of each pixel that a sensor under a Bayer `pattern` counts.

    `pattern` names the colours of the first two rows' first two pixels: "RGGB" or "GBRG".
    """
    out = np.empty(rgb.shape[:2], np.uint8)
    for (i, j), colour in zip(((0, 0), (0, 1), (1, 0), (1, 1)), _colours(pattern), strict=True):
        out[i::2, j::2] = rgb[i::2, j::2, colour]
    return out


def demosaic(raw: UInt8[np.ndarray, "h w"], pattern: str) -> UInt8[np.ndarray, "h w 3"]:
    """Fill in the two missing colours of each pixel from its neighbours; the counted one stays."""
    first = _colours(pattern)
    # OpenCV names a pattern after the second row's second and third pixel
    code = cv2.COLOR_BayerBG2RGB if first[0] == 0 else cv2.COLOR_BayerGR2RGB
    rim = 2  # OpenCV copies the outermost pixels, so give it some to lose
    framed = cv2.copyMakeBorder(raw, rim, rim, rim, rim, cv2.BORDER_REFLECT_101)
    rgb: UInt8[np.ndarray, "h w 3"] = cv2.cvtColor(framed, code)[rim:-rim, rim:-rim]
    return np.ascontiguousarray(rgb)


def _colours(pattern: str) -> tuple[int, ...]:
    if pattern not in BAYER[1:]:
        raise ValueError(f"unknown Bayer pattern {pattern!r}; choose from {', '.join(BAYER[1:])}")
    return tuple("RGB".index(letter) for letter in pattern)
