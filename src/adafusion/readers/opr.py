# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The NCLT and Oxford sets as OpenPlaceRecognition prepares and publishes them.

NCLT, ten days, a place every 5 m or so:

    <src>/<date>/track.csv                  image, pointcloud (times that name the files) and a pose
    <src>/<date>/velodyne_data/<t>.bin      float32 x y z, or x y z intensity
    <src>/<date>/lb3_small/Cam5/<t>.png     or images_small/Cam5: upright, undistorted, cropped
    <src>/{train,val,test}.csv              track, image, pointcloud, northing, easting

Clouds are in NCLT's body frame, on the ground, x forward, y right, z down: turned to (x, -y, -z).
A pose is x y z r p h or tx ty tz qx qy qz qw in NCLT's world, x north, y east, z down; here x is
east, y north, z up, the world of the `nclt` reader. It was taken within 10 ms of image and cloud.
Where a day has no track.csv, the three tables give its frames, and positions without a heading.

Oxford, submaps of the PointNetVLAD benchmark with images of four cameras:

    <src>/{train,val,test}.csv      track, pointcloud, stereo_centre, mono_left, ..., northing,
                                    easting and, in test.csv, in_query
    <src>/<run>/pointcloud_20m_10overlap/<t>.bin    of train.csv and val.csv
    <src>/<run>/pointcloud_20m/<t>.bin              of test.csv
    <src>/<run>/images_small/stereo_centre/<t>.png

Read as in `adafusion.readers.pointnetvlad`. Images of both are kept byte for byte.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32
from scipy.spatial.transform import Rotation

from adafusion.datasets.native import CONVENTIONS, DatasetInfo
from adafusion.datasets.recording import Recording, Shot
from adafusion.datasets.sensor_files import check_points, damaged, read_bytes
from adafusion.datasets.writer import check_run_name
from adafusion.geometry import pose, rotation_from_rpy
from adafusion.readers.manifest import mark_synthetic
from adafusion.readers.pointnetvlad import CLOUD_UNIT, UNITS, read_submap
from adafusion.readers.runs import choose_runs, files_by_stamp, number, whole
from adafusion.readers.sensors import T_ENU_NED, T_FLU_FRD, encoded_image
from adafusion.readers.text import path_inside, read_records
from adafusion.readers.track import keyframes
from adafusion.types import Frame, UserError

TABLES = ("train.csv", "val.csv", "test.csv")
REMEDY = "fetch the set again"


class _Set(NamedTuple):
    """What the two sets differ in."""

    cameras: tuple[str, ...]  # the first is the default
    images: tuple[str, ...]  # folders that may hold them
    lidars: dict[str, tuple[str, tuple[str, ...]]]  # folder of clouds, and the tables of it
    world: str
    licence: str
    sensors: dict[str, str]
    conventions: dict[str, str]


SETS = {
    "nclt": _Set(
        cameras=("Cam5", "Cam0", "Cam1", "Cam2", "Cam3", "Cam4"),
        images=("lb3_small/{}", "images_small/{}", "images/{}"),
        lidars={"velodyne": ("velodyne_data", TABLES)},
        world="NCLT local ENU",
        licence="ODbL 1.0",
        sensors={},
        conventions={"image": "RGB, undistorted, centre crop 768 x 960, resized to 256 x 320"},
    ),
    "oxford": _Set(
        cameras=("stereo_centre", "mono_left", "mono_rear", "mono_right"),
        images=("images_small/{}", "images/{}_small"),
        lidars={
            "20m_10overlap": ("pointcloud_20m_10overlap", ("train.csv", "val.csv")),
            "20m": ("pointcloud_20m", ("test.csv",)),
        },
        world="UTM zone 30N",
        licence="CC BY-NC-SA 4.0",
        sensors={"cloud_unit": CLOUD_UNIT},
        conventions=UNITS,
    ),
}


def recognises(src: Path) -> bool:
    """Whether one of the two sets, with its tables, lies at `src`."""
    try:
        return _kind(src) is not None
    except OSError:
        return False


def read(
    src: str | Path,
    *,
    runs: Sequence[str] | None = None,
    every_m: float = 0.0,
    camera: str | None = None,
    lidar: str | None = None,
) -> Recording:
    """Frames that have both image and cloud; which of the two sets it is shows by its tables.

    `camera` is Cam0 to Cam5 of NCLT (default Cam5, the front one), stereo_centre (the default),
    mono_left, mono_rear or mono_right of Oxford; where no camera is named and there are no images,
    all clouds are taken. `lidar` of Oxford is 20m_10overlap (the default) or 20m. A frame without
    its files is left out and noted. With `every_m` a frame is that far or more from the last one.
    """
    src = Path(src)
    if (kind := _kind(src)) is None:
        raise UserError(f"{src} has no train.csv, test.csv or */track.csv of OPR: {REMEDY}")
    which, notes = SETS[kind], list[str]()
    lidar = _choice("lidar", lidar, tuple(which.lidars))
    clouds, tables = which.lidars[lidar]
    named, camera = camera, _choice("camera", camera, which.cameras)
    rows = _table_rows(src, tables, "image" if kind == "nclt" else camera, notes)
    if kind == "nclt":
        rows = _with_poses(src, rows)
    if not rows:
        raise UserError(f"{src}: the tables of {lidar} are missing or name no frame: {REMEDY}")
    chosen = choose_runs(src, {row.run for row in rows}, runs)
    images = {run: _folder(src / run, which.images, camera) for run in chosen}
    with_images = any(images.values())
    if named and not with_images:
        raise UserError(f"{src} has no <run>/{which.images[0].format(camera)}: {REMEDY}")
    files: list[_Files] = []
    for run in chosen:
        of_run = [row for row in rows if row.run == run]
        there = _find(src / run / clouds, images[run], with_images, of_run)
        if lost := len(of_run) - len(there):
            notes.append(f"{run}: {lost} of {len(of_run)} frames lack a file: left out")
        positions_m = np.array([row.position_m for row, _, _ in there]).reshape(-1, 3)
        files += [there[k] for k in keyframes(positions_m, every_m)]
    if not files:
        raise UserError(f"none of {len(rows)} frames of {src} has its files: {REMEDY}")
    pictures = camera if with_images else "no images"
    return Recording(
        info=_describe(src, kind, f"{lidar}, {pictures}, every {every_m:g} m"),
        shots=_shots(files, read_submap if kind == "oxford" else read_nclt_cloud),
        total=len(files),
        notes=notes,
    )


def read_nclt_cloud(path: str | Path) -> Float32[np.ndarray, "n 3"]:
    """Points in our body frame, metres; UserError where the file is cut short or damaged.

    Every fourth number of a file with intensities is a whole one in [0, 255]; every fourth number
    of a file without is a coordinate, and those are multiples of 5 mm.
    """
    data = read_bytes(Path(path), "cloud")
    numbers = np.frombuffer(data[: len(data) // 4 * 4], "<f4")
    fourth = numbers[3::4]
    whole_bytes = (fourth >= 0) & (fourth <= 255) & (fourth == np.floor(fourth))
    width = 4 if len(fourth) and whole_bytes.all() else 3
    if len(data) % (4 * width):
        raise damaged(path, f"is cut short: {len(data)} bytes are no whole points", "cloud")
    points_frd = numbers.reshape(-1, width)[:, :3]
    return check_points(points_frd * np.array((1.0, -1.0, -1.0), np.float32), path)


# ----------------------------------------------------------------------------------------- tables


class _Row(NamedTuple):
    """A frame, as the tables have it."""

    run: str
    time_us: int  # of the cloud
    image_us: int
    position_m: tuple[float, float, float]  # east, north, up
    T_world_body: Float[np.ndarray, "4 4"] | None = None


def _kind(src: Path) -> str | None:
    """Name in `SETS`, from the headers of the tables."""
    for name in TABLES:
        columns = _header(src / name)
        if {"track", "pointcloud", "northing", "easting"} <= columns:
            if columns & set(SETS["oxford"].cameras):
                return "oxford"
            if "image" in columns:
                return "nclt"
    tracks = src.glob("*/track.csv")
    return "nclt" if any({"image", "pointcloud"} <= _header(path) for path in tracks) else None


def _header(path: Path) -> set[str]:
    """Names of the columns; none where there is no such file."""
    if not path.is_file():
        return set()
    with path.open("rb") as file:
        line = file.readline(4096)
    return {word.strip() for word in line.decode("utf-8-sig", "replace").split(",")}


def _choice(what: str, wanted: str | None, choices: tuple[str, ...]) -> str:
    if wanted is not None and wanted not in choices:
        raise UserError(f"unknown {what} {wanted!r}: choose from {', '.join(choices)}")
    return wanted or choices[0]


def _table_rows(
    src: Path, tables: tuple[str, ...], image_column: str, notes: list[str]
) -> list[_Row]:
    """Frames of the tables that are there, each once."""
    rows: dict[tuple[str, int], _Row] = {}
    for table in (src / name for name in tables if (src / name).is_file()):
        columns = ("track", "pointcloud", image_column, "northing", "easting")
        queries = total = 0
        for line, row in read_records(table, columns, remedy=REMEDY):
            run = row["track"]
            path_inside(src, run, f"{table}: line {line}")
            check_run_name(run)
            time_us, image_us = (whole(row[c], table, line) for c in ("pointcloud", image_column))
            north, east = (number(row[c], table, line) for c in ("northing", "easting"))
            rows.setdefault((run, time_us), _Row(run, time_us, image_us, (east, north, 0.0)))
            queries += row.get("in_query") == "True"
            total += 1
        if queries:
            notes.append(f"{queries} of {total} rows of {table} are queries (in_query)")
    return list(rows.values())


def _with_poses(src: Path, rows: list[_Row]) -> list[_Row]:
    """Frames of NCLT: of all days with a track.csv those in it, of the others those of `rows`."""
    tracks = {path.parent.name: _track_rows(path) for path in src.glob("*/track.csv")}
    for row in rows:
        posed = tracks.get(row.run, {}).get(row.time_us)
        if posed and np.abs(np.subtract(posed.position_m, row.position_m))[:2].max() > 1.0:
            raise UserError(
                f"{src / row.run / 'track.csv'}: cloud {row.time_us} lies at (east, north) "
                f"{posed.position_m[:2]}, by the tables above it at {row.position_m[:2]}: {REMEDY}"
            )
    posed_rows = [row for track in tracks.values() for row in track.values()]
    return posed_rows + [row for row in rows if row.run not in tracks]


def _track_rows(path: Path) -> dict[int, _Row]:
    """Frames of a day by the time of their cloud."""
    columns = _header(path)
    angles, quaternion = ("x", "y", "z", "r", "p", "h"), ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
    used = angles if columns >= set(angles) else quaternion
    rows: dict[int, _Row] = {}
    for line, row in read_records(path, ("image", "pointcloud", *used), remedy=REMEDY):
        time_us, image_us = (whole(row[c], path, line) for c in ("pointcloud", "image"))
        values = [number(row[c], path, line) for c in used]
        if used is angles:
            R = rotation_from_rpy(*values[3:])
        elif abs(np.linalg.norm(values[3:]) - 1.0) < 0.01:
            R = Rotation.from_quat(values[3:]).as_matrix()
        else:
            raise UserError(f"{path}: line {line} has no quaternion of length 1: {REMEDY}")
        T_world_body = T_ENU_NED @ pose(R, np.array(values[:3])) @ T_FLU_FRD
        position_m = tuple(T_world_body[:3, 3].tolist())
        run = path.parent.name
        rows.setdefault(time_us, _Row(run, time_us, image_us, position_m, T_world_body))
    return rows


# ------------------------------------------------------------------------------------------ files


def _folder(run: Path, patterns: tuple[str, ...], camera: str) -> Path | None:
    """Where images of this camera lie."""
    folders = (run / pattern.format(camera) for pattern in patterns)
    return next((folder for folder in folders if folder.is_dir()), None)


class _Files(NamedTuple):
    """A frame whose files are there."""

    row: _Row
    cloud: Path
    image: Path | None


def _find(clouds: Path, images: Path | None, with_images: bool, rows: list[_Row]) -> list[_Files]:
    """Frames of a run by time, those whose files are there."""
    scans = files_by_stamp(clouds, ".bin")
    pictures = files_by_stamp(images, ".png") if images else {}
    return [
        _Files(row, scans[row.time_us], pictures.get(row.image_us))
        for row in sorted(rows, key=lambda row: row.time_us)
        if row.time_us in scans and (row.image_us in pictures or not with_images)
    ]


# ---------------------------------------------------------------------------------------- results


def _shots(
    files: list[_Files], read_points: Callable[[Path], Float32[np.ndarray, "n 3"]]
) -> Iterator[Shot]:
    for row, cloud, image in files:
        frame = Frame(
            run=row.run,
            timestamp_us=row.time_us,
            position_m=row.position_m,
            T_world_body=row.T_world_body,
            image_time_us=row.image_us if image and row.image_us != row.time_us else None,
        )
        read_image = None if image is None else partial(encoded_image, image)
        yield Shot(frame=frame, image=read_image, cloud=partial(read_points, cloud))


def _describe(src: Path, kind: str, settings: str) -> DatasetInfo:
    which = SETS[kind]
    info = DatasetInfo(
        name="opr",
        version=kind,
        source=f"OpenPlaceRecognition's prepared {kind} set; {settings}",
        licence=which.licence,
        synthetic=False,
        world=which.world,
        sensors=which.sensors,
        conventions={**CONVENTIONS, **which.conventions},
    )
    return mark_synthetic(info, src, same_world=False)
