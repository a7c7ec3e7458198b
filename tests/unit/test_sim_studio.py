# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A run is its conditions: each factor reaches the sensors, and only its own part of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from adafusion.sim.run.conditions import PRESETS, Conditions, with_seeds
from adafusion.sim.studio import FROZEN_FRAMES, Studio, conditions_of, make_job
from adafusion.types import UserError

BASE = with_seeds(PRESETS["overcast"], 1)
K = 30


@pytest.fixture(scope="module")
def seen() -> Callable[[str], Studio]:
    """One studio for all: a world is built once."""
    runs: dict[str, Conditions] = {
        "base": BASE,
        "again": BASE,
        "cars": replace(BASE, parked_seed=2, parked_density=0.9),
        "people": replace(BASE, traffic_seed=2, people_density=0.9, traffic_density=0.9),
        "high": replace(BASE, lift_m=0.4),
        "dead": replace(BASE, lidar_dead=True),
        "black": replace(BASE, camera_fault="black"),
        "rarely black": replace(BASE, camera_fault="black", camera_fault_share=0.3),
        "frozen": replace(BASE, camera_fault="frozen"),
    }
    return Studio(make_job(3, runs, "tiny"))


def test_a_name_says_preset_direction_and_repeat() -> None:
    assert not conditions_of(1, "night").reverse
    assert conditions_of(1, "night-reverse-2").reverse
    assert conditions_of(1, "night-reverse-2").headlights == PRESETS["night"].headlights
    assert conditions_of(1, "day") != conditions_of(1, "day-2") != conditions_of(2, "day-2")
    with pytest.raises(UserError, match="'noon'"):
        conditions_of(1, "noon-reverse")


def test_runs_that_share_all_seeds_differ_in_noise_alone(seen: Studio) -> None:
    np.testing.assert_array_equal(seen.drive("base").T_world_body, seen.drive("again").T_world_body)
    a, b = (seen.image(run, K).astype(int) for run in ("base", "again"))
    assert 0 < np.abs(a - b).max() < 60
    assert np.abs(a - b).mean() < 4.0
    assert abs(len(seen.points("base", K)) - len(seen.points("again", K))) < 200


@pytest.mark.parametrize("run", ["cars", "people"])
def test_what_moves_changes_places_but_not_the_way(seen: Studio, run: str) -> None:
    np.testing.assert_array_equal(seen.drive("base").path, seen.drive(run).path)
    streets = [k for k, zone in enumerate(seen.drive("base").zone) if zone == "street"]

    def changed(other: str) -> float:
        """Largest share of a picture's pixels that differ by more than noise."""
        return max(
            float((np.abs(a - b).max(axis=2) > 60).mean())
            for a, b in (
                (seen.image("base", k).astype(int), seen.image(other, k)) for k in streets[::3]
            )
        )

    assert changed("again") == 0.0
    assert changed(run) > 0.002


def test_a_load_lifts_the_sensors_and_the_calibration_does_not_know(seen: Studio) -> None:
    def ground(run: str) -> float:
        points = seen.points(run, K)
        near = np.hypot(points[:, 0], points[:, 1]) < 14.0
        return float(np.median(points[near & (points[:, 2] < 0.3), 2]))

    assert ground("high") - ground("base") == pytest.approx(-0.4, abs=0.05)
    np.testing.assert_array_equal(seen.drive("base").T_world_body, seen.drive("high").T_world_body)


def test_a_dead_lidar_leaves_the_image_alone(seen: Studio) -> None:
    _, observation = seen.observe("dead", K)
    assert observation.points_body is None
    assert observation.image is not None
    assert observation.image.mean() > 30


def test_a_fault_reaches_its_share_of_frames(seen: Studio) -> None:
    assert seen.image("black", K).mean() < 25
    dark = [seen.image("rarely black", k).mean() < 25 for k in range(40)]
    assert 0.1 < np.mean(dark) < 0.55


def test_a_frozen_camera_shows_an_earlier_frame(seen: Studio) -> None:
    first = FROZEN_FRAMES * (K // FROZEN_FRAMES)
    np.testing.assert_array_equal(seen.image("frozen", K), seen.image("frozen", first))
    assert not np.array_equal(seen.image("frozen", K), seen.image("frozen", K + FROZEN_FRAMES))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"runs": ["noon"]}, "'noon'"),
        ({"runs": ["day", "day"]}, "each once"),
        ({"runs": {}}, "one or more"),
        ({"profile": "huge"}, "tiny, small, compact, full"),
        ({"places": 0}, "places"),
    ],
)
def test_bad_wishes_are_answered_at_once(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(UserError, match=message):
        make_job(**{"seed": 3, "runs": ["day"], "profile": "tiny", **wrong})
