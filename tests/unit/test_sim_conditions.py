# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Conditions are independent, checked numbers; presets are points among them."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from adafusion.sim.run.conditions import (
    PRESETS,
    RANGES,
    Conditions,
    between,
    preset,
    vary,
    with_seeds,
)
from adafusion.types import UserError

DAY, NIGHT = PRESETS["day"], PRESETS["night"]


def test_presets_are_there_and_differ() -> None:
    assert set(PRESETS) == {
        *("day", "overcast", "dusk", "night", "fog"),
        *("rain", "snow", "glare", "winter", "autumn"),
    }
    assert len(set(PRESETS.values())) == len(PRESETS)


def test_an_unknown_preset_is_answered_with_the_choices() -> None:
    with pytest.raises(UserError, match=r"'noon'.*autumn, day, dusk, fog, glare, night"):
        preset("noon")


@pytest.mark.parametrize("name", sorted(RANGES))
def test_every_factor_is_held_to_its_range(name: str) -> None:
    low, high = RANGES[name]
    assert getattr(Conditions(**{name: low}), name) == low
    assert getattr(Conditions(**{name: high}), name) == high
    for wrong in (low - 1e-6, high + 1e-6, math.nan, math.inf):
        with pytest.raises(ValueError, match=name):
            Conditions(**{name: wrong})


@pytest.mark.parametrize(
    "wrong",
    [
        {"sun_rgb": (1.0, -1.0, 0.0)},
        {"zenith_rgb": (1.0, math.inf, 0.0)},
        {"window_rgb": (1.0, math.nan, 0.0)},
        {"sun_azimuth_rad": math.inf},
        {"parked_seed": -1},
        {"way_seed": 2**31},
        {"camera_fault": "broken"},
    ],
)
def test_what_is_no_single_number_is_checked_by_name_too(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Conditions(**wrong)


def test_every_factor_has_a_check() -> None:
    rest = {
        *("sun_azimuth_rad", "sun_rgb", "zenith_rgb", "horizon_rgb", "cloud_rgb", "window_rgb"),
        *("cloud_seed", "window_seed", "parked_seed", "traffic_seed", "way_seed"),
        *("reverse", "camera_fault", "lidar_dead"),
    }
    assert set(asdict(Conditions())) == set(RANGES) | rest


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_a_run_varies_its_preset_within_range(name: str) -> None:
    runs = [vary(PRESETS[name], np.random.default_rng(k)) for k in range(50)]
    assert len(set(runs)) == 50
    assert {run.sun_rgb for run in runs} == {PRESETS[name].sun_rgb}


def test_between_two_conditions_light_moves_geometrically() -> None:
    bright = replace(DAY, sun_rgb=(1.0, 1.0, 1.0), rain_mm_h=0.0, reverse=True)
    dim = replace(NIGHT, sun_rgb=(0.01, 0.0, 1.0), rain_mm_h=10.0)
    middle = between(bright, dim, 0.5)
    assert middle.sun_rgb == pytest.approx((0.1, 10**-3.5, 1.0), rel=1e-3)
    assert middle.rain_mm_h == 5.0
    assert middle.reverse
    assert between(bright, dim, 0.0) == bright
    assert between(bright, dim, 1.0).sun_rgb == dim.sun_rgb


def test_between_goes_no_further_than_its_ends() -> None:
    with pytest.raises(ValueError, match="t = 1"):
        between(DAY, NIGHT, 1.5)


def test_a_seed_that_is_not_given_is_the_run_s_own() -> None:
    assert DAY.seed_of("cloud_seed", 7) == 7
    assert replace(DAY, cloud_seed=0).seed_of("cloud_seed", 7) == 0
    assert replace(DAY, cloud_seed=0).seed_of("window_seed", 7) == 7


def test_all_seeds_are_given_at_once_and_nothing_else_is_changed() -> None:
    given = with_seeds(NIGHT, 3)
    changed = {name for name, value in asdict(given).items() if value != asdict(NIGHT)[name]}
    assert changed == {name for name in asdict(NIGHT) if name.endswith("_seed")}
    assert {asdict(given)[name] for name in changed} == {3}
