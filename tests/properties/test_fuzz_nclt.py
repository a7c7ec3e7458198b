# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever the bytes, NCLT's files give values or a UserError."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from adafusion.readers.nclt.camera import read_lens, read_picture, read_u2d
from adafusion.readers.nclt.poses import read_ins, read_truth, track_around
from adafusion.readers.nclt.reader import read
from adafusion.readers.nclt.velodyne import TURN_EDGES_US, find_turn, read_scan, read_turn
from adafusion.types import UserError

FEW = settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
WIDTH, HEIGHT = 5, 3


def packet(utime: int, hits: int) -> bytes:
    header = struct.pack("<HHHHIQI", *[44444] * 4, hits, utime, 0)
    return header + struct.pack("<HHHBB", 21000, 19000, 20100, 1, 2) * hits


STREAM = b"".join(packet(1_000_000 + 1_000 * k, k % 4) for k in range(300))
SCAN = struct.pack("<HHHBB", 21000, 19000, 20100, 1, 2) * 9
U2D = f"{WIDTH},{HEIGHT}\n" + "".join(
    f"{r} {c} {r} {c}\n" for r in range(HEIGHT) for c in range(WIDTH)
)
TRUTH = "".join(f"{1_000_000 + 10_000 * k},{k},2,3,0.1,0.2,0.3\n" for k in range(40))
GPS = "".join(f"{1_000_000 + 100_000 * k},3,7,0.738,-1.46,270,0,0\n" for k in range(5))
EULER = "".join(f"{1_000_000 + 20_000 * k},0.1,0.2,0.3\n" for k in range(20))
PICTURE = cv2.imencode(".tiff", np.full((HEIGHT, WIDTH, 3), 90, np.uint8))[1].tobytes()


@st.composite
def damaged(draw: st.DrawFn, whole: bytes) -> bytes:
    """A file that was cut, or of which some bytes are others, or which is another one."""
    if draw(st.integers(0, 4)) == 0:
        return draw(st.binary(max_size=200))
    data = bytearray(whole)
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, len(data) - 1))
        part = draw(st.binary(min_size=1, max_size=9))
        data[at : at + len(part)] = part
    return bytes(data[: draw(st.integers(0, len(data)))] if draw(st.booleans()) else data)


def attempt(path: Path, data: bytes, parse: Callable[[], object]) -> None:
    path.write_bytes(data)
    with contextlib.suppress(UserError):
        parse()


@FEW
@given(data=damaged(SCAN))
def test_a_scan_is_points_or_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "scan.bin"
    attempt(path, data, lambda: read_scan(path))


@FEW
@given(found_in=damaged(STREAM), read_from=damaged(STREAM), end_us=st.integers(900_000, 1_400_000))
def test_a_stream_is_turns_or_refused(
    tmp_path: Path, found_in: bytes, read_from: bytes, end_us: int
) -> None:
    path = tmp_path / "velodyne_hits.bin"
    path.write_bytes(found_in)
    still = np.tile(np.eye(4), (len(TURN_EDGES_US), 1, 1))
    turn = None
    with contextlib.suppress(UserError):
        turn = find_turn(path, end_us, still)
    if turn is not None:
        attempt(path, found_in, lambda: read_turn(turn))
        attempt(path, read_from, lambda: read_turn(turn))


@FEW
@given(data=damaged(U2D.encode()))
def test_a_map_is_one_or_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "U2D_Cam5_5X3.txt"
    attempt(path, data, lambda: read_u2d(path))


@FEW
@given(data=damaged(PICTURE))
def test_a_picture_is_one_or_refused(
    tmp_path: Path, data: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    path, u2d = tmp_path / "1.tiff", tmp_path / "U2D_Cam5_5X3.txt"
    u2d.write_text(U2D)
    attempt(path, data, lambda: read_picture(path, u2d))
    capfd.readouterr()  # the decoder has its say on stderr


@FEW
@given(K=damaged(b"4,0,2\n0,4,1\n0,0,1\n"), pose=damaged(b"0.1,0.2,0.3,160,89,160\n"))
def test_a_lens_is_one_or_refused(tmp_path: Path, K: bytes, pose: bytes) -> None:
    (tmp_path / "U2D_Cam5_5X3.txt").write_text(U2D)
    (tmp_path / "K_cam5.csv").write_bytes(K)
    attempt(tmp_path / "x_lb3_c5.csv", pose, lambda: read_lens(tmp_path, "Cam5"))


@FEW
@given(data=damaged(TRUTH.encode()))
def test_ground_truth_is_a_track_or_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "groundtruth_2012-01-08.csv"
    at_us = np.array([900_000, 1_200_000, 1_300_005])

    def parse() -> None:
        track = track_around(read_truth(path)[0], at_us)
        track.at(at_us[track.near(at_us, 200_000)])

    attempt(path, data, parse)


@FEW
@given(gps=damaged(GPS.encode()), euler=damaged(EULER.encode()))
def test_fixes_are_poses_or_refused(tmp_path: Path, gps: bytes, euler: bytes) -> None:
    gps_file, euler_file = tmp_path / "gps.csv", tmp_path / "ms25_euler.csv"
    gps_file.write_bytes(gps)
    attempt(euler_file, euler, lambda: read_ins(gps_file, euler_file, np.array([1_200_000])))


@FEW
@given(data=damaged(b'{"synthetic": true, "generator": "g", "licence": "l", "seed": 1}'))
def test_a_manifest_is_read_or_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "groundtruth_a.csv").write_text(TRUTH)
    (tmp_path / "a/velodyne_sync").mkdir(parents=True, exist_ok=True)
    (tmp_path / "a/velodyne_sync/1200000.bin").write_bytes(SCAN)
    attempt(tmp_path / "manifest.json", data, lambda: list(read(tmp_path).shots))
