# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A camera of NCLT's Ladybug3: undistorted, turned upright, with its pose on the robot.

    K_cam5.csv              3x3 intrinsics of the undistorted picture on its side
    x_lb3_c5.csv            pose of the camera in the Ladybug's frame: metres, then roll, pitch,
                            yaw in degrees, R = Rz Ry Rx
    U2D_Cam5_1616X1232.txt  a line with width and height, then `row column raw-row raw-column` for
                            each pixel of the undistorted picture: where it lies in the raw one

The Ladybug stands so that its pictures lie on their side: a quarter turn clockwise makes them
upright. Pixel (column u, row v) of a picture of height h goes to (h - 1 - v, u), and with it turn
the axes of the camera: its new x is the old -y, its new y the old x.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from adafusion.datasets.sensor_files import decode_image, read_bytes
from adafusion.geometry import pose, rotation_from_rpy
from adafusion.readers.sensors import T_FLU_FRD
from adafusion.readers.text import read_numbers
from adafusion.types import UserError

# the Ladybug on the robot, as the paper gives it
T_NCLT_LADYBUG = pose(rotation_from_rpy(*np.radians([-179.93, -0.23, 0.50])), (0.035, 0.002, -1.23))
_T_SIDE_UPRIGHT = pose(
    np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), (0.0, 0.0, 0.0)
)

_REMEDY = "unpack cam_params and U2D of NCLT's Ladybug3 calibration at SRC, or give --calibration"
_LARGEST_SIDE = 32_766  # pixels; what the remapping can do
_SHORTEST_LINE = len("0 0 0 0\n")


@dataclass(frozen=True, eq=False, kw_only=True)
class Lens:
    """What is known of a camera whose pictures are undistorted and upright."""

    size: tuple[int, int]  # height, width
    K: Float64[np.ndarray, "3 3"]
    T_body_camera: Float64[np.ndarray, "4 4"]  # z along the view, x right, y down
    u2d: Path  # the map that undistorts


def read_lens(folder: Path, camera: str) -> Lens:
    """Calibration of a camera such as "Cam5", from files in `folder` or one level below it."""
    number = camera.removeprefix("Cam")
    u2d = _find(folder, f"U2D_{camera}_*.txt")
    K_file, pose_file = (_find(folder, f"{name}{number}.csv") for name in ("K_cam", "x_lb3_c"))
    K = read_numbers(K_file, 3, remedy=_REMEDY, delimiter=",")
    if K.shape != (3, 3) or K[0, 0] <= 0 or K[1, 1] <= 0 or not _is_plain(K):
        raise UserError(f"{K_file} is no 3x3 matrix of a camera without skew: {_REMEDY}")
    six = read_numbers(pose_file, None, remedy=_REMEDY, delimiter=",").ravel()
    if six.size != 6:
        raise UserError(f"{pose_file} holds {six.size} numbers, not 6: {_REMEDY}")
    T_ladybug_side = pose(rotation_from_rpy(*np.radians(six[3:])), tuple(six[:3].tolist()))
    height, width = _read_size(u2d)  # of the picture on its side
    (fx, _, cx), (_, fy, cy), _ = K.tolist()
    return Lens(
        size=(width, height),
        K=np.array([[fy, 0.0, height - 1 - cy], [0.0, fx, cx], [0.0, 0.0, 1.0]]),
        T_body_camera=T_FLU_FRD @ T_NCLT_LADYBUG @ T_ladybug_side @ _T_SIDE_UPRIGHT,
        u2d=u2d,
    )


def read_picture(path: Path, u2d: Path) -> UInt8[np.ndarray, "h w 3"]:
    """The RGB picture of a file, undistorted and upright; black where the lens saw nothing."""
    raw = decode_image(read_bytes(path, "image"), path)
    column, row = _upright_map(u2d)
    if raw.shape[:2] != column.shape[::-1]:
        raise UserError(
            f"{path} is {raw.shape[1]} x {raw.shape[0]}, {u2d} is for {column.shape[0]} x "
            f"{column.shape[1]}: give the map of this size, as --calibration"
        )
    return cv2.remap(raw, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)


def read_u2d(path: Path) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Column and row in the raw picture of each pixel of the undistorted one, on its side."""
    height, width = _read_size(path)
    table = read_numbers(path, 4, remedy=_REMEDY, skip_lines=1)
    place = table[:, 0] * width + table[:, 1]
    within = (table[:, :2] >= 0) & (table[:, :2] < (height, width))
    if len(table) != height * width or not within.all() or len(np.unique(place)) != len(place):
        raise UserError(
            f"{path} has no one line for each pixel of {width} x {height}: it has {len(table)}; "
            f"{_REMEDY}"
        )
    raw = np.empty((height * width, 2), np.float32)
    raw[place.astype(np.int64)] = table[:, 2:]
    row, column = np.moveaxis(raw.reshape(height, width, 2), -1, 0)
    return column, row


# a text of two million lines: a process reads it once
@lru_cache(maxsize=2)
def _upright_map(path: Path) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """The map turned a quarter clockwise: what it makes is undistorted and upright in one step."""
    column, row = (np.ascontiguousarray(np.rot90(part, -1)) for part in read_u2d(path))
    return column, row


def _read_size(path: Path) -> tuple[int, int]:
    """Height and width that a map gives in its first line; UserError if it cannot hold so many."""
    try:
        with path.open("rb") as file:
            first = file.readline(1000)
            size = path.stat().st_size
    except OSError as error:
        raise UserError(f"{path} cannot be read ({error.strerror}): {_REMEDY}") from error
    sides = [int(digits) for digits in re.findall(rb"[0-9]+", first)]
    if len(sides) != 2 or not all(1 <= side <= _LARGEST_SIDE for side in sides):
        raise UserError(f"{path}: line 1 names no width and height: {_REMEDY}")
    width, height = sides
    if width * height * _SHORTEST_LINE > size:
        raise UserError(f"{path} is too short for {width} x {height} pixels: {_REMEDY}")
    return height, width


def _is_plain(K: Float64[np.ndarray, "3 3"]) -> bool:
    """Whether K has nothing but focal lengths and a principal point."""
    return bool(K[0, 1] == K[1, 0] == 0.0 and (K[2] == (0.0, 0.0, 1.0)).all())


def _find(folder: Path, pattern: str) -> Path:
    found = sorted({*folder.glob(pattern), *folder.glob(f"*/{pattern}")})
    if not found:
        raise UserError(f"{folder} has no {pattern} there or one level below: {_REMEDY}")
    if len(found) > 1:
        raise UserError(
            f"{folder} has several files {pattern}: {', '.join(map(str, found))}; leave one, or "
            f"give --calibration FOLDER"
        )
    return found[0]
