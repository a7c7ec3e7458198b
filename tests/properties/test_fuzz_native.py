# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A damaged dataset opens or is refused with a UserError, and so do its images and clouds."""

from __future__ import annotations

import shutil
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from adafusion.datasets.native import DatasetInfo, open_dataset
from adafusion.datasets.sensor_files import decode_image, read_cloud, read_image
from adafusion.datasets.writer import DatasetWriter
from adafusion.geometry import pose_from_xyz_yaw
from adafusion.types import Frame, Observation, UserError

INFO = DatasetInfo(
    name="toy",
    version="1",
    source="drawn",
    licence="CC0-1.0",
    synthetic=True,
    calibration={"K": [[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]]},
    regions={"test": [[0.0, 0.0, 1.0, 1.0]]},
)
CHECKS = settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("native") / "toy"
    rng = np.random.default_rng(0)
    with DatasetWriter(out, INFO) as writer:
        for t in range(3):
            frame = Frame(
                run="day",
                timestamp_us=t,
                position_m=(float(t), 0.0, 0.0),
                T_world_body=pose_from_xyz_yaw(float(t), 0.0, 0.0, 0.1),
                zone="street",
            )
            image = rng.integers(0, 256, (6, 8, 3), dtype=np.uint8)
            writer.add(frame, Observation(image, rng.normal(size=(5, 3)).astype(np.float32)))
    return out


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    return shutil.copytree(whole, tmp_path / "toy")


@st.composite
def changed(draw: st.DrawFn, data: bytes) -> bytes:
    """`data` with a few bytes overwritten, removed or put in, or cut off."""
    mutable = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(mutable)))
        mutable[start : start + draw(st.integers(0, 8))] = draw(st.binary(max_size=8))
    return bytes(mutable[: draw(st.just(len(mutable)) | st.integers(0, len(mutable)))])


@st.composite
def rewritten(draw: st.DrawFn, text: str) -> bytes:
    """Lines of YAML lost, doubled, or with another value."""
    lines = text.splitlines()
    values = ["", "[]", "{}", "-1", "~", ".nan", "'9'", "2001-99-99", "[[[", "*a", "!!binary x",
              "{a: b}", "9" * 400, "!!python/none x", "[" * 3000, "1e400", "? a"]  # fmt: skip
    for _ in range(draw(st.integers(1, 3))):
        row = draw(st.integers(0, len(lines) - 1))
        key = lines[row].partition(":")[0]
        new = draw(st.sampled_from(values) | st.text(max_size=8))
        lines[row : row + 1] = draw(
            st.sampled_from([[], [lines[row]] * 2, [f"{key}: {new}"], [f"{lines[row]} {new}"]])
        )
    return "\n".join(lines).encode(errors="replace")


def is_refused_or_opens(path: Path) -> None:
    try:
        dataset = open_dataset(path)
    except UserError:
        return
    assert np.isfinite(dataset.positions_m).all()
    assert len(dataset.frames) in (0, 3)


@CHECKS
@given(drawn=st.data())
def test_any_dataset_yaml_is_read_or_refused(copy: Path, whole: Path, drawn: st.DataObject) -> None:
    data = (whole / "dataset.yaml").read_bytes()
    some = rewritten(data.decode()) | changed(data) | st.binary(max_size=100)
    (copy / "dataset.yaml").write_bytes(drawn.draw(some))
    is_refused_or_opens(copy)


@pytest.mark.parametrize(
    "text", ["a: 2001-99-99", "[" * 3000, "{a: " * 900, "a: \0", "&a [*a]", "? {a: b}", "\ud800"]
)
def test_yaml_that_its_reader_stumbles_over_is_refused(copy: Path, text: str) -> None:
    (copy / "dataset.yaml").write_bytes(text.encode(errors="surrogatepass"))
    with pytest.raises(UserError, match=r"dataset\.yaml"):
        open_dataset(copy)


@CHECKS
@given(drawn=st.data())
def test_any_table_of_frames_is_read_or_refused(
    copy: Path, whole: Path, drawn: st.DataObject
) -> None:
    data = (whole / "day" / "frames.parquet").read_bytes()
    (copy / "day" / "frames.parquet").write_bytes(
        drawn.draw(changed(data) | st.binary(max_size=100))
    )
    is_refused_or_opens(copy)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tiff"])
@settings(max_examples=100, deadline=None)
@given(drawn=st.data())
def test_any_image_is_decoded_or_refused(suffix: str, drawn: st.DataObject) -> None:
    pixels = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)
    encoded = cv2.imencode(suffix, pixels)[1].tobytes()
    data = drawn.draw(changed(encoded) | st.binary(max_size=100))
    try:
        image = decode_image(data, "any")
    except UserError:
        return
    assert image.dtype == np.uint8
    assert image.shape[2:] == (3,)


@CHECKS
@given(drawn=st.data())
def test_any_prepared_cloud_is_read_or_refused(
    copy: Path, whole: Path, drawn: st.DataObject
) -> None:
    data = (whole / "day" / "clouds" / "0.npy").read_bytes()
    path = copy / "day" / "clouds" / "0.npy"
    path.write_bytes(drawn.draw(changed(data) | st.binary(max_size=200)))
    try:
        points = read_cloud(path)
    except UserError:
        return
    assert np.isfinite(points).all()


def chunk(kind: bytes, body: bytes) -> bytes:
    length, checksum = struct.pack(">I", len(body)), struct.pack(">I", zlib.crc32(kind + body))
    return length + kind + body + checksum


def claiming_png(width: int, height: int) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    pixels = chunk(b"IDAT", zlib.compress(b"\0" * 100))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + pixels + chunk(b"IEND", b"")


def claiming_jpeg(width: int, height: int) -> bytes:
    data = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    at = data.index(b"\xff\xc0") + 5
    return data[:at] + struct.pack(">HH", height, width) + data[at + 4 :]


def claiming_bmp(width: int, height: int) -> bytes:
    data = bytearray(cv2.imencode(".bmp", np.zeros((8, 8, 3), np.uint8))[1])
    struct.pack_into("<ii", data, 18, width, height)
    return bytes(data)


def claiming_tiff(order: str, *tags: tuple[int, int]) -> bytes:
    """A TIFF of one uncompressed strip; `tags` come on top of those that every TIFF has."""
    always = {256: 8, 257: 8, 258: 8, 259: 1, 262: 1, 273: 8, 277: 1, 278: 8, 279: 64}
    entries = sorted((always | dict(tags)).items())
    start = {"<": b"II*\0", ">": b"MM\0*"}[order] + struct.pack(f"{order}I", 8 + 64)
    body = struct.pack(f"{order}H", len(entries))
    for tag, value in entries:
        body += struct.pack(f"{order}HHII", tag, 4, 1, value)
    return start + b"\0" * 64 + body + b"\0" * 4


def test_what_claims_no_more_than_it_has_is_decoded() -> None:
    for data in (claiming_tiff("<"), claiming_tiff(">"), claiming_bmp(8, 8), claiming_bmp(8, -8)):
        assert decode_image(data, "whole").shape == (8, 8, 3)


def test_a_jpeg_may_fill_up_before_a_marker() -> None:
    data = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    at = data.index(b"\xff\xc0")
    assert decode_image(data[:at] + b"\xff\xff" + data[at:], "filled").shape == (8, 8, 3)


CLAIMS = {
    "png": claiming_png(30_000, 30_000),
    "largest png": claiming_png(2**31 - 1, 2**31 - 1),
    "png of 100 million": claiming_png(10_000, 10_000),
    "jpeg": claiming_jpeg(30_000, 30_000),
    "largest jpeg": claiming_jpeg(65_000, 65_000),
    "filled jpeg": claiming_jpeg(30_000, 30_000).replace(b"\xff\xc0", b"\xff\xff\xff\xc0"),
    "littered jpeg": claiming_jpeg(30_000, 30_000).replace(b"\xff\xc0", b"litter\xff\xc0"),
    "bmp": claiming_bmp(30_000, 30_000),
    "bmp from the top": claiming_bmp(30_000, -30_000),
    "old bmp": b"BM" + b"\0" * 12 + struct.pack("<IHHHH", 12, 30_000, 30_000, 1, 24) + b"\0" * 99,
    "tiff": claiming_tiff("<", (256, 30_000), (257, 30_000)),
    "tiff, other order": claiming_tiff(">", (256, 30_000), (257, 30_000)),
    "tile": claiming_tiff("<", (322, 2**20), (323, 2**20), (324, 8), (325, 64)),
    "long side": claiming_png(40_000, 2),
}


@pytest.mark.timeout(20)
@pytest.mark.parametrize("data", CLAIMS.values(), ids=CLAIMS.keys())
def test_an_image_that_claims_too_much_never_meets_the_decoder(
    tmp_path: Path, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("it was decoded"))
    (tmp_path / "claim").write_bytes(data)
    with pytest.raises(UserError, match=r"claim claims .* pixels, more than any camera has"):
        read_image(tmp_path / "claim")


@pytest.mark.timeout(20)
@pytest.mark.parametrize(
    "data",
    [
        claiming_png(0, 0),
        claiming_bmp(0, 0),
        claiming_tiff("<", (256, 0)),
        b"\xff\xd8\xff\xd9",
        b"\xff\xd8" + b"\xff" * 2**22 + b"\0\xff\xd9",
        b"\xff\xd8" + b"\xff\xe0\0\0" * 3 + b"\xff\xd9",
        b"II*\0\xff\xff\xff\xff",
        b"BM",
    ],
)
def test_an_image_that_claims_nothing_is_refused(data: bytes) -> None:
    with pytest.raises(UserError, match="any is damaged or cut short"):
        decode_image(data, "any")


@pytest.mark.parametrize("suffix", [".webp", ".jp2", ".ppm"])
def test_an_image_of_another_format_is_refused(suffix: str) -> None:
    data = cv2.imencode(suffix, np.zeros((64, 64, 3), np.uint8))[1].tobytes()
    with pytest.raises(UserError, match="any is no PNG, JPEG, TIFF or BMP"):
        decode_image(data, "any")


def test_an_archive_of_arrays_is_no_cloud(tmp_path: Path) -> None:
    np.savez(tmp_path / "many.npz", a=np.zeros((3, 3), np.float32))
    (tmp_path / "many.npz").rename(tmp_path / "0.npy")
    with pytest.raises(UserError, match=r"0\.npy is damaged"):
        read_cloud(tmp_path / "0.npy")
