# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where a camera and a LiDAR sit on a vehicle and how the lens bends, from a YAML file.

    K: [[525.0, 0.0, 319.5], [0.0, 525.0, 239.5], [0.0, 0.0, 1.0]]
    distortion: [-0.28, 0.07, 0.0002, 0.0001, 0.0]     # k1 k2 p1 p2 [k3 ...]
    T_body_camera: [[0, 0, 1, 1.2], [-1, 0, 0, 0.0], [0, -1, 0, 1.5], [0, 0, 0, 1]]
    T_body_lidar: [[1, 0, 0, 0.9], [0, 1, 0, 0.0], [0, 0, 1, 1.7], [0, 0, 0, 1]]

Every key may be left out. Distortion has 4, 5, 8, 12 or 14 numbers, in the order of OpenCV and
ROS: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty. Body: x forward, y left, z up, z = 0 the ground;
camera: z along the view, x right, y down; metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import yaml
from jaxtyping import Float, Float32, Float64, UInt8

from adafusion.geometry import is_rigid
from adafusion.readers.text import read_text
from adafusion.types import UserError

_REMEDY = "give K, distortion, T_body_camera, T_body_lidar as the documentation shows them"
_LONGEST_PX = 2**15 - 2  # cv2.remap counts pixels in 16 bits


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """What is known of a camera and a LiDAR; None or () where it is not."""

    K: Float[np.ndarray, "3 3"] | None = None
    distortion: tuple[float, ...] = ()  # k1 k2 p1 p2 [k3 ...], k1 k2 k3 k4 of a fisheye
    fisheye: bool = False  # a lens of the equidistant model
    T_body_camera: Float[np.ndarray, "4 4"] | None = None
    T_body_lidar: Float[np.ndarray, "4 4"] | None = None

    @property
    def bends(self) -> bool:
        """Whether images need to be undistorted."""
        return self.fisheye or any(self.distortion)

    def as_plain(self) -> dict[str, list[list[float]]]:
        """What is known, as `DatasetInfo.calibration` keeps it; the images are undistorted."""
        known = {
            "K": self.K,
            "T_body_camera": self.T_body_camera,
            "T_body_lidar": self.T_body_lidar,
        }
        return {name: value.tolist() for name, value in known.items() if value is not None}


def read_calibration(path: str | Path) -> Calibration:
    """Read and check a calibration file; UserError names the entry at fault."""
    text = read_text(path, _REMEDY)
    try:
        values = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise UserError(f"{path} is no YAML ({error}): {_REMEDY}") from error
    if not isinstance(values, dict) or not values:
        raise UserError(f"{path} holds no entries: {_REMEDY}")
    if unknown := set(map(str, values)) - {"K", "distortion", "T_body_camera", "T_body_lidar"}:
        raise UserError(f"{path} has unknown entries {', '.join(sorted(unknown))}: {_REMEDY}")

    def array(name: str, *shape: int) -> Float64[np.ndarray, ...] | None:
        if values.get(name) is None:
            return None
        try:
            value = np.array(values[name], dtype=np.float64)
        except (ValueError, TypeError, OverflowError):
            value = np.array(np.nan)
        if not np.isfinite(value).all() or (shape and value.shape != shape):
            what = f"{'x'.join(map(str, shape))} finite" if shape else "finite"
            raise UserError(f"{path}: {name} is not {what} numbers: {_REMEDY}")
        return value

    K = array("K", 3, 3)
    if K is not None and not is_camera_matrix(K):
        raise UserError(f"{path}: K is not [[fx, s, cx], [0, fy, cy], [0, 0, 1]]: {_REMEDY}")
    T_body_camera, T_body_lidar = array("T_body_camera", 4, 4), array("T_body_lidar", 4, 4)
    for name, T in (("T_body_camera", T_body_camera), ("T_body_lidar", T_body_lidar)):
        if T is not None and not is_rigid(T):
            raise UserError(f"{path}: {name} is no rigid motion: {_REMEDY}")
    distortion = array("distortion")
    coefficients = () if distortion is None else tuple(np.atleast_1d(distortion).tolist())
    if not is_distortion(coefficients):
        raise UserError(f"{path}: distortion is not 4, 5, 8, 12 or 14 numbers in a row: {_REMEDY}")
    if any(coefficients) and K is None:
        raise UserError(f"{path}: distortion without K: {_REMEDY}")
    return Calibration(
        K=K, distortion=coefficients, T_body_camera=T_body_camera, T_body_lidar=T_body_lidar
    )


def is_camera_matrix(K: Float[np.ndarray, "3 3"]) -> bool:
    """Whether K projects: focal lengths above 0, a last row of 0 0 1."""
    return bool(
        np.isfinite(K).all()
        and K[0, 0] > 0
        and K[1, 1] > 0
        and K[1, 0] == 0
        and (K[2] == (0.0, 0.0, 1.0)).all()
    )


def is_distortion(coefficients: tuple[float, ...]) -> bool:
    """Whether these are none, or k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty or what begins so."""
    known = len(coefficients) in (0, 4, 5, 8, 12, 14)
    return known and all(isinstance(k, float) for k in coefficients)


def undistort(
    image: UInt8[np.ndarray, "h w 3"],
    K: Float[np.ndarray, "3 3"],
    distortion: tuple[float, ...],
    *,
    fisheye: bool = False,
    where: object = "an image",
) -> UInt8[np.ndarray, "h w 3"]:
    """The image that a lens without distortion would have made under the same K and size.

    UserError, which names `where` it comes from, for more pixels a side than OpenCV can map.
    """
    height, width = image.shape[:2]
    if max(height, width) > _LONGEST_PX:
        raise UserError(
            f"{where} has {width}x{height} pixels, and more than {_LONGEST_PX} a side cannot be "
            "undistorted: undistort and resize it beforehand"
        )
    columns, rows = _maps(tuple(K.ravel().tolist()), distortion, fisheye, height, width)
    return cv2.remap(image, columns, rows, cv2.INTER_LINEAR)


@lru_cache(maxsize=4)
def _maps(
    K: tuple[float, ...], distortion: tuple[float, ...], fisheye: bool, height: int, width: int
) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Column and row in the distorted image of every pixel; the same for all images of a run."""
    matrix = np.array(K).reshape(3, 3)
    size = (width, height)
    make = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
    columns, rows = make(matrix, np.array(distortion), np.eye(3), matrix, size, cv2.CV_32FC1)
    return columns, rows
