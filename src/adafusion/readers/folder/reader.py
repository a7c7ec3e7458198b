# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Plain folders: images, clouds and a table of poses, as anyone may save them.

    <src>/images/<name>.png             or .jpg .jpeg .bmp .tif .tiff
    <src>/clouds/<name>.pcd             or .bin .npy .ply .las: `adafusion.readers.clouds`
    <src>/poses.csv                     or rows as TUM or KITTI have them: `pose_files`

Several runs lie side by side, each in a folder of its own: `<src>/<run>/images/...`. Poses are
those of the body, in one world for all runs, z up; latitudes become UTM. Clouds are moved by
`T_body_lidar` of the calibration, or up by `lidar_height_m`; without either they are in the body
frame already. Images stay as they are, byte for byte, unless the calibration has `distortion` (they
are undistorted then) or they are neither PNG nor JPEG; both are written as PNG.

A name is one of two things, for all files of a run alike:

* a time, where it has a decimal point (seconds) or is large enough to count seconds, milliseconds,
  microseconds or nanoseconds since 1970. A pose is interpolated to it.
* anything else is matched to the equal name of the other sensor's file and to a row of the poses:
  if there are as many names as rows, in order; else by its number, the first row being 0. Whole
  numbers may also count s, ms, us or ns on the clock of the poses: the unit whose span is nearest
  to theirs, if half of the names lie within them. Where both fit and differ, they are refused.

A frame has the time of its cloud; without times in the poses, row i is i seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Float32, Int64, UInt8

from adafusion.datasets.native import CONVENTIONS, DatasetInfo
from adafusion.datasets.recording import Recording, Shot
from adafusion.datasets.sensor_files import read_image
from adafusion.geometry import pose, transform
from adafusion.readers.calibration import Calibration, read_calibration, undistort
from adafusion.readers.clouds import read_points
from adafusion.readers.folder.files import KEPT_IMAGES, RunFiles, find_files, find_poses, find_runs
from adafusion.readers.folder.names import name_times
from adafusion.readers.manifest import mark_synthetic
from adafusion.readers.pose_files import PoseTable, read_poses
from adafusion.readers.runs import choose_runs
from adafusion.readers.sensors import encoded_image
from adafusion.readers.track import Track, keyframes, nearest
from adafusion.types import Frame, UserError

POSE_GAP_S = 2.0  # poses further apart say nothing of what lies between


def recognises(src: Path) -> bool:
    """Whether `src` or a folder in it has images or clouds where `read` looks for them."""
    try:
        if not src.is_dir() or (src / "dataset.yaml").exists():
            return False
        return bool(find_runs(src, None, None))
    except (OSError, ValueError, UserError):
        return False


def read(
    src: str | Path,
    *,
    runs: Sequence[str] | None = None,
    every_m: float = 0.0,
    slop_ms: float = 50.0,
    poses: str | Path | None = None,
    calibration: str | Path | None = None,
    camera: str | None = None,
    lidar: str | None = None,
    lidar_height_m: float | None = None,
) -> Recording:
    """What a plain folder holds; see above for how it is laid out.

    `poses` names the table of poses, below the folder of a run or anywhere, where it is not the one
    file there that is called poses, trajectory, groundtruth or odometry (.txt, .csv, .tum).
    `camera` and `lidar` name the folders where there are several, or others than images and clouds.
    Where a run has both, a frame needs both, at most `slop_ms` apart. `calibration` is a file as
    `adafusion.readers.calibration` reads it.
    """
    src = Path(src)
    if not src.is_dir():
        raise UserError(f"{src} is no folder: give the one that holds images, clouds and poses")
    is_said = lidar_height_m is not None
    lidar_height_m = lidar_height_m or 0.0
    if not (0 <= slop_ms <= 60_000 and every_m >= 0 and np.isfinite(lidar_height_m)):
        raise UserError("give a slop of 0 to 60,000 ms, a spacing from 0 m on and a finite height")
    folders = find_runs(src, camera, lidar)
    if not folders:
        raise UserError(
            f"{src} holds no images or clouds: they lie in its folders images and clouds, or in "
            f"those of <run>; name others by --camera and --lidar"
        )
    known = Calibration() if calibration is None else read_calibration(calibration)
    T_body_lidar = pose(np.eye(3), (0.0, 0.0, lidar_height_m))
    if known.T_body_lidar is not None:
        if lidar_height_m:
            raise UserError(f"{calibration} has T_body_lidar: leave the height of the LiDAR out")
        T_body_lidar = known.T_body_lidar

    shots: list[Shot] = []
    notes: list[str] = []
    zones: dict[str, str | None] = {}
    timeless = False
    for run in choose_runs(src, folders, runs):
        files = find_files(run, folders[run], camera, lidar)
        path = find_poses(src, folders[run], poses)
        zone = next(iter(zones.values()), None)
        table = read_poses(path, zone)
        zones[run] = table.zone
        timeless |= table.time_us is None
        found = _join(files, table, path, round(slop_ms * 1000), every_m, notes)
        shots += _shots(files, found, known, T_body_lidar)
    if known.T_body_lidar is None and not is_said:
        notes.append(
            "clouds are taken to be in the body frame, z = 0 on the ground: give --lidar-height-m "
            "or --calibration where they are the LiDAR's own"
        )
    if len(set(zones.values())) > 1:
        raise UserError(f"{src}: only some runs have latitudes: prepare the others by themselves")

    zone = next(iter(zones.values()))
    sensors_at = known.as_plain() | {"T_body_lidar": T_body_lidar.tolist()}
    world = "x east, y north of the UTM grid, z up" if zone else "z up; as the poses have it"
    info = DatasetInfo(
        name="folder",
        version="1",
        source=f"folder: camera {camera or 'found'}, lidar {lidar or 'found'}, "
        f"{lidar_height_m:g} m up, poses {poses or 'found'}; image and cloud "
        f"within {slop_ms:g} ms, every {every_m:g} m, distortion {list(known.distortion)}",
        licence="as its source",
        synthetic=False,
        world=f"UTM zone {zone}" if zone else "",
        calibration=sensors_at,
        conventions=CONVENTIONS
        | {"world": world}
        | ({"time": "row i of the poses is i seconds: they have no times"} if timeless else {}),
    )
    info = mark_synthetic(info, src, same_world=False)
    return Recording(info=info, shots=shots, total=len(shots), notes=notes)


@dataclass(frozen=True, eq=False)
class _Found:
    """What becomes the frames of a run: a row for each."""

    time_us: Int64[np.ndarray, " n"]
    T_world_body: Float[np.ndarray, "n 4 4"]
    has_rotation: bool
    images: list[str] | None  # names
    clouds: list[str] | None
    image_time_us: Int64[np.ndarray, " n"]


def _join(
    files: RunFiles, table: PoseTable, path: Path, slop_us: int, every_m: float, notes: list[str]
) -> _Found:
    """Bring images, clouds and poses of a run together by time."""
    of_name, pose_us = name_times(files.images, files.clouds, table, path, slop_us)
    images, image_us = _by_time(files.images, of_name, files.run)
    clouds, cloud_us = _by_time(files.clouds, of_name, files.run)
    kind, time_us = ("clouds", cloud_us) if clouds else ("images", image_us)
    partner = np.arange(len(time_us))
    keep = np.ones(len(time_us), dtype=bool)
    if images and clouds:
        partner = nearest(image_us, cloud_us)
        keep = np.abs(image_us[partner] - cloud_us) <= slop_us
        _note(notes, ~keep, f"{kind} of {files.run} have no image within {slop_us / 1000:g} ms")
    track = Track(pose_us, table.T_world_body)
    placed = track.near(time_us, round(POSE_GAP_S * 1e6))
    _note(notes, ~placed, f"{kind} of {files.run} lie outside the poses or in a gap of them")
    keep &= placed
    if not keep.any():
        raise UserError(
            f"no frame of {files.run} is left: {kind} from {time_us[0]} to {time_us[-1]} us, poses "
            f"from {pose_us[0]} to {pose_us[-1]} us in {path}, image and cloud within "
            f"{slop_us / 1000:g} ms: see that their times have one clock, or allow more"
        )
    rows = np.flatnonzero(keep)
    T = track.at(time_us[rows])
    chosen = keyframes(T[:, :3, 3], every_m)
    rows, T = rows[chosen], T[chosen]
    if table.has_rotation:
        _note_sideways(notes, T, files.run)
    return _Found(
        time_us=time_us[rows],
        T_world_body=T,
        has_rotation=table.has_rotation,
        images=[images[i] for i in partner[rows]] if images else None,
        clouds=[clouds[i] for i in rows] if clouds else None,
        image_time_us=image_us[partner[rows]] if images else time_us[rows],
    )


def _by_time(
    files: dict[str, Path], of_name: dict[str, int], run: str
) -> tuple[list[str], Int64[np.ndarray, " n"]]:
    names = sorted(files, key=lambda name: of_name[name])
    time_us = np.array([of_name[name] for name in names], dtype=np.int64)
    if same := np.flatnonzero(np.diff(time_us) <= 0).tolist():
        a, b = files[names[same[0]]], files[names[same[0] + 1]]
        raise UserError(f"{a} and {b.name} of run {run} have the same time: remove one")
    return names, time_us


def _note(notes: list[str], lost: Bool[np.ndarray, " n"], what: str) -> None:
    if lost.any():
        notes.append(f"{lost.sum()} of {len(lost)} {what}: left out")


def _note_sideways(notes: list[str], T: Float[np.ndarray, "n 4 4"], run: str) -> None:
    """Say so where the vehicle does not move along its own x axis: a sign of other axes."""
    steps = np.diff(T[:, :3, 3], axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    moved = lengths > 0.2
    if moved.sum() < 5:
        return
    along = (steps[moved] * T[:-1][moved][:, :3, 0]).sum(axis=1) / lengths[moved]
    if (off_deg := np.degrees(np.arccos(np.clip(np.median(along), -1, 1)))) > 45:
        notes.append(
            f"{run} moves {off_deg:.0f} degrees off its x axis in the median: see that the poses "
            f"are those of a body with x forward, y left, z up, in a world with z up"
        )


def _shots(
    files: RunFiles, found: _Found, known: Calibration, T_body_lidar: Float[np.ndarray, "4 4"]
) -> list[Shot]:
    shots = []
    for row, time_us in enumerate(found.time_us.tolist()):
        T, image_us = found.T_world_body[row], int(found.image_time_us[row])
        image = None if found.images is None else files.images[found.images[row]]
        cloud = None if found.clouds is None else files.clouds[found.clouds[row]]
        frame = Frame(
            run=files.run,
            timestamp_us=time_us,
            position_m=tuple(T[:3, 3].tolist()),
            T_world_body=T if found.has_rotation else None,
            image_time_us=image_us if image_us != time_us else None,
        )
        shots.append(
            Shot(
                frame=frame,
                image=None if image is None else partial(_image, image, known),
                cloud=None if cloud is None else partial(_in_body, cloud, T_body_lidar),
                image_suffix=_kept_as(image, known) or ".png",
            )
        )
    return shots


def _kept_as(image: Path | None, known: Calibration) -> str | None:
    """Suffix of an image that is kept byte for byte."""
    return None if image is None or known.distortion else KEPT_IMAGES.get(image.suffix.lower())


def _image(path: Path, known: Calibration) -> UInt8[np.ndarray, "h w 3"] | bytes:
    if _kept_as(path, known):
        return encoded_image(path)
    image = read_image(path)
    if known.K is None or not known.distortion:
        return image
    return undistort(image, known.K, known.distortion, where=path)


def _in_body(path: Path, T_body_lidar: Float[np.ndarray, "4 4"]) -> Float32[np.ndarray, "n 3"]:
    return transform(T_body_lidar, read_points(path))
