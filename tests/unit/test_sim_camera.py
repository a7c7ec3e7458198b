# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The camera in a yard made by hand: a level ground and one wall ten metres ahead."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from adafusion.sim.run.conditions import PRESETS, Conditions
from adafusion.sim.sensing.camera import Camera, photograph, radiance
from adafusion.sim.sensing.lens import STILL, Motion, spread
from adafusion.sim.sensing.sensor import develop, meter, mosaic
from adafusion.sim.town.shapes import Material

CAMERA = Camera(size=(30, 40))
HERE = np.eye(4)
DAY, OVERCAST, NIGHT = PRESETS["day"], PRESETS["overcast"], PRESETS["night"]
RUN = 5  # seed of the run
GROUND, WALL = (-2, 20), (8, 20)  # pixels


@pytest.fixture
def picture(yard):
    """Take a picture of the yard."""

    def take(
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

    return take


@pytest.fixture
def light_in(yard):
    """The light that reaches the camera in the yard."""

    def look(
        conditions: Conditions, run_seed: int = RUN, *, camera: Camera = CAMERA, **kind: object
    ) -> np.ndarray:
        world, scene = yard(**kind)
        return radiance(scene, world.lamps, camera, conditions, HERE, run_seed)[0]

    return look


def test_the_camera_looks_forward_with_x_right_and_y_down() -> None:
    camera = Camera(size=(30, 40), pitch_down_rad=0.0)
    R = camera.T_body_camera[:3, :3]
    np.testing.assert_allclose(R, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)
    assert np.linalg.det(Camera().T_body_camera[:3, :3]) == pytest.approx(1.0)


def test_the_picture_agrees_with_its_calibration(yard) -> None:
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


def test_the_same_seed_gives_the_same_picture_and_another_only_other_noise(picture) -> None:
    np.testing.assert_array_equal(picture(DAY), picture(DAY))
    other = np.abs(picture(DAY, 2).astype(int) - picture(DAY))
    assert 0 < other.max() < 40


def test_depth_is_the_distance_along_the_ray(yard) -> None:
    world, scene = yard()
    _, depth = radiance(scene, world.lamps, CAMERA, DAY, HERE, RUN)
    R, t = CAMERA.T_body_camera[:3, :3], CAMERA.T_body_camera[:3, 3]
    for i, j in ((5, 3), (8, 20), (29, 30)):
        d = R @ np.linalg.inv(CAMERA.K) @ (j, i, 1.0)
        d /= np.linalg.norm(d)
        wall, ground = (10.0 - t[0]) / d[0], -t[2] / d[2] if d[2] < 0.0 else math.inf
        assert depth[i, j] == pytest.approx(min(wall, ground), rel=1e-5)


def test_distortion_agrees_with_that_of_opencv(yard) -> None:
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


def test_night_is_darker_than_dusk_and_dusk_than_day(picture, light_in) -> None:
    mean = [float(light_in(PRESETS[name]).mean()) for name in ("night", "dusk", "day")]
    assert mean[0] < 0.1 * mean[1] < 0.1 * mean[2]
    assert picture(NIGHT).mean() < 0.7 * picture(DAY).mean()


def test_lamps_light_the_wall_and_only_when_they_are_on(light_in) -> None:
    night = replace(NIGHT, headlights=0.0)
    on, off = (light_in(replace(night, street_lamps=power)) for power in (1.0, 0.0))
    assert on[12, 8].sum() > 5 * off[12, 8].sum()


def test_headlights_light_what_is_ahead(light_in) -> None:
    dark = replace(NIGHT, street_lamps=0.0)
    on, off = (light_in(replace(dark, headlights=power)) for power in (1.0, 0.0))
    assert on[20, 20].sum() > 20 * off[20, 20].sum()


def test_the_lamps_of_vehicles_that_drive_shine(light_in) -> None:
    night = replace(NIGHT, street_lamps=0.0)
    on, off = (
        light_in(replace(night, headlights=power), wall=Material.CAR_LIGHT) for power in (1.0, 0.0)
    )
    assert on[WALL][0] > 0.03 > 100 * off[WALL][0]


def test_the_sun_casts_shadows(light_in) -> None:
    """Behind the wall the ground is lit; before it, with the sun behind the wall, it is not."""
    ahead = replace(DAY, sun_azimuth_rad=0.0, sun_elevation_rad=0.5, cloud_cover=0.0)
    lit, dark = light_in(replace(ahead, sun_azimuth_rad=math.pi)), light_in(ahead)
    assert lit[-1, 20].sum() > 2 * dark[-1, 20].sum()


def test_the_sky_belongs_to_the_run_unless_its_seed_is_given(light_in) -> None:
    up = replace(CAMERA, pitch_down_rad=-1.0)

    def sky(cloud_seed: int | None, run_seed: int) -> np.ndarray:
        return light_in(replace(DAY, cloud_seed=cloud_seed), run_seed, camera=up)

    assert np.abs(sky(None, 5) - sky(None, 6)).max() > 0.01
    np.testing.assert_array_equal(sky(3, 5), sky(3, 6))
    assert np.abs(sky(3, 5) - sky(4, 5)).max() > 0.01


def test_fog_hides_the_wall_but_not_indoors(light_in) -> None:
    def red(indoor: bool, fog: float) -> float:
        r, _, b = light_in(replace(OVERCAST, fog_per_m=fog), indoor=indoor)[14, 20]
        return float(r / b)

    assert red(False, 0.3) < 0.5 * red(False, 0.0)
    assert red(True, 0.3) == pytest.approx(red(True, 0.0), rel=1e-5)


def test_snow_is_white_out_of_doors_and_absent_indoors(picture, light_in) -> None:
    snow = replace(OVERCAST, snow_cover=1.0)
    bare, white = light_in(OVERCAST)[GROUND], light_in(snow)[GROUND]
    assert white.min() > 3.5 * bare.min()  # 0.82 over 0.2, and what the ground throws back
    assert white.max() < 1.3 * white.min()
    np.testing.assert_allclose(light_in(snow)[WALL] / light_in(OVERCAST)[WALL], 1.0, atol=0.5)
    np.testing.assert_array_equal(
        picture(snow, indoor=True), picture(replace(snow, snow_cover=0.0), indoor=True)
    )
    assert picture(snow)[-8:].min() > 170


def test_more_snow_covers_more_ground(light_in) -> None:
    covers = (0.0, 0.25, 0.5, 0.75, 1.0)
    share = [
        (light_in(replace(OVERCAST, snow_cover=c), ground=Material.GRASS)[22:, :, 2] > 0.2).mean()
        for c in covers
    ]
    assert share == sorted(share)
    assert share[0] == 0.0
    assert 0.1 < share[2] < 0.95
    assert share[4] == 1.0


def test_wet_ground_is_dark_near_by_and_mirrors_the_wall_farther_off(light_in) -> None:
    dry = light_in(OVERCAST, ground=Material.PAVING)
    wet = light_in(replace(OVERCAST, wetness=1.0), ground=Material.PAVING)
    assert wet[-1, 20, 1] < 0.8 * dry[-1, 20, 1]
    wet_red, dry_red = (light[20, :, 0] / light[20, :, 2] for light in (wet, dry))
    assert wet_red.mean() > 1.05 * dry_red.mean()  # just below the foot of the wall
    np.testing.assert_array_equal(
        light_in(replace(OVERCAST, wetness=1.0), indoor=True), light_in(OVERCAST, indoor=True)
    )


def test_rain_puts_drops_on_the_lens_out_of_doors_only(picture) -> None:
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


def test_leaves_turn_in_autumn(light_in) -> None:
    green = light_in(replace(OVERCAST, autumn=0.0), wall=Material.LEAF)
    gold = light_in(replace(OVERCAST, autumn=1.0), wall=Material.LEAF)
    assert np.abs(green - gold)[:14].max() > 0.02
    np.testing.assert_array_equal(green[22:], gold[22:])  # the ground does not


@pytest.mark.parametrize(("elevation_deg", "shines"), [(66.0, False), (76.0, True)])
def test_the_sun_veils_the_picture_where_it_shines_on_the_lens(
    picture, light_in, elevation_deg: float, shines: bool
) -> None:
    """The wall ends 71 degrees up."""
    camera = replace(CAMERA, pitch_down_rad=-1.0)
    sun = replace(DAY, sun_azimuth_rad=0.0, sun_elevation_rad=math.radians(elevation_deg))
    light = spread(light_in(sun, camera=camera), camera.blur_px)
    unveiled = develop(light, meter(light, camera.sensor, 1.0), camera.sensor, 1)
    assert np.array_equal(picture(sun, camera=camera), unveiled) != shines


def test_a_still_vehicle_is_sharp_and_a_fast_one_smears_what_is_near(picture) -> None:
    camera = replace(CAMERA, size=(120, 160), read_noise=0.0, full_well=1e7, sensitivity=8e9)
    c = replace(NIGHT, sun_elevation_rad=0.0, headlights=0.0, street_lamps=3.0)

    def sharp(motion: Motion) -> np.ndarray:
        return picture(c, camera=camera, motion=motion).astype(int)

    still = sharp(Motion())
    slow, fast = (np.abs(sharp(Motion(v)) - still).mean() for v in (3.0, 12.0))
    assert 0.0 < slow < fast


def test_a_mosaic_keeps_what_its_pixels_counted(picture) -> None:
    plain, bayer = picture(DAY), picture(DAY, camera=replace(CAMERA, bayer="GBRG"))
    assert bayer.shape == plain.shape
    np.testing.assert_array_equal(mosaic(bayer, "GBRG"), mosaic(plain, "GBRG"))
    with pytest.raises(ValueError, match="bayer"):
        Camera(bayer="XXXX")


def test_a_capped_camera_sees_noise_alone(picture) -> None:
    black = picture(replace(DAY, camera_fault="black"))
    assert black.max() < 60
    assert black.std() > 0.0
    assert np.any(black != picture(replace(DAY, camera_fault="black"), 2))


def test_a_dirty_lens_hides_a_part_that_belongs_to_the_run(picture) -> None:
    dirty = replace(OVERCAST, camera_fault="occluded")

    def hidden(run_seed: int, seed: int = 1) -> np.ndarray:
        return picture(dirty, seed, run_seed=run_seed)[:, :, 1] < 40

    assert 0.1 < hidden(5).mean() < 0.8
    assert np.mean(hidden(5) ^ hidden(5, 2)) < 0.05
    assert np.mean(hidden(5) ^ hidden(6)) > 0.05


def test_a_stuck_meter_gives_a_white_picture(picture) -> None:
    assert np.median(picture(replace(OVERCAST, camera_fault="over-exposed"))) > 235
    assert np.median(picture(OVERCAST)) < 180


def test_a_frozen_picture_is_for_the_caller_to_repeat(picture) -> None:
    np.testing.assert_array_equal(picture(replace(DAY, camera_fault="frozen")), picture(DAY))


def test_a_camera_without_pixels_is_refused() -> None:
    with pytest.raises(ValueError, match="shows nothing"):
        Camera(size=(0, 40))
