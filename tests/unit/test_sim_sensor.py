# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Exposure, electrons and mosaics of even pictures."""

from __future__ import annotations

import numpy as np
import pytest

from adafusion.sim.sensing.camera import Camera
from adafusion.sim.sensing.sensor import Exposure, demosaic, develop, meter, mosaic

SENSOR = Camera().sensor._replace(
    full_well=10_000.0, sensitivity=1e6, shortest_s=1e-4, longest_s=0.01, largest_gain=8.0, key=0.2
)


def even(*rgb: float) -> np.ndarray:
    return np.broadcast_to(np.array(rgb, np.float32), (40, 40, 3)).copy()


PLAIN = Exposure(0.01, 1.0, 1.0, 1.0)


def developed(level: float, exposure: Exposure = PLAIN, seed: int = 3) -> np.ndarray:
    return develop(even(level, level, level), exposure, SENSOR, seed)


@pytest.mark.parametrize(
    ("level", "seconds", "gain"),
    [
        (1.0, 0.002, 1.0),  # 0.2 of 10,000 electrons at 1e6 a second
        (0.1, 0.01, 2.0),  # the shutter is at its end
        (0.001, 0.01, 8.0),  # so is the gain
        (1000.0, 1e-4, 1.0),
    ],
)
def test_the_meter_takes_time_before_gain(level: float, seconds: float, gain: float) -> None:
    exposure = meter(even(level, level, level), SENSOR, 1.0)
    assert (exposure.seconds, exposure.gain) == pytest.approx((seconds, gain), rel=1e-4)
    assert (exposure.red, exposure.blue) == pytest.approx((1.0, 1.0))


def test_the_meter_can_be_told_better() -> None:
    assert meter(even(1.0, 1.0, 1.0), SENSOR, 3.0).seconds == pytest.approx(0.006, rel=1e-4)


def test_the_balance_takes_most_of_a_cast_away() -> None:
    exposure = meter(even(0.8, 0.4, 0.2), SENSOR, 1.0)
    assert 0.5 < exposure.red < 1.0 < exposure.blue < 2.0
    r, g, b = develop(even(0.8, 0.4, 0.2), exposure, SENSOR, 1).mean(axis=(0, 1))
    assert r > g > b  # an evening stays warm


def test_more_light_is_never_darker() -> None:
    level = [float(developed(x).mean()) for x in (0.0, 0.01, 0.1, 0.5, 1.0, 2.0, 1e6)]
    assert level == sorted(level)
    assert level[0] < 20
    assert level[-1] == 255.0


def test_the_noise_is_that_of_counted_electrons() -> None:
    """Twice: 0.2 at gain 1 counts 2,000 electrons, at gain 4 a quarter of them."""
    bright, dim = developed(0.2), developed(0.05, PLAIN._replace(gain=4.0))
    middle = slice(15, 25)
    assert dim.mean() == pytest.approx(bright.mean(), rel=0.02)
    ratio = dim[middle, middle].std() / bright[middle, middle].std()
    assert ratio == pytest.approx(2.0, rel=0.15)


def test_a_picture_darkens_towards_its_corners() -> None:
    picture = developed(0.3)
    assert picture[:4, :4].mean() < picture[18:22, 18:22].mean() - 10


def test_noise_belongs_to_the_seed() -> None:
    one, same, other = (developed(0.1, seed=k) for k in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert np.any(one != other)


def test_no_light_at_all_is_a_picture_too() -> None:
    dark = even(0.0, 0.0, 0.0)
    exposure = meter(dark, SENSOR, 1.0)
    assert exposure == Exposure(0.01, 8.0, 1.0, 1.0)
    assert 0 < develop(dark, exposure, SENSOR, 1).mean() < 20


@pytest.mark.parametrize(
    ("pattern", "wanted"), [("RGGB", [[1, 12], [22, 33]]), ("GBRG", [[2, 13], [21, 32]])]
)
def test_a_mosaic_names_its_first_two_rows(pattern: str, wanted: list[list[int]]) -> None:
    rgb = np.array([[(1, 2, 3), (11, 12, 13)], [(21, 22, 23), (31, 32, 33)]], np.uint8)
    np.testing.assert_array_equal(mosaic(rgb, pattern), wanted)


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG"])
def test_filling_in_keeps_what_was_counted_and_gets_an_even_colour_right(pattern: str) -> None:
    raw = np.random.default_rng(1).integers(0, 256, (12, 14)).astype(np.uint8)
    np.testing.assert_array_equal(mosaic(demosaic(raw, pattern), pattern), raw)
    orange = np.broadcast_to(np.array((200, 120, 40), np.uint8), (10, 12, 3))
    np.testing.assert_array_equal(demosaic(mosaic(orange, pattern), pattern), orange)


def test_an_unknown_mosaic_is_refused() -> None:
    with pytest.raises(ValueError, match="RGGB, GBRG"):
        mosaic(np.zeros((4, 4, 3), np.uint8), "BOGUS")
