# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Lens and motion blur on pictures made by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from adafusion.sim.sensing.camera import Camera
from adafusion.sim.sensing.lens import Motion, smear, smudge, spatter, spread, sun_veil

CAMERA = Camera(size=(60, 80), pitch_down_rad=0.0, forward_m=0.0)
VIEW = CAMERA.view(np.eye(4))


def spot(i: int, j: int, value: float = 1.0) -> np.ndarray:
    light = np.zeros((60, 80, 3), np.float32)
    light[i, j] = value
    return light


def trail(j: int, depth_m: float, motion: Motion, seconds: float = 0.05) -> np.ndarray:
    """Where the light of one pixel of the middle row goes."""
    depth = np.full((60, 80), depth_m, np.float32)
    return smear(spot(30, j), depth, VIEW, CAMERA.T_body_camera, motion, seconds)[:, :, 0]


def test_an_even_picture_stays_even() -> None:
    even = np.full((60, 80, 3), 0.3, np.float32)
    np.testing.assert_allclose(spread(even, 0.5), 0.3, rtol=1e-5)
    depth = np.full((60, 80), 2.0, np.float32)
    smeared = smear(even, depth, VIEW, CAMERA.T_body_camera, Motion(20.0, 0.5), 0.05)
    np.testing.assert_allclose(smeared, 0.3, rtol=1e-5)


def test_bloom_spills_a_small_share_far_and_loses_nothing() -> None:
    out = spread(spot(30, 40, 100.0), 0.45)
    assert out.sum() == pytest.approx(300.0, rel=0.02)
    assert 0.95 < out[29:32, 39:42].sum() / 300.0 < 0.99
    assert out[30, 48, 0] > out[30, 60, 0] > 0.0


def test_a_sharp_lens_blurs_nothing_but_the_bloom() -> None:
    assert spread(spot(30, 40), 0.0)[30, 40, 0] > 0.95
    assert spread(spot(30, 40), 0.45)[30, 40, 0] < 0.9


def test_a_vehicle_that_stands_is_sharp() -> None:
    np.testing.assert_array_equal(trail(60, 2.0, Motion()), spot(30, 60)[:, :, 0])


def test_the_trail_of_a_drive_has_the_length_of_the_flow() -> None:
    """f X / Z: what is 20.5 px off the axis goes out by 20.5 * 2 / 4 when 2 of 4 m are driven."""
    near = trail(60, 4.0 * math.hypot(1.0, 20.5 / VIEW.fx), Motion(40.0))
    assert np.count_nonzero(near.sum(axis=0)) == pytest.approx(20.5 * 2.0 / 4.0 + 2.0, abs=1.5)


def test_near_things_smear_and_far_ones_do_not() -> None:
    peak = [float(trail(70, depth, Motion(10.0)).max()) for depth in (2.0, 5.0, 100.0)]
    assert peak[0] < peak[1] < peak[2] == 1.0


def test_blur_grows_with_speed_and_with_exposure() -> None:
    speed = [float(trail(70, 3.0, Motion(v)).max()) for v in (0.0, 6.0, 20.0)]
    assert speed[0] > speed[1] > speed[2]
    exposure = [float(trail(70, 3.0, Motion(6.0), s).max()) for s in (0.0001, 0.03, 0.1)]
    assert exposure[0] > exposure[1] > exposure[2]


def test_turning_smears_near_and_far_alike() -> None:
    """f times 0.1 rad, along the row."""
    for depth in (2.0, 400.0):
        out = trail(40, depth, Motion(0.0, 2.0))
        columns = np.flatnonzero(out.sum(axis=0))
        assert columns.max() - columns.min() == pytest.approx(VIEW.fx * 0.1, abs=2.0)
        assert out.sum(axis=1)[[28, 32]].max() < 0.05


def test_the_sun_veils_most_where_it_is_and_nothing_from_behind() -> None:
    ahead = sun_veil(VIEW, (1.0, 0.0, 0.0), (3.0, 2.0, 1.0), (60, 80))
    i, j = np.unravel_index(ahead[:, :, 0].argmax(), (60, 80))
    assert abs(i - 29.5) <= 0.5
    assert abs(j - 39.5) <= 0.5
    np.testing.assert_allclose(ahead[:, :, 0], 3.0 * ahead[:, :, 2], rtol=1e-5)
    beside = sun_veil(VIEW, (math.cos(0.7), math.sin(0.7), 0.0), (3.0, 2.0, 1.0), (60, 80))
    assert beside[30, 0, 0] > beside[30, 79, 0] > 0.0  # it is to the left
    assert not sun_veil(VIEW, (-1.0, 0.0, 0.0), (3.0, 2.0, 1.0), (60, 80)).any()


def test_more_rain_leaves_more_drops_and_the_same_seed_the_same() -> None:
    light = np.linspace(0.0, 1.0, 60 * 80 * 3, dtype=np.float32).reshape(60, 80, 3)
    wet = [float((spatter(light, rain, 1) != light).mean()) for rain in (0.0, 2.0, 60.0)]
    assert wet[0] == 0.0 < wet[1] < wet[2] < 0.5
    np.testing.assert_array_equal(spatter(light, 9.0, 1), spatter(light, 9.0, 1))
    assert np.any(spatter(light, 9.0, 1) != spatter(light, 9.0, 2))


def test_dirt_hides_a_part_softly() -> None:
    for seed in range(5):
        clear = smudge((60, 80), seed)[:, :, 0]
        assert clear.min() < 0.05
        assert 0.05 < (clear < 0.5).mean() < 0.8
        assert np.abs(np.diff(clear, axis=1)).max() < 0.2
