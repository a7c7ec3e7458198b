# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Point clouds to an elevation map in front of the vehicle, and where the camera sees its cells.

Cell (i, j) of a map of N rows and M columns lies (N - i - 1/2) cells ahead of the vehicle and
(M/2 - j - 1/2) cells to its left, as in CORAL (Pan et al., ICRA 2021): row 0 is the farthest.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from scipy import ndimage

from adafusion.geometry import invert, is_rigid, transform
from adafusion.preprocess.image import Crop
from adafusion.types import UserError

EMPTY = 0  # grey level of a cell that no point fell in
OUTSIDE = 2.0  # image coordinate of a cell that the camera does not see: beyond [-1, 1]
NEAREST_M = 0.1  # what lies nearer to the camera, or behind it, is out of sight
SAME_PX, SAME_M = 1.0, 0.01  # by how much two cameras may differ and be one to a model


@dataclass(frozen=True, kw_only=True)
class RigCamera:
    """The camera of the rig that a model was trained for."""

    K: tuple[tuple[float, ...], ...]  # 3x3, pixels of the whole image
    T_body_camera: tuple[tuple[float, ...], ...]  # 4x4; the camera looks along z, x right, y down
    size: tuple[int, int]  # (height, width) of the whole image
    distortion: tuple[float, ...] = ()  # k1, k2, p1, p2, k3; (): none

    def __post_init__(self) -> None:
        object.__setattr__(self, "K", _matrix(self.K, 3))
        object.__setattr__(self, "T_body_camera", _matrix(self.T_body_camera, 4))
        object.__setattr__(self, "size", tuple(operator.index(n) for n in self.size))
        distortion = tuple(float(k) for k in self.distortion)
        object.__setattr__(self, "distortion", distortion if any(distortion) else ())
        (fx, skew, _), (zero, fy, _), last = self.K
        if min(fx, fy) <= 0 or skew or zero or last != (0.0, 0.0, 1.0):
            raise ValueError(f"K {self.K} must be (fx 0 cx), (0 fy cy), (0 0 1)")
        if not is_rigid(np.array(self.T_body_camera)):
            raise ValueError(f"T_body_camera {self.T_body_camera} is no rigid motion")
        if len(self.size) != 2 or min(self.size) < 1:
            raise ValueError(f"size {self.size} must be a positive (height, width)")
        if len(distortion) not in (0, 4, 5) or not np.isfinite(distortion).all():
            raise ValueError(f"distortion {distortion} must be k1, k2, p1, p2, k3, or nothing")


@dataclass(frozen=True, kw_only=True)
class Elevation:
    """The highest point of each cell, `step_m` a grey level above `lowest_m`; 0 is empty.

    Points above the top level (255 steps) hang over the road and are left out. One pass fills an
    empty inner cell with the mean of its neighbours that are not. A cell lower than `seen_from_m`
    keeps its height, and is not looked for in the image: CORAL's authors do so too.
    """

    shape: tuple[int, int] = (80, 80)
    cell_m: float = 0.5
    lowest_m: float = -2.0
    step_m: float = 0.02
    seen_from_m: float = -1.5
    camera: RigCamera | None = None  # None until a training takes it from its dataset

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", tuple(operator.index(n) for n in self.shape))
        if len(self.shape) != 2 or min(self.shape) < 3 or min(self.cell_m, self.step_m) <= 0:
            raise ValueError(f"{self} is no map: rows, columns, cell_m and step_m are positive")


def elevation_map(
    points_body: Float[np.ndarray, "n 3"], settings: Elevation
) -> UInt8[np.ndarray, "rows columns"]:
    """Grey levels: 1 + whole steps above the lowest height, 0 where there is no point."""
    rows, columns = settings.shape
    x, y, z = points_body.astype(np.float64).T
    row = rows - 1 - np.floor(x / settings.cell_m)
    column = columns - 1 - np.floor(y / settings.cell_m + columns / 2)
    level = np.floor((z - settings.lowest_m) / settings.step_m) + 1
    kept = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    kept &= (level >= 1) & (level <= 255)
    grey = np.zeros(settings.shape, np.uint8)
    cells = row[kept].astype(np.intp), column[kept].astype(np.intp)
    np.maximum.at(grey, cells, level[kept].astype(np.uint8))
    return _fill(grey)


def _fill(grey: UInt8[np.ndarray, "rows columns"]) -> UInt8[np.ndarray, "rows columns"]:
    """Empty inner cells become the mean of those of their 3x3 neighbours that are not empty."""
    ones = np.ones((3, 3))
    known = ndimage.convolve((grey != EMPTY).astype(float), ones, mode="constant")
    total = ndimage.convolve(grey.astype(float), ones, mode="constant")
    inner = np.zeros(grey.shape, bool)
    inner[1:-1, 1:-1] = True
    fill = inner & (grey == EMPTY) & (known > 0)
    filled = grey.copy()
    filled[fill] = np.round(total[fill] / known[fill])
    return filled


def lift(
    grey: UInt8[np.ndarray, "b rows columns"], settings: Elevation, crop: Crop
) -> Float32[np.ndarray, "b 3 rows columns"]:
    """Height in [0, 1], and x and y of each cell in the image, from -1 to 1 (left to right, down).

    The image is the one that is left after `crop`. A cell that is empty, too low or out of sight
    has x = y = 2; one behind a wall is seen all the same, and where it would be. ValueError where
    the settings have no camera.
    """
    if settings.camera is None:
        raise ValueError("an elevation map is lifted into the image of a camera: set one")
    rows, columns = settings.shape
    ahead = (rows - 0.5 - np.arange(rows)) * settings.cell_m
    left = (columns / 2 - 0.5 - np.arange(columns)) * settings.cell_m
    height = settings.lowest_m + (grey.astype(np.float64) - 0.5) * settings.step_m
    where = np.empty((*grey.shape, 3))
    where[..., 0], where[..., 1], where[..., 2] = ahead[:, None], left, height
    looked_for = (grey != EMPTY) & (height >= settings.seen_from_m)
    xy = np.full((*grey.shape, 2), OUTSIDE)
    xy[looked_for] = _project(where[looked_for], settings.camera, crop)
    xy[(np.abs(xy) > 1.0).any(axis=-1)] = OUTSIDE
    parts = [grey / 255.0, xy[..., 0], xy[..., 1]]
    return np.stack(parts, axis=1).astype(np.float32)


def rig_camera(calibration: Mapping[str, Any], image_size: tuple[int, int]) -> RigCamera:
    """The one camera of a dataset's calibration, whose images are of `image_size` (height, width).

    Takes K, T_body_camera and, where there is one, the distortion of the whole dataset, or of each
    run. UserError where one is missing or no camera, or where runs differ by more than a pixel or a
    centimetre: a model carries one camera, and would look for its cells in the wrong places.
    """
    runs = {run: of for run, of in calibration.items() if isinstance(of, Mapping)}
    of_runs = (runs or {"": calibration}).items()
    return one_camera({f"run {run}": _camera(of, image_size, run) for run, of in of_runs})


def one_camera(cameras: Mapping[str, RigCamera]) -> RigCamera:
    """The camera that all of them are, by whose they are.

    UserError where two differ by more than a pixel or a centimetre.
    """
    first, camera = next(iter(cameras.items()))
    for name, other in cameras.items():
        pixels, metres = _difference(camera, other)
        if pixels > SAME_PX or metres > SAME_M:
            raise UserError(
                f"the cameras of {first} and {name} differ, by {pixels:.1f} pixels and "
                f"{100 * metres:.1f} cm: take the data of one camera alone, or say which camera to "
                "go by in model.preprocess.elevation.camera"
            )
    return camera


def _camera(calibration: Mapping[str, Any], size: tuple[int, int], run: str) -> RigCamera:
    where = f"the calibration of run {run}" if run else "the dataset's calibration"
    remedy = "correct it, or set model.preprocess.elevation.camera"
    if missing := [key for key in ("K", "T_body_camera") if key not in calibration]:
        raise UserError(
            f"{where} has no {' and no '.join(missing)}, and an elevation map is lifted into the "
            f"camera's image: {remedy}"
        )
    try:
        return RigCamera(
            K=_matrix(calibration["K"], 3),
            T_body_camera=_matrix(calibration["T_body_camera"], 4),
            size=size,
            distortion=tuple(float(k) for k in calibration.get("distortion", ())),
        )
    except (TypeError, ValueError) as error:
        raise UserError(f"{where} is of no camera ({error}): {remedy}") from error


def _difference(a: RigCamera, b: RigCamera) -> tuple[float, float]:
    """By how many pixels they see far things apart, and by how many metres they stand apart."""
    h, w = a.size
    corners = np.array([[x, y, 1.0] for x in (0, w - 1) for y in (0, h - 1)])
    far_a = 1000.0 * np.linalg.solve(np.array(a.K), corners.T).T
    T_body_a, T_body_b = np.array(a.T_body_camera), np.array(b.T_body_camera)
    far_b = transform(invert(T_body_b) @ T_body_a, far_a)
    if (far_b[:, 2] < NEAREST_M).any():
        return math.inf, float(np.linalg.norm(T_body_a[:3, 3] - T_body_b[:3, 3]))
    apart = np.linalg.norm(_pixels(far_a, a) - _pixels(far_b, b), axis=1).max()
    return float(apart), float(np.linalg.norm(T_body_a[:3, 3] - T_body_b[:3, 3]))


def _project(
    points_body: Float[np.ndarray, "n 3"], camera: RigCamera, crop: Crop
) -> Float[np.ndarray, "n 2"]:
    """Where the camera sees points, in [-1, 1] of the cropped image; OUTSIDE what it cannot see."""
    points = transform(invert(np.array(camera.T_body_camera)), points_body)
    visible = points[:, 2] > NEAREST_M
    visible &= np.hypot(points[:, 0], points[:, 1]) < _reach(camera.distortion) * points[:, 2]
    xy = np.full((len(points), 2), OUTSIDE)
    if visible.any():
        h, w = camera.size
        low = np.array([round(w * crop.left), round(h * crop.top)])
        high = np.array([w - round(w * crop.right), h - round(h * crop.bottom)])
        # pixel centres are whole numbers: the image begins half a pixel before the first
        xy[visible] = 2.0 * (_pixels(points[visible], camera) + 0.5 - low) / (high - low) - 1.0
    return xy


def _pixels(points_camera: Float[np.ndarray, "n 3"], camera: RigCamera) -> Float[np.ndarray, "n 2"]:
    still = np.zeros(3)
    distortion = np.array(camera.distortion) if camera.distortion else np.zeros(5)
    return cv2.projectPoints(points_camera, still, still, np.array(camera.K), distortion)[0][:, 0]


def _reach(distortion: tuple[float, ...]) -> float:
    """How far off the axis, in focal lengths, the lens still is one-to-one.

    Beyond that its polynomial folds back, and would put what lies far to the side into the picture.
    """
    k1, k2, _, _, k3 = (*distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    turns = np.roots([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])  # of r + k1 r^3 + ..., in r squared
    squares = [root.real for root in turns if abs(root.imag) < 1e-12 and root.real > 0.0]
    return math.sqrt(min(squares)) if squares else math.inf


def _matrix(values: object, n: int) -> tuple[tuple[float, ...], ...]:
    matrix = np.array(values, dtype=np.float64)
    if matrix.shape != (n, n) or not np.isfinite(matrix).all():
        raise ValueError(f"{values} is no {n}x{n} matrix of finite numbers")
    return tuple(tuple(float(v) for v in row) for row in matrix)
