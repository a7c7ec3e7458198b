# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""KITTI odometry (Geiger, Lenz, Urtasun, CVPR 2012): colour image and Velodyne cloud, with poses.

    <src>/poses/04.txt                  row i: T_first_cam0 of frame i, 3x4 row by row
    <src>/sequences/04/times.txt        row i: seconds since the first frame
    <src>/sequences/04/calib.txt        P2: projection of image_2 from camera 0; Tr: T_cam0_velo
    <src>/sequences/04/image_2/000000.png
    <src>/sequences/04/velodyne/000000.bin      float32 x y z reflectance

Camera 0 looks along z with x right and y down; the Velodyne has x forward, y left, z up. The body
frame lies under the Velodyne, on the ground, with the Velodyne's axes.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from adafusion.datasets.native import CONVENTIONS, Dataset, DatasetInfo, open_dataset
from adafusion.datasets.sensor_files import (
    IMAGE_SUFFIXES,
    check_points,
    decode_image,
    read_bytes,
    write_cloud,
    write_image,
)
from adafusion.datasets.writer import DatasetWriter
from adafusion.geometry import invert, is_rigid, pose, transform
from adafusion.types import Frame, Progress, UserError, silent

VELODYNE_HEIGHT_M = 1.73  # above the ground, from the drawing of the sensor setup
RUN_SPACING_M = 10_000.0  # sequences share no world: put apart, none seems to revisit another

T_BODY_LIDAR = pose(np.eye(3), (0.0, 0.0, VELODYNE_HEIGHT_M))

_RECORD_BYTES = 16  # float32 x y z reflectance

logger = logging.getLogger(__name__)


def prepare_kitti_odometry(
    src: str | Path,
    out: str | Path,
    *,
    sequences: Sequence[str] | None = None,
    progress: Progress = silent,
) -> Dataset:
    """Turn a KITTI odometry folder into a dataset at `out`, one run a sequence; return it opened.

    Takes every frame that has a file, gaps are no harm; a frame with only an image or only a cloud
    is kept with None for the other. Images are kept byte for byte. `sequences` are names such as
    "04", by default all that have files and poses. The world of the first run is the body frame of
    its first pose; run k lies `k * RUN_SPACING_M` further along y: another list, another world.

    All files are read and checked on the way, a frame at a time. UserError names the first one that
    is missing, cut short, empty or not finite, and there is no `out` then.
    """
    src = Path(src)
    drives = [
        _read_drive(src, run, origin_y_m=row * RUN_SPACING_M)
        for row, run in enumerate(_choose(src, sequences))
    ]
    info = DatasetInfo(
        name="kitti-odometry",
        version="2012",
        source="KITTI odometry benchmark (Geiger, Lenz, Urtasun, CVPR 2012)",
        licence="CC BY-NC-SA 3.0",
        synthetic=False,
        world=f"KITTI odometry {' '.join(drive.run for drive in drives)}",
        sensors={
            "camera": "image_2: left colour camera, rectified",
            "lidar": f"Velodyne HDL-64E, {VELODYNE_HEIGHT_M} m above the ground",
        },
        calibration={drive.run: drive.calibration for drive in drives},
        conventions={
            **CONVENTIONS,
            "world": f"z up; each run has its own, put {RUN_SPACING_M:.0f} m apart along y",
        },
    )
    todo = [(drive, index) for drive in drives for index in drive.indices]
    with DatasetWriter(out, info) as writer:
        for drive, index in progress(todo, total=len(todo), desc="prepare"):
            writer.add_written(_convert(drive, index, writer.folder))
    return open_dataset(out)


def read_velodyne(path: str | Path) -> Float32[np.ndarray, "n 3"]:
    """Points of a KITTI scan in the Velodyne frame, metres; UserError where the file is damaged."""
    data = read_bytes(Path(path), "cloud")
    if len(data) % _RECORD_BYTES:
        raise UserError(
            f"{path} is cut short: {len(data)} bytes are no whole number of {_RECORD_BYTES}-byte "
            f"points; replace it with a whole cloud, or leave it out"
        )
    return check_points(np.frombuffer(data, "<f4").reshape(-1, 4)[:, :3], path)


@dataclass(frozen=True)
class _Drive:
    """One sequence: everything but the images and clouds."""

    run: str
    timestamps_us: list[int]  # of all frames, with files or without
    T_world_body: Float[np.ndarray, "n 4 4"]
    calibration: dict[str, list[list[float]]]
    images: dict[int, Path]  # by row
    clouds: dict[int, Path]

    @property
    def indices(self) -> list[int]:
        return sorted(self.images.keys() | self.clouds.keys())


def _choose(src: Path, sequences: Sequence[str] | None) -> list[str]:
    folder = src / "sequences"
    there = sorted(path.name for path in folder.glob("*") if path.is_dir())
    if not there:
        raise UserError(f"{folder} holds no sequences: give the folder above `sequences`")
    if sequences is None:
        whole = [name for name in there if _has_files(src, name) and _poses(src, name).is_file()]
        if left_out := sorted(set(there) - set(whole)):
            logger.warning("%s: left out %s: no files or no poses", src, ", ".join(left_out))
        return whole or there  # where none is whole, to read the first says what it lacks
    chosen = list(dict.fromkeys(sequences))
    if missing := [name for name in chosen if name not in there]:
        raise UserError(f"{folder / missing[0]} is missing: choose from {', '.join(there)}")
    if not chosen:
        raise UserError(f"no sequence of {folder} is chosen: choose from {', '.join(there)}")
    return chosen


def _read_drive(src: Path, run: str, origin_y_m: float) -> _Drive:
    folder, poses_file = src / "sequences" / run, _poses(src, run)
    calibration = _read_calibration(folder / "calib.txt")
    seconds = _read_rows(folder / "times.txt", columns=1)[:, 0]
    rows = _read_rows(poses_file, columns=12)
    if len(rows) != len(seconds):
        raise UserError(
            f"{poses_file} has {len(rows)} poses, {folder / 'times.txt'} {len(seconds)} times: "
            f"fetch both again, they must be of one sequence"
        )
    if (np.diff(seconds) <= 0).any():
        line = 2 + int(np.argmax(np.diff(seconds) <= 0))
        raise UserError(
            f"{folder / 'times.txt'}: line {line} is no later time: fetch the file again"
        )
    T_first_cam0 = np.tile(np.eye(4), (len(rows), 1, 1))
    T_first_cam0[:, :3] = rows.reshape(-1, 3, 4)
    if not is_rigid(T_first_cam0):
        line = 1 + next(i for i, T in enumerate(T_first_cam0) if not is_rigid(T))
        raise UserError(f"{poses_file}: line {line} is no rigid motion: fetch the file again")

    T_body_cam0 = calibration["T_body_cam0"]
    T_world_body = T_body_cam0 @ T_first_cam0 @ invert(T_body_cam0)
    T_world_body[:, 1, 3] += origin_y_m
    drive = _Drive(
        run=run,
        timestamps_us=[round(s * 1e6) for s in seconds.tolist()],
        T_world_body=T_world_body,
        calibration={name: value.tolist() for name, value in calibration.items()},
        images=_find_images(folder),
        clouds=_find_clouds(folder),
    )
    if not drive.indices:
        raise UserError(f"{folder} has no image_2/*.png and no velodyne/*.bin: fetch either")
    if drive.indices[-1] >= len(rows):
        raise UserError(
            f"{folder} has a frame {drive.indices[-1]:06d}, {poses_file} only {len(rows)} poses: "
            f"fetch the poses again, or remove the frame"
        )
    logger.info("%s: %d images, %d clouds", folder, len(drive.images), len(drive.clouds))
    return drive


def _read_calibration(path: Path) -> dict[str, Float[np.ndarray, "rows columns"]]:
    """K of image_2 and the poses of the sensors in the body frame."""
    entries = dict(line.split(":", 1) for line in _read_text(path).splitlines() if ":" in line)
    P2, Tr = (_matrix(path, entries, name) for name in ("P2", "Tr"))
    K = P2[:, :3]
    T_cam0_velo = np.vstack([Tr, (0.0, 0.0, 0.0, 1.0)])
    if not is_rigid(T_cam0_velo):
        raise UserError(f"{path}: Tr is no rigid motion: fetch the file again")
    if not np.linalg.det(K) > 0:
        raise UserError(f"{path}: P2 is no projection: fetch the file again")
    T_cam2_cam0 = pose(np.eye(3), np.linalg.solve(K, P2[:, 3]))  # P2 = K [I | t]: rectified
    T_body_cam0 = T_BODY_LIDAR @ invert(T_cam0_velo)
    return {
        "K": K,
        "T_body_camera": T_body_cam0 @ invert(T_cam2_cam0),
        "T_body_lidar": T_BODY_LIDAR,
        "T_body_cam0": T_body_cam0,  # the poses of the benchmark are those of camera 0
    }


def _matrix(path: Path, entries: dict[str, str], name: str) -> Float[np.ndarray, "3 4"]:
    try:
        matrix = np.array([float(word) for word in entries[name].split()]).reshape(3, 4)
    except (KeyError, ValueError):
        matrix = np.full((3, 4), np.nan)
    if not np.isfinite(matrix).all():
        raise UserError(
            f"{path} has no {name} with 12 numbers: fetch the odometry calibration again"
        )
    return matrix


def _read_rows(path: Path, columns: int) -> Float[np.ndarray, "rows columns"]:
    rows = []
    for number, line in enumerate(_read_text(path).splitlines(), start=1):
        try:
            row = [float(word) for word in line.split()]
        except ValueError:
            row = []
        if len(row) != columns or not np.isfinite(row).all():
            raise UserError(
                f"{path}: line {number} is not {columns} finite numbers: fetch the file again"
            )
        rows.append(row)
    return np.array(rows).reshape(-1, columns)


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii")
    except FileNotFoundError:
        raise UserError(
            f"{path} is missing: fetch it from the benchmark, or choose other sequences"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path} cannot be read ({error}): fetch it again") from error


def _poses(src: Path, run: str) -> Path:
    return src / "poses" / f"{run}.txt"


def _has_files(src: Path, run: str) -> bool:
    folder = src / "sequences" / run
    return bool(_find_images(folder) or _find_clouds(folder))


def _find_images(folder: Path) -> dict[int, Path]:
    return _find_files(folder / "image_2", IMAGE_SUFFIXES)


def _find_clouds(folder: Path) -> dict[int, Path]:
    return _find_files(folder / "velodyne", (".bin",))


def _find_files(folder: Path, suffixes: Sequence[str]) -> dict[int, Path]:
    names = sorted(folder.glob("[0-9]" * 6 + ".*"))
    return {int(path.stem): path for path in names if path.suffix in suffixes}


def _convert(drive: _Drive, index: int, folder: Path) -> Frame:
    """Check and write the files of one frame."""
    timestamp_us, T_world_body = drive.timestamps_us[index], drive.T_world_body[index]
    image = cloud = None
    if index in drive.images:
        source = drive.images[index]
        data = read_bytes(source, "image")
        decode_image(data, source)  # finds damage; the bytes are kept as they are
        image = write_image(folder, drive.run, timestamp_us, data, source.suffix)
    if index in drive.clouds:
        points_body = transform(T_BODY_LIDAR, read_velodyne(drive.clouds[index]))
        cloud = write_cloud(folder, drive.run, timestamp_us, points_body)
    return Frame(
        run=drive.run,
        timestamp_us=timestamp_us,
        position_m=tuple(T_world_body[:3, 3].tolist()),
        T_world_body=T_world_body,
        image=image,
        cloud=cloud,
    )
