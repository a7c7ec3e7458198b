# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Camera and LiDAR in a yard made by hand: a level ground and one wall ten metres ahead."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from adafusion.geometry import pose_from_xyz_yaw
from adafusion.sim.camera import Camera, develop, photograph, radiance
from adafusion.sim.conditions import PRESETS, Conditions
from adafusion.sim.lidar import HDL_32E, HDL_64E, VLP_16, Lidar, ray_directions, scan, scan_ranges
from adafusion.sim.plan import Hills, WorldSpec, Zone
from adafusion.sim.scene import Scene, build_scene, build_static, outdoor_length
from adafusion.sim.shapes import Material, SoupBuilder, rectangle
from adafusion.sim.world import World

CAMERA = Camera(size=(30, 40))
HERE = np.eye(4)
DARK = (0.0, 0.0, 0.0)


def yard(*, indoor: bool = False, wall: Material = Material.PLAIN) -> tuple[World, Scene]:
    soup = SoupBuilder()
    grey = soup.add_object("ground", (0.2, 0.2, 0.2))
    soup.cap(rectangle((0.0, 0.0), 120.0, 120.0, 0.0), 0.0, Material.PLAIN, grey)
    red = soup.add_object("wall", (0.6, 0.1, 0.1))
    face = [(10.0, -50.0, 0.0), (10.0, 50.0, 0.0), (10.0, 50.0, 30.0), (10.0, -50.0, 30.0)]
    soup.quads(np.array([face]), wall, red)
    zones = (Zone((-60.0, -60.0, -1.0), (60.0, 60.0, 40.0), "hall", True, 0.01),) if indoor else ()
    lamps = np.array([[5.0, 3.0, 6.0, 0.5, 0.4, 0.3, 0.0 if indoor else -1.0, 0.0]])
    level = Hills(np.zeros((0, 4)), ())
    world = World(WorldSpec(seed=0), np.zeros((1, 2)), (), soup.build(), zones, lamps, level)
    return world, build_scene(world, build_static(world), SoupBuilder().build())


def picture(conditions: Conditions, seed: int = 1) -> np.ndarray:
    world, scene = yard()
    return photograph(scene, world.lamps, CAMERA, conditions, HERE, seed, 5)


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
    light = radiance(scene, world.lamps, camera, PRESETS["overcast"], HERE, 5)
    redness = light[:, round(u / w), 0] / light[:, round(u / w), 2]
    rows = np.flatnonzero(redness > 3.0)
    assert abs(rows.max() + 0.5 - v / w) <= 1.0


def test_the_same_seed_gives_the_same_picture_and_another_only_other_noise() -> None:
    day = PRESETS["day"]
    np.testing.assert_array_equal(picture(day), picture(day))
    other = np.abs(picture(day, 2).astype(int) - picture(day))
    assert 0 < other.max() < 40


def test_night_is_darker_than_dusk_and_dusk_than_day() -> None:
    world, scene = yard()
    mean = [
        float(radiance(scene, world.lamps, CAMERA, PRESETS[name], HERE, 5).mean())
        for name in ("night", "dusk", "day")
    ]
    assert mean[0] < 0.1 * mean[1] < 0.1 * mean[2]
    assert picture(PRESETS["night"]).mean() < 0.85 * picture(PRESETS["day"]).mean()


def test_the_dark_is_noisy() -> None:
    dim = np.full((40, 40, 3), 0.0002, np.float32)
    bright = np.full((40, 40, 3), 0.3, np.float32)
    noise = [
        develop(light, CAMERA, 3).std() / develop(light, CAMERA, 3).mean()
        for light in (dim, bright)
    ]
    assert noise[0] > 4 * noise[1]


def test_black_and_blinding_light_stay_pictures() -> None:
    assert develop(np.zeros((20, 20, 3), np.float32), CAMERA, 1).mean() < 40
    assert develop(np.full((20, 20, 3), 1e6, np.float32), CAMERA, 1).min() > 150


def test_lamps_light_the_wall_and_only_when_they_are_on() -> None:
    world, scene = yard()
    night = replace(PRESETS["night"], headlights=0.0)
    on, off = (
        radiance(scene, world.lamps, CAMERA, replace(night, street_lamps=power), HERE, 5)
        for power in (1.0, 0.0)
    )
    assert on[12, 8].sum() > 5 * off[12, 8].sum()


def test_the_sun_casts_shadows() -> None:
    """Behind the wall the ground is lit; before it, with the sun behind the wall, it is not."""
    world, scene = yard()
    ahead = replace(PRESETS["day"], sun_azimuth_rad=0.0, sun_elevation_rad=0.5, cloud_cover=0.0)
    lit = radiance(scene, world.lamps, CAMERA, replace(ahead, sun_azimuth_rad=math.pi), HERE, 5)
    dark = radiance(scene, world.lamps, CAMERA, ahead, HERE, 5)
    assert lit[-1, 20].sum() > 2 * dark[-1, 20].sum()


def test_fog_hides_the_wall_but_not_indoors() -> None:
    def red(indoor: bool, fog: float) -> float:
        world, scene = yard(indoor=indoor)
        c = replace(PRESETS["overcast"], fog_per_m=fog)
        r, _, b = radiance(scene, world.lamps, CAMERA, c, HERE, 5)[14, 20]
        return float(r / b)

    assert red(False, 0.3) < 0.5 * red(False, 0.0)
    assert red(True, 0.3) == pytest.approx(red(True, 0.0), rel=1e-5)


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
    points = scan(scene, HDL_32E, PRESETS["day"], T, 1)
    assert points.dtype == np.float32
    wall = points[points[:, 2] > 0.5]
    assert len(wall) > 500
    np.testing.assert_allclose(wall[:, 1], -9.0, atol=0.3)  # sigma grows with the slant
    near = np.hypot(points[:, 0], points[:, 1]) < 8.0
    assert abs(np.median(points[near, 2])) < 0.01
    assert points[near, 2].std() < 0.03


def test_ranges_are_true_to_two_centimetres() -> None:
    _, scene = yard()
    T = HDL_32E.T_body_lidar
    truth = scan_ranges(scene, replace(HDL_32E, sigma_m=0.0), PRESETS["day"], T, 1)
    noisy = scan_ranges(scene, HDL_32E, PRESETS["day"], T, 1)
    error = (noisy - truth)[truth > 0]
    assert error.std() == pytest.approx(0.02, rel=0.05)
    assert abs(error.mean()) < 0.001


def test_far_slanted_ground_is_lost() -> None:
    _, scene = yard()
    T = HDL_32E.T_body_lidar
    seen = scan_ranges(scene, HDL_32E, PRESETS["day"], T, 1)
    assert (seen[:8] > 0).mean() > 0.95
    assert seen.max() < HDL_32E.range_m
    behind = seen[20, :40]  # 4 degrees down: the ground is met 28 m away
    assert (seen[21:23, :40] > 0).mean() < (behind > 0).mean() + 0.05


def test_fog_takes_returns_away_and_adds_returns_from_the_air() -> None:
    _, scene = yard()
    T = HDL_32E.T_body_lidar
    thick = replace(PRESETS["fog"], lidar_fog_per_m=0.05, lidar_scatter_per_m=0.02)
    clear = scan_ranges(scene, HDL_32E, PRESETS["day"], T, 1)
    foggy = scan_ranges(scene, HDL_32E, thick, T, 1)
    far = clear > 25.0
    assert (foggy[far] > 0).mean() < 0.8
    hit = (foggy > 0) & (clear > 0)
    assert (foggy[hit] < clear[hit] - 0.2).mean() > 0.02


def test_weather_stays_out_of_doors() -> None:
    _, scene = yard(indoor=True)
    T = HDL_32E.T_body_lidar
    np.testing.assert_array_equal(
        scan_ranges(scene, HDL_32E, PRESETS["fog"], T, 1),
        scan_ranges(scene, HDL_32E, PRESETS["day"], T, 1),
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
        (scan_ranges(s, HDL_32E, PRESETS["day"], T, 1)[24:, ahead] > 0).mean()
        for s in (scene, opaque)
    ]
    assert count[0] < 0.3 < 0.9 < count[1]


def test_a_sensor_without_beams_is_refused() -> None:
    with pytest.raises(ValueError, match="0 beams"):
        Lidar(beams=0)
    with pytest.raises(ValueError, match="degrees"):
        Lidar(lowest_deg=5.0, highest_deg=-5.0)
