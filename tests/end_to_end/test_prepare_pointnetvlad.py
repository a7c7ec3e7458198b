# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""From the synthetic world in the benchmark's layout, with RobotCar's images, to a dataset."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from adafusion.datasets.native import Dataset
from adafusion.datasets.recording import write_recording
from adafusion.preprocess import Preprocess, VoxelGrid
from adafusion.readers.pointnetvlad import read, read_submap, recognises
from adafusion.sim.exports.pointnetvlad import encode_points, make_submap

WISHES = {"seed": 3, "runs": ["day"], "profile": "tiny", "places": 2}
SLOP_MS = 3000.0  # the export has one picture about every 10 m


@pytest.fixture(scope="module")
def exported(export_once) -> dict[str, Path]:
    return {kind: export_once(kind, **WISHES) for kind in ("pointnetvlad", "robotcar")}


@pytest.fixture(scope="module")
def prepared(exported: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    recording = read(exported["pointnetvlad"], images=exported["robotcar"], slop_ms=SLOP_MS)
    return write_recording(recording, tmp_path_factory.mktemp("prepared") / "set").dataset


def table(folder: Path, run: str) -> dict[int, tuple[float, float]]:
    """Time to (easting, northing) of a run's submaps."""
    path = folder / "oxford" / run / "pointcloud_locations_20m_10overlap.csv"
    with path.open() as file:
        rows = list(csv.DictReader(file))
    return {int(row["timestamp"]): (float(row["easting"]), float(row["northing"])) for row in rows}


def test_every_submap_that_has_an_image_is_a_frame_where_the_table_says(
    exported: dict[str, Path], prepared: Dataset
) -> None:
    assert recognises(exported["pointnetvlad"])
    assert not recognises(exported["robotcar"])
    for run in WISHES["runs"]:
        places = table(exported["pointnetvlad"], run)
        images = exported["robotcar"] / run / "stereo" / "centre"
        taken = np.array(sorted(int(path.stem) for path in images.iterdir()))
        near = {t: int(taken[np.abs(taken - t).argmin()]) for t in places}
        expected = {t: near[t] for t in places if abs(near[t] - t) <= SLOP_MS * 1000}
        frames = [frame for frame in prepared.frames if frame.run == run]
        assert frames
        assert {f.timestamp_us: f.image_time_us or f.timestamp_us for f in frames} == expected
        for frame in frames:
            assert frame.position_m == (*places[frame.timestamp_us], 0.0)


def test_points_are_those_of_the_files(exported: dict[str, Path], prepared: Dataset) -> None:
    for frame in prepared.frames:
        folder = exported["pointnetvlad"] / "oxford" / frame.run / "pointcloud_20m_10overlap"
        back_left_up = np.fromfile(folder / f"{frame.timestamp_us}.bin", "<f8").reshape(-1, 3)
        points = prepared.load(frame).points_body
        np.testing.assert_allclose(points[:, 0], -back_left_up[:, 0], atol=1e-7)
        np.testing.assert_allclose(points[:, 1:], back_left_up[:, 1:], atol=1e-7)


def test_images_are_the_demosaiced_ones(exported: dict[str, Path], prepared: Dataset) -> None:
    for frame in prepared.frames:
        name = f"{frame.image_time_us or frame.timestamp_us}.png"
        path = exported["robotcar"] / frame.run / "stereo" / "centre" / name
        mosaic = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        image = prepared.load(frame).image
        assert image.shape == (*mosaic.shape, 3)
        # green, blue / red, green: each pixel keeps the colour that it recorded
        for (y, x), channel in {(0, 0): 1, (0, 1): 2, (1, 0): 0, (1, 1): 1}.items():
            inner = slice(2 + y, -2, 2), slice(2 + x, -2, 2)
            np.testing.assert_array_equal(image[(*inner, channel)], mosaic[inner])


def test_it_is_called_synthetic(prepared: Dataset) -> None:
    assert prepared.info.synthetic
    assert prepared.info.name == "synthetic world in pointnetvlad layout"


def test_what_is_ahead_left_and_above_is_read_so(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    forward_right_down = rng.uniform((-9, -20, -8), (9, 20, 1), (3000, 3))
    submap = make_submap(forward_right_down, rng)
    path = tmp_path / "1.bin"
    path.write_bytes(encode_points(submap.points))
    metres = read_submap(path).astype(float) / submap.scale  # as nobody can of the real ones
    forward_left_up = metres + submap.centroid * (1, -1, -1)
    # the mean of what a cell holds lies within the cloud: corners of the box show the axes
    for sign in np.array([(1, 1, 1), (1, -1, 1), (-1, 1, 1), (1, 1, -1)]):
        corner = (forward_left_up * sign).sum(axis=1).argmax()
        furthest = (forward_right_down * sign * (1, -1, -1)).sum(axis=1).max()
        assert (forward_left_up[corner] * sign).sum() == pytest.approx(furthest, abs=4.0)


def test_the_papers_box_holds_most_of_a_submap(prepared: Dataset) -> None:
    box = Preprocess(
        voxels=VoxelGrid(lower_m=(-0.4, -0.8, -0.2), upper_m=(0.4, 0.8, 0.4), shape=(72, 72, 48))
    )
    for frame in prepared.frames:
        points = prepared.load(frame).points_body
        inside = (np.abs(points[:, :2]) < (0.4, 0.8)).all(axis=1)
        assert inside.mean() > 0.3
        assert box.lidar_tensor(points).sum() > 100
