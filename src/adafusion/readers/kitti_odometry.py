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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from adafusion.datasets.native import CONVENTIONS, DatasetInfo
from adafusion.datasets.recording import Recording, Shot
from adafusion.datasets.sensor_files import IMAGE_SUFFIXES
from adafusion.geometry import invert, pose
from adafusion.readers.calibration import is_camera_matrix
from adafusion.readers.runs import choose_runs, files_by_stamp, matches
from adafusion.readers.sensors import check_rigid, encoded_image, read_xyz, to_body
from adafusion.readers.text import read_numbers, read_text
from adafusion.readers.track import keyframes
from adafusion.types import Frame, UserError

VELODYNE_HEIGHT_M = 1.73  # above the ground, from the drawing of the sensor setup
RUN_SPACING_M = 10_000.0  # sequences share no world: put apart, none seems to revisit another

T_BODY_LIDAR = pose(np.eye(3), (0.0, 0.0, VELODYNE_HEIGHT_M))

_RECORD_BYTES = 16  # float32 x y z reflectance
_FETCH = "fetch it from the benchmark, or choose other sequences"


def recognises(src: Path) -> bool:
    """Whether `src` holds `sequences` with calibrations and times."""
    return matches(src, "sequences/*/calib.txt", "sequences/*/times.txt")


def read(src: str | Path, *, runs: Sequence[str] | None = None, every_m: float = 0.0) -> Recording:
    """Read the tables of a KITTI odometry folder, one run a sequence.

    Takes every frame that has a file, gaps are no harm; a frame with only an image or only a cloud
    is kept with None for the other. Images are kept byte for byte. `runs` are names such as "04",
    by default all that have files and poses. The world of the first run is the body frame of its
    first pose; run k lies `k * RUN_SPACING_M` further along y: another list, another world.
    """
    src = Path(src)
    chosen, notes = _choose(src, runs)
    drives = [
        _read_drive(src, run, every_m, origin_y_m=row * RUN_SPACING_M)
        for row, run in enumerate(chosen)
    ]
    thinned = f", a frame every {every_m:g} m" if every_m > 0 else ""
    info = DatasetInfo(
        name="kitti-odometry",
        version="2012",
        source=f"KITTI odometry benchmark (Geiger, Lenz, Urtasun, CVPR 2012){thinned}",
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
    return Recording(
        info=info,
        shots=(shot for drive in drives for shot in _shots(drive)),
        total=sum(len(drive.indices) for drive in drives),
        notes=notes,
    )


def read_velodyne(path: str | Path) -> Float32[np.ndarray, "n 3"]:
    """Points of a KITTI scan in the Velodyne frame, metres; UserError where the file is damaged."""
    return read_xyz(Path(path), _RECORD_BYTES)


def read_matrices(
    path: Path, shapes: Mapping[str, tuple[int, int]], remedy: str
) -> list[Float[np.ndarray, "rows columns"]]:
    """Matrices of a calibration file with lines `name: numbers`, in the order of `shapes`."""
    lines = read_text(path, remedy).splitlines()
    entries = dict(line.split(":", 1) for line in lines if ":" in line)
    matrices = []
    for name, (rows, columns) in shapes.items():
        try:
            matrix = np.array([float(word) for word in entries[name].split()])
            matrix = matrix.reshape(rows, columns)
        except (KeyError, ValueError):
            matrix = np.full((rows, columns), np.nan)
        if not np.isfinite(matrix).all():
            raise UserError(f"{path} has no {name} with {rows * columns} numbers: {remedy}")
        matrices.append(matrix)
    return matrices


def split_projection(
    P: Float[np.ndarray, "3 4"], what: str, remedy: str
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "4 4"]]:
    """K and T_camera_rect of P = K [I | t]: rectified cameras differ by a shift alone."""
    K = P[:, :3]
    if not is_camera_matrix(K):
        raise UserError(f"{what} is no projection: {remedy}")
    with np.errstate(over="ignore", invalid="ignore"):
        T_camera_rect = pose(np.eye(3), np.linalg.solve(K, P[:, 3]))
    check_rigid(T_camera_rect, what, remedy)
    return K, T_camera_rect


@dataclass(frozen=True)
class _Drive:
    """One sequence: everything but the images and clouds."""

    run: str
    timestamps_us: list[int]  # of all frames, with files or without
    T_world_body: Float[np.ndarray, "n 4 4"]
    calibration: dict[str, list[list[float]]]
    images: dict[int, Path]  # by row
    clouds: dict[int, Path]
    indices: list[int]  # frames to write


def _choose(src: Path, runs: Sequence[str] | None) -> tuple[list[str], list[str]]:
    """Sequences to read, and what to say of those left out."""
    folder = src / "sequences"
    there = sorted(path.name for path in folder.glob("*") if path.is_dir())
    if not there:
        raise UserError(f"{folder} holds no sequences: give the folder above `sequences`")
    if runs is None:
        whole = [name for name in there if _has_files(src, name) and _poses(src, name).is_file()]
        left_out = sorted(set(there) - set(whole))
        notes = [f"{src}: left out {', '.join(left_out)}: no files or no poses"] if left_out else []
        return whole or there, notes  # where none is whole, to read the first says what it lacks
    return choose_runs(folder, there, runs), []


def _read_drive(src: Path, run: str, every_m: float, origin_y_m: float) -> _Drive:
    folder, poses_file = src / "sequences" / run, _poses(src, run)
    calibration = _read_calibration(folder / "calib.txt")
    seconds = read_numbers(folder / "times.txt", 1, remedy=_FETCH)[:, 0]
    rows = read_numbers(poses_file, 12, remedy=_FETCH)
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
    if len(seconds) and max(-seconds[0], seconds[-1]) > 1e9:
        raise UserError(
            f"{folder / 'times.txt'} counts no seconds since the start: fetch the file again"
        )
    T_first_cam0 = np.tile(np.eye(4), (len(rows), 1, 1))
    T_first_cam0[:, :3] = rows.reshape(-1, 3, 4)
    check_rigid(T_first_cam0, str(poses_file), "fetch the file again")

    T_body_cam0 = calibration["T_body_cam0"]
    T_world_body = T_body_cam0 @ T_first_cam0 @ invert(T_body_cam0)
    T_world_body[:, 1, 3] += origin_y_m
    images, clouds = _find_images(folder), _find_clouds(folder)
    indices = sorted(images.keys() | clouds.keys())
    if not indices:
        raise UserError(f"{folder} has no image_2/*.png and no velodyne/*.bin: fetch either")
    if indices[-1] >= len(rows):
        raise UserError(
            f"{folder} has a frame {indices[-1]:06d}, {poses_file} only {len(rows)} poses: "
            f"fetch the poses again, or remove the frame"
        )
    kept = keyframes(T_world_body[indices, :3, 3], every_m)
    return _Drive(
        run=run,
        timestamps_us=[round(s * 1e6) for s in seconds.tolist()],
        T_world_body=T_world_body,
        calibration={name: value.tolist() for name, value in calibration.items()},
        images=images,
        clouds=clouds,
        indices=[indices[row] for row in kept],
    )


def _read_calibration(path: Path) -> dict[str, Float[np.ndarray, "rows columns"]]:
    """K of image_2 and the poses of the sensors in the body frame."""
    P2, Tr = read_matrices(path, {"P2": (3, 4), "Tr": (3, 4)}, _FETCH)
    T_cam0_velo = np.vstack([Tr, (0.0, 0.0, 0.0, 1.0)])
    check_rigid(T_cam0_velo, f"{path}: Tr", _FETCH)
    K, T_cam2_cam0 = split_projection(P2, f"{path}: P2", _FETCH)
    T_body_cam0 = T_BODY_LIDAR @ invert(T_cam0_velo)
    return {
        "K": K,
        "T_body_camera": T_body_cam0 @ invert(T_cam2_cam0),
        "T_body_lidar": T_BODY_LIDAR,
        "T_body_cam0": T_body_cam0,  # the poses of the benchmark are those of camera 0
    }


def _poses(src: Path, run: str) -> Path:
    return src / "poses" / f"{run}.txt"


def _has_files(src: Path, run: str) -> bool:
    folder = src / "sequences" / run
    return bool(_find_images(folder) or _find_clouds(folder))


def _find_images(folder: Path) -> dict[int, Path]:
    return files_by_stamp(folder / "image_2", *IMAGE_SUFFIXES)


def _find_clouds(folder: Path) -> dict[int, Path]:
    return files_by_stamp(folder / "velodyne", ".bin")


def _shots(drive: _Drive) -> Iterator[Shot]:
    for index in drive.indices:
        T_world_body = drive.T_world_body[index]
        image, cloud = drive.images.get(index), drive.clouds.get(index)
        yield Shot(
            frame=Frame(
                run=drive.run,
                timestamp_us=drive.timestamps_us[index],
                position_m=tuple(T_world_body[:3, 3].tolist()),
                T_world_body=T_world_body,
            ),
            image=None if image is None else partial(encoded_image, image),
            cloud=None if cloud is None else partial(to_body, read_velodyne, cloud, T_BODY_LIDAR),
            image_suffix=".png" if image is None else image.suffix,
        )
