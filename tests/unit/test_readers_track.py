# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from adafusion.geometry import pose_from_xyz_yaw
from adafusion.readers.track import Track, keyframes, nearest

START_US = 1_700_000_000_123_457  # microseconds that float64 seconds would round


def us(*times: int) -> np.ndarray:
    return np.array(times, dtype=np.int64)


def drive(*rows: tuple[int, float, float, float]) -> Track:
    """Of rows of time after START_US, x, y, yaw."""
    T = np.stack([pose_from_xyz_yaw(x, y, 2.0 * x, yaw) for _, x, y, yaw in rows])
    return Track(us(*(START_US + t for t, *_ in rows)), T)


def test_it_interpolates_positions_along_lines_and_turns_along_arcs() -> None:
    track = drive((0, 0.0, 0.0, 0.0), (1_000_000, 4.0, 0.0, 0.0), (3_000_000, 4.0, 8.0, 1.0))
    T = track.at(us(START_US + 250_000, START_US + 1_500_000))
    np.testing.assert_allclose(T[0], pose_from_xyz_yaw(1.0, 0.0, 2.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(T[1], pose_from_xyz_yaw(4.0, 2.0, 8.0, 0.25), atol=1e-12)


def test_it_gives_recorded_poses_back() -> None:
    track = drive((0, 0.0, 1.0, 3.0), (7, 4.0, 0.0, -3.0), (9, 5.0, 0.0, 0.5))
    np.testing.assert_allclose(track.at(track.time_us), track.T_world_body, atol=1e-12)


def test_it_turns_the_short_way_across_half_a_turn() -> None:
    track = drive((0, 0.0, 0.0, np.pi - 0.2), (2, 0.0, 0.0, -np.pi + 0.2))
    [T] = track.at(us(START_US + 1))
    np.testing.assert_allclose(T, pose_from_xyz_yaw(0.0, 0.0, 0.0, np.pi), atol=1e-12)


def test_it_tells_single_microseconds_apart_far_from_zero() -> None:
    """Near 2^62 float64 counts in steps of 512 us."""
    base = 2**62
    track = Track(
        us(base, base + 4), np.stack([pose_from_xyz_yaw(x, 0.0, 0.0, 0.0) for x in (0.0, 4.0)])
    )
    np.testing.assert_allclose(track.at(us(base + 1, base + 3))[:, 0, 3], [1.0, 3.0], atol=1e-12)


def test_one_pose_is_a_track_of_one_moment() -> None:
    track = drive((0, 3.0, 0.0, 0.5))
    np.testing.assert_array_equal(track.at(us(START_US))[0], track.T_world_body[0])
    assert track.near(us(START_US - 1, START_US, START_US + 1), 10).tolist() == [False, True, False]
    assert track.at(us()).shape == (0, 4, 4)


@pytest.mark.parametrize("off", [-1, 1_000_001])
def test_it_guesses_nothing_outside_the_track(off: int) -> None:
    track = drive((0, 0.0, 0.0, 0.0), (1_000_000, 1.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="ask `near` first"):
        track.at(us(START_US + off))


def test_near_knows_gaps_and_ends() -> None:
    track = drive((0, 0.0, 0.0, 0.0), (10, 1.0, 0.0, 0.0), (40, 2.0, 0.0, 0.0), (50, 3.0, 0.0, 0.0))
    at = us(-1, 0, 5, 10, 11, 39, 40, 45, 50, 51) + START_US
    expected = [False, True, True, True, False, False, True, True, True, False]
    assert track.near(at, 10).tolist() == expected
    assert track.near(at, 29).tolist() == expected
    assert track.near(at, 30).tolist() == [False, *[True] * 8, False]
    assert track.near(us(), 10).tolist() == []


@pytest.mark.parametrize("times", [[], [1, 1], [2, 1], [0, 5, 4]])
def test_times_of_a_track_rise(times: list[int]) -> None:
    with pytest.raises(ValueError, match="times that rise"):
        Track(us(*times), np.tile(np.eye(4), (len(times), 1, 1)))


def test_nearest_takes_the_earlier_of_two_as_near() -> None:
    times = us(10, 20, 40)
    at = us(-5, 10, 14, 15, 16, 20, 29, 30, 31, 40, 99)
    assert nearest(times, at).tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2]


@pytest.mark.parametrize("count", [1, 2, 3, 20])
def test_nearest_agrees_with_looking_at_all(count: int) -> None:
    rng = np.random.default_rng(count)
    times = START_US + np.sort(rng.choice(100, count, replace=False)).astype(np.int64)
    at = START_US + rng.integers(-20, 120, 300)
    slow = [int(np.argmin([abs(int(t) - int(a)) for t in times])) for a in at]
    assert nearest(times, at).tolist() == slow


def test_nearest_of_nothing() -> None:
    assert nearest(us(1, 2), us()).tolist() == []
    with pytest.raises(ValueError, match="no time to be near to"):
        nearest(us(), us(1))


def test_keyframes_are_so_far_from_the_last_one_kept() -> None:
    x = np.array([0.0, 1.0, 1.9, 2.0, 2.5, 4.0, 3.0, 1.9])
    line = np.column_stack([x, np.zeros_like(x)])
    assert keyframes(line, 2.0).tolist() == [0, 3, 5, 7]  # distance, not travel
    assert keyframes(line, 0.0).tolist() == list(range(8))
    assert keyframes(line, -1.0).tolist() == list(range(8))
    assert keyframes(line, np.inf).tolist() == [0]


def test_keyframes_count_height_and_bear_standing_still() -> None:
    assert keyframes(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 3.0]]), 3.0).tolist() == [0, 1]
    assert keyframes(np.zeros((5, 3)), 0.1).tolist() == [0]
    assert keyframes(np.zeros((0, 3)), 1.0).tolist() == []
