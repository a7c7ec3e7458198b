# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Which cell and level a point has, and where a hand-made camera sees the cells."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from adafusion.config import from_plain, to_plain
from adafusion.geometry import rotation_from_rpy
from adafusion.preprocess import Crop, Elevation, ImageSettings, Preprocess, RigCamera
from adafusion.preprocess.elevation import OUTSIDE, elevation_map, lift, rig_camera
from adafusion.preprocess.image import resize
from adafusion.sim.sensing.camera import Camera
from adafusion.types import UserError

# looks ahead from 1.5 m above the ground; 100 pixels are 45 degrees
AHEAD = [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.5], [0.0, 0.0, 0.0, 1.0]]
CALIBRATION: dict[str, Any] = {
    "K": [[100.0, 0.0, 99.5], [0.0, 100.0, 49.5], [0.0, 0.0, 1.0]],
    "T_body_camera": AHEAD,
}
SIZE = (100, 200)
CAMERA = rig_camera(CALIBRATION, SIZE)
MAP = Elevation(camera=CAMERA)


def points(*xyz: tuple[float, float, float]) -> np.ndarray:
    return np.array(xyz, np.float32).reshape(-1, 3)


def cell(x: float, y: float, settings: Elevation = MAP) -> tuple[int, int]:
    """The cell that a point on the ground falls in: filled ones lie all around it."""
    row, column = np.median(np.argwhere(elevation_map(points((x, y, 0.0)), settings)), axis=0)
    return int(row), int(column)


def one_cell(row: int, column: int, level: int, settings: Elevation = MAP) -> np.ndarray:
    grey = np.zeros((1, *settings.shape), np.uint8)
    grey[0, row, column] = level
    return grey


def seen_at(row: int, column: int, level: int, settings: Elevation = MAP, **crop: float) -> Any:
    lifted = lift(one_cell(row, column, level, settings), settings, Crop(**crop))
    return lifted[0, 1:, row, column]


def test_the_nearest_row_is_the_last_and_the_leftmost_column_the_first() -> None:
    assert cell(1.25, 1.25) == (77, 37)
    assert cell(38.75, 18.75) == (2, 2)
    assert cell(10.25, -2.25) == (59, 44)


def test_a_cell_owns_its_nearer_and_its_right_edge() -> None:
    assert cell(2.0, 1.0) == (75, 37)
    assert cell(1.99, 0.0) == (76, 39)
    assert cell(2.0, -0.01) == (75, 40)


def test_what_lies_beside_the_map_is_left_out() -> None:
    beside = points((-0.01, 0, 0), (40.0, 0, 0), (5, 20.0, 0), (5, -20.01, 0))
    assert not elevation_map(beside, MAP).any()
    assert not elevation_map(points(), MAP).any()
    assert not elevation_map(points((np.nan, 0, 0), (np.inf, 0, 0), (5, 0, np.nan)), MAP).any()


def test_a_map_of_odd_width_has_a_column_in_the_middle() -> None:
    odd = replace(MAP, shape=(5, 5), cell_m=1.0)
    assert cell(2.5, 0.4, odd) == cell(2.5, -0.4, odd) == (2, 2)
    assert seen_at(2, 2, 176, odd)[0] == pytest.approx(0.0, abs=1e-6)  # straight ahead


@pytest.mark.parametrize(
    ("z", "level"), [(-2.01, 0), (-1.999, 1), (0.01, 101), (0.03, 102), (3.09, 255), (3.11, 0)]
)
def test_a_level_is_two_centimetres(z: float, level: int) -> None:
    assert elevation_map(points((5.25, 0.25, z)), MAP)[69, 39] == level


def test_the_highest_point_below_the_top_counts() -> None:
    stacked = points((5.25, 0.25, 0.01), (5.3, 0.3, 1.01), (5.25, 0.25, 0.5), (5.25, 0.25, 4.0))
    assert elevation_map(stacked, MAP)[69, 39] == 151


def test_one_pass_fills_inner_cells_with_the_mean_of_their_neighbours() -> None:
    small = replace(MAP, shape=(5, 6), cell_m=1.0)
    # levels 101 and 104 in row 2, columns 2 and 3
    grey = elevation_map(points((2.5, 0.5, 0.01), (2.5, -0.5, 0.07)), small)
    assert grey.tolist() == [
        [0, 0, 0, 0, 0, 0],
        [0, 101, 102, 102, 104, 0],  # the mean of 101 and 104, to the even one
        [0, 101, 101, 104, 104, 0],
        [0, 101, 102, 102, 104, 0],
        [0, 0, 0, 0, 0, 0],
    ]


def test_a_cell_is_seen_where_its_middle_is() -> None:
    # (59, 35): 10.25 m ahead, 2.25 m to the left; level 101: 0.01 m, 1.49 m below the camera
    x, y = seen_at(59, 35, 101)
    assert x == pytest.approx(-2.25 / 10.25, abs=1e-6)  # 100 pixels either side of the axis
    assert y == pytest.approx(2 * 1.49 / 10.25, abs=1e-6)  # 50 above it and below


def test_a_crop_moves_what_is_seen() -> None:
    below_axis_px = 100 * 1.49 / 10.25
    x, y = seen_at(59, 35, 101, top=0.2, bottom=0.3, left=0.25)
    assert y == pytest.approx(2 * (50 + below_axis_px - 20) / 50 - 1, abs=1e-6)
    assert x == pytest.approx(2 * (100 - 100 * 2.25 / 10.25 - 50) / 150 - 1, abs=1e-6)
    assert seen_at(59, 35, 101, top=0.7).tolist() == [OUTSIDE, OUTSIDE]


def test_it_is_seen_where_the_resized_image_has_it() -> None:
    crop = Crop(top=0.2, bottom=0.1, left=0.1)
    image = np.zeros((*SIZE, 3), np.uint8)
    u, v = 99.5 - 100 * 2.25 / 10.25, 49.5 + 100 * 1.49 / 10.25
    image[round(v), round(u)] = 255
    small = resize(image, ImageSettings(size=(35, 90), crop=crop))[..., 0]
    row, column = np.unravel_index(int(small.argmax()), small.shape)
    x, y = lift(one_cell(59, 35, 101), MAP, crop)[0, 1:, 59, 35]
    assert (int((y + 1) / 2 * 35), int((x + 1) / 2 * 90)) == (row, column)


def test_heights_come_as_shares_and_empty_cells_as_nothing() -> None:
    lifted = lift(one_cell(59, 35, 102), MAP, Crop())
    assert lifted.shape == (1, 3, 80, 80)
    assert lifted.dtype == np.float32
    assert lifted[0, 0, 59, 35] == pytest.approx(102 / 255)
    lifted[0, :, 59, 35] = 0.0, OUTSIDE, OUTSIDE
    assert not lifted[:, 0].any()
    assert (lifted[:, 1:] == OUTSIDE).all()


def test_what_the_camera_does_not_see_is_outside() -> None:
    assert seen_at(75, 5, 101).tolist() == [OUTSIDE, OUTSIDE]  # far to the left
    assert seen_at(78, 39, 101).tolist() == [OUTSIDE, OUTSIDE]  # below the image's edge
    T = np.array(AHEAD)
    T[0, 3] = 12.0
    forward = replace(MAP, camera=rig_camera({**CALIBRATION, "T_body_camera": T}, SIZE))
    assert seen_at(59, 35, 101, forward).tolist() == [OUTSIDE, OUTSIDE]  # behind
    assert seen_at(39, 39, 101, forward)[0] == pytest.approx(-0.25 / 8.25, abs=1e-6)


def test_a_cell_too_low_keeps_its_height_and_is_not_seen() -> None:
    # level 26 is -1.49 m, 2.99 m below the camera; level 25 is -1.51 m
    assert seen_at(59, 35, 26)[1] == pytest.approx(2 * 2.99 / 10.25, abs=1e-6)
    lifted = lift(one_cell(59, 35, 25), MAP, Crop())[0, :, 59, 35]
    assert lifted.tolist() == pytest.approx([25 / 255, OUTSIDE, OUTSIDE])
    assert seen_at(59, 35, 25, replace(MAP, seen_from_m=-2.0))[0] != OUTSIDE


def test_a_lens_bends_what_is_seen() -> None:
    bent = rig_camera({**CALIBRATION, "distortion": [-0.2, 0.05, 0.0, 0.0, 0.0]}, SIZE)
    x, y = seen_at(59, 35, 101, replace(MAP, camera=bent))
    u, v = -2.25 / 10.25, 1.49 / 10.25
    r2 = u * u + v * v
    factor = 1 - 0.2 * r2 + 0.05 * r2 * r2
    assert (x, y) == pytest.approx((u * factor, 2 * v * factor), abs=1e-6)


def test_a_lens_that_folds_back_puts_nothing_from_the_side_into_the_picture() -> None:
    # r (1 - 0.3 r^2) turns at r = 1.054; the cell lies at r = 1.75 and would come to r = 0.14
    folding = rig_camera({**CALIBRATION, "distortion": [-0.3, 0.0, 0.0, 0.0]}, SIZE)
    settings = replace(MAP, camera=folding)
    row, column = 79 - 8, 39 - 14  # 4.25 m ahead, 7.25 m to the left
    assert seen_at(row, column, 101, settings).tolist() == [OUTSIDE, OUTSIDE]
    assert seen_at(row, 39 - 4, 101, settings)[0] != OUTSIDE


def test_a_map_without_a_camera_is_not_lifted() -> None:
    with pytest.raises(ValueError, match="camera"):
        lift(one_cell(0, 0, 1), Elevation(), Crop())


def test_the_preprocessing_of_a_cloud_is_map_and_lift() -> None:
    settings = Preprocess(lidar="elevation", elevation=MAP)
    cloud = points((10.25, 2.25, 0.01), (39.9, -3.0, 2.0))
    tensor = settings.lidar_tensor(cloud)
    assert tuple(tensor.shape) == settings.lidar_shape == (3, 80, 80)
    assert np.array_equal(tensor, lift(elevation_map(cloud, MAP)[None], MAP, Crop())[0])
    assert tensor[:, 59, 35].tolist() == pytest.approx(
        [101 / 255, -2.25 / 10.25, 2 * 1.49 / 10.25], abs=1e-6
    )


def test_settings_with_a_camera_survive_a_file() -> None:
    settings = Preprocess(lidar="elevation", elevation=MAP)
    again = from_plain(Preprocess, to_plain(settings))
    assert again == settings
    assert hash(again) == hash(settings)
    assert again.fingerprint == settings.fingerprint
    assert from_plain(Preprocess, to_plain(Preprocess())) == Preprocess()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"K": [[100.0, 0.5, 99.5], [0.0, 100.0, 49.5], [0.0, 0.0, 1.0]]}, "K"),
        ({"K": np.eye(4)}, "3x3"),
        ({"T_body_camera": np.diag([2.0, 1.0, 1.0, 1.0])}, "rigid"),
        ({"distortion": [0.1, 0.2]}, "k1"),
        ({"distortion": 0.1}, "float"),
    ],
)
def test_a_calibration_of_no_camera_is_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        rig_camera({**CALIBRATION, **changes}, SIZE)


@pytest.mark.parametrize("key", ["K", "T_body_camera"])
def test_a_calibration_that_lacks_something_names_it_and_the_remedy(key: str) -> None:
    lacking = {name: value for name, value in CALIBRATION.items() if name != key}
    with pytest.raises(UserError, match=rf"no {key}.*model\.preprocess\.elevation\.camera"):
        rig_camera(lacking, SIZE)
    with pytest.raises(UserError, match=rf"run night has no {key}"):
        rig_camera({"day": CALIBRATION, "night": lacking}, SIZE)
    with pytest.raises(UserError, match="no K and no T_body_camera"):
        rig_camera({}, SIZE)


def moved(*, K: float = 0.0, t: float = 0.0, yaw: float = 0.0) -> dict[str, Any]:
    changed = np.array(CALIBRATION["K"]), np.array(AHEAD)
    changed[0][0, 2] += K
    changed[1][:3, :3] = rotation_from_rpy(0.0, 0.0, yaw) @ changed[1][:3, :3]
    changed[1][1, 3] += t
    return {**CALIBRATION, "K": changed[0].tolist(), "T_body_camera": changed[1].tolist()}


def test_runs_that_hardly_differ_have_one_camera() -> None:
    near = moved(K=0.3, t=0.005, yaw=0.001)
    assert rig_camera({"a": CALIBRATION, "b": near, "c": CALIBRATION}, SIZE) == CAMERA


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (moved(K=1.5), r"by 1\.5 pixels and 0\.0 cm"),
        (moved(t=0.02), r"by 0\.0 pixels and 2\.0 cm"),
        (moved(yaw=math.radians(1)), r"by 3\.6 pixels and 0\.0 cm"),
        (moved(yaw=math.pi), r"by inf pixels"),
        ({**CALIBRATION, "distortion": [-0.2, 0.0, 0.0, 0.0, 0.0]}, r"by \d+\.\d pixels"),
    ],
)
def test_runs_of_different_cameras_are_refused(other: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=f"run a and run b differ, {said}.*one camera alone"):
        rig_camera({"a": CALIBRATION, "b": other}, SIZE)


def test_the_synthetic_world_s_camera_is_one() -> None:
    camera = Camera()
    calibration = {
        "K": camera.K.tolist(),
        "distortion": list(camera.distortion),
        "T_body_camera": camera.T_body_camera.tolist(),
        "T_body_lidar": np.eye(4).tolist(),
    }
    rig = rig_camera(calibration, camera.size)
    assert rig.distortion == ()
    assert rig == RigCamera(K=rig.K, T_body_camera=rig.T_body_camera, size=camera.size)
    lifted = lift(np.full((1, 80, 80), 101, np.uint8), Elevation(camera=rig), Crop())
    seen = (np.abs(lifted[0, 1:]) <= 1).all(axis=0)
    assert 0.3 < seen.mean() < 0.9  # of a wide square ahead, by a camera 70 degrees wide
    assert seen[:70, 39:41].all()
