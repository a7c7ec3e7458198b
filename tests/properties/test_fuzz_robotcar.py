# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever bytes lie in RobotCar's files, they are read or refused by name."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from adafusion.geometry import is_rigid
from adafusion.readers import robotcar
from adafusion.readers.robotcar.files import (
    read_extrinsics,
    read_model,
    read_picture,
    read_poses,
    read_scan,
)
from adafusion.types import UserError

POSES = (
    b"timestamp,ins_status,northing,easting,down,roll,pitch,yaw\n"
    b"1000,INS_SOLUTION_GOOD,5735000.5,620000.5,-100.5,0.01,-0.02,3.1\n"
    b"21000,INS_SOLUTION_GOOD,5735001.5,620000.5,-100.5,0.01,-0.02,3.1\n"
    b"5021000,INS_SOLUTION_GOOD,5735101.5,620000.5,-100.5,0.01,-0.02,3.1\n"
)
MODEL = b"5 5 2.5 1.5\n0 0 1 0\n1 0 0 0\n0 1 0 0\n0 0 0 1\n"
TABLE = struct.pack("<48d", *(float(k % 6) for k in range(24)), *(float(k // 6) for k in range(24)))
PICTURE = cv2.imencode(".png", np.arange(24, dtype=np.uint8).reshape(4, 6))[1].tobytes()
SCAN = struct.pack("<6d", 1.0, 2.0, 30.0, 0.0, 0.0, 0.0)

relaxed = settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@st.composite
def damaged(draw: st.DrawFn, whole: bytes) -> bytes:
    """Anything at all, or a whole file with some bytes changed and its end cut off."""
    if draw(st.booleans()):
        return draw(st.binary(max_size=300))
    data = bytearray(whole)
    for at, byte in draw(
        st.lists(st.tuples(st.integers(0, len(data) - 1), st.integers(0, 255)), max_size=6)
    ):
        data[at] = byte
    return bytes(data[: draw(st.integers(0, len(data)))])


def value_or_refusal(read: Callable[[], object], name: str) -> object:
    try:
        return read()
    except UserError as error:
        refusal = str(error)
    assert name in refusal
    return None


@relaxed
@given(data=damaged(POSES))
def test_tables_of_poses_are_read_or_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "ins.csv"
    path.write_bytes(data)
    poses = value_or_refusal(lambda: read_poses(path), "ins.csv")
    if poses is not None:
        assert is_rigid(poses.T_ned_ins)
        assert (np.diff(poses.time_us) > 0).all()


@relaxed
@given(data=damaged(b"-1.7132 0.1181 1.1948 -0.0125 0.0400 0.0050"))
def test_extrinsics_are_read_or_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "ins.txt"
    path.write_bytes(data)
    T = value_or_refusal(lambda: read_extrinsics(path), "ins.txt")
    assert T is None or is_rigid(T)


@relaxed
@given(data=damaged(MODEL))
def test_camera_models_are_read_or_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "mono_rear.txt"
    path.write_bytes(data)
    model = value_or_refusal(lambda: read_model(path), "mono_rear.txt")
    assert model is None or is_rigid(model.T_camera_optical)


@relaxed
@given(data=damaged(SCAN), flat=st.booleans())
def test_scans_are_read_or_refused(tmp_path: Path, data: bytes, flat: bool) -> None:
    (tmp_path / "7.bin").write_bytes(data)
    points = value_or_refusal(lambda: read_scan(tmp_path, flat, 7), "7.bin")
    assert points is None or np.isfinite(points).all()


@relaxed
@given(picture=damaged(PICTURE), table=damaged(TABLE))
def test_pictures_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, picture: bytes, table: bytes
) -> None:
    folder = tmp_path_factory.mktemp("picture")  # tables are kept by their path
    for name, data in (("7.png", picture), ("lut.bin", table)):
        (folder / name).write_bytes(data)
    image = value_or_refusal(
        lambda: read_picture(folder / "7.png", folder / "lut.bin", cv2.COLOR_BayerGBRG2RGB),
        str(folder),
    )
    assert image is None or image.dtype == np.uint8


@relaxed
@given(poses=damaged(POSES), times=st.lists(st.integers(0, 2**63), max_size=4))
def test_a_run_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, poses: bytes, times: list[int]
) -> None:
    src = tmp_path_factory.mktemp("robotcar")
    for name in ("models", "extrinsics", "run/gps", "run/stereo/centre", "run/lms_front"):
        (src / name).mkdir(parents=True)
    (src / "models/stereo_narrow_left.txt").write_bytes(MODEL)
    for name in ("stereo", "ins", "lms_front"):
        (src / f"extrinsics/{name}.txt").write_text("0 0 0 0 0 0")
    (src / "run/gps/ins.csv").write_bytes(poses)
    for time_us in [1000, 2000, 20000, *times]:
        (src / f"run/lms_front/{time_us}.bin").write_bytes(SCAN)
    for time_us in [1500, *times]:
        (src / f"run/stereo/centre/{time_us}.png").write_bytes(PICTURE)
    recording = value_or_refusal(lambda: robotcar.read(src), str(src))
    if recording is not None:
        assert len(list(recording.shots)) == recording.total
