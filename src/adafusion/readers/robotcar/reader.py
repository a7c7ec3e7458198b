# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Oxford RobotCar, raw (Maddern, Pascoe, Linegar, Newman, IJRR 2017): pictures and joined scans.

    <src>/<run>/stereo/centre/<t>.png       or stereo/left, stereo/right, mono_{left,right,rear}
    <src>/<run>/lms_front/<t>.bin           or ldmrs
    <src>/<run>/gps/ins.csv
    <src>/<run>/rtk.csv                     or <src>/rtk/<run>/rtk.csv, published apart
    <src>/{models,extrinsics}/              of the development kit, or in a checkout of it:
    <src>/robotcar-dataset-sdk/, beside <src>, or where `calibration` says

A frame is a picture and the submap that begins with it. Its time is that of the picture, its pose
where the vehicle was then; its cloud are the scans of the 20 m of the way from there on, each put
where the vehicle was when it was taken, in the body frame of the picture's instant. So the picture
shows what the cloud holds: both lie ahead. The PointNetVLAD benchmark stamps its submaps as well
with their beginning, but gives the place of their centroid, some 10 m ahead. The ground stays in
the cloud and its unit is the metre.

World: easting, northing, minus down. Body: below the stereo camera, its x axis along the camera's
view on the ground. Two things of it no file tells. How high the camera sits is `CAMERA_HEIGHT_M`;
how far it looks down is measured: it is the angle at which it sees the vehicle drive, the median
over the runs that are read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64

from adafusion.datasets.native import CONVENTIONS, DatasetInfo
from adafusion.datasets.recording import Recording, Shot
from adafusion.geometry import invert, pose, rotation_from_rpy
from adafusion.readers.calibration import Calibration
from adafusion.readers.manifest import mark_synthetic
from adafusion.readers.robotcar.files import (
    CAMERAS,
    LIDARS,
    Poses,
    Rig,
    find_calibration,
    has_poses,
    ins_file,
    read_picture,
    read_poses,
    read_rig,
    read_scan,
    rtk_file,
    runs_there,
)
from adafusion.readers.robotcar.submaps import Sweep, join, looks_down_rad, stretches, sweep
from adafusion.readers.runs import choose_runs, file_times
from adafusion.readers.sensors import T_ENU_NED, T_FLU_FRD
from adafusion.readers.track import Track, keyframes
from adafusion.types import Frame, UserError

# of the paper's comparison
RUNS = (
    *("2014-07-14-14-49-50", "2014-11-18-13-20-12", "2014-12-02-15-30-08", "2014-12-09-13-21-02"),
    *("2014-12-12-10-45-15", "2015-02-03-08-45-10", "2015-02-13-09-16-26", "2015-03-10-14-18-10"),
    *("2015-05-19-14-06-38", "2015-08-13-16-02-58"),
)
LENGTH_M = 20.0  # of a submap, along the way
FAN_M = 0.025  # scans that are nearer to the one before say nothing new
HOLE_M = 2.0  # without a scan, or a jump of the poses; ldmrs has a scan every metre in fast traffic
GAP_US = 200_000  # between poses that are interpolated; recorded are 50 a second

# above the ground: what Wagstaff and Kelly take their scale from on these pictures, in the code of
# "Self-Supervised Scale Recovery for Monocular Depth and Egomotion Estimation" (arXiv 2009.03787)
CAMERA_HEIGHT_M = 1.52
CHORD_US, CHORD_M = 1_000_000, 3.0  # of the way, to see which way the camera looks


def recognises(src: Path) -> bool:
    """Whether `src` holds runs of RobotCar: pictures or scans, and poses."""
    try:
        return any(has_poses(src, run) for run in runs_there(src))
    except OSError:
        return False


def read(
    src: str | Path,
    *,
    runs: Sequence[str] | None = None,
    every_m: float = 10.0,
    camera: str = "stereo/centre",
    lidar: str = "lms_front",
    poses: str | None = None,
    calibration: str | Path | None = None,
) -> Recording:
    """What RobotCar runs at `src` hold: a frame every `every_m` of the way, at a picture.

    `runs`: by default those of the paper's ten that are there, else all. `camera` and `lidar` are
    folders of a run; where a run lacks one of them, its frames have the other alone. `poses` is
    "rtk" or "ins", by default rtk where a run has it; what ins.csv says is kept as `T_world_ins`.
    `calibration` is a folder that holds `models` and `extrinsics`.

    UserError where a table is missing or damaged. Pictures without a pose within 0.2 s and those
    that no whole submap begins at are left out and noted.
    """
    src = Path(src)
    if camera not in CAMERAS:
        raise UserError(f"unknown camera {camera!r}: choose from {', '.join(CAMERAS)}")
    if lidar not in LIDARS:
        raise UserError(f"unknown lidar {lidar!r}: choose from {', '.join(LIDARS)}")
    if poses not in (None, "rtk", "ins"):
        raise UserError(f"unknown poses {poses!r}: choose rtk or ins")
    if not every_m >= 0.0:
        raise UserError(f"every_m = {every_m}: give metres of the way, or 0 for every picture")
    notes: list[str] = []
    chosen = _choose(src, runs, notes)
    rig = read_rig(find_calibration(src, calibration), camera, lidar)
    drives = [_read_drive(src, run, rig, poses, every_m, notes) for run in chosen]
    if not any(len(drive.at_us) for drive in drives):
        raise UserError(f"{src} gives no frame: {'; '.join(notes)}")
    seen = np.concatenate([drive.looks_down_rad for drive in drives])
    looks_down = float(np.median(seen)) if len(seen) else 0.0
    T_body_stereo = pose(
        rotation_from_rpy(0.0, looks_down, 0.0) @ T_FLU_FRD[:3, :3], (0.0, 0.0, CAMERA_HEIGHT_M)
    )
    settings = f"{camera}, submaps of {LENGTH_M:g} m of {lidar}, every {every_m:g} m"
    if calibration is not None:
        settings += f", calibration {calibration}"
    return Recording(
        info=_info(src, drives, rig, T_body_stereo, settings),
        shots=_shots(drives, rig, T_body_stereo),
        total=sum(len(drive.at_us) for drive in drives),
        notes=notes,
    )


# ------------------------------------------------------------------------------------ what is there


def _choose(src: Path, runs: Sequence[str] | None, notes: list[str]) -> list[str]:
    try:
        there = runs_there(src)
    except OSError as error:
        raise UserError(
            f"{src} cannot be read ({error.strerror}): give a folder of runs"
        ) from error
    if not there:
        raise UserError(f"{src} holds no runs: give the folder above <run>/stereo and <run>/gps")
    chosen = choose_runs(src, there, runs, preferred=RUNS)
    if runs is not None:
        return chosen
    with_poses = [run for run in chosen if has_poses(src, run)]
    if lacking := [run for run in chosen if run not in with_poses]:
        notes.append(f"left out, as they have neither gps/ins.csv nor rtk.csv: {' '.join(lacking)}")
    if others := len(there) - len(chosen):
        notes.append(f"{others} runs that are not of the paper's ten are left out: name them")
    return with_poses or chosen  # where none has poses, to read the first says it


# ------------------------------------------------------------------------------------------ one run


@dataclass(frozen=True, eq=False, kw_only=True)
class _Drive:
    """One run: its frames and its scans, all poses those of the stereo camera."""

    folder: Path
    poses: str  # the table they are from
    looks_down_rad: Float64[np.ndarray, " n"]
    at_us: Int64[np.ndarray, " k"]
    has_image: bool
    T_world_stereo: Float64[np.ndarray, "k 4 4"]
    by_ins: dict[int, Float64[np.ndarray, "4 4"]]  # the same as ins.csv says, by row
    scans: Sweep | None
    first: Int64[np.ndarray, " k"]  # scan of each frame's submap,
    end: Int64[np.ndarray, " k"]  # and the one after its last


def _read_drive(
    src: Path, run: str, rig: Rig, poses: str | None, every_m: float, notes: list[str]
) -> _Drive:
    poses = poses or ("rtk" if rtk_file(src, run).is_file() else "ins")
    table = rtk_file(src, run) if poses == "rtk" else ins_file(src, run)
    track = _track(read_poses(table), rig, notes)
    if track is None:
        raise UserError(f"{table} holds no good pose: leave the run out, or give other poses")
    # the lists <sensor>.timestamps name what was recorded; of that, archives bring some parts
    images = file_times(src / run / rig.camera, ".png")
    scan_us = file_times(src / run / rig.lidar, ".bin")
    scans = sweep(track, scan_us, every_m=FAN_M, gap_us=GAP_US) if len(scan_us) else None
    for times, sensor in ((images, rig.camera), (scan_us, rig.lidar)):
        if not len(times):
            notes.append(f"{run}: no files in {sensor}: its frames go without")
    at_us, what = (images, "pictures") if len(images) else (scan_us, "scans")
    known = track.near(at_us, GAP_US)
    if missing := int((~known).sum()):
        notes.append(f"{run}: {missing} of {len(at_us)} {what} lie in a gap of the poses: left out")
    at_us = at_us[known]
    T = track.at(at_us)
    first = end = np.zeros(len(at_us), np.int64)
    if scans is not None:
        first, end, whole = stretches(scans, at_us, T[:, :3, 3], length_m=LENGTH_M, hole_m=HOLE_M)
        if broken := int((~whole).sum()):
            notes.append(
                f"{run}: {broken} of {len(at_us)} {what} have no unbroken {LENGTH_M:g} m of scans "
                "ahead: left out"
            )
        at_us, T, first, end = at_us[whole], T[whole], first[whole], end[whole]
    kept = keyframes(T[:, :3, 3], every_m)
    return _Drive(
        folder=src / run,
        poses=poses,
        looks_down_rad=looks_down_rad(track, chord_us=CHORD_US, gap_us=GAP_US, shortest_m=CHORD_M),
        at_us=at_us[kept],
        has_image=len(images) > 0,
        T_world_stereo=T[kept],
        by_ins=_by_ins(ins_file(src, run), rig, at_us[kept], notes) if poses == "rtk" else {},
        scans=scans,
        first=first[kept],
        end=end[kept],
    )


def _track(found: Poses, rig: Rig, notes: list[str]) -> Track | None:
    """Poses of the stereo camera; None where the table holds no good one."""
    notes += found.notes
    if len(found.time_us) == 0:
        return None
    return Track(found.time_us, T_ENU_NED @ found.T_ned_ins @ invert(rig.T_stereo_ins))


def _by_ins(
    path: Path, rig: Rig, at_us: Int64[np.ndarray, " k"], notes: list[str]
) -> dict[int, Float64[np.ndarray, "4 4"]]:
    track = _track(read_poses(path), rig, notes) if path.is_file() else None
    if track is None:
        return {}
    rows = np.flatnonzero(track.near(at_us, GAP_US))
    return dict(zip(rows.tolist(), track.at(at_us[rows]), strict=True))


# ------------------------------------------------------------------------------------------- frames


def _shots(
    drives: Sequence[_Drive], rig: Rig, T_body_stereo: Float64[np.ndarray, "4 4"]
) -> Iterator[Shot]:
    T_stereo_body = invert(T_body_stereo)
    for drive in drives:
        for row, time_us in enumerate(drive.at_us.tolist()):
            T_world_body = drive.T_world_stereo[row] @ T_stereo_body
            by_ins = drive.by_ins.get(row)
            x, y, z = T_world_body[:3, 3].tolist()
            yield Shot(
                frame=Frame(
                    run=drive.folder.name,
                    timestamp_us=time_us,
                    position_m=(x, y, z),
                    T_world_body=T_world_body,
                    T_world_ins=None if by_ins is None else by_ins @ T_stereo_body,
                ),
                image=_image(drive, rig, time_us) if drive.has_image else None,
                cloud=_cloud(drive, drive.scans, row, rig, T_world_body) if drive.scans else None,
            )


def _image(drive: _Drive, rig: Rig, time_us: int) -> partial[Any]:
    path = drive.folder / rig.camera / f"{time_us}.png"
    return partial(read_picture, path, rig.table, CAMERAS[rig.camera].demosaic)


def _cloud(
    drive: _Drive, scans: Sweep, row: int, rig: Rig, T_world_body: Float64[np.ndarray, "4 4"]
) -> partial[Any]:
    # times and poses of the submap's scans travel with the frame, some 20 kB: for a process to find
    # them itself it would have to read and sort out all tables of the run
    own = slice(int(drive.first[row]), int(drive.end[row]))
    T_body_lidar = invert(T_world_body) @ scans.T_world_body[own] @ rig.T_stereo_lidar
    return partial(_join, drive.folder / rig.lidar, scans.time_us[own], T_body_lidar)


def _join(
    folder: Path, time_us: Int64[np.ndarray, " n"], T_body_lidar: Float[np.ndarray, "n 4 4"]
) -> Float32[np.ndarray, "m 3"]:
    """All points, those of the ground too: CORAL makes a map of heights of them."""
    return join(partial(read_scan, folder, folder.name != "ldmrs"), time_us.tolist(), T_body_lidar)


def _info(
    src: Path,
    drives: Sequence[_Drive],
    rig: Rig,
    T_body_stereo: Float64[np.ndarray, "4 4"],
    settings: str,
) -> DatasetInfo:
    known = Calibration(
        K=rig.K,
        T_body_camera=T_body_stereo @ rig.T_stereo_optical,
        T_body_lidar=T_body_stereo @ rig.T_stereo_lidar,
    )
    info = DatasetInfo(
        name="robotcar",
        version="raw",
        source=f"Oxford RobotCar (Maddern, Pascoe, Linegar, Newman, IJRR 2017); {settings}",
        licence="CC BY-NC-SA 4.0",
        synthetic=False,
        world="UTM zone 30N",
        sensors={
            "camera": f"{rig.camera}, undistorted",
            "lidar": f"{rig.lidar}, joined along {LENGTH_M:g} m of the way from the image on",
            "poses": {drive.folder.name: f"{drive.poses}.csv" for drive in drives},
        },
        calibration=dict(known.as_plain()),
        conventions={
            **CONVENTIONS,
            "world": "x easting, y northing, z up",
            "body": "x forward, y left, z up; on the ground below the stereo camera",
        },
    )
    return mark_synthetic(info, src, same_world=True)
