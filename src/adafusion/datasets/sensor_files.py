# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The files of one frame: an image or a cloud on disk, whole or refused by name."""

from __future__ import annotations

import contextlib
import io
import math
import os
import zlib
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Float32, Shaped, UInt8

from adafusion.files import atomic_path
from adafusion.types import Observation, UserError

IMAGE_SUFFIXES = (".png", ".jpg")

_MOST_PIXELS = 2**27  # no camera has as many, and a damaged header may claim any number
_NPY_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_image(path: str | Path) -> UInt8[np.ndarray, "h w 3"]:
    """Read a PNG or JPEG file as RGB; UserError where it is missing, cut short or damaged."""
    return decode_image(read_bytes(Path(path), "image"), path)


def decode_image(data: bytes, path: str | Path) -> UInt8[np.ndarray, "h w 3"]:
    """Decode the bytes of a PNG or JPEG file to RGB; `path` serves the error message only."""
    # decoders differ in what they make of a cut file: a part filled up with grey, or an error
    image = None
    if _is_whole(data) and _claimed_pixels(data) <= _MOST_PIXELS:
        with contextlib.suppress(cv2.error):  # of an image too large for it
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise damaged(path, "is damaged or cut short", "image")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def read_cloud(path: str | Path) -> Float32[np.ndarray, "n 3"]:
    """Read a cloud, body frame, metres; UserError where it is damaged, empty or not finite."""
    points = load_array(path)
    if points.dtype != np.float32 or points.ndim != 2 or points.shape[1] != 3:
        raise UserError(
            f"{path} holds {points.dtype} {points.shape}, not float32 (N, 3): save x, y, z alone, "
            "as points[:, :3].astype(np.float32)"
        )
    return check_points(points, path)


def load_array(path: str | Path) -> Shaped[np.ndarray, "*shape"]:
    """The array of a .npy file of a cloud; UserError where it is damaged or claims too much."""
    try:
        with Path(path).open("rb") as file:
            version = np.lib.format.read_magic(file)
            read_header = _NPY_HEADERS[version]
            shape, _, dtype = read_header(file)
            there = os.fstat(file.fileno()).st_size - file.tell()
            # asked for first: NumPy would take memory for whatever the header claims
            if not dtype.hasobject and math.prod(shape) * dtype.itemsize > there:
                raise ValueError(f"its header claims {dtype} {shape}, {there} bytes are there")
            file.seek(0)
            return np.lib.format.read_array(file, allow_pickle=False)
    except FileNotFoundError:
        raise damaged(path, "is missing", "cloud") from None
    except Exception as error:  # a damaged header is parsed as Python, and fails as anything
        raise damaged(path, f"is damaged ({error})", "cloud") from error


def check_points(points: Float[np.ndarray, "n 3"], path: str | Path) -> Float[np.ndarray, "n 3"]:
    """Return `points` if there are any and all are finite; else UserError that names `path`."""
    if len(points) == 0:
        raise damaged(path, "holds no points", "cloud")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise damaged(path, f"holds NaN or infinite points ({np.sum(~finite)})", "cloud")
    return points


def read_bytes(path: Path, kind: str) -> bytes:
    """All bytes of a sensor file; UserError where it cannot be read. `kind`: "image" or "cloud"."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise damaged(path, "is missing", kind) from None
    except OSError as error:
        raise damaged(path, f"cannot be read ({error.strerror})", kind) from error


def damaged(path: str | Path, what: str, kind: str) -> UserError:
    """What to say of a sensor file that cannot be used. `kind`: "image" or "cloud"."""
    return UserError(f"{path} {what}: replace it with a whole {kind}, or leave it out")


def _is_whole(data: bytes) -> bool:
    """Whether a PNG has all chunks with right sums up to IEND, a JPEG its end marker."""
    if data.startswith(b"\xff\xd8"):
        return data.rstrip(b"\0").endswith(b"\xff\xd9")  # some cameras pad with zeros
    if not data.startswith(b"\x89PNG\r\n\x1a\n"):
        return len(data) > 0  # another format: the decoder's word is all there is
    start = 8
    while start + 12 <= len(data):
        end = start + 12 + int.from_bytes(data[start : start + 4], "big")
        body, checksum = data[start + 4 : end - 4], data[end - 4 : end]
        if end > len(data) or zlib.crc32(body) != int.from_bytes(checksum, "big"):
            return False
        if body.startswith(b"IEND"):
            return True
        start = end
    return False


def _claimed_pixels(data: bytes) -> int:
    """Width times height by the header of a PNG or JPEG; 0 where there is none."""
    if data.startswith(b"\x89PNG"):
        width, height = data[16:20], data[20:24]
        return int.from_bytes(width, "big") * int.from_bytes(height, "big")
    start = 2
    while data.startswith(b"\xff\xd8") and start + 9 <= len(data) and data[start] == 0xFF:
        marker, length = data[start + 1], int.from_bytes(data[start + 2 : start + 4], "big")
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):  # start of frame
            height, width = data[start + 5 : start + 7], data[start + 7 : start + 9]
            return int.from_bytes(width, "big") * int.from_bytes(height, "big")
        start += 2 + length
    return 0


def write_observation(
    folder: str | Path,
    run: str,
    timestamp_us: int,
    observation: Observation,
    image_suffix: str = ".png",
) -> tuple[str | None, str | None]:
    """Write what the sensors saw, each file atomically; usable from any process.

    `folder` is the writer's `folder`. Returns the names of image and cloud relative to it, None
    for a sensor that gave nothing.
    """
    image, points = observation.image, observation.points_body
    return (
        None if image is None else write_image(folder, run, timestamp_us, image, image_suffix),
        None if points is None else write_cloud(folder, run, timestamp_us, points),
    )


def write_image(
    folder: str | Path,
    run: str,
    timestamp_us: int,
    image: UInt8[np.ndarray, "h w 3"] | bytes,
    suffix: str = ".png",
) -> str:
    """Write an RGB image, or the bytes of an encoded one as they are; return its relative name."""
    if suffix not in IMAGE_SUFFIXES:
        raise ValueError(f"image suffix {suffix!r} is none of {IMAGE_SUFFIXES}")
    if not isinstance(image, bytes):
        done, encoded = cv2.imencode(suffix, cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        if not done:
            raise ValueError(f"an image of shape {image.shape} cannot be encoded as {suffix}")
        image = encoded.tobytes()
    name = f"{run}/images/{timestamp_us}{suffix}"
    with atomic_path(Path(folder) / name) as temporary:
        temporary.write_bytes(image)
    return name


def write_cloud(
    folder: str | Path, run: str, timestamp_us: int, points_body: Float[np.ndarray, "n 3"]
) -> str:
    """Write a cloud given in the body frame, metres, as float32; return its relative name.

    ValueError where it is empty or not finite: a LiDAR that saw nothing has no cloud, so None.
    """
    if len(points_body) == 0 or not np.isfinite(points_body).all():
        raise ValueError(f"the cloud of {run}/{timestamp_us} is empty or not finite")
    name = f"{run}/clouds/{timestamp_us}.npy"
    encoded = io.BytesIO()  # straight to a file, NumPy would not say that the disk is full
    np.save(encoded, points_body.astype(np.float32, copy=False), allow_pickle=False)
    with atomic_path(Path(folder) / name) as temporary:
        temporary.write_bytes(encoded.getbuffer())
    return name
