# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever a file of the benchmark holds: a value or a UserError, and nothing is ever run."""

from __future__ import annotations

import contextlib
import os
import pickle
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from adafusion.readers.benchmark_lists import (
    read_evaluation_sets,
    read_image_index,
    read_training_queries,
)
from adafusion.readers.opr import read as read_opr
from adafusion.readers.opr import read_nclt_cloud
from adafusion.readers.pickles import load_pickle
from adafusion.readers.pointnetvlad import read as read_benchmark
from adafusion.readers.pointnetvlad import read_picture, read_submap
from adafusion.types import UserError

fuzzed = settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def damaged(whole: bytes) -> st.SearchStrategy[bytes]:
    """The bytes of a file with some changed, cut out, or put in; or any bytes at all."""

    @st.composite
    def change(draw: st.DrawFn) -> bytes:
        data = bytearray(whole)
        for _ in range(draw(st.integers(1, 4))):
            start = draw(st.integers(0, max(len(data) - 1, 0)))
            stop = start + draw(st.sampled_from([0, 1, 2, 8, len(data)]))
            data[start:stop] = draw(st.binary(max_size=8))
        return bytes(data)

    return change() | st.binary(max_size=200)


def value_or_user_error(read: Callable[[], object]) -> None:
    with contextlib.suppress(UserError):
        read()


LISTS = pickle.dumps(
    [
        {0: {"query": "oxford/a/1.bin", "northing": 5.5, "easting": np.float64(6), 1: [0, 3]}},
        {np.int64(5): [np.int64(7)], 0: np.arange(3), 1: np.array([1.5], dtype=object)},
        {0: {"query": "a", "positives": [1], "negatives": [2], "x": (1, (2,), None, True)}},
    ],
    protocol=4,
)
SUBMAP = struct.pack("<3d", 0.5, 0.25, -0.125) * 4096
RAW = cv2.imencode(".png", np.arange(48, dtype=np.uint8).reshape(6, 8))[1].tobytes()


@fuzzed
@given(data=damaged(LISTS) | damaged(pickle.dumps(pickle.loads(LISTS), protocol=2)))
@pytest.mark.parametrize(
    "read", [load_pickle, read_evaluation_sets, read_image_index, read_training_queries]
)
def test_a_pickle(tmp_path: Path, read: Callable[[Path], object], data: bytes) -> None:
    path = tmp_path / "any.pickle"
    path.write_bytes(data)
    value_or_user_error(lambda: read(path))


class Shell:
    """Makes a directory when it is unpickled by Python."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


@fuzzed
@given(choice=st.data(), protocol=st.integers(0, 5))
def test_a_pickle_that_is_a_command(tmp_path: Path, choice: st.DataObject, protocol: int) -> None:
    trap, path = tmp_path / "sprung", tmp_path / "any.pickle"
    path.write_bytes(choice.draw(damaged(pickle.dumps({0: [Shell(trap)]}, protocol))))
    value_or_user_error(lambda: load_pickle(path))
    assert not trap.exists()


@fuzzed
@given(data=damaged(SUBMAP))
def test_a_submap(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "1.bin"
    path.write_bytes(data)
    value_or_user_error(lambda: read_submap(path))


@fuzzed
@given(data=damaged(struct.pack("<4f", 1.5, 2.5, 3.5, 17.0) * 6))
def test_a_prepared_scan(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "1.bin"
    path.write_bytes(data)
    value_or_user_error(lambda: read_nclt_cloud(path))


@fuzzed
@given(data=damaged(RAW))
def test_an_image(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "1.png"
    path.write_bytes(data)
    value_or_user_error(lambda: read_picture(path, cv2.COLOR_BayerGBRG2RGB))


@fuzzed
@given(shape=st.tuples(st.integers(1, 3), st.integers(1, 3)))
def test_an_image_of_a_few_pixels(tmp_path: Path, shape: tuple[int, int]) -> None:
    path = tmp_path / "1.png"
    assert cv2.imwrite(str(path), np.full(shape, 9, np.uint8))
    value_or_user_error(lambda: read_picture(path, cv2.COLOR_BayerGBRG2RGB))


@fuzzed
@given(data=damaged(b"timestamp,northing,easting\n5,1.5,2.5\n7,1.5,2.5\n"))
def test_a_table_of_submaps(tmp_path: Path, data: bytes) -> None:
    run = tmp_path / "oxford" / "run"
    (run / "pointcloud_20m").mkdir(parents=True, exist_ok=True)
    (run / "pointcloud_20m" / "5.bin").write_bytes(SUBMAP)
    (run / "pointcloud_locations_20m.csv").write_bytes(data)
    value_or_user_error(lambda: list(read_benchmark(tmp_path).shots))


@fuzzed
@given(
    track=damaged(b",timestamp,image,pointcloud,x,y,z,r,p,h\n0,4,4,5,1,2,3,0,0,0.5\n"),
    table=damaged(b",track,image,pointcloud,northing,easting\n0,day,4,5,1.0,2.0\n"),
)
def test_tables_of_a_prepared_set(tmp_path: Path, track: bytes, table: bytes) -> None:
    day = tmp_path / "day"
    (day / "velodyne_data").mkdir(parents=True, exist_ok=True)
    (day / "velodyne_data" / "5.bin").write_bytes(struct.pack("<4f", 1.5, 2.5, 3.5, 17.0))
    (day / "track.csv").write_bytes(track)
    (tmp_path / "train.csv").write_bytes(table)
    value_or_user_error(lambda: list(read_opr(tmp_path).shots))
