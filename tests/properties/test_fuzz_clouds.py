# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Any bytes are a cloud or a UserError: arbitrary ones, and whole files with some bytes changed."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adafusion.readers.clouds import CLOUD_SUFFIXES, read_points
from adafusion.types import UserError

POINTS = np.arange(60, dtype=np.float32).reshape(20, 3) - 25.0
FOUR = np.column_stack([POINTS, np.zeros(20, np.float32)])


def _npy() -> bytes:
    stream = io.BytesIO()
    np.save(stream, FOUR)
    return stream.getvalue()


def _pcd(form: str) -> bytes:
    body = {
        "ascii": "\n".join(f"{x} {y} {z} 0" for x, y, z in POINTS).encode(),
        "binary": FOUR.tobytes(),
        # 320 bytes of one kind: one, then 264 and 55 that repeat it
        "binary_compressed": struct.pack("<II", 8, 320) + b"\0\x3f\xe0\xff\0\xe0\x2e\0",
    }[form]
    return (
        "VERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
        f"WIDTH 20\nHEIGHT 1\nPOINTS 20\nDATA {form}\n"
    ).encode() + body


def _ply(form: str) -> bytes:
    body = POINTS.astype(">f4" if "big" in form else "<f4").tobytes()
    if form == "ascii":
        body = "\n".join(f"{x} {y} {z}" for x, y, z in POINTS).encode()
    faces = b"3 0 1 2\n" * 2 if form == "ascii" else b"\x03\0\x01\x02" * 2
    return (
        f"ply\nformat {form} 1.0\nelement face 2\nproperty list uchar uchar i\nelement vertex 20\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    ).encode() + faces + body  # fmt: skip


def _las(minor: int) -> bytes:
    header = bytearray(375 if minor == 4 else 227)
    header[:4] = b"LASF"
    header[24:26] = bytes([1, minor])
    struct.pack_into("<HI", header, 94, len(header), len(header))
    struct.pack_into("<BHI", header, 104, 0, 20, 20)
    struct.pack_into("<6d", header, 131, 0.01, 0.01, 0.01, 0, 0, 0)
    if minor == 4:
        struct.pack_into("<Q", header, 247, 20)
    return bytes(header) + b"".join(struct.pack("<3i8x", *p) for p in POINTS.astype(int).tolist())


WHOLE = {
    "bin": (".bin", FOUR.tobytes()),
    "npy": (".npy", _npy()),
    **{f"pcd {f}": (".pcd", _pcd(f)) for f in ("ascii", "binary", "binary_compressed")},
    **{
        f"ply {f}": (".ply", _ply(f))
        for f in ("ascii", "binary_little_endian", "binary_big_endian")
    },
    "las 1.2": (".las", _las(2)),
    "las 1.4": (".las", _las(4)),
}


def check(suffix: str, data: bytes) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"cloud{suffix}"
        path.write_bytes(data)
        try:
            points = read_points(path)
        except UserError:
            return
    assert points.dtype == np.float32
    assert points.shape[1:] == (3,)
    assert len(points) <= len(data) * 88  # what the densest of them, LZF, can hold
    assert np.isfinite(points).all()


@st.composite
def changed(draw: st.DrawFn, whole: bytes) -> bytes:
    """`whole` with a few bytes overwritten, removed or put in, or cut off."""
    data = bytearray(whole)
    for _ in range(draw(st.integers(1, 3))):
        # headers first: there is more to break in them
        near_start = st.integers(0, min(len(data), 300))
        start = draw(near_start | st.integers(0, len(data)))
        end = start + draw(st.integers(0, 8))
        some = st.binary(max_size=8) | st.sampled_from([b"0", b"9", b"-1", b"9" * 17, b"\xff" * 8])
        data[start:end] = draw(some)
    return bytes(data[: draw(st.just(len(data)) | st.integers(0, len(data)))])


@pytest.mark.parametrize("name", WHOLE)
def test_a_whole_file_reads(name: str, tmp_path: Path) -> None:
    suffix, data = WHOLE[name]
    (tmp_path / f"cloud{suffix}").write_bytes(data)
    assert len(read_points(tmp_path / f"cloud{suffix}")) == 20


@pytest.mark.parametrize("name", WHOLE)
@settings(max_examples=150, deadline=None)
@given(drawn=st.data())
def test_a_changed_file_is_a_cloud_or_refused(name: str, drawn: st.DataObject) -> None:
    suffix, whole = WHOLE[name]
    check(suffix, drawn.draw(changed(whole)))


@settings(max_examples=100, deadline=None)
@given(suffix=st.sampled_from(CLOUD_SUFFIXES), data=st.binary(max_size=600))
def test_any_bytes_are_a_cloud_or_refused(suffix: str, data: bytes) -> None:
    check(suffix, data)
