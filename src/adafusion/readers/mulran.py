# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""MulRan (Kim et al., ICRA 2020) and HeLiPR (Jung et al., IJRR 2024): LiDARs without a camera.

MulRan:

    <src>/KAIST01/global_pose.csv               ns, T_world_base as 3x4 row by row; no header
    <src>/KAIST01/Ouster/<ns>.bin               float32 x y z intensity; also in sensor_data/Ouster

HeLiPR, with four LiDARs of their own records (packed, little-endian):

    <src>/Roundabout01/LiDAR_GT/Ouster_gt.txt   ns x y z qx qy qz qw: T_world_lidar
    <src>/Roundabout01/LiDAR/Ouster/<ns>.bin    float32 x y z intensity, uint32 t, uint16
                                                reflectivity, ring, ambient (26 bytes)
                             Velodyne           float32 x y z intensity, uint16 ring, float32 time
                                                (22 bytes)
                             Avia               float32 x y z, uint8 reflectivity, tag, line,
                                                uint32 offset (19 bytes)
                             Aeva               float32 x y z reflectivity velocity, int32 offset,
                                                uint8 line (25 bytes), and float32 intensity (29)
                                                in scans after 1691936557946849179 ns

Layouts after the data sets' file players and point cloud toolbox. Nanoseconds are cut to
microseconds, poses interpolated to the scans. Points at 0 0 0, where a ray never came back, are
dropped. The Ouster of MulRan looks backwards (calib_base2ouster), those of HeLiPR ahead, within
three degrees. The body frame of MulRan is its vehicle's base, moved to the ground; that of HeLiPR
lies under the LiDAR. How high a LiDAR is above the ground is measured from a few clouds where it is
not given: the base of MulRan is 1.80 m below its Ouster, but the road of KAIST03 1.62 m.

The world is UTM zone 52N, or each preparation's own where coordinates are small.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, Int64
from scipy.spatial.transform import Rotation

from adafusion.datasets.native import CONVENTIONS, DatasetInfo
from adafusion.datasets.recording import Recording, Shot
from adafusion.geometry import invert, pose
from adafusion.readers.ground import measure_height
from adafusion.readers.runs import choose_runs, files_by_stamp, matches
from adafusion.readers.sensors import check_rigid, read_xyz, to_body, without_origin, world_of
from adafusion.readers.text import read_text
from adafusion.readers.track import Track, keyframes
from adafusion.types import Frame, UserError

T_BASE_OUSTER = pose(
    Rotation.from_euler("xyz", (0.0001, 0.0003, 179.6654), degrees=True).as_matrix(),
    (1.7042, -0.021, 1.8047),
)

LIDARS = {"Ouster": 26, "Velodyne": 22, "Avia": 19, "Aeva": 29}  # of HeLiPR: bytes a point
_AEVA_EARLY_NS, _AEVA_EARLY_BYTES = 1691936557946849179, 25
_MULRAN_BYTES = 16

_POSE_GAP_US = 1_000_000
_UTM = "UTM zone 52N"


def recognises_mulran(src: Path) -> bool:
    """Whether `src` holds runs with poses and an Ouster."""
    return matches(src, "*/global_pose.csv") and (
        matches(src, "*/Ouster") or matches(src, "*/sensor_data/Ouster")
    )


def recognises_helipr(src: Path) -> bool:
    """Whether `src` holds runs with poses of their LiDARs."""
    return matches(src, "*/LiDAR", "*/LiDAR_GT/*_gt.txt")


def read_mulran(
    src: str | Path,
    *,
    runs: Sequence[str] | None = None,
    every_m: float = 5.0,
    lidar_height_m: float | None = None,
) -> Recording:
    """Read the tables of MulRan runs, as "KAIST01": clouds alone, as there is no camera.

    `lidar_height_m` None measures it.
    """
    src, notes = Path(src), ["MulRan has no camera: frames have clouds alone"]
    folders = {path.parent.name: path.parent for path in src.glob("*/global_pose.csv")}
    if not folders:
        raise UserError(f"{src} holds no <run>/global_pose.csv: give the folder above the runs")
    drives = []
    for run in choose_runs(src, folders, runs):
        folder = folders[run]
        times_us, T_world_base = read_global_poses(folder / "global_pose.csv")
        track = Track(times_us, T_world_base @ T_BASE_OUSTER)
        scans = folder / "Ouster"
        scans = scans if scans.is_dir() else folder / "sensor_data/Ouster"
        drives.append(_read_drive(run, scans, track, every_m, notes))
    T_body_level = T_BASE_OUSTER.copy()
    T_body_level[2, 3] = 0.0
    return _recording(
        drives,
        DatasetInfo(
            name="mulran",
            version="2020",
            source="MulRan (Kim, Park, Cho, Jeong, Kim, ICRA 2020)",
            licence="CC BY-NC-SA 4.0",
            synthetic=False,
            world="",
        ),
        "Ouster OS1-64",
        partial(_read_scan, record_bytes=_MULRAN_BYTES),
        T_body_level,
        every_m,
        lidar_height_m,
        notes,
    )


def read_helipr(
    src: str | Path,
    *,
    runs: Sequence[str] | None = None,
    every_m: float = 5.0,
    lidar: str = "Ouster",
    lidar_height_m: float | None = None,
) -> Recording:
    """Read the tables of HeLiPR runs, as "Roundabout01", for one of their LiDARs.

    Clouds alone, as there is no camera; `lidar_height_m` None measures it.
    """
    src, notes = Path(src), ["HeLiPR has no camera: frames have clouds alone"]
    if lidar not in LIDARS:
        raise UserError(f"lidar {lidar!r} is none of {', '.join(LIDARS)}: choose one")
    folders = {f.parent.parent.name: f.parent.parent for f in src.glob(f"*/LiDAR/{lidar}")}
    if not folders:
        raise UserError(f"{src} holds no <run>/LiDAR/{lidar}: give the folder above the runs")
    drives = []
    for run in choose_runs(src, folders, runs):
        folder = folders[run]
        track = Track(*read_lidar_poses(folder / f"LiDAR_GT/{lidar}_gt.txt"))
        drives.append(_read_drive(run, folder / "LiDAR" / lidar, track, every_m, notes))
    return _recording(
        drives,
        DatasetInfo(
            name="helipr",
            version="2024",
            source=f"HeLiPR (Jung et al., IJRR 2024), {lidar}",
            licence="CC BY-NC-SA 4.0",
            synthetic=False,
            world="",
        ),
        lidar,
        partial(_read_aeva if lidar == "Aeva" else _read_scan, record_bytes=LIDARS[lidar]),
        np.eye(4),
        every_m,
        lidar_height_m,
        notes,
    )


def read_global_poses(
    path: str | Path,
) -> tuple[Int64[np.ndarray, " n"], Float64[np.ndarray, "n 4 4"]]:
    """Times in microseconds, rising, and T_world_base of a `global_pose.csv`."""
    times_us, rows = _read_stamped(path, 12, delimiter=",")
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3] = rows.reshape(-1, 3, 4)
    check_rigid(T, str(path), _fetch(path))
    return times_us, T


def read_lidar_poses(
    path: str | Path,
) -> tuple[Int64[np.ndarray, " n"], Float64[np.ndarray, "n 4 4"]]:
    """Times in microseconds, rising, and T_world_lidar of a `<lidar>_gt.txt`."""
    times_us, rows = _read_stamped(path, 7, delimiter=None)
    lengths = np.linalg.norm(np.clip(rows[:, 3:], -2.0, 2.0), axis=1)
    if (np.abs(lengths - 1.0) > 0.01).any():
        row = 1 + int(np.argmax(np.abs(lengths - 1.0) > 0.01))
        raise UserError(f"{path}: row {row} has no unit quaternion: {_fetch(path)}")
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, :3] = Rotation.from_quat(rows[:, 3:]).as_matrix()
    T[:, :3, 3] = rows[:, :3]
    check_rigid(T, str(path), _fetch(path))
    return times_us, T


@dataclass(frozen=True, eq=False)
class _Drive:
    """The frames of one run."""

    run: str
    time_us: Int64[np.ndarray, " n"]
    T_world_lidar: Float64[np.ndarray, "n 4 4"]
    clouds: list[Path]


def _read_drive(run: str, scans: Path, track: Track, every_m: float, notes: list[str]) -> _Drive:
    by_ns = files_by_stamp(scans, ".bin")
    if not by_ns:
        raise UserError(f"{scans} holds no <nanoseconds>.bin: fetch the scans of {run}")
    times_us = np.array([ns // 1000 for ns in by_ns], np.int64)
    clouds = list(by_ns.values())
    known = track.near(times_us, _POSE_GAP_US)
    if not known.any():
        raise UserError(f"no scan in {scans} has a pose at its time: fetch the run's poses again")
    if not known.all():
        notes.append(
            f"{(~known).sum()} of {len(known)} scans of {run} have no pose within "
            f"{_POSE_GAP_US / 1e6:g} s: left out"
        )
    kept = np.flatnonzero(known)
    T_world_lidar = track.at(times_us[kept])
    rows = keyframes(T_world_lidar[:, :3, 3], every_m)
    return _Drive(
        run, times_us[kept[rows]], T_world_lidar[rows], [clouds[row] for row in kept[rows]]
    )


def _recording(
    drives: Sequence[_Drive],
    info: DatasetInfo,
    lidar: str,
    read_scan: Callable[[Path], Float32[np.ndarray, "n 3"]],
    T_body_level: Float64[np.ndarray, "4 4"],  # of the LiDAR, its height still 0
    every_m: float,
    lidar_height_m: float | None,
    notes: list[str],
) -> Recording:
    if lidar_height_m is None:
        turn = pose(T_body_level[:3, :3], (0.0, 0.0, 0.0))
        scans = [partial(to_body, read_scan, path, turn) for d in drives for path in d.clouds]
        lidar_height_m = measure_height(scans, "the recording")
        notes.append(f"the {lidar} is {lidar_height_m:.2f} m above the ground, by the clouds")
    T_body_lidar = T_body_level.copy()
    T_body_lidar[2, 3] = lidar_height_m
    positions = np.concatenate([drive.T_world_lidar[:, :3, 3] for drive in drives])
    thinned = f", a frame every {every_m:g} m" if every_m > 0 else ""
    info = replace(
        info,
        source=f"{info.source}{thinned}",
        world=world_of(positions, _UTM, info.world),
        sensors={"lidar": f"{lidar}, {lidar_height_m:.2f} m above the ground"},
        calibration={"T_body_lidar": T_body_lidar.tolist()},
        conventions={**CONVENTIONS, "world": "x east, y north, z up"},
    )
    return Recording(
        info=info,
        shots=(shot for drive in drives for shot in _shots(drive, read_scan, T_body_lidar)),
        total=len(positions),
        notes=notes,
    )


def _shots(
    drive: _Drive,
    read_scan: Callable[[Path], Float32[np.ndarray, "n 3"]],
    T_body_lidar: Float64[np.ndarray, "4 4"],
) -> Iterator[Shot]:
    for time_us, T_world_lidar, path in zip(
        drive.time_us.tolist(), drive.T_world_lidar, drive.clouds, strict=True
    ):
        T_world_body = T_world_lidar @ invert(T_body_lidar)
        yield Shot(
            frame=Frame(
                run=drive.run,
                timestamp_us=time_us,
                position_m=tuple(T_world_body[:3, 3].tolist()),
                T_world_body=T_world_body,
            ),
            image=None,
            cloud=partial(to_body, read_scan, path, T_body_lidar),
        )


def _read_scan(path: Path, record_bytes: int) -> Float32[np.ndarray, "n 3"]:
    return without_origin(read_xyz(path, record_bytes))


def _read_aeva(path: Path, record_bytes: int) -> Float32[np.ndarray, "n 3"]:
    early = int(path.stem) <= _AEVA_EARLY_NS
    return without_origin(read_xyz(path, _AEVA_EARLY_BYTES if early else record_bytes))


def _read_stamped(
    path: str | Path, columns: int, delimiter: str | None
) -> tuple[Int64[np.ndarray, " n"], Float64[np.ndarray, "n columns"]]:
    """Microseconds and numbers of rows that begin with nanoseconds, by rising time.

    Of rows with one time, the first is taken. Nanoseconds would not be exact as floats.
    """
    rows: dict[int, list[float]] = {}
    for number, line in enumerate(read_text(path, _fetch(path)).splitlines(), start=1):
        words = line.strip().split(delimiter)
        if words in ([], [""]):
            continue
        try:
            time_us, row = int(words[0]) // 1000, [float(word) for word in words[1:]]
        except ValueError:
            time_us, row = -1, []
        if len(row) != columns or not 0 <= time_us < 2**62 or not np.isfinite(row).all():
            raise UserError(
                f"{path}: line {number} is not nanoseconds and {columns} finite numbers: "
                f"{_fetch(path)}"
            )
        rows.setdefault(time_us, row)
    if not rows:
        raise UserError(f"{path} holds no poses: {_fetch(path)}")
    times = sorted(rows)
    return np.array(times, np.int64), np.array([rows[time] for time in times])


def _fetch(path: str | Path) -> str:
    return f"fetch {Path(path).name} of this run again"
