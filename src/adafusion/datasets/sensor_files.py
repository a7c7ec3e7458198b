# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The files of one frame: an image or a cloud on disk, whole or refused by name."""

from __future__ import annotations

import io
import zlib
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from adafusion.files import atomic_path
from adafusion.types import Observation, UserError

IMAGE_SUFFIXES = (".png", ".jpg")


def read_image(path: str | Path) -> UInt8[np.ndarray, "h w 3"]:
    """Read a PNG or JPEG file as RGB; UserError where it is missing, cut short or damaged."""
    return decode_image(read_bytes(Path(path), "image"), path)


def decode_image(data: bytes, path: str | Path) -> UInt8[np.ndarray, "h w 3"]:
    """Decode the bytes of a PNG or JPEG file to RGB; `path` serves the error message only."""
    # decoders differ in what they make of a cut file: a part filled up with grey, or an error
    whole = _is_whole(data)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if whole else None
    if image is None:
        raise _damaged(path, "is damaged or cut short", "image")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def read_cloud(path: str | Path) -> Float32[np.ndarray, "n 3"]:
    """Read a cloud, body frame, metres; UserError where it is damaged, empty or not finite."""
    try:
        with Path(path).open("rb") as file:
            points = np.load(file, allow_pickle=False)
    except FileNotFoundError:
        raise _damaged(path, "is missing", "cloud") from None
    except Exception as error:  # a damaged header is parsed as Python, and fails as anything
        raise _damaged(path, f"is damaged ({error})", "cloud") from error
    if points.dtype != np.float32 or points.ndim != 2 or points.shape[1] != 3:
        raise UserError(
            f"{path} holds {points.dtype} {points.shape}, not float32 (N, 3): save x, y, z alone, "
            "as points[:, :3].astype(np.float32)"
        )
    return check_points(points, path)


def check_points(points: Float[np.ndarray, "n 3"], path: str | Path) -> Float[np.ndarray, "n 3"]:
    """Return `points` if there are any and all are finite; else UserError that names `path`."""
    if len(points) == 0:
        raise _damaged(path, "holds no points", "cloud")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise _damaged(path, f"holds NaN or infinite points ({np.sum(~finite)})", "cloud")
    return points


def read_bytes(path: Path, kind: str) -> bytes:
    """All bytes of a sensor file; UserError where it cannot be read. `kind`: "image" or "cloud"."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise _damaged(path, "is missing", kind) from None
    except OSError as error:
        raise _damaged(path, f"cannot be read ({error.strerror})", kind) from error


def _damaged(path: str | Path, what: str, kind: str) -> UserError:
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
