# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Messages put together byte by byte from their public definitions."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest

from adafusion.geometry import pose, rotation_from_rpy
from adafusion.readers.bag.messages import (
    CAMERA_INFO,
    CLOUD,
    COMPRESSED,
    FIX,
    IMAGE,
    Message,
    decode_camera_info,
    decode_fix,
    decode_pose,
    decode_transforms,
    header,
)
from adafusion.readers.bag.sensors import decode_cloud, decode_picture, encoded_suffix
from adafusion.readers.calibration import Calibration, undistort
from adafusion.types import UserError

NO_LENS = Calibration()
STAMP_S, STAMP_NS = 1_700_000_000, 123_456_789


class Cdr:
    """Plain CDR as ROS 2 writes it: each number aligned to its size, counted after four bytes."""

    def __init__(self, order: str = "<") -> None:
        self.order = order
        self.data = b""

    def put(self, codes: str, *values: float) -> Cdr:
        for code, value in zip(codes, values, strict=True):
            self.data += b"\0" * (-len(self.data) % struct.calcsize(code))
            self.data += struct.pack(self.order + code, value)
        return self

    def text(self, text: str) -> Cdr:
        data = text.encode() + b"\0"
        self.put("I", len(data)).data += data
        return self

    def blob(self, data: bytes) -> Cdr:
        self.put("I", len(data)).data += data
        return self

    def header(self, frame: str, s: int = STAMP_S, ns: int = STAMP_NS) -> Cdr:
        return self.put("iI", s, ns).text(frame)

    def message(self, kind: str) -> Message:
        mark = b"\0\1\0\0" if self.order == "<" else b"\0\0\0\0"
        return Message("a.mcap", "/topic", kind, False, 10**18, mark + self.data)


def cloud_message(
    data: bytes,
    fields: list[tuple[str, int, int]],
    *,
    width: int,
    height: int = 1,
    point_step: int = 16,
    row_step: int | None = None,
    big_endian: bool = False,
    cdr: str = "<",
) -> Message:
    cdr_ = Cdr(cdr).header("lidar").put("IIi", height, width, len(fields))
    for name, offset, datatype in fields:
        cdr_.text(name).put("IBI", offset, datatype, 1)
    row = width * point_step if row_step is None else row_step
    return cdr_.put("BII", big_endian, point_step, row).blob(data).put("B", 0).message(CLOUD)


XYZI = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7)]


def image_message(
    encoding: str, pixels: bytes, *, width: int, height: int, step: int, big_endian: int = 0
) -> Message:
    cdr = Cdr().header("camera").put("II", height, width).text(encoding)
    return cdr.put("BI", big_endian, step).blob(pixels).message(IMAGE)


def compressed_message(form: str, data: bytes) -> Message:
    return Cdr().header("camera").text(form).blob(data).message(COMPRESSED)


def test_header_reads_time_and_frame_of_either_byte_order() -> None:
    for order in "<>":
        read = header(Cdr(order).header("/base").message(IMAGE))
        assert read == (1_700_000_000_123_456, "base")


def test_header_reads_ros1() -> None:
    raw = struct.pack("<IIII", 77, STAMP_S, STAMP_NS, 5) + b"lidar" + b"whatever follows"
    assert header(Message("a.bag", "/t", CLOUD, True, 0, raw)) == (1_700_000_000_123_456, "lidar")


def test_header_refuses_a_frame_that_is_cut() -> None:
    cut = Message("a.mcap", "/t", CLOUD, False, 5_000_000_001, b"\0\1\0\0" + b"\1\0\0\0" * 3)
    with pytest.raises(UserError, match=r"a\.mcap: the message of /t received at 5\.000000001 s"):
        header(cut)


def test_cloud_is_moved_into_the_body() -> None:
    T = pose(rotation_from_rpy(0.0, 0.0, np.pi / 2), (1.0, 0.0, 2.0))
    message = cloud_message(struct.pack("<4f", 1, 2, 3, 9), XYZI, width=1)
    np.testing.assert_allclose(decode_cloud(message, T), [[-1, 1, 5]], atol=1e-6)


def test_cloud_of_ros1_is_byte_exact() -> None:
    points = np.array([[1.5, -2.25, 3.125, 7], [0.1, 0.2, 0.3, 8]], "<f4")
    raw = struct.pack("<IIII", 1, STAMP_S, STAMP_NS, 1) + b"l" + struct.pack("<III", 1, 2, 3)
    for name, offset in (("x", 0), ("y", 4), ("z", 8)):
        raw += struct.pack("<I", 1) + name.encode() + struct.pack("<IBI", offset, 7, 1)
    raw += struct.pack("<BIII", 0, 16, 32, 32) + points.tobytes() + b"\1"
    decoded = decode_cloud(Message("a.bag", "/t", CLOUD, True, 0, raw), np.eye(4))
    assert decoded.dtype == np.float32
    assert decoded.tobytes() == points[:, :3].tobytes()


def test_cloud_may_have_fields_in_any_order_and_type() -> None:
    fields = [("z", 0, 8), ("ring", 8, 4), ("y", 10, 7), ("x", 14, 3)]
    record = struct.pack("<dHfh", 3.5, 99, -2.0, 4) + b"padding"
    message = cloud_message(record * 2, fields, width=2, point_step=len(record))
    np.testing.assert_array_equal(decode_cloud(message, np.eye(4)), [[4, -2, 3.5]] * 2)


def test_cloud_may_be_big_endian_in_either_wire_order() -> None:
    data = struct.pack(">4f", 1, 2, 3, 0)
    for order in "<>":
        message = cloud_message(data, XYZI, width=1, big_endian=True, cdr=order)
        np.testing.assert_array_equal(decode_cloud(message, np.eye(4)), [[1, 2, 3]])


def test_organised_cloud_has_padded_rows_and_gaps() -> None:
    nan = float("nan")
    rows = [
        struct.pack("<8f", 1, 1, 1, 0, nan, nan, nan, 0) + b"\xff" * 12,
        struct.pack("<8f", 0, 0, 0, 5, 2, 2, 2, 0) + b"\xff" * 12,
    ]
    message = cloud_message(b"".join(rows), XYZI, width=2, height=2, row_step=44)
    np.testing.assert_array_equal(decode_cloud(message, np.eye(4)), [[1, 1, 1], [2, 2, 2]])


def test_cloud_of_one_row_needs_no_row_step() -> None:
    message = cloud_message(struct.pack("<4f", 1, 2, 3, 0), XYZI, width=1, row_step=0)
    assert len(decode_cloud(message, np.eye(4))) == 1


def test_empty_cloud_has_no_points() -> None:
    assert decode_cloud(cloud_message(b"", XYZI, width=0), np.eye(4)).shape == (0, 3)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"width": 3}, "claims 1 rows of 3 points"),
        ({"width": 2**32 - 1, "height": 2**32 - 1, "point_step": 16, "row_step": 0}, "claims"),
        ({"width": 1, "height": 2, "row_step": 8}, "8 bytes a row"),
        ({"width": 2, "point_step": 8}, "outside its points of 8 bytes"),
        ({"width": 2, "point_step": 0}, "outside its points of 0 bytes"),
    ],
)
def test_cloud_that_claims_what_it_has_not_is_refused(change: dict[str, int], says: str) -> None:
    with pytest.raises(UserError, match=says):
        decode_cloud(cloud_message(b"\0" * 32, XYZI, **change), np.eye(4))


def test_cloud_without_z_is_refused() -> None:
    with pytest.raises(UserError, match="no field z"):
        decode_cloud(cloud_message(b"\0" * 16, XYZI[:2], width=1), np.eye(4))


def test_cloud_of_absurd_numbers_is_dropped_quietly() -> None:
    fields = [("x", 0, 8), ("y", 8, 8), ("z", 16, 8)]
    data = struct.pack("<3d", 1e300, 1, 1) + struct.pack("<3d", 1, 1, 1)
    message = cloud_message(data, fields, width=2, point_step=24)
    assert decode_cloud(message, np.eye(4)).shape == (1, 3)


RGB = np.array([[[10, 20, 30], [40, 50, 60]], [[70, 80, 90], [100, 110, 120]]], np.uint8)


@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("rgb8", RGB),
        ("bgr8", RGB[..., ::-1]),
        ("8UC3", RGB[..., ::-1]),
        ("rgba8", np.dstack([RGB, np.full((2, 2), 7, np.uint8)])),
        ("bgra8", np.dstack([RGB[..., ::-1], np.full((2, 2), 7, np.uint8)])),
    ],
)
def test_colour_images_become_rgb(encoding: str, pixels: np.ndarray) -> None:
    row = 2 * pixels.shape[2]
    padded = np.hstack([pixels.reshape(2, row), np.full((2, 3), 255, np.uint8)])
    message = image_message(encoding, padded.tobytes(), width=2, height=2, step=row + 3)
    np.testing.assert_array_equal(decode_picture(message, NO_LENS, (2, 2)), RGB)


def test_grey_images_become_rgb() -> None:
    grey = np.array([[0, 128, 255]], np.uint8)
    expected = np.repeat(grey[..., None], 3, axis=2)
    message = image_message("mono8", grey.tobytes(), width=3, height=1, step=3)
    np.testing.assert_array_equal(decode_picture(message, NO_LENS, None), expected)
    for order in "<>":
        deep = (grey.astype(int) * 256 + 99).astype(order + "u2").tobytes()
        message = image_message(
            "mono16", deep, width=3, height=1, step=6, big_endian=int(order == ">")
        )
        np.testing.assert_array_equal(decode_picture(message, NO_LENS, None), expected)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_mosaics_become_the_colour_that_made_them(pattern: str) -> None:
    colour = {"r": 200, "g": 100, "b": 50}
    cell = np.array([colour[letter] for letter in pattern], np.uint8).reshape(2, 2)
    mosaic = np.tile(cell, (4, 4))
    raw = image_message(f"bayer_{pattern}8", mosaic.tobytes(), width=8, height=8, step=8)
    png = cv2.imencode(".png", mosaic)[1].tobytes()
    kept = compressed_message(f"bayer_{pattern}8; png compressed ", png)
    for message in (raw, kept):
        image = decode_picture(message, NO_LENS, None)
        np.testing.assert_array_equal(image[2:-2, 2:-2], np.tile([200, 100, 50], (4, 4, 1)))
    assert encoded_suffix(kept, NO_LENS) == ".png"


def test_yuv_images_have_their_colour_in_the_right_place() -> None:
    # BT.601 of studio range: Y 81, U 90, V 240 is red
    for encoding, order in (("yuv422", (90, 81, 240, 81)), ("yuv422_yuy2", (81, 90, 81, 240))):
        message = image_message(encoding, bytes(order), width=2, height=1, step=4)
        np.testing.assert_allclose(
            decode_picture(message, NO_LENS, None), [[[255, 0, 0]] * 2], atol=3
        )


def test_jpeg_and_png_are_kept_byte_for_byte() -> None:
    for suffix, form in ((".jpg", "rgb8; jpeg compressed bgr8"), (".png", "png")):
        data = cv2.imencode(suffix, RGB)[1].tobytes()
        message = compressed_message(form, data)
        assert decode_picture(message, NO_LENS, (2, 2)) == data
        assert encoded_suffix(message, NO_LENS) == suffix


def test_another_compression_is_decoded() -> None:
    data = cv2.imencode(".bmp", RGB[..., ::-1])[1].tobytes()
    np.testing.assert_array_equal(
        decode_picture(compressed_message("bmp", data), NO_LENS, None), RGB
    )


def test_cut_jpeg_is_refused() -> None:
    data = cv2.imencode(".jpg", RGB)[1].tobytes()
    with pytest.raises(UserError, match=r"a\.mcap.* damaged or cut"):
        decode_picture(compressed_message("jpeg", data[:-9]), NO_LENS, None)


@pytest.mark.parametrize(
    ("encoding", "shape", "says"),
    [
        ("rgb8", {"width": 2, "height": 2, "step": 7}, "7 bytes a row, in 12 bytes"),
        ("rgb8", {"width": 2, "height": 2, "step": 3}, "3 bytes a row"),
        ("rgb8", {"width": 2**32 - 1, "height": 2**32 - 1, "step": 2**32 - 1}, "claims"),
        ("rgb8", {"width": 0, "height": 0, "step": 0}, "claims 0 rows"),
        ("32FC1", {"width": 3, "height": 1, "step": 12}, "'32FC1'"),
    ],
)
def test_image_that_is_not_what_it_says_is_refused(
    encoding: str, shape: dict[str, int], says: str
) -> None:
    with pytest.raises(UserError, match=says):
        decode_picture(image_message(encoding, b"\0" * 12, **shape), NO_LENS, None)


def test_image_of_another_size_than_its_camera_info_is_refused() -> None:
    message = image_message("rgb8", RGB.tobytes(), width=2, height=2, step=6)
    with pytest.raises(UserError, match="2x2 pixels, its camera info is of 4x4"):
        decode_picture(message, NO_LENS, (4, 4))


def test_distortion_is_undone() -> None:
    K = np.array([[40.0, 0, 31.5], [0, 40.0, 31.5], [0, 0, 1]])
    lens = Calibration(K=K, distortion=(-0.3, 0.0, 0.0, 0.0))
    # without distortion a point at x = 20 px from the axis (0.5) lies at 0.5 (1 - 0.3 0.25) 40 px
    image = np.zeros((64, 64, 3), np.uint8)
    image[:, round(31.5 + 18.5)] = 255
    message = image_message("rgb8", image.tobytes(), width=64, height=64, step=192)
    row = decode_picture(message, lens, None)[31, :, 0].astype(float)
    assert (row @ np.arange(64)) / row.sum() == pytest.approx(31.5 + 20, abs=0.6)
    assert encoded_suffix(compressed_message("jpeg", b"\xff\xd8"), lens) == ".png"


def test_fisheye_is_undone() -> None:
    K = np.array([[40.0, 0, 31.5], [0, 40.0, 31.5], [0, 0, 1]])
    lens = Calibration(K=K, distortion=(0.0, 0.0, 0.0, 0.0), fisheye=True)
    # a point at x = 20 px from the axis, atan(0.5) off it, lies at 40 atan(0.5) = 18.5 px
    image = np.zeros((64, 64, 3), np.uint8)
    image[:, round(31.5 + 18.5)] = 255
    message = image_message("rgb8", image.tobytes(), width=64, height=64, step=192)
    row = decode_picture(message, lens, None)[31, :, 0].astype(float)
    assert (row @ np.arange(64)) / row.sum() == pytest.approx(31.5 + 20, abs=0.6)
    assert encoded_suffix(compressed_message("jpeg", b"\xff\xd8"), lens) == ".png"


def test_image_that_is_too_long_to_be_undistorted_is_refused() -> None:
    lens = Calibration(K=np.diag([9.0, 9.0, 1.0]), distortion=(0.1, 0.0, 0.0, 0.0))
    message = image_message("mono8", bytes(32_767), width=32_767, height=1, step=32_767)
    with pytest.raises(UserError, match=r"a\.mcap: .*32767x1 pixels"):
        decode_picture(message, lens, None)
    fits = image_message("mono8", bytes(32_766), width=32_766, height=1, step=32_766)
    assert decode_picture(fits, lens, None).shape == (1, 32_766, 3)


def camera_info(
    distortion: list[float], model: str = "plumb_bob", *, k: float = 100.0, binning: int = 0
) -> Message:
    cdr = Cdr().header("camera").put("II", 480, 640).text(model)
    cdr.put("I", len(distortion)).put("d" * len(distortion), *distortion)
    cdr.put("d" * 9, k, 0, 320, 0, k, 240, 0, 0, 1)
    cdr.put("d" * 9, 1, 0, 0, 0, 1, 0, 0, 0, 1)
    cdr.put("d" * 12, 90, 0, 310, 0, 0, 90, 230, 0, 0, 0, 1, 0)
    return cdr.put("II", binning, binning).put("IIIIB", 0, 0, 0, 0, 0).message(CAMERA_INFO)


def test_camera_info_gives_k_and_distortion() -> None:
    info = decode_camera_info(camera_info([0.1, 0.2, 0, 0, 0]), rectified=False)
    np.testing.assert_array_equal(info.calibration.K, [[100, 0, 320], [0, 100, 240], [0, 0, 1]])
    assert info.calibration.distortion == (0.1, 0.2, 0, 0, 0)
    assert info.size == (640, 480)
    assert not info.note


def test_camera_info_of_rectified_images_gives_the_projection() -> None:
    info = decode_camera_info(camera_info([0.1, 0.2, 0, 0, 0]), rectified=True)
    np.testing.assert_array_equal(info.calibration.K, [[90, 0, 310], [0, 90, 230], [0, 0, 1]])
    assert info.calibration.distortion == ()


def test_camera_info_of_binned_images_is_that_of_fewer_pixels() -> None:
    info = decode_camera_info(camera_info([], binning=2), rectified=False)
    np.testing.assert_array_equal(info.calibration.K, [[50, 0, 160], [0, 50, 120], [0, 0, 1]])
    assert info.size == (320, 240)


def test_camera_info_says_what_it_cannot_do() -> None:
    for distortion, model in (
        ([0.1, 0, 0, 0], "fov"),
        ([0.1, 0, 0, 0, 0], "equidistant"),
        ([0.1] * 7, "rational_polynomial"),
        ([float("nan")] * 5, "plumb_bob"),
    ):
        info = decode_camera_info(camera_info(distortion, model), rectified=False)
        assert f"distortion {model!r} of {len(distortion)} numbers in /topic" in info.note
        assert "no K is kept" in info.note
        assert info.calibration.K is None
        assert not info.calibration.bends
    empty = decode_camera_info(camera_info([], k=0.0), rectified=False)
    assert "nobody calibrated" in empty.note
    assert empty.calibration.K is None


@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_camera_info_may_have_as_many_numbers_as_opencv_knows(count: int) -> None:
    info = decode_camera_info(camera_info([0.1] * count, "rational_polynomial"), rectified=False)
    assert info.calibration.distortion == (0.1,) * count
    undistort(np.zeros((4, 6, 3), np.uint8), info.calibration.K, info.calibration.distortion)


def test_camera_info_of_a_fisheye_bends_without_numbers() -> None:
    info = decode_camera_info(camera_info([0, 0, 0, 0], "equidistant"), rectified=False)
    assert info.calibration.fisheye
    assert info.calibration.bends
    assert not info.note


def test_odometry_names_its_frames() -> None:
    cdr = Cdr().header("odom").text("base_link").put("ddddddd", 1, 2, 3, 0, 0, 0, 1)
    cdr.put("d" * (36 + 6 + 36), *([0.0] * (36 + 6 + 36)))  # covariances, and the twist
    read = decode_pose(cdr.message("nav_msgs/msg/Odometry"))
    assert read == ("odom", "base_link", 1_700_000_000_123_456, (1, 2, 3), (0, 0, 0, 1))


def test_transforms_are_all_read() -> None:
    cdr = Cdr().put("I", 2)
    for child in ("a", "b"):
        cdr.header("/root").text(child).put("ddddddd", 1, 2, 3, 0, 0, 0, 1)
    one, two = decode_transforms(cdr.message("tf2_msgs/msg/TFMessage"))
    assert (one.parent, one.child, two.child) == ("root", "a", "b")
    assert one.position_m == (1, 2, 3)


def fix(status: int, latitude: float, longitude: float, altitude: float) -> Message:
    cdr = Cdr().header("gps").put("bH", status, 1)
    cdr.put("ddd", latitude, longitude, altitude).put("d" * 9, *([0.0] * 9))
    return cdr.put("B", 0).message(FIX)


def test_fix_is_taken_where_the_receiver_has_one() -> None:
    nan = float("nan")
    assert decode_fix(fix(0, 48.5, 11.25, 500)) == (48.5, 11.25, 500)
    assert decode_fix(fix(2, 48.5, 11.25, nan)) == (48.5, 11.25, 0)
    for none in (fix(-1, 48.5, 11.25, 500), fix(0, nan, nan, nan), fix(0, 0, 0, 0)):
        assert decode_fix(none) is None
