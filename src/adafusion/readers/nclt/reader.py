# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""NCLT, the University of Michigan North Campus Long-Term data set, as its archives unpack.

    <src>/ground_truth/groundtruth_<run>.csv                                    see `poses`
    <src>/sensor_data/<run>/{gps,ms25_euler}.csv
    <src>/velodyne_data/<run>/velodyne_sync/<utime>.bin, or velodyne_hits.bin   see `velodyne`
    <src>/images/<run>/lb3/Cam5/<utime>.tiff                                    see `camera`
    <src>/cam_params/{K_cam5,x_lb3_c5}.csv, <src>/U2D_Cam5_1616X1232.txt

A run is a date. Its files may also lie in `<src>/<run>/`, where the archives put them when all are
unpacked in one folder, or in folders named after the archives (`velodyne_data/<run>_vel/`).

World: x = east, y = north, z up (the ground truth's y, x and -z), from 42.293227 N, 83.709657 W,
270 m. Body: x forward, y left, z up (x, -y, -z of the robot's frame, whose origin a scan shows to
be on the ground). The robot balances on two wheels: poses and clouds lean with it.

Source: N. Carlevaris-Bianco, A. K. Ushani, R. M. Eustice, IJRR 35(9), 2016, and the sample scripts
of the data set's site, robots.engin.umich.edu/nclt.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from adafusion.datasets.native import CONVENTIONS, DatasetInfo
from adafusion.datasets.recording import Recording, Shot
from adafusion.readers.manifest import mark_synthetic
from adafusion.readers.nclt.camera import Lens, read_lens, read_picture
from adafusion.readers.nclt.files import (
    CAMERAS,
    LIDARS,
    RunFiles,
    find_runs,
    find_truth,
)
from adafusion.readers.nclt.poses import read_ins, read_truth, track_around
from adafusion.readers.nclt.velodyne import (
    T_BODY_VELODYNE,
    TURN_EDGES_US,
    find_turn,
    read_scan,
    read_turn,
)
from adafusion.readers.runs import file_times
from adafusion.readers.sensors import refuse
from adafusion.readers.track import keyframes, nearest
from adafusion.types import Frame, UserError

POSE_GAP_US = 200_000  # the longest time between two poses that a frame may lie in
CAMERA_US = 200_000  # between frames of a run that has packets and no pictures, as the cameras did


def recognises(src: Path) -> bool:
    """Whether a folder holds ground truth of NCLT."""
    try:
        return bool(find_truth(src))
    except OSError:
        return False


def read(
    src: str | Path,
    *,
    runs: Sequence[str] | None = None,
    every_m: float = 10.0,
    camera: str = "Cam5",
    lidar: str = "velodyne_sync",
    slop_ms: float = 10.0,
    calibration: str | Path | None = None,
) -> Recording:
    """Frames of some runs, one about every `every_m` metres (0: all), at the times of the scans.

    By default the runs are those of the AdaFusion paper that are there, or else all. `calibration`
    is the folder of the camera's files where that is not `src`. A frame has a scan and a picture at
    most `slop_ms` apart; a run that has only one of the two gives frames of that sensor alone.

    With `velodyne_hits` a frame has the time of a picture and the turn that ended then, freed of
    the robot's motion by the ground truth: what `velodyne_sync` has, which its makers freed by
    odometry.
    """
    src = Path(src)
    if camera not in CAMERAS:
        raise UserError(f"unknown camera {camera!r}: choose from {', '.join(CAMERAS)}")
    if lidar not in LIDARS:
        raise UserError(f"unknown lidar {lidar!r}: choose from {', '.join(LIDARS)}")
    if not (0 <= every_m < np.inf and 0 <= slop_ms < 1e9):
        raise UserError(f"every-m {every_m} and slop-ms {slop_ms} must be numbers of 0 or more")
    notes: list[str] = []
    chosen = find_runs(src, runs, camera, lidar, notes)
    seen = any(files.images is not None for files in chosen)
    lens = read_lens(Path(calibration or src), camera) if seen else None
    drives = [_read_drive(files, every_m, round(slop_ms * 1000), notes) for files in chosen]
    settings = f"every {every_m:g} m, {camera}, {lidar}, at most {slop_ms:g} ms apart"
    if calibration is not None:
        settings += f", calibration {calibration}"
    return Recording(
        info=_describe(src, settings, camera, lens),
        shots=(shot for drive in drives for shot in _shots(drive, lens)),
        total=sum(len(drive.time_us) for drive in drives),
        notes=notes,
    )


# ------------------------------------------------------------------------------------------ frames


@dataclass(frozen=True, eq=False, kw_only=True)
class _Drive:
    """The frames of a run."""

    files: RunFiles
    time_us: Int64[np.ndarray, " n"]
    image_us: Int64[np.ndarray, " n"]  # `time_us` where there are no pictures
    T_world_body: Float64[np.ndarray, "n 4 4"]
    has_ins: Bool[np.ndarray, " n"]
    T_world_ins: Float64[np.ndarray, "n 4 4"]
    turns: list[partial[Any]]  # of velodyne_hits alone: each reads one, or tells what is amiss


def _read_drive(files: RunFiles, every_m: float, slop_us: int, notes: list[str]) -> _Drive:
    """Which frames a run has: those with a partner in time and a pose, thinned out by way."""
    rows, lost = read_truth(files.truth)
    if lost:
        notes.append(f"{files.truth}: {lost} of {lost + len(rows)} rows hold no pose: skipped")
    time_us, image_us = _candidates(files, rows, slop_us, notes)

    edges_us = time_us[:, None] + (TURN_EDGES_US if files.packets else np.zeros(1, np.int64))
    track = track_around(rows, edges_us.ravel())
    posed = track.near(edges_us[:, 0], POSE_GAP_US) & track.near(time_us, POSE_GAP_US)
    _note_loss(notes, files, posed, f"frames have no pose within {POSE_GAP_US / 1e6:g} s")
    time_us, image_us, edges_us = time_us[posed], image_us[posed], edges_us[posed]

    T_world_body = track.at(time_us)
    kept = keyframes(T_world_body[:, :3, 3], every_m)
    turns: list[partial[Any]] = []
    if files.packets is not None:
        T_edges = track.at(edges_us[kept].ravel()).reshape(len(kept), -1, 4, 4)
        found = [
            _turn(files.packets, end_us, T)
            for end_us, T in zip(time_us[kept].tolist(), T_edges, strict=True)
        ]
        turns = [turn for turn in found if turn is not None]
        whole = np.array([turn is not None for turn in found], dtype=bool)
        _note_loss(notes, files, whole, "frames have no whole turn of the LiDAR")
        kept = kept[whole]

    has_ins, T_world_ins = np.zeros(len(kept), dtype=bool), np.tile(np.eye(4), (len(kept), 1, 1))
    if files.ins is not None:
        has_ins, T_world_ins = read_ins(*files.ins, time_us[kept])
    return _Drive(
        files=files,
        time_us=time_us[kept],
        image_us=image_us[kept],
        T_world_body=T_world_body[kept],
        has_ins=has_ins,
        T_world_ins=T_world_ins,
        turns=turns,
    )


def _turn(
    packets: Path, end_us: int, T_world_body: Float64[np.ndarray, "k 4 4"]
) -> partial[Any] | None:
    """What reads the turn that ended at a time; None where it has a gap."""
    try:
        turn = find_turn(packets, end_us, T_world_body)
    except UserError as error:  # damage near this turn says nothing of the others
        return partial(refuse, str(error))
    return None if turn is None else partial(read_turn, turn)


def _candidates(
    files: RunFiles, rows: Float64[np.ndarray, "n 7"], slop_us: int, notes: list[str]
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Times of frames and of their pictures, by the files that are there."""
    if files.images is None:
        notes.append(f"run {files.run} has no pictures: its frames are of the LiDAR alone")
        if files.scan_files is not None:
            time_us = _times(files.scan_files, ".bin")
        else:
            _, first = np.unique(rows[:, 0] // CAMERA_US, return_index=True)
            time_us = rows[first, 0].astype(np.int64)
        return time_us, time_us
    image_us = _times(files.images, ".tiff")
    if files.scan_files is None:
        if files.packets is None:
            notes.append(f"run {files.run} has no scans: its frames are of the camera alone")
        return image_us, image_us
    time_us = _times(files.scan_files, ".bin")
    image_us = image_us[nearest(image_us, time_us)]
    paired = np.abs(image_us - time_us) <= slop_us
    _note_loss(notes, files, paired, f"scans have no image within {slop_us / 1000:g} ms")
    return time_us[paired], image_us[paired]


def _times(folder: Path, suffix: str) -> Int64[np.ndarray, " n"]:
    times = file_times(folder, suffix)
    if len(times) == 0:
        raise UserError(
            f"{folder} holds no <microseconds>{suffix}: unpack it again, or leave the run out"
        )
    return times


def _note_loss(notes: list[str], files: RunFiles, kept: Bool[np.ndarray, " n"], what: str) -> None:
    if not kept.all():
        notes.append(f"run {files.run}: {np.sum(~kept)} of {len(kept)} {what}: left out")


def _shots(drive: _Drive, lens: Lens | None) -> Iterator[Shot]:
    files = drive.files
    for row, (time_us, image_us) in enumerate(
        zip(drive.time_us.tolist(), drive.image_us.tolist(), strict=True)
    ):
        image = cloud = None
        if files.images is not None and lens is not None:
            image = partial(read_picture, files.images / f"{image_us}.tiff", lens.u2d)
        if files.packets is not None:
            cloud = drive.turns[row]
        elif files.scan_files is not None:
            cloud = partial(read_scan, files.scan_files / f"{time_us}.bin")
        T_world_body = drive.T_world_body[row]
        frame = Frame(
            run=files.run,
            timestamp_us=time_us,
            position_m=tuple(T_world_body[:3, 3].tolist()),
            T_world_body=T_world_body,
            T_world_ins=drive.T_world_ins[row] if drive.has_ins[row] else None,
            image_time_us=image_us if image_us != time_us else None,
        )
        yield Shot(frame=frame, image=image, cloud=cloud)


# ------------------------------------------------------------------------------------- the dataset


def _describe(src: Path, settings: str, camera: str, lens: Lens | None) -> DatasetInfo:
    calibration = {"T_body_lidar": T_BODY_VELODYNE.tolist()}
    sensors = {"lidar": "Velodyne HDL-32E, hung upside down 0.96 m above the ground"}
    if lens is not None:
        height, width = lens.size
        sensors["camera"] = f"Ladybug3 {camera}, undistorted and upright, {width} x {height}"
        calibration |= {"K": lens.K.tolist(), "T_body_camera": lens.T_body_camera.tolist()}
    info = DatasetInfo(
        name="nclt",
        version="2016",
        source=f"NCLT (Carlevaris-Bianco, Ushani, Eustice, IJRR 2016); {settings}",
        licence="ODbL 1.0",
        synthetic=False,
        world="NCLT local ENU",
        sensors=sensors,
        calibration=calibration,
        conventions={**CONVENTIONS, "world": "x east, y north, z up; the same for all runs"},
    )
    return mark_synthetic(info, src, same_world=True)
