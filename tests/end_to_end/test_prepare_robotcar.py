# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""From the synthetic world in RobotCar's layout back to what the vehicle saw where it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import convolve, map_coordinates

from adafusion.datasets.native import Dataset
from adafusion.datasets.recording import write_recording
from adafusion.geometry import invert, transform
from adafusion.readers import robotcar
from adafusion.sim.exports import export
from adafusion.sim.exports.pictures import shrinkage, undistortion
from adafusion.sim.exports.pushbroom import LMS_FRONT, Sweep, lift, mounting
from adafusion.sim.exports.robotcar import WIDTH, bumblebee
from adafusion.sim.run.route import pose_along
from adafusion.sim.sensing.sensor import mosaic
from adafusion.sim.studio import PROFILES, Studio, make_job

WISHES = {"seed": 3, "runs": ["day", "night"], "profile": "tiny", "places": 4}


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export("robotcar", tmp_path_factory.mktemp("robotcar") / "world", **WISHES)


@pytest.fixture(scope="module")
def prepared(exported: Path) -> Dataset:
    recording = robotcar.read(exported, every_m=5.0)
    written = write_recording(recording, exported.parent / "prepared")
    assert len(written.dataset.frames) == recording.total
    return written.dataset


@pytest.fixture(scope="module")
def studio() -> Studio:
    camera = bumblebee(shrinkage(WIDTH, PROFILES["tiny"].camera.size[1]))
    return Studio(make_job(**WISHES), camera=camera)


@pytest.fixture(scope="module")
def T_native_body(prepared: Dataset, studio: Studio) -> np.ndarray:
    """Our body frame on the world's vehicle: another height, and further to the front."""
    T_body_camera = np.array(prepared.info.calibration["T_body_camera"])
    return studio.camera.T_body_camera @ invert(T_body_camera)


def test_it_is_recognised(exported: Path) -> None:
    assert robotcar.recognises(exported)


def test_what_is_written_opens_as_a_synthetic_dataset(prepared: Dataset) -> None:
    assert prepared.info.synthetic
    assert prepared.runs == ("day", "night")
    assert len(prepared.frames) >= 5
    assert all(frame.image and frame.cloud for frame in prepared.frames)


def test_the_body_stands_on_the_ground(prepared: Dataset, T_native_body: np.ndarray) -> None:
    # springs and slopes of some 50 m of road leave a few milliradians
    assert abs(T_native_body[2, 0]) < 0.01
    assert T_native_body[2, 3] == pytest.approx(0.08, abs=0.01)  # 1.6 m against 1.52 m
    np.testing.assert_allclose(T_native_body[:2, 3], (0.4, 0.0), atol=0.02)


def test_poses_are_those_of_the_drive(
    prepared: Dataset, studio: Studio, T_native_body: np.ndarray
) -> None:
    for frame in prepared.frames:
        way = studio.drive(frame.run)
        true = pose_along(studio.world, way, np.array([frame.timestamp_us]))[0] @ T_native_body
        # poses have 6 decimals, and between two of them the springs bend the way
        np.testing.assert_allclose(frame.T_world_body[:3, 3], true[:3, 3], atol=1e-4)
        np.testing.assert_allclose(frame.T_world_body[:3, :3], true[:3, :3], atol=1e-4)
        k = way.timestamp_us.tolist().index(frame.timestamp_us)
        ins = way.T_world_ins[k] @ T_native_body
        # the unit's error turns a corner at each frame of the drive, amid two rows
        np.testing.assert_allclose(frame.T_world_ins, ins, atol=1e-3)


def test_points_are_the_fans_where_they_were_traced(prepared: Dataset, studio: Studio) -> None:
    for frame in {frame.run: frame for frame in prepared.frames}.values():
        sweep = Sweep(studio, frame.run)
        points = transform(frame.T_world_body, prepared.load(frame).points_body.astype(float))
        first = int(np.searchsorted(sweep.time_us, frame.timestamp_us))
        last, count, fans = first, 0, []
        while count < len(points):
            fans.append(
                transform(sweep.T_world_body[last] @ mounting(LMS_FRONT), lift(sweep.scan(last)))
            )
            count, last = count + len(fans[-1]), last + 1
        # whole fans of 20 m: the ones before and after the end are at most 10 cm from it
        assert sweep.driven_m[last - 1] - sweep.driven_m[first] == pytest.approx(20.0, abs=0.1)
        # tables have 6 decimals of a metre and of a radian, 50 m away; float32 adds 2e-6 m
        np.testing.assert_allclose(points, np.concatenate(fans), atol=1e-4)


def test_images_are_the_cameras_without_its_distortion(prepared: Dataset, studio: Studio) -> None:
    for frame in prepared.frames:
        k = studio.drive(frame.run).timestamp_us.tolist().index(frame.timestamp_us)
        picture = studio.image(frame.run, k)
        # the development kit's way, slowly: bilinear colours, then bilinear in float
        colour = bilinear_colours(mosaic(picture, "GBRG"))
        column, row = np.moveaxis(undistortion(studio.camera), -1, 0)
        expected = np.stack(
            [map_coordinates(channel, [row, column], order=1) for channel in colour], axis=-1
        )
        image = prepared.load(frame).image.astype(float)
        inside = (slice(4, -4), slice(4, -4))  # at the rim colours are copied
        apart = np.abs(image - expected)[inside]
        # both round, and OpenCV looks up in steps of 1/32 pixel: a few levels across an edge
        assert np.quantile(apart, 0.99) <= 3.0
        assert apart.max() <= 255 / 32 + 2.0


def bilinear_colours(raw: np.ndarray) -> list[np.ndarray]:
    """Red, green and blue of a GBRG mosaic, each the mean of its nearest pixels."""
    cross = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4.0
    square = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4.0
    row, column = np.indices(raw.shape) % 2
    where = ((row == 1) & (column == 0), row == column, (row == 0) & (column == 1))
    kernels = (square, cross, square)
    return [
        convolve(np.where(there, raw, 0).astype(float), kernel, mode="mirror")
        for there, kernel in zip(where, kernels, strict=True)
    ]
