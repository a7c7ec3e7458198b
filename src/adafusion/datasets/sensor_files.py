# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The files of one frame: an image or a cloud on disk, whole or refused by name."""

from __future__ import annotations

import contextlib
import errno
import io
import math
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np
from jaxtyping import Float, Float32, Shaped, UInt8

from adafusion.datasets.image_headers import claimed_size
from adafusion.files import atomic_path
from adafusion.types import Observation, UserError

IMAGE_SUFFIXES = (".png", ".jpg")

_LARGEST_BYTES = 2**30  # of a sensor's file; a cloud of 50 million points is smaller
# A damaged header may claim any number. A lens of a Ladybug has 2 million pixels and a camera for
# surveys 50 million; of these, an image and its copy take 400 MB.
_MOST_PIXELS = 2**26
_LONGEST_SIDE_PX = 2**15 - 2  # OpenCV remaps no longer one
_NPY_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_image(path: str | Path) -> UInt8[np.ndarray, "h w 3"]:
    """Read an image file as RGB; UserError where it is missing, cut short or damaged."""
    return decode_image(read_bytes(Path(path), "image"), path)


def decode_image(data: bytes, path: str | Path) -> UInt8[np.ndarray, "h w 3"]:
    """Decode a PNG, JPEG, TIFF or BMP file to RGB; `path` serves the error message only."""
    # decoders differ in what they make of a cut file: a part filled up with grey, or an error
    try:
        height, width = claimed_size(data)
    except ValueError as error:
        raise damaged(path, str(error), "image") from None
    if height * width > _MOST_PIXELS or max(height, width) > _LONGEST_SIDE_PX:
        what = f"claims {width} x {height} pixels, more than any camera has"
        raise damaged(path, what, "image")
    image = None
    with contextlib.suppress(cv2.error):
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
        with open_regular(path, _LARGEST_BYTES) as file:
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
        with open_regular(path, _LARGEST_BYTES) as file:
            return file.read()
    except FileNotFoundError:
        raise damaged(path, "is missing", kind) from None
    except OSError as error:
        raise damaged(path, f"cannot be read ({error.strerror})", kind) from error


@contextlib.contextmanager
def open_regular(path: str | Path, largest_bytes: int) -> Iterator[BinaryIO]:
    """Open a file to read; OSError, too, where it is larger or is none.

    A folder from elsewhere may hold pipes and links to devices, whose reading never ends.
    """
    with open(path, "rb", opener=_open_at_once) as file:  # Path.open takes no opener
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "no regular file")
        if found.st_size > largest_bytes:
            raise OSError(errno.EFBIG, f"larger than {largest_bytes >> 20} MB")
        yield file


def _open_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))  # a pipe would wait for its writer


def damaged(path: str | Path, what: str, kind: str) -> UserError:
    """What to say of a sensor file that cannot be used. `kind`: "image" or "cloud"."""
    return UserError(f"{path} {what}: replace it with a whole {kind}, or leave it out")


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
