# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The LiDAR in a yard made by hand: a level ground and one wall ten metres ahead."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from adafusion.geometry import pose_from_xyz_yaw
from adafusion.sim.run.conditions import PRESETS
from adafusion.sim.sensing.lidar import (
    HDL_32E,
    HDL_64E,
    VLP_16,
    Lidar,
    measure,
    ray_directions,
    scan,
    scan_ranges,
)
from adafusion.sim.sensing.scene import outdoor_length
from adafusion.sim.town.shapes import Material

HERE = np.eye(4)
DAY = PRESETS["day"]
RUN = 5  # seed of the run


@pytest.mark.parametrize(
    ("lidar", "beams", "lowest", "highest"),
    [(HDL_32E, 32, -30.67, 10.67), (HDL_64E, 64, -24.8, 2.0), (VLP_16, 16, -15.0, 15.0)],
)
def test_beams_are_those_of_the_data_sheet(
    lidar: Lidar, beams: int, lowest: float, highest: float
) -> None:
    elevation = np.degrees(np.arcsin(ray_directions(lidar)[..., 2]))
    assert elevation.shape == (beams, lidar.steps)
    np.testing.assert_allclose((elevation.min(), elevation.max()), (lowest, highest), atol=1e-9)


def test_points_are_in_the_body_frame(yard) -> None:
    _, scene = yard()
    T = pose_from_xyz_yaw(1.0, 2.0, 0.0, math.pi / 2)  # the wall is now to the right, 9 m away
    points = scan(scene, HDL_32E, DAY, T, 1, RUN)
    assert points.dtype == np.float32
    wall = points[points[:, 2] > 0.5]
    assert len(wall) > 500
    np.testing.assert_allclose(wall[:, 1], -9.0, atol=0.3)  # sigma grows with the slant
    near = np.hypot(points[:, 0], points[:, 1]) < 8.0
    assert abs(np.median(points[near, 2])) < 0.01
    assert points[near, 2].std() < 0.03


@pytest.fixture
def straight_at(yard):
    """Ranges of n pulses at one point of the wall, `angle_rad` off its normal, 5 m away."""

    def measured(angle_rad: float, sensor: Lidar, n: int = 4000, **changes: object) -> np.ndarray:
        _, scene = yard()
        distance = 5.0 * math.cos(angle_rad)
        way = np.tile([math.cos(angle_rad), math.sin(angle_rad), 0.0], (n, 1))
        return measure(scene, (10.0 - distance, 0.0, 15.0), way, sensor, replace(DAY, **changes), 1)

    return measured


def test_ranges_are_true_to_two_centimetres(straight_at) -> None:
    error = straight_at(0.0, HDL_32E) - 5.0
    error = error[error > -1.0]
    assert error.std() == pytest.approx(0.02, rel=0.05)
    assert abs(error.mean()) < 0.001
    exact = straight_at(0.0, replace(HDL_32E, sigma_m=0.0))
    np.testing.assert_allclose(exact[exact > 0], 5.0, atol=1e-6)


@pytest.mark.parametrize(("angle_deg", "times"), [(60.0, 1.414), (75.5, 2.0), (88.0, 3.0)])
def test_noise_grows_with_incidence(straight_at, angle_deg: float, times: float) -> None:
    ranges = straight_at(math.radians(angle_deg), replace(HDL_32E, power_half=1e-12))
    assert ranges[ranges > 0].std() == pytest.approx(0.02 * times, rel=0.06)


def test_far_slanted_ground_is_lost(yard) -> None:
    _, scene = yard()
    T = HDL_32E.T_body_lidar
    seen = scan_ranges(scene, HDL_32E, DAY, T, 1, RUN)
    assert (seen[:8] > 0).mean() > 0.95
    assert seen.max() < HDL_32E.range_m
    # power rho sin(elevation) / r^2 over the one at which every second pulse comes back
    behind = np.r_[0:60, -60:0]
    for beam, degrees_down in ((20, 4.0), (21, 2.667)):
        down = math.sin(math.radians(degrees_down))
        r = HDL_32E.height_m / down
        odds = (0.35 * down / r**2 / HDL_32E.power_half) ** 3
        expected = (1.0 - HDL_32E.drop_out) * odds / (1.0 + odds)
        assert (seen[beam, behind] > 0).mean() == pytest.approx(expected, abs=0.09)


def test_fog_takes_returns_away_and_adds_returns_from_the_air(yard) -> None:
    _, scene = yard()
    T = HDL_32E.T_body_lidar
    thick = replace(PRESETS["fog"], lidar_fog_per_m=0.05, lidar_scatter_per_m=0.02)
    clear = scan_ranges(scene, HDL_32E, DAY, T, 1, RUN)
    foggy = scan_ranges(scene, HDL_32E, thick, T, 1, RUN)
    far = clear > 25.0
    assert (foggy[far] > 0).mean() < 0.8
    hit = (foggy > 0) & (clear > 0)
    assert (foggy[hit] < clear[hit] - 0.2).mean() > 0.02


def test_weather_stays_out_of_doors(yard) -> None:
    _, scene = yard(indoor=True, ground=Material.ASPHALT)
    T, sensor = HDL_32E.T_body_lidar, replace(HDL_32E, range_m=59.0)  # the hall ends at 60
    foul = replace(PRESETS["fog"], rain_mm_h=50.0, wetness=1.0, snow_cover=1.0)
    np.testing.assert_array_equal(
        scan_ranges(scene, sensor, foul, T, 1, RUN), scan_ranges(scene, sensor, DAY, T, 1, RUN)
    )


def test_heavy_rain_answers_three_times_in_a_kilometre(yard) -> None:
    """Beer and Lambert over 9 m of air, dimmed by how faintly far drops answer."""
    _, scene = yard()
    n, sensor = 200_000, replace(HDL_32E, drop_out=1.0 - 1e-9, nearest_m=0.0)
    way = np.tile([1.0, 0.0, 0.0], (n, 1))
    rain = replace(DAY, rain_mm_h=25.0)
    seen = measure(scene, (1.0, 0.0, 15.0), way, sensor, rain, 1)
    rate = 0.003
    expected = rate * 12.0 * (1.0 - math.exp(-9.0 / 12.0))
    assert (seen > 0).mean() == pytest.approx(expected, rel=0.1)
    assert not measure(scene, (1.0, 0.0, 15.0), way, sensor, DAY, 1).any()


@pytest.fixture
def returns_from_ground(yard):
    """Share of pulses that the ground behind the vehicle gives back."""

    def share(ground: Material, **changes: float) -> float:
        _, scene = yard(ground=ground)
        T = HDL_32E.T_body_lidar
        weak = replace(HDL_32E, power_half=2e-4)  # so that it sees dry asphalt half the time
        behind = scan_ranges(scene, weak, replace(DAY, **changes), T, 1, RUN)[:20, :200]
        return float((behind > 0).mean())

    return share


def test_wet_ground_swallows_pulses_and_wet_lawns_do_not(returns_from_ground) -> None:
    road = [returns_from_ground(Material.ASPHALT, wetness=w) for w in (0.0, 0.5, 1.0)]
    assert road[0] > road[1] + 0.02 > road[2] + 0.04
    lawn = [returns_from_ground(Material.GRASS, wetness=w) for w in (0.0, 1.0)]
    assert lawn[1] == pytest.approx(lawn[0], abs=0.02)


def test_snow_answers_better_than_the_road_below(returns_from_ground) -> None:
    bare, white = (returns_from_ground(Material.ASPHALT, snow_cover=s) for s in (0.0, 1.0))
    assert white > bare + 0.03


def test_a_dead_sector_is_as_wide_as_it_says_and_stays_through_a_run(yard) -> None:
    _, scene = yard()
    T = HDL_32E.T_body_lidar
    broken = replace(DAY, lidar_dead_sector_rad=math.pi / 2)
    whole = scan_ranges(scene, HDL_32E, DAY, T, 1, RUN)
    left = scan_ranges(scene, HDL_32E, broken, T, 1, RUN)
    dead = ~(left > 0).any(axis=0)
    assert dead.sum() == pytest.approx(256, abs=1)
    assert np.count_nonzero(dead != np.roll(dead, 1)) == 2  # one piece
    np.testing.assert_array_equal(left[:, ~dead], whole[:, ~dead])
    again = scan_ranges(scene, HDL_32E, broken, T, 2, RUN)
    np.testing.assert_array_equal(~(again > 0).any(axis=0), dead)
    other = scan_ranges(scene, HDL_32E, broken, T, 1, RUN + 1)
    assert np.any(~(other > 0).any(axis=0) != dead)


def test_dead_beams_are_as_many_as_it_says_and_stay_through_a_run(yard) -> None:
    _, scene = yard(indoor=True)
    T = VLP_16.T_body_lidar
    broken = replace(DAY, lidar_dead_beams=0.25)
    sensor = replace(VLP_16, range_m=500.0, power_half=1e-12)
    whole = scan_ranges(scene, sensor, DAY, T, 1, RUN)
    left = scan_ranges(scene, sensor, broken, T, 1, RUN)
    dead = ~(left[:, 250:260] > 0).any(axis=1)
    assert dead.sum() == 4
    np.testing.assert_array_equal(left[~dead], whole[~dead])
    other = scan_ranges(scene, sensor, broken, T, 1, RUN + 1)
    assert np.any(~(other[:, 250:260] > 0).any(axis=1) != dead)


def test_a_dead_sensor_gives_no_points(yard) -> None:
    _, scene = yard()
    points = scan(scene, VLP_16, replace(DAY, lidar_dead=True), HERE, 1, RUN)
    assert points.shape == (0, 3)
    assert points.dtype == np.float32


def test_a_scan_is_its_pulses_measured_one_by_one(yard) -> None:
    _, scene = yard()
    T = VLP_16.T_body_lidar
    ways = ray_directions(VLP_16).reshape(-1, 3)
    ranges = measure(scene, (0.0, 0.0, 1.9), ways, VLP_16, PRESETS["rain"], 4)
    np.testing.assert_array_equal(
        ranges, scan_ranges(scene, VLP_16, PRESETS["rain"], T, 4, RUN).reshape(-1)
    )


@pytest.mark.parametrize(
    ("origin", "direction", "t", "outdoors"),
    [
        ((-5.0, 0.0, 1.0), (1.0, 0.0, 0.0), 20.0, 16.0),  # through the box
        ((2.0, 0.0, 1.0), (1.0, 0.0, 0.0), 20.0, 18.0),  # out of it
        ((2.0, 0.0, 1.0), (1.0, 0.0, 0.0), 1.0, 0.0),  # not yet out
        ((-5.0, 3.0, 1.0), (1.0, 0.0, 0.0), 20.0, 20.0),  # past it
        ((-5.0, 0.0, 1.0), (-1.0, 0.0, 0.0), 20.0, 20.0),  # away from it
    ],
)
def test_a_ray_knows_how_long_it_is_outdoors(
    origin: tuple[float, ...], direction: tuple[float, ...], t: float, outdoors: float
) -> None:
    box = np.array([[0.0, -1.0, 0.0, 4.0, 1.0, 3.0, 0.1]])
    assert outdoor_length(box, origin, direction, t) == pytest.approx(outdoors)


def test_glass_swallows_most_pulses(yard) -> None:
    _, scene = yard(wall=Material.GLASS)
    _, opaque = yard()
    T = HDL_32E.T_body_lidar
    ahead = slice(480, 545)
    count = [
        (scan_ranges(s, HDL_32E, DAY, T, 1, RUN)[24:, ahead] > 0).mean() for s in (scene, opaque)
    ]
    assert count[0] < 0.3 < 0.9 < count[1]


def test_a_sensor_without_beams_is_refused() -> None:
    with pytest.raises(ValueError, match="0 beams"):
        Lidar(beams=0)
    with pytest.raises(ValueError, match="degrees"):
        Lidar(lowest_deg=5.0, highest_deg=-5.0)
