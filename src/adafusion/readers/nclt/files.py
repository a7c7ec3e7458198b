# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where the files of NCLT's runs are, by the names that its archives and its users give folders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from adafusion.readers.runs import choose_runs
from adafusion.types import UserError

PAPER_RUNS = (
    "2012-01-08",
    "2012-01-22",
    "2012-02-12",
    "2012-02-18",
    "2012-03-31",
    "2012-05-26",
    "2012-08-04",
    "2012-10-28",
    "2012-11-04",
    "2012-12-01",
)
CAMERAS = ("Cam0", "Cam1", "Cam2", "Cam3", "Cam4", "Cam5")  # 0 looks up, 5 ahead, 2 back
LIDARS = ("velodyne_sync", "velodyne_hits")

# what the folder of a run is called beside its date, when it is named after its archive
_ARCHIVES = {"velodyne_data": "vel", "images": "lb3", "sensor_data": "sen"}
_TRUTH = "groundtruth_*.csv"


@dataclass(frozen=True, kw_only=True)
class RunFiles:
    """Where the parts of a run are."""

    run: str
    truth: Path
    ins: tuple[Path, Path] | None  # gps.csv and ms25_euler.csv
    images: Path | None  # folder of the camera
    scan_files: Path | None  # velodyne_sync/
    packets: Path | None  # velodyne_hits.bin


def find_runs(
    src: Path, runs: Sequence[str] | None, camera: str, lidar: str, notes: list[str]
) -> list[RunFiles]:
    """Files of the runs that are named, or else of the paper's that are there, or else of all.

    UserError where a run is unknown, or has neither scans nor pictures.
    """
    truth = find_truth(src)
    if not truth:
        raise UserError(
            f"{src} has no {_TRUTH} in it or one level below: give the folder that holds "
            f"`ground_truth`, and put the files of the runs there"
        )
    files = {run: _find_files(src, run, truth[run], camera, lidar) for run in sorted(truth)}
    usable = [run for run, one in files.items() if one.images or one.scan_files or one.packets]
    if runs is None:
        chosen = choose_runs(src, usable or files, None, preferred=PAPER_RUNS)
        if others := [run for run in usable if run not in chosen]:
            notes.append(f"{', '.join(others)}: not of the paper's ten runs, left out: name them")
    else:
        chosen = choose_runs(src, files, runs)
    for run in chosen:
        if run not in usable:
            raise UserError(
                f"{src} has neither {lidar} nor pictures of {camera} of run {run}: unpack them to "
                f"{src / 'velodyne_data' / run} and {src / 'images' / run}"
            )
    return [files[run] for run in chosen]


def find_truth(src: Path) -> dict[str, Path]:
    """Ground-truth file of each run that has one."""
    paths = sorted([*src.glob(_TRUTH), *src.glob(f"*/{_TRUTH}")])
    return {path.stem.removeprefix("groundtruth_"): path for path in paths}


def _find_files(src: Path, run: str, truth: Path, camera: str, lidar: str) -> RunFiles:

    def find(part: str, name: str) -> Path | None:
        folders = (src / part / run, src / part / f"{run}_{_ARCHIVES[part]}", src / run)
        return next((folder / name for folder in folders if (folder / name).exists()), None)

    gps, euler = (find("sensor_data", name) for name in ("gps.csv", "ms25_euler.csv"))
    return RunFiles(
        run=run,
        truth=truth,
        ins=(gps, euler) if gps is not None and euler is not None else None,
        images=find("images", f"lb3/{camera}"),
        scan_files=find("velodyne_data", lidar) if lidar == "velodyne_sync" else None,
        packets=find("velodyne_data", f"{lidar}.bin") if lidar == "velodyne_hits" else None,
    )
