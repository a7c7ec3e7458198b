# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Camera and LiDAR in a yard made by hand: a level ground and one wall ten metres ahead."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from adafusion.geometry import pose_from_xyz_yaw
from adafusion.sim.run.conditions import PRESETS, Conditions
from adafusion.sim.run.vehicles import LIT
from adafusion.sim.sensing.camera import Camera, Motion, mosaic, photograph, radiance
from adafusion.sim.sensing.lens import STILL, spread
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
from adafusion.sim.sensing.scene import Scene, build_scene, build_static, outdoor_length
from adafusion.sim.sensing.sensor import develop, meter
from adafusion.sim.town.plan import Hills, WorldSpec, Zone
from adafusion.sim.town.shapes import Material, SoupBuilder, rectangle
from adafusion.sim.town.world import World

CAMERA = Camera(size=(30, 40))
HERE = np.eye(4)
DAY, OVERCAST, NIGHT = PRESETS["day"], PRESETS["overcast"], PRESETS["night"]
RUN = 5  # seed of the run
GROUND, WALL = (-2, 20), (8, 20)  # pixels


def yard(
    *, indoor: bool = False, wall: Material = Material.PLAIN, ground: Material = Material.PLAIN
) -> tuple[World, Scene]:
    soup = SoupBuilder()
    grey = soup.add_object("ground", (0.2, 0.2, 0.2))
    soup.cap(rectangle((0.0, 0.0), 120.0, 120.0, 0.0), 0.0, ground, grey)
    red = soup.add_object("wall", (0.6, 0.1, 0.1), style=LIT)
    face = [(10.0, -50.0, 0.0), (10.0, 50.0, 0.0), (10.0, 50.0, 30.0), (10.0, -50.0, 30.0)]
    soup.quads(np.array([face]), wall, red)
    zones = (Zone((-60.0, -60.0, -1.0), (60.0, 60.0, 40.0), "hall", True, 0.01),) if indoor else ()
    lamps = np.array([[5.0, 3.0, 6.0, 0.5, 0.4, 0.3, 0.0 if indoor else -1.0, 0.0]])
    level = Hills(np.zeros((0, 4)), ())
    world = World(WorldSpec(seed=0), np.zeros((1, 2)), (), soup.build(), zones, lamps, level)
    return world, build_scene(world, build_static(world), SoupBuilder().build())


def picture(
    conditions: Conditions,
    seed: int = 1,
    *,
    camera: Camera = CAMERA,
    motion: Motion = STILL,
    run_seed: int = RUN,
    indoor: bool = False,
) -> np.ndarray:
    world, scene = yard(indoor=indoor)
    return photograph(scene, world.lamps, camera, conditions, HERE, seed, run_seed, motion)


def light_in(
    conditions: Conditions, run_seed: int = RUN, *, camera: Camera = CAMERA, **kind: object
) -> np.ndarray:
    world, scene = yard(**kind)
    return radiance(scene, world.lamps, camera, conditions, HERE, run_seed)[0]


# ---------------------------------------------------------------------------------------- camera


def test_the_camera_looks_forward_with_x_right_and_y_down() -> None:
    camera = Camera(size=(30, 40), pitch_down_rad=0.0)
    R = camera.T_body_camera[:3, :3]
    np.testing.assert_allclose(R, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)
    assert np.linalg.det(Camera().T_body_camera[:3, :3]) == pytest.approx(1.0)


def test_the_picture_agrees_with_its_calibration() -> None:
    """The lower edge of the wall, at the height of the ground, is where K and T put it."""
    world, scene = yard()
    camera = replace(CAMERA, size=(120, 160))
    T_camera_world = np.linalg.inv(camera.T_body_camera)
    x, y, z = (T_camera_world @ (10.0, 0.0, 0.0, 1.0))[:3]
    u, v, w = camera.K @ (x, y, z)
    light, _ = radiance(scene, world.lamps, camera, OVERCAST, HERE, RUN)
    redness = light[:, round(u / w), 0] / light[:, round(u / w), 2]
    rows = np.flatnonzero(redness > 3.0)
    assert abs(rows.max() + 0.5 - v / w) <= 1.0


def test_the_same_seed_gives_the_same_picture_and_another_only_other_noise() -> None:
    np.testing.assert_array_equal(picture(DAY), picture(DAY))
    other = np.abs(picture(DAY, 2).astype(int) - picture(DAY))
    assert 0 < other.max() < 40


def test_depth_is_the_distance_along_the_ray() -> None:
    world, scene = yard()
    _, depth = radiance(scene, world.lamps, CAMERA, DAY, HERE, RUN)
    R, t = CAMERA.T_body_camera[:3, :3], CAMERA.T_body_camera[:3, 3]
    for i, j in ((5, 3), (8, 20), (29, 30)):
        d = R @ np.linalg.inv(CAMERA.K) @ (j, i, 1.0)
        d /= np.linalg.norm(d)
        wall, ground = (10.0 - t[0]) / d[0], -t[2] / d[2] if d[2] < 0.0 else math.inf
        assert depth[i, j] == pytest.approx(min(wall, ground), rel=1e-5)


def test_distortion_agrees_with_that_of_opencv() -> None:
    """The foot of the wall, seen through Brown's lens, is where cv2.projectPoints puts it."""
    brown = (-0.25, 0.07, 0.002, -0.001, 0.01)
    camera = replace(CAMERA, size=(120, 160), distortion=brown)
    world, scene = yard()
    light, _ = radiance(scene, world.lamps, camera, OVERCAST, HERE, RUN)
    T_camera_world = np.linalg.inv(camera.T_body_camera)
    for y in (-6.0, -3.0, 0.0, 3.0, 6.0):
        rvec, _ = cv2.Rodrigues(T_camera_world[:3, :3])
        uv, _ = cv2.projectPoints(
            np.array([[10.0, y, 0.0]]), rvec, T_camera_world[:3, 3], camera.K, np.array(brown)
        )
        u, v = uv.reshape(2)
        redness = light[:, round(u), 0] / light[:, round(u), 2]
        assert abs(np.flatnonzero(redness > 3.0).max() + 0.5 - v) <= 1.0


def test_a_lens_that_folds_the_picture_is_refused() -> None:
    with pytest.raises(ValueError, match="folds"):
        Camera(distortion=(-1.5, 0.0, 0.0, 0.0, 0.0))


def test_night_is_darker_than_dusk_and_dusk_than_day() -> None:
    mean = [float(light_in(PRESETS[name]).mean()) for name in ("night", "dusk", "day")]
    assert mean[0] < 0.1 * mean[1] < 0.1 * mean[2]
    assert picture(NIGHT).mean() < 0.7 * picture(DAY).mean()


def test_lamps_light_the_wall_and_only_when_they_are_on() -> None:
    night = replace(NIGHT, headlights=0.0)
    on, off = (light_in(replace(night, street_lamps=power)) for power in (1.0, 0.0))
    assert on[12, 8].sum() > 5 * off[12, 8].sum()


def test_headlights_light_what_is_ahead() -> None:
    dark = replace(NIGHT, street_lamps=0.0)
    on, off = (light_in(replace(dark, headlights=power)) for power in (1.0, 0.0))
    assert on[20, 20].sum() > 20 * off[20, 20].sum()


def test_the_lamps_of_vehicles_that_drive_shine() -> None:
    night = replace(NIGHT, street_lamps=0.0)
    on, off = (
        light_in(replace(night, headlights=power), wall=Material.CAR_LIGHT) for power in (1.0, 0.0)
    )
    assert on[WALL][0] > 0.03 > 100 * off[WALL][0]


def test_the_sun_casts_shadows() -> None:
    """Behind the wall the ground is lit; before it, with the sun behind the wall, it is not."""
    ahead = replace(DAY, sun_azimuth_rad=0.0, sun_elevation_rad=0.5, cloud_cover=0.0)
    lit, dark = light_in(replace(ahead, sun_azimuth_rad=math.pi)), light_in(ahead)
    assert lit[-1, 20].sum() > 2 * dark[-1, 20].sum()


def test_the_sky_belongs_to_the_run_unless_its_seed_is_given() -> None:
    up = replace(CAMERA, pitch_down_rad=-1.0)

    def sky(cloud_seed: int | None, run_seed: int) -> np.ndarray:
        return light_in(replace(DAY, cloud_seed=cloud_seed), run_seed, camera=up)

    assert np.abs(sky(None, 5) - sky(None, 6)).max() > 0.01
    np.testing.assert_array_equal(sky(3, 5), sky(3, 6))
    assert np.abs(sky(3, 5) - sky(4, 5)).max() > 0.01


def test_fog_hides_the_wall_but_not_indoors() -> None:
    def red(indoor: bool, fog: float) -> float:
        r, _, b = light_in(replace(OVERCAST, fog_per_m=fog), indoor=indoor)[14, 20]
        return float(r / b)

    assert red(False, 0.3) < 0.5 * red(False, 0.0)
    assert red(True, 0.3) == pytest.approx(red(True, 0.0), rel=1e-5)


def test_snow_is_white_out_of_doors_and_absent_indoors() -> None:
    snow = replace(OVERCAST, snow_cover=1.0)
    bare, white = light_in(OVERCAST)[GROUND], light_in(snow)[GROUND]
    assert white.min() > 3.5 * bare.min()  # 0.82 over 0.2, and what the ground throws back
    assert white.max() < 1.3 * white.min()
    np.testing.assert_allclose(light_in(snow)[WALL] / light_in(OVERCAST)[WALL], 1.0, atol=0.5)
    np.testing.assert_array_equal(
        picture(snow, indoor=True), picture(replace(snow, snow_cover=0.0), indoor=True)
    )
    assert picture(snow)[-8:].min() > 170


def test_more_snow_covers_more_ground() -> None:
    covers = (0.0, 0.25, 0.5, 0.75, 1.0)
    share = [
        (light_in(replace(OVERCAST, snow_cover=c), ground=Material.GRASS)[22:, :, 2] > 0.2).mean()
        for c in covers
    ]
    assert share == sorted(share)
    assert share[0] == 0.0
    assert 0.1 < share[2] < 0.95
    assert share[4] == 1.0


def test_wet_ground_is_dark_near_by_and_mirrors_the_wall_farther_off() -> None:
    dry = light_in(OVERCAST, ground=Material.PAVING)
    wet = light_in(replace(OVERCAST, wetness=1.0), ground=Material.PAVING)
    assert wet[-1, 20, 1] < 0.8 * dry[-1, 20, 1]
    wet_red, dry_red = (light[20, :, 0] / light[20, :, 2] for light in (wet, dry))
    assert wet_red.mean() > 1.05 * dry_red.mean()  # just below the foot of the wall
    np.testing.assert_array_equal(
        light_in(replace(OVERCAST, wetness=1.0), indoor=True), light_in(OVERCAST, indoor=True)
    )


def test_rain_puts_drops_on_the_lens_out_of_doors_only() -> None:
    camera = replace(CAMERA, size=(60, 80))

    def changed(indoor: bool, seed: int = 1) -> np.ndarray:
        dry, rain = (
            picture(replace(DAY, rain_mm_h=rain), seed, camera=camera, indoor=indoor)
            for rain in (0.0, 40.0)
        )
        return np.abs(rain.astype(int) - dry).max(axis=2)

    assert changed(False).max() > 25
    assert np.abs(changed(False) - changed(False, 2)).max() > 25  # other drops
    assert changed(True).max() == 0


def test_leaves_turn_in_autumn() -> None:
    green = light_in(replace(OVERCAST, autumn=0.0), wall=Material.LEAF)
    gold = light_in(replace(OVERCAST, autumn=1.0), wall=Material.LEAF)
    assert np.abs(green - gold)[:14].max() > 0.02
    np.testing.assert_array_equal(green[22:], gold[22:])  # the ground does not


@pytest.mark.parametrize(("elevation_deg", "shines"), [(66.0, False), (76.0, True)])
def test_the_sun_veils_the_picture_where_it_shines_on_the_lens(
    elevation_deg: float, shines: bool
) -> None:
    """The wall ends 71 degrees up."""
    camera = replace(CAMERA, pitch_down_rad=-1.0)
    sun = replace(DAY, sun_azimuth_rad=0.0, sun_elevation_rad=math.radians(elevation_deg))
    light = spread(light_in(sun, camera=camera), camera.blur_px)
    unveiled = develop(light, meter(light, camera.sensor, 1.0), camera.sensor, 1)
    assert np.array_equal(picture(sun, camera=camera), unveiled) != shines


def test_a_still_vehicle_is_sharp_and_a_fast_one_smears_what_is_near() -> None:
    camera = replace(CAMERA, size=(120, 160), read_noise=0.0, full_well=1e7, sensitivity=8e9)
    c = replace(NIGHT, sun_elevation_rad=0.0, headlights=0.0, street_lamps=3.0)

    def sharp(motion: Motion) -> np.ndarray:
        return picture(c, camera=camera, motion=motion).astype(int)

    still = sharp(Motion())
    slow, fast = (np.abs(sharp(Motion(v)) - still).mean() for v in (3.0, 12.0))
    assert 0.0 < slow < fast


def test_a_mosaic_keeps_what_its_pixels_counted() -> None:
    plain, bayer = picture(DAY), picture(DAY, camera=replace(CAMERA, bayer="GBRG"))
    assert bayer.shape == plain.shape
    np.testing.assert_array_equal(mosaic(bayer, "GBRG"), mosaic(plain, "GBRG"))
    with pytest.raises(ValueError, match="bayer"):
        Camera(bayer="XXXX")


def test_a_capped_camera_sees_noise_alone() -> None:
    black = picture(replace(DAY, camera_fault="black"))
    assert black.max() < 60
    assert black.std() > 0.0
    assert np.any(black != picture(replace(DAY, camera_fault="black"), 2))


def test_a_dirty_lens_hides_a_part_that_belongs_to_the_run() -> None:
    dirty = replace(OVERCAST, camera_fault="occluded")

    def hidden(run_seed: int, seed: int = 1) -> np.ndarray:
        return picture(dirty, seed, run_seed=run_seed)[:, :, 1] < 40

    assert 0.1 < hidden(5).mean() < 0.8
    assert np.mean(hidden(5) ^ hidden(5, 2)) < 0.05
    assert np.mean(hidden(5) ^ hidden(6)) > 0.05


def test_a_stuck_meter_gives_a_white_picture() -> None:
    assert np.median(picture(replace(OVERCAST, camera_fault="over-exposed"))) > 235
    assert np.median(picture(OVERCAST)) < 180


def test_a_frozen_picture_is_for_the_caller_to_repeat() -> None:
    np.testing.assert_array_equal(picture(replace(DAY, camera_fault="frozen")), picture(DAY))


def test_a_camera_without_pixels_is_refused() -> None:
    with pytest.raises(ValueError, match="shows nothing"):
        Camera(size=(0, 40))


# ----------------------------------------------------------------------------------------- lidar


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


def test_points_are_in_the_body_frame() -> None:
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


def straight_at(angle_rad: float, sensor: Lidar, n: int = 4000, **changes: object) -> np.ndarray:
    """Ranges of n pulses at one point of the wall, `angle_rad` off its normal, 5 m away."""
    _, scene = yard()
    distance = 5.0 * math.cos(angle_rad)
    way = np.tile([math.cos(angle_rad), math.sin(angle_rad), 0.0], (n, 1))
    return measure(scene, (10.0 - distance, 0.0, 15.0), way, sensor, replace(DAY, **changes), 1)


def test_ranges_are_true_to_two_centimetres() -> None:
    error = straight_at(0.0, HDL_32E) - 5.0
    error = error[error > -1.0]
    assert error.std() == pytest.approx(0.02, rel=0.05)
    assert abs(error.mean()) < 0.001
    exact = straight_at(0.0, replace(HDL_32E, sigma_m=0.0))
    np.testing.assert_allclose(exact[exact > 0], 5.0, atol=1e-6)


@pytest.mark.parametrize(("angle_deg", "times"), [(60.0, 1.414), (75.5, 2.0), (88.0, 3.0)])
def test_noise_grows_with_incidence(angle_deg: float, times: float) -> None:
    ranges = straight_at(math.radians(angle_deg), replace(HDL_32E, power_half=1e-12))
    assert ranges[ranges > 0].std() == pytest.approx(0.02 * times, rel=0.06)


def test_far_slanted_ground_is_lost() -> None:
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


def test_fog_takes_returns_away_and_adds_returns_from_the_air() -> None:
    _, scene = yard()
    T = HDL_32E.T_body_lidar
    thick = replace(PRESETS["fog"], lidar_fog_per_m=0.05, lidar_scatter_per_m=0.02)
    clear = scan_ranges(scene, HDL_32E, DAY, T, 1, RUN)
    foggy = scan_ranges(scene, HDL_32E, thick, T, 1, RUN)
    far = clear > 25.0
    assert (foggy[far] > 0).mean() < 0.8
    hit = (foggy > 0) & (clear > 0)
    assert (foggy[hit] < clear[hit] - 0.2).mean() > 0.02


def test_weather_stays_out_of_doors() -> None:
    _, scene = yard(indoor=True, ground=Material.ASPHALT)
    T = HDL_32E.T_body_lidar
    foul = replace(PRESETS["fog"], rain_mm_h=50.0, wetness=1.0, snow_cover=1.0)
    np.testing.assert_array_equal(
        scan_ranges(scene, HDL_32E, foul, T, 1, RUN), scan_ranges(scene, HDL_32E, DAY, T, 1, RUN)
    )


def test_heavy_rain_answers_three_times_in_a_kilometre() -> None:
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


def returns_from_ground(ground: Material, **changes: float) -> float:
    _, scene = yard(ground=ground)
    T = HDL_32E.T_body_lidar
    weak = replace(HDL_32E, power_half=2e-4)  # so that it sees dry asphalt half the time
    behind = scan_ranges(scene, weak, replace(DAY, **changes), T, 1, RUN)[:20, :200]
    return float((behind > 0).mean())


def test_wet_ground_swallows_pulses_and_wet_lawns_do_not() -> None:
    road = [returns_from_ground(Material.ASPHALT, wetness=w) for w in (0.0, 0.5, 1.0)]
    assert road[0] > road[1] + 0.02 > road[2] + 0.04
    lawn = [returns_from_ground(Material.GRASS, wetness=w) for w in (0.0, 1.0)]
    assert lawn[1] == pytest.approx(lawn[0], abs=0.02)


def test_snow_answers_better_than_the_road_below() -> None:
    bare, white = (returns_from_ground(Material.ASPHALT, snow_cover=s) for s in (0.0, 1.0))
    assert white > bare + 0.03


def test_a_dead_sector_is_as_wide_as_it_says_and_stays_through_a_run() -> None:
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


def test_dead_beams_are_as_many_as_it_says_and_stay_through_a_run() -> None:
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


def test_a_dead_sensor_gives_no_points() -> None:
    _, scene = yard()
    points = scan(scene, VLP_16, replace(DAY, lidar_dead=True), HERE, 1, RUN)
    assert points.shape == (0, 3)
    assert points.dtype == np.float32


def test_a_scan_is_its_pulses_measured_one_by_one() -> None:
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


def test_glass_swallows_most_pulses() -> None:
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
