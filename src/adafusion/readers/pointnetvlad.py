# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Submaps of the PointNetVLAD benchmark (Uy, Lee, CVPR 2018), with RobotCar images if there are.

    <src>/oxford/<run>/pointcloud_20m_10overlap/<t>.bin     submaps of 20 m, one begins every 10 m
    <src>/oxford/<run>/pointcloud_locations_20m_10overlap.csv
    <src>/oxford/<run>/pointcloud_20m/<t>.bin               one begins where the last one ended
    <src>/oxford/<run>/pointcloud_locations_20m.csv
    <src>/inhouse_datasets/<run>/pointcloud_25m_10/<t>.bin  the same of 25 m, every 10 and 25 m
    <src>/inhouse_datasets/<run>/pointcloud_centroids_10.csv, pointcloud_25m_25/, ..._25.csv
    <images>/<run>/stereo/centre/<t>.png        as recorded: Bayer, one channel
    <images>/<run>/<t>.png                      as MinkLoc++ prepares them: RGB
    <images>/lidar2image_ndx.pickle             its times of images by time of submap

`<src>` may also be the folder above `benchmark_datasets`. A submap is 4096 points, float64 x y z in
[-1, 1], without the road: minus their mean, times half of one over their mean distance from it,
negated, so x is back, y left, z up. That is turned to (-x, y, z), forward, left, up. It cannot be
taken back to metres, and there is no pose: neither scale nor heading is kept. A submap's time is
that of its first scan, the position in the table (timestamp, northing, easting) that of its mean,
some ten metres on; here it is x = easting, y = northing, z = 0.

Images are those nearest in time, demosaiced where they are raw and not undistorted, as in
MinkLoc++ (Komorowski, Wysoczanska, Trzcinski, IJCNN 2021).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, Int64, UInt8

from adafusion.datasets.native import CONVENTIONS, DatasetInfo
from adafusion.datasets.recording import Recording, Shot
from adafusion.datasets.sensor_files import check_points, damaged, decode_image, read_bytes
from adafusion.readers.benchmark_lists import (
    read_file_names,
    read_image_index,
)
from adafusion.readers.manifest import is_synthetic, mark_synthetic
from adafusion.readers.robotcar.files import CAMERAS
from adafusion.readers.runs import choose_runs, files_by_stamp, number, whole
from adafusion.readers.text import path_inside, read_records
from adafusion.readers.track import nearest
from adafusion.types import Frame, UserError

POINTS = 4096
SLOP_MS = 1000.0  # what MinkLoc++ counts as too late
IMAGE_INDEX = "lidar2image_ndx.pickle"


class _Layout(NamedTuple):
    """Where submaps of one kind lie, below the benchmark's folder."""

    part: str
    folder: str
    table: str

    @property
    def length_m(self) -> str:
        return self.folder.split("_")[1].removesuffix("m")


LAYOUTS = {
    "20m_10overlap": _Layout(
        "oxford", "pointcloud_20m_10overlap", "pointcloud_locations_20m_10overlap.csv"
    ),
    "20m": _Layout("oxford", "pointcloud_20m", "pointcloud_locations_20m.csv"),
    "25m_10": _Layout("inhouse_datasets", "pointcloud_25m_10", "pointcloud_centroids_10.csv"),
    "25m_25": _Layout("inhouse_datasets", "pointcloud_25m_25", "pointcloud_centroids_25.csv"),
}

UNITS = {  # conventions of submaps, where they depart
    "body": "x forward, y left, z up; the origin is the mean of the points",
    "image": "RGB, not undistorted",
}
CLOUD_UNIT = "normalised: 1 is not a metre, and differs from submap to submap"


def recognises(src: Path) -> bool:
    """Whether submaps of the benchmark, with their tables, lie at `src`."""
    try:
        return any(_root(src, layout) is not None for layout in LAYOUTS.values())
    except OSError:
        return False


def read(
    src: str | Path,
    *,
    runs: Sequence[str] | None = None,
    lidar: str | None = None,
    images: str | Path | None = None,
    camera: str = "stereo/centre",
    slop_ms: float = SLOP_MS,
) -> Recording:
    """Submaps of one kind, each with the image nearest in time where `images` names their folder.

    `lidar` is one of `LAYOUTS`, by default the first of which there are any. A submap without a
    file, and with `images` one without an image within `slop_ms`, is left out and noted. Where a
    lidar2image_ndx.pickle lies at `images` or `src`, it says which image is nearest.
    """
    src = Path(src)
    root, lidar, layout = _find(src, lidar)
    there = sorted(path.parent.name for path in root.glob(f"*/{layout.table}"))
    chosen = choose_runs(root, there, runs)
    notes: list[str] = []
    submaps = [s for run in chosen for s in _read_table(root / run, layout, notes)]
    if not submaps:
        raise UserError(f"{root}/*/{layout.folder} holds no submap that a table names: fetch them")
    if camera not in CAMERAS:
        raise UserError(f"unknown camera {camera!r}: choose from {', '.join(CAMERAS)}")
    settings = f"{lidar}, no images"
    if images is not None:
        pictures = _find_pictures(src, Path(images), camera, chosen)
        submaps = _join(submaps, pictures, slop_ms, notes)
        if not submaps:
            raise UserError(f"{images}: no image lies within {slop_ms:g} ms of any submap")
        settings = f"{lidar}, {camera} within {slop_ms:g} ms, images {images}"
    notes.extend(_missing(root.parent))
    return Recording(
        info=mark_synthetic(
            _describe(layout, settings),
            src if is_synthetic(src) else root.parent,
            same_world=True,
        ),
        shots=_shots(submaps, CAMERAS[camera].demosaic),
        total=len(submaps),
        notes=notes,
    )


def read_submap(path: str | Path) -> Float32[np.ndarray, "4096 3"]:
    """Points of a submap, x forward, y left, z up, in its own unit; UserError where damaged."""
    data = read_bytes(Path(path), "cloud")
    if len(data) != POINTS * 24:
        raise UserError(
            f"{path} has {len(data)} bytes, a submap {POINTS * 24}: replace it with a whole cloud, "
            "or leave it out"
        )
    stored = np.frombuffer(data, "<f8").reshape(POINTS, 3)
    if not (np.abs(stored) <= 1.001).all():  # NaN fails as well
        raise UserError(
            f"{path} holds points outside of [-1, 1]: replace it with a whole cloud, or leave it "
            "out"
        )
    return check_points((stored * (-1.0, 1.0, 1.0)).astype(np.float32), path)


# ------------------------------------------------------------------------------- tables and files


class _Submap(NamedTuple):
    run: str
    time_us: int
    easting_m: float
    northing_m: float
    cloud: Path
    image: Path | None = None
    image_time_us: int | None = None


def _root(src: Path, layout: _Layout) -> Path | None:
    """Folder of the runs: below `src`, below a benchmark_datasets there, or `src` itself."""
    folders = [src / layout.part, src / "benchmark_datasets" / layout.part]
    if src.name == layout.part:
        folders.append(src)
    return next((f for f in folders if any(f.glob(f"*/{layout.table}"))), None)


def _find(src: Path, lidar: str | None) -> tuple[Path, str, _Layout]:
    if lidar is not None and lidar not in LAYOUTS:
        raise UserError(f"unknown lidar {lidar!r}: choose from {', '.join(LAYOUTS)}")
    for name in [lidar] if lidar else LAYOUTS:
        if (root := _root(src, LAYOUTS[name])) is not None:
            return root, name, LAYOUTS[name]
    wanted = [LAYOUTS[lidar]] if lidar else LAYOUTS.values()
    tables = " or ".join(f"{layout.part}/<run>/{layout.table}" for layout in wanted)
    raise UserError(f"{src} has no {tables}: give the folder benchmark_datasets")


def _read_table(folder: Path, layout: _Layout, notes: list[str]) -> list[_Submap]:
    """Submaps of a run that have a file, by time."""
    table, clouds = folder / layout.table, folder / layout.folder
    files = files_by_stamp(clouds, ".bin")
    submaps: dict[int, _Submap] = {}
    rows = 0
    for line, row in read_records(
        table, ("timestamp", "northing", "easting"), remedy="fetch the benchmark again"
    ):
        rows += 1
        time_us = whole(row["timestamp"], table, line)
        northing_m, easting_m = (number(row[c], table, line) for c in ("northing", "easting"))
        if time_us in files and time_us not in submaps:
            submaps[time_us] = _Submap(folder.name, time_us, easting_m, northing_m, files[time_us])
    if lost := rows - len(submaps):
        notes.append(f"{lost} of {rows} rows of {table} have no file of their own: left out")
    return [submaps[time_us] for time_us in sorted(submaps)]


def _missing(root: Path) -> Iterator[str]:
    """Notes of what the benchmark's own lists of training and evaluation name, and is not here."""
    for path in sorted(root.glob("*_queries_*.pickle")) + sorted(
        root.glob("*_evaluation_*.pickle")
    ):
        try:
            files = read_file_names(path)
            lost = sum(not path_inside(root, file, path).is_file() for file in files)
        except UserError as error:  # nothing else needs the list
            yield str(error)
        else:
            if lost:
                yield f"{lost} of the {len(files)} submaps that {path} names are not here"


# ----------------------------------------------------------------------------------------- images


def read_picture(path: str | Path, bayer: int) -> UInt8[np.ndarray, "h w 3"] | bytes:
    """Demosaic a raw image (`bayer` as OpenCV names the pattern); keep an RGB file as it is."""
    data = read_bytes(Path(path), "image")
    image = decode_image(data, path)
    if data[25:26] != b"\0":  # colour type of a PNG: 0 is one channel
        return data
    if min(image.shape[:2]) < 2:
        raise damaged(path, "is too small for a Bayer pattern", "image")
    return cv2.cvtColor(np.ascontiguousarray(image[..., 0]), bayer)


class _Pictures(NamedTuple):
    """Images of one camera by run, and what MinkLoc++ says of which is nearest."""

    files: dict[str, dict[int, Path]]  # by time
    times_us: dict[str, Int64[np.ndarray, " n"]]  # rising
    listed: dict[int, Int64[np.ndarray, " k"]]  # time of a submap -> times of images


def _find_pictures(src: Path, images: Path, camera: str, runs: Sequence[str]) -> _Pictures:
    files = {}
    for run in runs:
        for folder in (images / run / camera, images / run):
            if found := files_by_stamp(folder, ".png"):
                files[run] = found
                break
    if not files:
        raise UserError(
            f"{images} has no <run>/{camera}/<time>.png and no <run>/<time>.png of {runs[0]}"
        )
    lists = [folder / IMAGE_INDEX for folder in (images, src)]
    listed = next((read_image_index(path) for path in lists if path.is_file()), {})
    times = {run: np.array(list(found), dtype=np.int64) for run, found in files.items()}
    return _Pictures(files, times, listed)


def _join(
    submaps: list[_Submap], pictures: _Pictures, slop_ms: float, notes: list[str]
) -> list[_Submap]:
    """Submaps that have an image near in time, with it."""
    joined = []
    total, lost = Counter(s.run for s in submaps), Counter[str]()
    for submap in submaps:
        time_us = _nearest_picture(submap, pictures)
        if time_us is None or not abs(time_us - submap.time_us) <= slop_ms * 1000:
            lost[submap.run] += 1
            continue
        image = pictures.files[submap.run][time_us]
        joined.append(submap._replace(image=image, image_time_us=time_us))
    notes.extend(
        f"{run}: {count} of {total[run]} submaps have no image within {slop_ms:g} ms: left out"
        for run, count in lost.items()
    )
    return joined


def _nearest_picture(submap: _Submap, pictures: _Pictures) -> int | None:
    """Time of the nearest image: the first of those listed that is there, else by the names."""
    if (times_us := pictures.times_us.get(submap.run)) is None:
        return None
    if (listed := pictures.listed.get(submap.time_us)) is not None:
        there = listed[np.isin(listed, times_us)]
        return int(there[0]) if len(there) else None
    return int(times_us[nearest(times_us, np.array([submap.time_us]))[0]])


# ---------------------------------------------------------------------------------------- results


def _shots(submaps: Iterable[_Submap], bayer: int) -> Iterator[Shot]:
    for submap in submaps:
        frame = Frame(
            run=submap.run,
            timestamp_us=submap.time_us,
            position_m=(submap.easting_m, submap.northing_m, 0.0),
            image_time_us=submap.image_time_us if submap.image_time_us != submap.time_us else None,
        )
        image = None if submap.image is None else partial(read_picture, submap.image, bayer)
        yield Shot(frame=frame, image=image, cloud=partial(read_submap, submap.cloud))


def _describe(layout: _Layout, settings: str) -> DatasetInfo:
    oxford = layout.part == "oxford"
    return DatasetInfo(
        name="pointnetvlad",
        version="2018",
        source=f"PointNetVLAD benchmark (Uy, Lee, CVPR 2018); {settings}",
        licence="CC BY-NC-SA 4.0 (RobotCar)" if oxford else "as the benchmark's authors grant it",
        synthetic=False,
        world="UTM zone 30N" if oxford else "PointNetVLAD in-house",
        sensors={
            "lidar": f"{POINTS} points of some {layout.length_m} m of travel, no road",
            "cloud_unit": CLOUD_UNIT,
        },
        conventions={**CONVENTIONS, **UNITS},
    )
