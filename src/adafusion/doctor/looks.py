# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A frame opened once and boiled down to the few numbers that the checks ask for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int64, UInt8
from scipy.spatial import cKDTree

from adafusion.datasets import Dataset, read_cloud, read_image
from adafusion.doctor.calibration import CameraModel
from adafusion.doctor.table import Table
from adafusion.geometry import invert, transform
from adafusion.preprocess import Preprocess
from adafusion.preprocess.ground import remove_ground
from adafusion.preprocess.voxels import voxelize
from adafusion.readers.ground import ground_below
from adafusion.types import UserError

THUMB = (64, 48)  # (width, height): sensor noise averages out, a moved scene does not
WHITE = 250  # a channel at or above it says nothing any more

EYE_M = 2.0  # what is higher above z = 0 is no ground, by whatever height the LiDAR is wrong

WALL_M = (0.7, 6.0)  # heights that show motion: the ground looks alike after any step
NEAR_M = 30.0
PROBES = 1500  # points compared between neighbouring clouds
LEAST_PROBES = 200
LEAST_STEP_M = 1.0  # below it the motion drowns in the spacing of the points
# In a corridor, or where the vehicle stands, clouds fit as well unmoved: nothing can be told there.
TELLING_M = 0.5


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ImageLook:
    """What an image is like."""

    size: tuple[int, int]  # (height, width)
    bright: float  # 95th percentile of its grey values, 0 to 255
    spread: float  # standard deviation of its grey values
    white: float  # share of pixels at the upper end


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudLook:
    """What a cloud is like."""

    points: int
    range_m: float  # from the body's origin, 99th percentile
    in_box: float  # share of the points in the voxel box
    occupied: int  # cells of the grid
    ground_m: float  # height of the ground under the vehicle; NaN where too little is seen
    above: float  # share of the points more than a metre above z = 0
    below: float  # and more than a metre below it
    in_view: float | None  # share of the points that fall into the image; None: not known


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """What one frame is like; None for a sensor that it lacks or whose file is damaged."""

    row: int
    image: ImageLook | None
    cloud: CloudLook | None
    faults: tuple[str, ...]  # of files that cannot be read
    # with the frame before, where that was opened too and the vehicle moved in between
    moved_m: float | None = None
    likeness: float | None = None  # mean difference of the two images' thumbs, grey values
    # distance from points of one cloud to the other, moved as the poses say, over that of clouds
    # left where they are; below 1 where poses explain what the LiDAR saw
    misfit: float | None = None


def choose_rows(
    table: Table, samples: int | None, rng: np.random.Generator
) -> Int64[np.ndarray, " k"]:
    """About `samples` rows of each run, as pairs of neighbours spread along it; None: all."""
    if samples is None:
        return np.arange(len(table.frames))
    chosen: list[int] = []
    for number in range(len(table.runs)):
        rows = np.flatnonzero(table.run == number)
        if len(rows) <= samples:
            chosen += rows.tolist()
            continue
        edges = np.linspace(0, len(rows) - 1, max(samples // 2, 1) + 1)
        first = np.floor(rng.uniform(edges[:-1], edges[1:])).astype(int)
        chosen += rows[np.unique([first, first + 1])].tolist()
    return np.array(chosen, dtype=np.int64)


def look_at(
    dataset: Dataset,
    table: Table,
    rows: Iterable[int],
    preprocess: Preprocess,
    cameras: Mapping[str, CameraModel],
    rng: np.random.Generator,
) -> Iterator[Look]:
    """Open each frame once, in the order of `rows`, which rises; one frame is in memory."""
    before: tuple[int, UInt8[np.ndarray, "h w"] | None, Float32[np.ndarray, "n 3"] | None]
    before = (-2, None, None)
    for row in rows:
        frame = table.frames[row]
        faults = []
        image = thumb = cloud = points = None
        if frame.image is not None:
            try:
                image, thumb = _image_look(read_image(dataset.root / frame.image))
            except UserError as error:
                faults.append(str(error))
        if frame.cloud is not None:
            try:
                points = read_cloud(dataset.root / frame.cloud)
                size = image.size if image else None
                cloud = _cloud_look(points, preprocess, cameras.get(frame.run), size)
            except UserError as error:
                faults.append(str(error))
        walls = None if points is None else _walls(points)
        moved_m = likeness = misfit = None
        if before[0] == row - 1 and table.run[row - 1] == table.run[row]:
            moved_m = float(table.step_after[row - 1])
            if thumb is not None and before[1] is not None:
                likeness = float(np.abs(thumb.astype(float) - before[1]).mean())
            if walls is not None and before[2] is not None and moved_m >= LEAST_STEP_M:
                misfit = _misfit(table, row, before[2], walls, rng)
        before = row, thumb, walls
        yield Look(
            row=row,
            image=image,
            cloud=cloud,
            faults=tuple(faults),
            moved_m=moved_m,
            likeness=likeness,
            misfit=misfit,
        )


def _image_look(image: UInt8[np.ndarray, "h w 3"]) -> tuple[ImageLook, UInt8[np.ndarray, "a b"]]:
    """What the image is like, and a thumb of it in grey."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    height, width = grey.shape
    look = ImageLook(
        size=(height, width),
        bright=float(np.percentile(grey, 95)),
        spread=float(grey.std()),
        white=float((grey >= WHITE).mean()),
    )
    return look, cv2.resize(grey, THUMB, interpolation=cv2.INTER_AREA)


def _cloud_look(
    points: Float32[np.ndarray, "n 3"],
    preprocess: Preprocess,
    camera: CameraModel | None,
    size: tuple[int, int] | None,
) -> CloudLook:
    grid = preprocess.voxels
    kept = remove_ground(points, preprocess.ground)
    inside = ((points >= grid.lower_m) & (points < grid.upper_m)).all(axis=1)
    in_view = None
    if camera is not None and size is not None:
        in_view = float(camera.project(points, size)[0].mean())
    return CloudLook(
        points=len(points),
        range_m=float(np.percentile(np.linalg.norm(points, axis=1), 99)),
        in_box=float(inside.mean()),
        occupied=int(np.count_nonzero(voxelize(kept, grid))),
        ground_m=ground_height_m(points),
        above=float((points[:, 2] > 1).mean()),
        below=float((points[:, 2] < -1).mean()),
        in_view=in_view,
    )


def ground_height_m(points_body: Float[np.ndarray, "n 3"]) -> float:
    """Height of the ground under a vehicle; NaN where the cloud does not show it."""
    below_m = ground_below(points_body - np.array([0.0, 0.0, EYE_M]))
    return float("nan") if below_m is None else EYE_M - below_m


def _walls(points: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "m 3"]:
    """Points on what stands about the vehicle."""
    near = (np.abs(points[:, :2]) < NEAR_M).all(axis=1)
    return points[near & (points[:, 2] > WALL_M[0]) & (points[:, 2] < WALL_M[1])]


def _misfit(
    table: Table,
    row: int,
    before: Float32[np.ndarray, "n 3"],
    now: Float32[np.ndarray, "m 3"],
    rng: np.random.Generator,
) -> float | None:
    if not (table.has_pose[row - 1] and table.has_pose[row]):
        return None
    if min(len(before), len(now)) < LEAST_PROBES:
        return None
    T_before_now = invert(table.T_world_body[row - 1]) @ table.T_world_body[row]
    probes = now[rng.choice(len(now), size=min(PROBES, len(now)), replace=False)]
    tree = cKDTree(before)
    moved, left = (np.median(tree.query(p)[0]) for p in (transform(T_before_now, probes), probes))
    return float(moved / left) if left >= TELLING_M else None
