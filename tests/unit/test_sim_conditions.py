# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Conditions are independent, checked numbers; presets are points among them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from adafusion.sim.conditions import PRESETS, Conditions, preset, vary
from adafusion.types import UserError


def test_presets_are_there_and_differ() -> None:
    assert {"day", "overcast", "dusk", "night", "fog"} <= set(PRESETS)
    assert len(set(PRESETS.values())) == len(PRESETS)


def test_an_unknown_preset_is_answered_with_the_choices() -> None:
    with pytest.raises(UserError, match=r"'noon'.*day, dusk, fog, night"):
        preset("noon")


@pytest.mark.parametrize(
    "wrong",
    [
        {"foliage": 1.5},
        {"fog_per_m": -0.1},
        {"parked_density": math.nan},
        {"sun_rgb": (1.0, -1.0, 0.0)},
        {"zenith_rgb": (1.0, math.inf, 0.0)},
        {"sun_elevation_rad": 2.0},
        {"path_offset_m": 5.0},
        {"street_lamps": -1.0},
    ],
)
def test_a_factor_out_of_range_is_refused_by_name(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Conditions(**wrong)


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_a_run_varies_its_preset_within_range(name: str) -> None:
    runs = [vary(PRESETS[name], np.random.default_rng(k)) for k in range(50)]
    assert len(set(runs)) == 50
    assert {run.sun_rgb for run in runs} == {PRESETS[name].sun_rgb}
