# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The synthetic world goes out in NCLT's layout and comes back as it was."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from adafusion.datasets import Dataset
from adafusion.datasets.recording import write_recording
from adafusion.geometry import pose, transform
from adafusion.readers.nclt.reader import read
from adafusion.sim.exports import export
from adafusion.sim.exports.nclt import ladybug, velodyne
from adafusion.sim.exports.pictures import shrinkage
from adafusion.sim.numeric import keyed_seed
from adafusion.sim.run.route import pose_along
from adafusion.sim.sensing.lidar import ray_directions, scan_ranges
from adafusion.sim.studio import PROFILES, Studio, make_job

SEED, RUNS, PLACES = 3, ["day", "night"], 4


@pytest.fixture(scope="module")
def studio() -> Studio:
    profile = PROFILES["tiny"]
    return Studio(
        make_job(SEED, RUNS, "tiny", PLACES),
        camera=ladybug(shrinkage(1616, profile.camera.size[1])),
        lidar=velodyne(profile.lidar.steps),
    )


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("nclt") / "raw"
    return export("nclt", out, seed=SEED, runs=RUNS, profile="tiny", places=PLACES)


@pytest.fixture(scope="module")
def dataset(exported: Path) -> Dataset:
    recording = read(exported, every_m=0.0)
    out = exported.parent / "prepared"
    dataset = write_recording(recording, out).dataset
    assert all("hold no pose" in note for note in recording.notes)  # the track begins with NaN
    return dataset


def test_every_frame_comes_back(dataset: Dataset, studio: Studio) -> None:
    assert dataset.runs == ("day", "night")
    assert dataset.info.synthetic
    for run in RUNS:
        frames = [frame for frame in dataset.frames if frame.run == run]
        pictures = [frame.image_time_us or frame.timestamp_us for frame in frames]
        assert pictures == studio.drive(run).timestamp_us.tolist()


def test_poses_are_those_at_the_times_of_the_scans(dataset: Dataset, studio: Studio) -> None:
    for run in RUNS:
        frames = [frame for frame in dataset.frames if frame.run == run]
        at = np.array([frame.timestamp_us for frame in frames])
        expected = pose_along(studio.world, studio.drive(run), at)
        # tables have six digits; turns are straight between their rows
        np.testing.assert_allclose([f.T_world_body for f in frames], expected, rtol=0, atol=2e-5)
        np.testing.assert_allclose(
            [f.position_m for f in frames], expected[:, :3, 3], rtol=0, atol=1e-6
        )


def test_what_the_ins_said_is_near_what_it_said(dataset: Dataset, studio: Studio) -> None:
    """The world's sphere and NCLT's ellipsoid differ by some 0.2 % of the way from the origin."""
    for run in RUNS:
        drive = studio.drive(run)
        frames = [frame for frame in dataset.frames if frame.run == run]
        for k, frame in enumerate(frames):
            if frame.T_world_ins is None:
                continue  # before the first fix or after the last
            T = drive.T_world_ins[k]
            far_m = np.linalg.norm(T[:3, 3])
            assert np.linalg.norm(frame.T_world_ins[:3, 3] - T[:3, 3]) < 0.3 + 0.003 * far_m
            np.testing.assert_allclose(frame.T_world_ins[:3, :3], T[:3, :3], atol=0.02)
        assert sum(frame.T_world_ins is not None for frame in frames) >= len(frames) - 2


def test_points_are_those_that_the_laser_hit(dataset: Dataset, studio: Studio) -> None:
    T_body_lidar = pose(np.eye(3), (0.002, 0.004, 0.957))
    for run in RUNS:
        frame = next(frame for frame in dataset.frames if frame.run == run)
        utime = frame.timestamp_us
        T = pose_along(studio.world, studio.drive(run), np.array([utime]))[0]
        ranges = scan_ranges(
            studio.scene_at(run, utime, T),
            studio.lidar,
            studio.conditions[run],
            studio.lifted(run, T) @ T_body_lidar,
            keyed_seed(SEED, "run", run, "velodyne", utime),
            studio.run_seed(run),
        )
        hit = ranges > 0.0
        traced = transform(T_body_lidar, ray_directions(studio.lidar)[hit] * ranges[hit][:, None])
        points = dataset.load(frame).points_body
        assert points is not None
        assert len(points) == len(traced)
        distance_m, _ = cKDTree(traced).query(points)
        assert distance_m.max() < 0.0025 * np.sqrt(3.0) + 1e-4  # steps of 5 mm along each axis


def test_pictures_are_the_upright_ones_undistorted(dataset: Dataset, studio: Studio) -> None:
    camera = studio.camera
    K = np.array(dataset.info.calibration["K"])
    np.testing.assert_allclose(K, camera.K, atol=1e-9)
    np.testing.assert_allclose(
        dataset.info.calibration["T_body_camera"], camera.T_body_camera, atol=1e-9
    )
    frame = next(frame for frame in dataset.frames if frame.run == "day")
    image = dataset.load(frame).image
    assert image is not None
    expected = cv2.undistort(studio.image("day", 0), camera.K, np.array(camera.distortion))
    assert image.shape == expected.shape
    # the map has six digits and the remapping steps of 1/32 pixel
    apart = np.abs(image.astype(int) - expected.astype(int))
    assert apart.mean() < 0.5
    assert np.percentile(apart, 99) < 8


def test_frames_every_so_many_metres(exported: Path) -> None:
    recording = read(exported, every_m=25.0)
    for run in RUNS:
        at = [shot.frame.position_m for shot in read(exported, runs=[run], every_m=25.0).shots]
        steps_m = np.linalg.norm(np.diff(np.array(at), axis=0), axis=1)
        assert (steps_m >= 25.0).all()
    assert recording.total is not None
    assert 2 <= recording.total < 2 * PLACES
