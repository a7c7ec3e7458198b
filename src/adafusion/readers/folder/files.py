# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Which runs, sensor files and poses a plain folder has, by their names alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from adafusion.readers.clouds import CLOUD_SUFFIXES
from adafusion.types import UserError

IMAGE_FOLDERS = ("images", "image", "camera", "rgb")
CLOUD_FOLDERS = ("clouds", "cloud", "lidar", "velodyne", "points")
POSE_NAMES = ("poses", "pose", "trajectory", "groundtruth", "ground_truth", "odometry")
KEPT_IMAGES = {".png": ".png", ".jpg": ".jpg", ".jpeg": ".jpg"}

_IMAGE_SUFFIXES = (*KEPT_IMAGES, ".bmp", ".tif", ".tiff")
_CLOUD_SUFFIXES = (*CLOUD_SUFFIXES, ".laz")  # which is refused by name rather than overlooked


@dataclass(frozen=True)
class RunFiles:
    """Sensor files of a run, by name without suffix."""

    run: str
    images: dict[str, Path]
    clouds: dict[str, Path]


def find_runs(src: Path, camera: str | None, lidar: str | None) -> dict[str, Path]:
    """Folder of each run at `src`, by name: `src` itself, or else the folders in it."""
    if _has_sensor(src, camera, lidar):
        name = src.resolve().name
        return {name if name.isprintable() and name.strip(". ") else "run": src}
    inside = [path for path in _listed(src) if _is_folder(path)]
    found = {path.name: path for path in inside if _has_sensor(path, camera, lidar)}
    for name in found:
        if not name.isprintable():
            raise UserError(f"{src} has a run {name!a}: rename it to letters and digits")
    return found


def find_files(run: str, folder: Path, camera: str | None, lidar: str | None) -> RunFiles:
    """The images and clouds of a run; UserError where there are several folders of either."""
    found = []
    for option, named, names, suffixes in (
        ("camera", camera, IMAGE_FOLDERS, _IMAGE_SUFFIXES),
        ("lidar", lidar, CLOUD_FOLDERS, _CLOUD_SUFFIXES),
    ):
        there = _sensor_folders(folder, named, names, suffixes)
        if len(there) > 1:
            both = " and ".join(path.name for path in there)
            raise UserError(f"{folder} has {both}: choose one by the option {option}")
        found.append(_by_name(there[0], suffixes) if there else {})
    return RunFiles(run, *found)


def find_poses(src: Path, folder: Path, given: str | Path | None) -> Path:
    """The one table of poses of a run: the one `given`, else the one in `folder`, else in `src`."""
    if given is not None:
        return folder / given if _is_file(folder / given) else Path(given)
    for place in (folder, src):
        found = [
            path
            for path in _listed(place)
            if path.suffix.lower() == ".tum"
            or (path.suffix.lower() in (".txt", ".csv") and path.stem.lower() in POSE_NAMES)
        ]
        if len(found) > 1:
            names = " and ".join(path.name for path in found)
            raise UserError(f"{place} has {names}: choose one by --poses")
        if found:
            return found[0]
    raise UserError(
        f"{folder} has no poses.txt, poses.csv or .tum: put the poses there, or name their file by "
        f"--poses"
    )


def _has_sensor(folder: Path, camera: str | None, lidar: str | None) -> bool:
    return bool(
        _sensor_folders(folder, camera, IMAGE_FOLDERS, _IMAGE_SUFFIXES)
        or _sensor_folders(folder, lidar, CLOUD_FOLDERS, _CLOUD_SUFFIXES)
    )


def _sensor_folders(
    folder: Path, named: str | None, names: Sequence[str], suffixes: Sequence[str]
) -> list[Path]:
    """Folders that a sensor's files may lie in, and do."""
    paths = [folder / name for name in ((named,) if named else names)]
    return [
        path
        for path in paths
        if _is_folder(path) and any(file.suffix.lower() in suffixes for file in _listed(path))
    ]


def _by_name(folder: Path, suffixes: Sequence[str]) -> dict[str, Path]:
    """Files by name without suffix; what is no file, as a dead link, is refused when it is read."""
    files: dict[str, Path] = {}
    for path in _listed(folder):
        if path.suffix.lower() not in suffixes or _is_folder(path):
            continue
        if not path.name.isprintable():
            raise UserError(f"{folder} has a file {path.name!a}: rename or remove it")
        if path.stem in files:
            raise UserError(f"{folder} has {files[path.stem].name} and {path.name}: remove one")
        files[path.stem] = path
    return files


def _listed(folder: Path) -> list[Path]:
    """What a folder holds, sorted, without hidden names."""
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError as error:
        raise UserError(
            f"{folder} cannot be read ({error.strerror}): give the right to, or another folder"
        ) from error


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:  # of a name that is too long, or without the right to look
        return False


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:
        return False
