# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The MulRan reader on true poses of two runs and two true clouds, put into its layout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from adafusion.datasets import Dataset
from adafusion.datasets.recording import write_recording
from adafusion.geometry import invert
from adafusion.readers.mulran import T_BASE_OUSTER, read_mulran

STEP_NS = 100_000_000


@pytest.fixture(scope="module")
def dataset(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The poses are those of the Ouster, a row a scan; one scan in a hundred gets a true cloud."""
    src = tmp_path_factory.mktemp("mulran")
    clouds = [true_cloud(real_data / f"pcd/00000{i}.pcd") for i in (0, 1)]
    for run in ("kaist01", "kaist02"):
        (src / run / "Ouster").mkdir(parents=True)
        rows = np.loadtxt(real_data / f"mulran/{run}.poses.txt").reshape(-1, 3, 4)
        T_world_ouster = np.tile(np.eye(4), (len(rows), 1, 1))
        T_world_ouster[:, :3] = rows
        T_world_base = T_world_ouster @ invert(T_BASE_OUSTER)
        lines = [
            ",".join([str(1_560_000_000 * 10**9 + i * STEP_NS), *map(repr, T[:3].ravel().tolist())])
            for i, T in enumerate(T_world_base)
        ]
        (src / run / "global_pose.csv").write_text("\n".join(lines))
        for i in range(0, len(rows), 100):
            name = f"{1_560_000_000 * 10**9 + i * STEP_NS}.bin"
            (src / run / "Ouster" / name).write_bytes(clouds[i // 100 % 2])
    return write_recording(read_mulran(src), src.parent / "out").dataset


def true_cloud(path: Path) -> bytes:
    """The records of a binary PCD of x y z intensity, which are those of a MulRan scan."""
    header, data = path.read_bytes().split(b"DATA binary\n", 1)
    count = int(header.split(b"POINTS ")[1].split()[0])
    return data[: 16 * count]


def test_it_drives_the_way_it_looks(dataset: Dataset) -> None:
    for run in dataset.runs:
        T = np.array([f.T_world_body for f in dataset.frames if f.run == run])
        # the body looks along the road; between frames 10 s apart the road bends now and then
        step = np.diff(T[:, :3, 3], axis=0)
        ahead = np.einsum("ni,ni->n", T[:-1, :3, 0], step) / np.linalg.norm(step, axis=1)
        assert np.median(ahead) > 0.95


def test_the_second_run_meets_the_first(dataset: Dataset) -> None:
    first = np.array([f.position_m for f in dataset.frames if f.run == "kaist01"])
    second = np.array([f.position_m for f in dataset.frames if f.run == "kaist02"])
    assert (cKDTree(first).query(second)[0] < 50.0).mean() > 0.9


def test_the_ground_lies_at_zero(dataset: Dataset) -> None:
    assert "1.62 m above the ground" in dataset.info.sensors["lidar"]
    points = dataset.load(dataset.frames[0]).points_body
    assert points is not None
    x, y, z = points.T
    road = z[(x > 4.7) & (x < 9.0) & (np.abs(y) < 2.0)]  # from 3 m ahead of the Ouster
    assert len(road) > 500
    assert abs(np.median(road)) < 0.1
    assert (x > 5.0).sum() > 4 * (x < -5.0).sum()  # the radar behind it makes it blind
