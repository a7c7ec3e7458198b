# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""ROS images as RGB and ROS clouds as points of the body frame.

Definitions: sensor_msgs of ROS 1 and 2, whose encodings are those of `image_encodings`, and the
formats that image_transport writes into a CompressedImage.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from adafusion.datasets.sensor_files import decode_image
from adafusion.geometry import transform
from adafusion.readers.bag.messages import COMPRESSED, Message, decode, refused
from adafusion.readers.calibration import Calibration, undistort
from adafusion.types import UserError

_FARTHEST_M = 1e6  # no LiDAR sees so far: garbage


def decode_cloud(
    message: Message, T_body_lidar: Float[np.ndarray, "4 4"]
) -> Float32[np.ndarray, "n 3"]:
    """Points in the body frame, without those that are no returns.

    Dropped: NaN and infinite points, and points at the sensor's own origin, which is what some
    drivers fill the gaps of an organised cloud with.
    """
    cloud = decode(message)
    with np.errstate(invalid="ignore"):  # NaN may signal
        points = _points(cloud, message)
        # what is compared with NaN is False
        real = (np.abs(points) < _FARTHEST_M).all(axis=1) & (points != 0).any(axis=1)
    return transform(T_body_lidar, points[real]).astype(np.float32)


_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def _points(cloud: Any, where: Message) -> Float[np.ndarray, "n 3"]:
    """x, y, z of every point in the cloud's own frame, NaN and all."""
    fields = {field.name: field for field in cloud.fields}
    width, height, step = int(cloud.width), int(cloud.height), int(cloud.point_step)
    row_step = int(cloud.row_step) if height > 1 else width * step  # some drivers leave it 0
    order = ">" if cloud.is_bigendian else "<"
    remedy = "mend the driver, or choose another --cloud-topic"
    if lacking := [axis for axis in "xyz" if axis not in fields]:
        raise UserError(f"{where} has no field {', '.join(lacking)}: {remedy}")
    types = [_NUMBERS.get(int(fields[axis].datatype)) for axis in "xyz"]
    offsets = [int(fields[axis].offset) for axis in "xyz"]
    if width == 0 or height == 0:
        return np.empty((0, 3), np.float32)
    if None in types or any(
        offset + int(str(kind)[1]) > step for offset, kind in zip(offsets, types, strict=True)
    ):
        raise UserError(f"{where} has x, y, z outside its points of {step} bytes: {remedy}")
    if row_step < width * step or (height - 1) * row_step + width * step > len(cloud.data):
        raise UserError(
            f"{where} claims {height} rows of {width} points of {step} bytes, {row_step} bytes a "
            f"row, in {len(cloud.data)} bytes: {remedy}"
        )
    columns = [
        np.ndarray((height, width), order + str(kind), cloud.data, offset, (row_step, step))
        for kind, offset in zip(types, offsets, strict=True)
    ]
    wide = np.float32 if set(types) == {"f4"} else np.float64
    return np.stack([column.ravel().astype(wide) for column in columns], axis=1)


# ------------------------------------------------------------------------------------------ images


class _Encoding(NamedTuple):
    channels: int
    to_rgb: int | None  # OpenCV's conversion
    sample_bytes: int = 1


_ENCODINGS = {
    "rgb8": _Encoding(3, None),
    "bgr8": _Encoding(3, cv2.COLOR_BGR2RGB),
    "8UC3": _Encoding(3, cv2.COLOR_BGR2RGB),  # by the convention of cv_bridge
    "rgba8": _Encoding(4, cv2.COLOR_RGBA2RGB),
    "bgra8": _Encoding(4, cv2.COLOR_BGRA2RGB),
    "mono8": _Encoding(1, cv2.COLOR_GRAY2RGB),
    "8UC1": _Encoding(1, cv2.COLOR_GRAY2RGB),
    "mono16": _Encoding(1, cv2.COLOR_GRAY2RGB, 2),
    "yuv422": _Encoding(2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": _Encoding(2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": _Encoding(2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": _Encoding(2, cv2.COLOR_YUV2RGB_YUY2),
    "bayer_rggb8": _Encoding(1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": _Encoding(1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": _Encoding(1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": _Encoding(1, cv2.COLOR_BayerGRBG2RGB),
}


def encoded_suffix(message: Message, calibration: Calibration) -> str:
    """ ".jpg" where `decode_picture` will hand a JPEG on as it is, else ".png"."""
    if message.kind != COMPRESSED or calibration.bends:
        return ".png"
    try:
        value = decode(message)
    except UserError:  # `decode_picture` will say it, of this frame
        return ".png"
    jpeg = bytes(value.data[:2]) == b"\xff\xd8" and _mosaic(value) is None
    return ".jpg" if jpeg else ".png"


def decode_picture(
    message: Message, calibration: Calibration, size: tuple[int, int] | None
) -> UInt8[np.ndarray, "h w 3"] | bytes:
    """The RGB image, undistorted; or the file in the message, whole and checked, if it will do.

    `size` is the (width, height) that the calibration is of, where that is known.
    """
    value = decode(message)
    data: bytes | None = None
    if message.kind == COMPRESSED:
        data = bytes(value.data)
        image = decode_image(data, str(message))
        if (mosaic := _mosaic(value)) is not None:
            with refused(message, "choose another --image-topic"):
                image = cv2.cvtColor(np.ascontiguousarray(image[..., 0]), mosaic)
            data = None
        elif not data.startswith((b"\xff\xd8", b"\x89PNG")):
            data = None  # another format, which a dataset does not keep
    else:
        image = _raw_image(value, message)
    if size is not None and (image.shape[1], image.shape[0]) != size:
        raise UserError(
            f"{message} is an image of {image.shape[1]}x{image.shape[0]} pixels, its camera info "
            f"is of {size[0]}x{size[1]}: give the calibration of these images with --calibration"
        )
    if calibration.bends and calibration.K is not None:
        lens = calibration.K, calibration.distortion
        return undistort(image, *lens, fisheye=calibration.fisheye, where=message)
    return image if data is None else data


def _mosaic(value: Any) -> int | None:
    """How to make colour of a compressed image of raw pixels; None where it has colour.

    The format reads `bayer_rggb8; jpeg compressed ` there, with a colour at the end if it was
    converted before.
    """
    match = re.fullmatch(r"(bayer_[rgb]{4}8); *\w+ compressed *", value.format)
    known = _ENCODINGS.get(match[1]) if match else None
    return None if known is None else known.to_rgb


def _raw_image(value: Any, where: Message) -> UInt8[np.ndarray, "h w 3"]:
    width, height, step = int(value.width), int(value.height), int(value.step)
    encoding = _ENCODINGS.get(value.encoding)
    if encoding is None:
        raise UserError(
            f"{where} is encoded as {value.encoding!r}, not as one of {', '.join(_ENCODINGS)}: "
            "choose another --image-topic"
        )
    row = width * encoding.channels * encoding.sample_bytes
    if width == 0 or height == 0 or step < row or step * height != len(value.data):
        raise UserError(
            f"{where} claims {height} rows of {width} pixels, {step} bytes a row, in "
            f"{len(value.data)} bytes: mend the driver, or leave the message out"
        )
    pixels = value.data.reshape(height, step)[:, :row]
    if encoding.sample_bytes == 2:
        pixels = pixels[:, 0 if value.is_bigendian else 1 :: 2]  # the upper eight bits
    pixels = np.ascontiguousarray(pixels.reshape(height, width, encoding.channels))
    if encoding.to_rgb is None:
        return pixels
    with refused(where, "choose another --image-topic"):
        return cv2.cvtColor(pixels, encoding.to_rgb)
