# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The KITTI reader on true bytes: frames 0, 2, ..., 40 of sequence 04."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from adafusion.datasets import Dataset
from adafusion.datasets.recording import write_recording
from adafusion.geometry import invert, pose, rotation_from_rpy, transform
from adafusion.readers.kitti_odometry import read
from adafusion.types import Observation, UserError


@pytest.fixture(scope="module")
def src(real_data: Path) -> Path:
    return real_data / "kitti_odometry"


def prepare(src: Path, out: Path) -> Dataset:
    return write_recording(read(src), out).dataset


@pytest.fixture(scope="module")
def dataset(src: Path, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return prepare(src, tmp_path_factory.mktemp("kitti") / "out")


def test_every_frame_is_there_with_both_sensors(dataset: Dataset, src: Path) -> None:
    assert len(dataset.frames) == 21
    names = sorted(path.name for path in (src / "sequences/04/image_2").iterdir())
    for frame, name in zip(dataset.frames, names, strict=True):
        seen = dataset.load(frame)
        assert frame.image is not None
        assert seen.image is not None
        assert seen.points_body is not None
        assert seen.image.shape == (370, 1226, 3)
        assert 115_000 < len(seen.points_body) < 130_000
        original = src / "sequences/04/image_2" / name
        assert (dataset.root / frame.image).read_bytes() == original.read_bytes()


def test_the_route_is_as_long_as_the_cameras(dataset: Dataset, src: Path) -> None:
    travelled = np.loadtxt(src / "poses/04.txt")[:41:2, [3, 7, 11]]
    steps = np.linalg.norm(np.diff(dataset.positions_m, axis=0), axis=1)
    np.testing.assert_allclose(steps, np.linalg.norm(np.diff(travelled, axis=0), axis=1), atol=0.02)
    heading = dataset.positions_m[-1] / np.linalg.norm(dataset.positions_m[-1])
    np.testing.assert_allclose(heading, [1.0, 0.0, 0.0], atol=0.02)  # a straight street, ahead


def test_the_ground_lies_at_zero(dataset: Dataset) -> None:
    for frame in dataset.frames:
        points = cloud_of(dataset.load(frame))
        ahead = points[(points[:, 0] > 5) & (points[:, 0] < 15) & (np.abs(points[:, 1]) < 3)]
        assert abs(np.median(ahead[:, 2])) < 0.15


def test_the_cloud_fits_the_picture_best_as_calibrated(dataset: Dataset) -> None:
    """Points where the range jumps fall on edges of the picture, unless the cloud is turned."""
    calibration = {name: np.array(T) for name, T in dataset.info.calibration["04"].items()}
    T_camera_body = invert(calibration["T_body_camera"])

    def edge_strength(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> float:
        turn = pose(rotation_from_rpy(*np.deg2rad([roll, pitch, yaw])), (0.0, 0.0, 0.0))
        T_camera_lidar = T_camera_body @ calibration["T_body_lidar"] @ turn
        T_camera_turned = T_camera_lidar @ invert(calibration["T_body_lidar"])
        strengths = [
            strength_at(edges, project(calibration["K"], transform(T_camera_turned, jumps)))
            for edges, jumps in seen
        ]
        return float(np.mean(strengths))

    seen = [
        (picture_edges(observation), range_jumps(cloud_of(observation)))
        for observation in map(dataset.load, dataset.frames[::4])
    ]
    calibrated = edge_strength()
    for degrees in (-1.0, 1.0):
        assert calibrated > 1.5 * edge_strength(yaw=degrees)
        assert calibrated > 1.1 * edge_strength(pitch=degrees)


def test_clouds_of_the_drive_agree_in_the_world(dataset: Dataset) -> None:
    """What stands between two frames 13 m apart lies on itself, and 1 m off it does not."""
    frames = dataset.frames[5], dataset.frames[10]
    middle = np.mean([frame.position_m for frame in frames], axis=0)
    standing = []
    for frame in frames:
        assert frame.T_world_body is not None
        points = transform(frame.T_world_body, cloud_of(dataset.load(frame)).astype(np.float64))
        near = np.linalg.norm(points[:, :2] - middle[:2], axis=1) < 15.0
        standing.append(points[near & (points[:, 2] - middle[2] > 0.5)])
    tree = cKDTree(standing[0])

    def gap(ahead_m: float) -> float:
        return float(np.median(tree.query(standing[1] + [ahead_m, 0.0, 0.0])[0]))

    assert gap(0.0) < 0.15
    assert min(gap(-1.0), gap(1.0)) > 2 * gap(0.0)


@pytest.mark.parametrize(
    ("file", "damage", "told"),
    [
        ("velodyne/000002.bin", lambda data: data[: len(data) // 2 + 5], "is cut short"),
        ("velodyne/000002.bin", lambda data: b"", "holds no points"),
        ("velodyne/000002.bin", lambda data: data[:32] + b"\xff" * 16 + data[48:], "NaN"),
        ("image_2/000002.png", lambda data: data[: len(data) // 2], "damaged or cut short"),
    ],
)
def test_a_damaged_recording_is_named(
    src: Path, tmp_path: Path, file: str, damage: Callable[[bytes], bytes], told: str
) -> None:
    copy = tmp_path / "kitti"
    for path in (src / "poses/04.txt", *(src / "sequences/04").rglob("*.*")):
        if path.suffix == ".txt" or path.stem in ("000000", "000002"):
            target = copy / path.relative_to(src)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
    broken = copy / "sequences/04" / file
    broken.write_bytes(damage(broken.read_bytes()))
    with pytest.raises(UserError, match=f"{file} .*{told}"):
        prepare(copy, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def cloud_of(seen: Observation) -> np.ndarray:
    assert seen.points_body is not None
    return seen.points_body


def range_jumps(points: np.ndarray) -> np.ndarray:
    """Points more than 1 m nearer than a neighbour in firing order: the rims of things."""
    distance = np.linalg.norm(points[:, :2], axis=1)
    gap = np.maximum(np.roll(distance, 1), np.roll(distance, -1)) - distance
    return points[(gap > 1.0) & (distance < 30.0) & (points[:, 0] > 3.0)].astype(np.float64)


def picture_edges(seen: Observation) -> np.ndarray:
    assert seen.image is not None
    grey = cv2.cvtColor(seen.image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return cv2.GaussianBlur(np.abs(cv2.Sobel(grey, cv2.CV_32F, 1, 0)), (0, 0), 1.0)


def project(K: np.ndarray, points_camera: np.ndarray) -> np.ndarray:
    """Pixels (column, row) of points in front of the camera."""
    homogeneous = points_camera @ K.T
    return homogeneous[:, :2] / homogeneous[:, 2:]


def strength_at(edges: np.ndarray, pixels: np.ndarray) -> float:
    column, row = np.round(pixels).astype(int).T
    height, width = edges.shape
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return float(edges[row[inside], column[inside]].mean())
