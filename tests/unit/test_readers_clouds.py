# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Cloud files made by hand from the descriptions of their formats, byte by byte."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from adafusion.readers.clouds import count_columns, read_points
from adafusion.types import UserError

XYZ = [(1.0, -2.0, 0.5), (-3.5, 4.0, 0.25), (10.0, 20.0, -1.75)]  # exact as float32


@pytest.fixture
def save(tmp_path: Path):
    """Write bytes under a suffix; return their path."""

    def write(suffix: str, data: bytes) -> Path:
        path = tmp_path / f"cloud{suffix}"
        path.write_bytes(data)
        return path

    return write


def street(points: int, rng: np.random.Generator) -> np.ndarray:
    """A cloud as a LiDAR has it: wide in x and y, flat in z, x first."""
    return (rng.normal(size=(points, 3)) * (20.0, 15.0, 1.0)).astype(np.float32)


# -------------------------------------------------------------------------------------------- bin


@pytest.mark.parametrize("points", [1200, 1201, 1202, 1203])
def test_it_tells_three_numbers_a_point_from_four(save, points: int) -> None:
    rng = np.random.default_rng(points)
    xyz = street(points, rng)
    assert count_columns(xyz.ravel()) == 3
    np.testing.assert_array_equal(read_points(save(".bin", xyz.tobytes())), xyz)
    for intensity in (rng.random(points), rng.integers(0, 65536, points), np.zeros(points)):
        four = np.column_stack([xyz, intensity]).astype(np.float32)
        assert count_columns(four.ravel()) == 4
        np.testing.assert_array_equal(read_points(save(".bin", four.tobytes())), xyz)


def test_it_takes_few_points_by_the_size_of_the_file(save) -> None:
    two = save(".bin", struct.pack("<8f", *XYZ[0], 0.3, *XYZ[1], 0.9))  # 32 bytes
    np.testing.assert_array_equal(read_points(two), XYZ[:2])
    three = save(".bin", struct.pack("<9f", *XYZ[0], *XYZ[1], *XYZ[2]))  # 36 bytes
    np.testing.assert_array_equal(read_points(three), XYZ)
    twelve = struct.pack("<12f", *XYZ[0], 0.3, *XYZ[1], 0.9, *XYZ[2], 0.0)  # 48 bytes
    with pytest.raises(UserError, match=r"cloud\.bin may have 3 numbers a point or 4: save"):
        read_points(save(".bin", twelve))
    np.testing.assert_array_equal(read_points(save(".bin", twelve), columns=4), XYZ)


def test_it_refuses_a_bin_whose_signs_and_size_disagree(save) -> None:
    rng = np.random.default_rng(0)
    four = np.column_stack([street(1200, rng), rng.random(1200)]).astype(np.float32)
    cut = four.tobytes()[: 1197 * 16 + 12]  # a whole number of 12-byte points, and none of 16
    assert len(cut) % 12 == 0
    with pytest.raises(UserError, match="may have 3 numbers a point or 4"):
        read_points(save(".bin", cut))
    ahead = np.abs(street(1200, rng))  # nothing below 0: signs say nothing
    with pytest.raises(UserError, match="pass `columns`"):
        read_points(save(".bin", ahead.tobytes()))
    decibels = np.column_stack([street(1200, rng), -rng.random(1200)]).astype(np.float32)
    with pytest.raises(UserError, match="pass `columns`"):
        read_points(save(".bin", decibels.tobytes()))


def test_it_refuses_submaps_of_doubles(save) -> None:
    """PointNetVLAD's 4096 x 3 float64, whose size fits floats of either width."""
    submap = np.random.default_rng(0).uniform(-1, 1, (4096, 3))
    with pytest.raises(UserError, match=r"cloud\.bin"):
        read_points(save(".bin", submap.tobytes()))


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "holds no points"),
        (b"\0" * 19, "is cut short: 19 bytes"),
        (struct.pack("<4f", np.nan, 0, 0, 0), "holds NaN or infinite"),
        (struct.pack("<4f", np.inf, 0, 0, 0), "holds NaN or infinite"),
    ],
)
def test_it_names_a_damaged_bin(save, data: bytes, told: str) -> None:
    with pytest.raises(UserError, match=rf"cloud\.bin {told}.*: replace it"):
        read_points(save(".bin", data))


# -------------------------------------------------------------------------------------------- npy


@pytest.mark.parametrize("kind", ["<f4", ">f4", "<f8", "<f2"])
@pytest.mark.parametrize("columns", [3, 4, 7])
def test_it_reads_arrays_of_any_float_and_width(tmp_path: Path, kind: str, columns: int) -> None:
    array = np.zeros((3, columns), dtype=kind)
    array[:, :3] = XYZ
    np.save(tmp_path / "cloud.npy", array)
    points = read_points(tmp_path / "cloud.npy")
    assert points.dtype == np.float32
    np.testing.assert_array_equal(points, XYZ)


@pytest.mark.parametrize(
    ("array", "told"),
    [
        (np.zeros((3, 2)), r"holds float64 \(3, 2\), not floats"),
        (np.zeros((3, 3), np.int32), "holds int32"),
        (np.zeros(9), r"holds float64 \(9,\)"),
        (np.zeros((0, 3)), "holds no points"),
        (np.array([{}]), "is damaged .*pickle"),
    ],
)
def test_it_refuses_other_arrays(tmp_path: Path, array: np.ndarray, told: str) -> None:
    np.save(tmp_path / "cloud.npy", array)
    with pytest.raises(UserError, match=rf"cloud\.npy {told}"):
        read_points(tmp_path / "cloud.npy")


def test_it_asks_for_no_memory_that_an_array_only_claims(save) -> None:
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999, 3), }\n"
    data = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + b"\0" * 12
    with pytest.raises(UserError, match=r"claims float32 \(99999999999, 3\), 12 bytes are there"):
        read_points(save(".npy", data))


# -------------------------------------------------------------------------------------------- pcd


def pcd(
    form: str,
    body: bytes,
    fields: str = "x y z intensity",
    size: str = "4 4 4 4",
    kind: str = "F F F F",
    count: str | None = "1 1 1 1",
    points: int = 3,
) -> bytes:
    counts = "" if count is None else f"COUNT {count}\n"
    header = (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {size}\n"
        f"TYPE {kind}\n{counts}WIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {points}\nDATA {form}\n"
    )
    return header.encode() + body


def literals(data: bytes) -> bytes:
    """LZF without a repeat: runs of up to 32 bytes, each after its length less one."""
    runs = [data[i : i + 32] for i in range(0, len(data), 32)]
    return b"".join(bytes([len(run) - 1]) + run for run in runs)


def test_it_reads_an_ascii_pcd(save) -> None:
    body = b"1 -2 0.5 9\n-3.5 4 0.25 8\n\n1e1 20.0 -1.75 nan\n"
    np.testing.assert_array_equal(read_points(save(".pcd", pcd("ascii", body))), XYZ)


def test_it_reads_a_binary_pcd_with_fields_in_any_order_and_type(save) -> None:
    body = b"".join(struct.pack("<dBhfHHH", z, 7, int(x), y, 1, 2, 3) for x, y, z in XYZ)
    path = save(".pcd", pcd("binary", body, "z ring x y _", "8 1 2 4 2", "F U I F U", "1 1 1 1 3"))
    expected = [(int(x), y, z) for x, y, z in XYZ]
    np.testing.assert_array_equal(read_points(path), expected)


def test_it_reads_a_pcd_without_counts(save) -> None:
    body = b"".join(struct.pack("<fff", *point) for point in XYZ)
    path = save(".pcd", pcd("binary", body, "x y z", "4 4 4", "F F F", None))
    np.testing.assert_array_equal(read_points(path), XYZ)


def test_it_reads_a_compressed_pcd_column_by_column(save) -> None:
    columns = struct.pack("<fff", *(x for x, _, _ in XYZ))
    columns += b"".join(struct.pack("<3f", *(point[i] for point in XYZ)) for i in (1, 2))
    columns += struct.pack("<3f", 9, 8, 7)
    packed = literals(columns)
    body = struct.pack("<II", len(packed), len(columns)) + packed
    path = save(".pcd", pcd("binary_compressed", body))
    np.testing.assert_array_equal(read_points(path), XYZ)


def test_it_unpacks_repeats_of_lzf(save) -> None:
    """100 points at 0 0 1: zeros as one repeat of the byte before, then a pattern of four."""
    zeros = b"\x00\x00" + b"\xe0\xff\x00" * 3  # one zero, then thrice 264 of what is 1 back
    zeros += b"\xe0\x00\x00"  # 1 + 792 = 793, then 9 more: 802
    ones = b"\x01\x80\x3f"  # with the last two zeros: 00 00 80 3f
    # 396 more bytes of the pattern that is 4 back: 264, then 132
    ones += b"\xe0\xff\x03" + b"\xe0" + bytes([132 - 9]) + b"\x03"
    packed = zeros + ones
    body = struct.pack("<II", len(packed), 1200) + packed
    path = save(".pcd", pcd("binary_compressed", body, "x y z", "4 4 4", "F F F", None, 100))
    np.testing.assert_array_equal(read_points(path), [(0.0, 0.0, 1.0)] * 100)


def test_it_drops_what_organised_clouds_hold_for_no_return(save) -> None:
    body = b"nan nan nan 0\n1 -2 0.5 9\n1 inf 0 0\n-3.5 4 0.25 8\n1 3e38 0 9\n1e300 0 0 9\n"
    data = pcd("ascii", body, points=6).replace(b"WIDTH 6\nHEIGHT 1", b"WIDTH 3\nHEIGHT 2")
    np.testing.assert_array_equal(read_points(save(".pcd", data)), XYZ[:2])
    nothing = pcd("ascii", b"nan nan nan 0\n" * 3)
    with pytest.raises(UserError, match="holds no points"):
        read_points(save(".pcd", nothing))


@pytest.mark.parametrize("suffix", [".bin", ".npy", ".pcd"])
def test_it_drops_points_at_the_origin_which_are_no_return(save, suffix: str) -> None:
    points = np.array([(0, 0, 0), *XYZ, (0, -0.0, 0), (0, 0, 0.5)], np.float32)
    data = {".bin": np.insert(points, 3, 9, axis=1).tobytes(), ".npy": b"", ".pcd": b""}[suffix]
    if suffix == ".pcd":
        body = "".join(f"{x} {y} {z} 9\n" for x, y, z in points.tolist())
        data = pcd("ascii", body.encode(), points=len(points))
    path = save(suffix, data)
    if suffix == ".npy":
        np.save(path, points)
    np.testing.assert_array_equal(read_points(path, columns=4), [*XYZ, (0, 0, 0.5)])


BINARY = b"".join(struct.pack("<4f", *point, 9) for point in XYZ)


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "has no header that ends with DATA"),
        (b"# .PCD\n" * 100_000, "has no header that ends with DATA"),
        (pcd("binary", BINARY[:-1]), "is cut short: its header claims 48 bytes, 47 are there"),
        (pcd("binary", BINARY, points=10**17), "claims 1600000000000000000 bytes, 48 are there"),
        (pcd("ascii", b"1 2 3 4\n" * 2), "claims 12 numbers, 8 are there"),
        (pcd("ascii", b"1 2 x 4\n" * 3), "could not convert"),
        (pcd("binary", BINARY, points=-3), "'-3' for a count"),
        (pcd("binary", BINARY).replace(b"POINTS 3", b"POINTS 2"), "2 POINTS, but WIDTH x HEIGHT"),
        (pcd("binary", BINARY, fields="x y w intensity"), "no field z of a known type"),
        (pcd("binary", BINARY, kind="F F Q F"), "no field z of a known type"),
        (pcd("binary", BINARY, size="4 4 3 5"), "no field z of a known type"),
        (pcd("binary", BINARY, count="1 1"), "FIELDS, SIZE, TYPE and COUNT do not match"),
        (pcd("zip", BINARY), "DATA 'zip', not ascii"),
        (pcd("binary_compressed", b"\0\0"), "no sizes after its header"),
        (pcd("binary_compressed", struct.pack("<II", 9, 48)), "claims 9 bytes, 0 are there"),
        (pcd("binary_compressed", struct.pack("<II", 1, 99) + b"\0"), "unpacks to 99 bytes"),
        (pcd("binary_compressed", struct.pack("<II", 2, 48) + b"\x20\x05"), "what is not there"),
        (pcd("binary_compressed", struct.pack("<II", 2, 48) + b"\x05\x01"), "do not unpack"),
    ],
)
def test_it_names_what_is_wrong_with_a_pcd(save, data: bytes, told: str) -> None:
    with pytest.raises(UserError, match=rf"cloud\.pcd .*{told}.*: replace it"):
        read_points(save(".pcd", data))


def test_it_unpacks_no_more_than_lzf_can(save) -> None:
    body = struct.pack("<II", 3, 16 * 10**6) + b"\0\0\0"
    with pytest.raises(UserError, match="claims 16000000 bytes, of which, 264 are there"):
        read_points(save(".pcd", pcd("binary_compressed", body, points=10**6)))


# -------------------------------------------------------------------------------------------- ply


def ply(form: str, elements: str, body: bytes) -> bytes:
    return f"ply\nformat {form} 1.0\ncomment by hand\n{elements}end_header\n".encode() + body


VERTEX = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(("form", "order"), [("little", "<"), ("big", ">")])
def test_it_reads_a_binary_ply_of_either_byte_order(save, form: str, order: str) -> None:
    vertex = "element vertex 3\nproperty uchar red\nproperty float64 y\n"
    vertex += "property float x\nproperty short z\n"
    body = b"".join(struct.pack(order + "Bdfh", 200, y, x, round(z)) for x, y, z in XYZ)
    path = save(".ply", ply(f"binary_{form}_endian", vertex, body))
    np.testing.assert_array_equal(read_points(path), [(x, y, round(z)) for x, y, z in XYZ])


def test_it_reads_a_ply_whose_vertices_come_after_lists(save) -> None:
    before = "element camera 2\nproperty float focal\nproperty int id\n"
    before += "element face 2\nproperty list uchar int vertex_indices\nproperty uchar flag\n"
    head = struct.pack("<fifi", 1, 2, 3, 4)
    faces = struct.pack("<B3iB", 3, 0, 1, 2, 7) + struct.pack("<BB", 0, 7)
    vertices = b"".join(struct.pack("<3f", *point) for point in XYZ)
    data = ply("binary_little_endian", before + VERTEX, head + faces + vertices)
    np.testing.assert_array_equal(read_points(save(".ply", data)), XYZ)


def test_it_reads_an_ascii_ply_with_either_line_end(save) -> None:
    face = "element face 1\nproperty list uchar int vertex_indices\n"
    body = b"3 0 1 2\n1 -2 0.5\n-3.5 4 0.25\n10 20 -1.75\n"
    data = ply("ascii", face + VERTEX, body)
    np.testing.assert_array_equal(read_points(save(".ply", data)), XYZ)
    np.testing.assert_array_equal(read_points(save(".ply", data.replace(b"\n", b"\r\n"))), XYZ)


LIST = "element face {}\nproperty list {} float a\n"


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"ply\n", "has no header that ends with end_header"),
        (ply("ascii", VERTEX, b"").replace(b"ply\n", b"plx\n"), "header line 'plx'"),
        (ply("binary", VERTEX, b""), "header line 'format binary 1.0'"),
        (ply("ascii", "", b""), "has no element vertex"),
        (ply("ascii", VERTEX, b"1 2 3\n" * 2), "claims 3 lines, 2 are there"),
        (ply("ascii", VERTEX, b"1 2 3 4\n" * 3), "a vertex that is not 3 numbers"),
        (ply("ascii", VERTEX, b"1 2 x\n" * 3), "could not convert"),
        (ply("ascii", VERTEX.replace(" z", " w"), b""), "a vertex without x, y, z"),
        (ply("ascii", VERTEX + "property list uchar int q\n", b""), "or with a list"),
        (ply("ascii", VERTEX.replace("float z", "half z"), b""), "unknown type 'half'"),
        (ply("binary_big_endian", VERTEX, b"\0" * 35), "claims 36 bytes, 35 are there"),
        (ply("binary_big_endian", VERTEX.replace("3", "9" * 17), b""), "bytes, 0 are there"),
        (
            ply("binary_little_endian", LIST.format(9**15, "uint") + VERTEX, b"\xff" * 8),
            "is cut short",
        ),
        (ply("binary_little_endian", LIST.format(1, "int") + VERTEX, b"\xff" * 8), "fewer than no"),
        (ply("binary_little_endian", LIST.format(1, "float") + VERTEX, b""), "length is a float"),
    ],
)
def test_it_names_what_is_wrong_with_a_ply(save, data: bytes, told: str) -> None:
    with pytest.raises(UserError, match=rf"cloud\.ply .*{told}.*: replace it"):
        read_points(save(".ply", data))


# -------------------------------------------------------------------------------------------- las

RECORD_BYTES = {0: 20, 1: 28, 2: 26, 3: 34, 4: 57, 5: 63, 6: 30, 7: 36, 8: 38, 9: 59, 10: 67}


def las(minor: int, form: int, *, extra: int = 0, number: int = 3) -> bytes:
    """LAS 1.2 to 1.4 of XYZ, one VLR's worth of filler between header and points."""
    scale, offset = (0.25, 0.5, 0.25), (1.0, 0.0, -2.0)
    size = {2: 227, 3: 235, 4: 375}[minor]
    stride = RECORD_BYTES[form] + extra
    header = bytearray(size)
    header[:4] = b"LASF"
    header[24:26] = bytes([1, minor])
    struct.pack_into("<HI", header, 94, size, size + 54)
    struct.pack_into("<BHI", header, 104, form, stride, 0 if minor == 4 else number)
    struct.pack_into("<6d", header, 131, *scale, *offset)
    if minor == 4:
        struct.pack_into("<Q", header, 247, number)
    points = b""
    for point in XYZ:
        raw = [round((a - o) / s) for a, s, o in zip(point, scale, offset, strict=True)]
        points += struct.pack("<3i", *raw) + b"\x55" * (stride - 12)
    return bytes(header) + b"\xaa" * 54 + points


@pytest.mark.parametrize(
    ("minor", "form"),
    [(2, 0), (2, 1), (2, 2), (2, 3), (3, 4), (3, 5), *((4, f) for f in range(11))],
)
def test_it_reads_every_point_format_of_las(save, minor: int, form: int) -> None:
    np.testing.assert_array_equal(read_points(save(".las", las(minor, form, extra=form))), XYZ)


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"LASF" + b"\0" * 100, "has no LAS header"),
        (b"LASX" + las(2, 0)[4:], "has no LAS header"),
        (las(2, 0)[:-1], "claims 341 bytes, 340 are there"),
        (las(4, 6, number=2**63), "bytes, 519 are there"),
        (las(2, 0)[:24] + b"\x02\x00" + las(2, 0)[26:], r"is LAS 2\.0"),
        (las(2, 0)[:104] + b"\x83" + las(2, 0)[105:], r"is compressed \(LAZ\): unpack"),
        (las(2, 0)[:104] + b"\x0b" + las(2, 0)[105:], "point format 11 with 20 bytes"),
        (las(2, 0)[:104] + b"\x03" + las(2, 0)[105:], "point format 3 with 20 bytes"),
        (las(2, 0)[:131] + b"\0" * 8 + las(2, 0)[139:], "a scale that is not above 0"),
        (las(2, 0)[:131] + b"\xff" * 8 + las(2, 0)[139:], "a scale that is not above 0"),
    ],
)
def test_it_names_what_is_wrong_with_a_las(save, data: bytes, told: str) -> None:
    with pytest.raises(UserError, match=rf"cloud\.las .*{told}.*: replace it"):
        read_points(save(".las", data))


# -------------------------------------------------------------------------------------------- any


def test_it_refuses_clouds_in_the_coordinates_of_a_map(save) -> None:
    moved = bytearray(las(2, 0))
    struct.pack_into("<3d", moved, 155, 612_000.0, 5_512_000.0, 230.0)
    with pytest.raises(UserError, match=r"cloud\.las: most points lie more than 10 km .* of a map"):
        read_points(save(".las", bytes(moved)))


@pytest.mark.parametrize(
    ("suffix", "told"),
    [
        (".laz", "is compressed: unpack it to .las"),
        (".xyz", r"is no cloud by its suffix: save it as \.bin, \.npy, \.pcd, \.ply, \.las"),
        ("", "is no cloud by its suffix"),
    ],
)
def test_it_refuses_other_suffixes_with_a_way_out(save, suffix: str, told: str) -> None:
    with pytest.raises(UserError, match=told):
        read_points(save(suffix, b"\0" * 48))


@pytest.mark.parametrize("suffix", [".bin", ".npy", ".pcd", ".ply", ".las"])
def test_it_names_a_missing_file_and_a_folder(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"cloud{suffix}"
    with pytest.raises(UserError, match=rf"cloud\{suffix} is missing"):
        read_points(path)
    path.mkdir()
    with pytest.raises(UserError, match=rf"cloud\{suffix} "):
        read_points(path)


def test_it_reads_suffixes_in_capitals(save) -> None:
    path = save(".PCD", pcd("binary", BINARY))
    np.testing.assert_array_equal(read_points(path), XYZ)
