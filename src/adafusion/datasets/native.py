# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Our own dataset form on disk: what every reader writes and everything else reads.

    <dataset>/dataset.yaml                      DatasetInfo, schema version, frames of each run
    <dataset>/<run>/frames.parquet              one row a frame, by rising timestamp
    <dataset>/<run>/images/<timestamp_us>.png   RGB, or .jpg
    <dataset>/<run>/clouds/<timestamp_us>.npy   (N, 3) float32, body frame, metres

A dataset grows in `<dataset>.partial` and takes its name in one step when it is whole.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from jaxtyping import Bool, Float

from adafusion.datasets.sensor_files import read_cloud, read_image
from adafusion.datasets.splits import check_boxes
from adafusion.files import fingerprint
from adafusion.geometry import is_rigid
from adafusion.types import Frame, Observation, UserError

SCHEMA_VERSION = 1
CONVENTIONS = {
    "body": "x forward, y left, z up; z = 0 is the ground under the vehicle",
    "world": "z up; the same for all runs of the dataset",
    "T_world_body": "4x4, row by row; maps body to world",
    "T_world_ins": "the same as a GPS/INS unit gave it, where the dataset keeps that apart",
    "image": "RGB, undistorted unless the calibration says otherwise",
    "units": "metres, radians, integer microseconds",
}

SCHEMA = pa.schema(
    [
        pa.field("timestamp_us", pa.int64(), nullable=False),
        *(pa.field(axis, pa.float64(), nullable=False) for axis in "xyz"),
        *(pa.field(name, pa.list_(pa.float64(), 16)) for name in ("T_world_body", "T_world_ins")),
        *(pa.field(name, pa.string()) for name in ("image", "cloud", "zone")),
        *(pa.field(name, pa.int64()) for name in ("image_time_us", "cloud_time_us")),
    ]
)
OPTIONAL = ("T_world_ins", "image_time_us", "cloud_time_us")  # columns that a table may lack
_INFO_TYPES: dict[str, type] = {
    "name": str,
    "version": str,
    "source": str,
    "licence": str,
    "synthetic": bool,
    "world": str,
    "sensors": dict,
    "calibration": dict,
    "conventions": dict,
    "regions": dict,
}


@dataclass(frozen=True, kw_only=True)
class DatasetInfo:
    """What a dataset is and where it comes from; all values are plain ones that YAML can hold.

    A writer resumes an unfinished dataset only under an equal DatasetInfo: whatever decides what
    is written (a seed, a profile) belongs into `source` or `sensors`.
    """

    name: str
    version: str
    source: str  # who made it, and with which settings
    licence: str
    synthetic: bool  # True where no real sensor saw it
    world: str = ""  # names the world frame for `Dataset.world`; "": no other dataset shares it
    sensors: dict[str, Any] = field(default_factory=dict)
    # K, T_body_camera, T_body_lidar; by run where they differ
    calibration: dict[str, Any] = field(default_factory=dict)
    conventions: dict[str, str] = field(default_factory=lambda: dict(CONVENTIONS))
    # name -> boxes [xmin, ymin, xmax, ymax] in metres; see `adafusion.datasets.splits`
    regions: dict[str, list[list[float]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_boxes(self.regions)

    @property
    def in_metres(self) -> bool:
        """Whether clouds are; those of submaps with a scale of their own say so in `sensors`."""
        return not str(self.sensors.get("cloud_unit", "")).startswith("normalised")


@dataclass(frozen=True, eq=False)
class Dataset:
    """An opened dataset: all frames are known, no image or cloud is read yet."""

    root: Path
    info: DatasetInfo
    frames: tuple[Frame, ...]  # run after run by name, by rising timestamp within each

    @cached_property
    def runs(self) -> tuple[str, ...]:
        """Names of the runs, sorted."""
        return tuple(sorted({frame.run for frame in self.frames}))

    @cached_property
    def world(self) -> str:
        """Identity of the world frame: positions of two datasets compare only where it is equal."""
        return self.info.world or f"{self.info.name} {self.fingerprint}"

    @cached_property
    def positions_m(self) -> Float[np.ndarray, "n 3"]:
        """Positions of all frames in the world frame, metres."""
        return np.array([frame.position_m for frame in self.frames]).reshape(-1, 3)

    @cached_property
    def fingerprint(self) -> str:
        """Changes with `dataset.yaml`, with any row of a run and with the size of any file.

        Taken when first asked for. Images and clouds are not read: that would take minutes.
        """
        tables = [self.root / "dataset.yaml", *(table_path(self.root, run) for run in self.runs)]
        names = [name for frame in self.frames for name in (frame.image, frame.cloud) if name]
        sizes = np.array([(self.root / name).stat().st_size for name in names], dtype="<i8")
        return fingerprint(*(path.read_bytes() for path in tables), sizes.tobytes())

    def load(self, frame: Frame) -> Observation:
        """Read what the sensors saw at `frame`; UserError where a file is damaged."""
        return Observation(
            image=None if frame.image is None else read_image(self.root / frame.image),
            points_body=None if frame.cloud is None else read_cloud(self.root / frame.cloud),
        )


# ---------------------------------------------------------------------------------------- reading


def open_dataset(path: str | Path) -> Dataset:
    """Open and validate a dataset; UserError names the file at fault and the remedy.

    Checked: schema version and keys of `dataset.yaml`, number of frames of each run, finite
    positions, rigid poses, unique timestamps, and that every file named is there.
    """
    root = Path(path)
    info, counts = _read_info(root)
    frames = [frame for run in sorted(counts) for frame in _read_run(root, run, counts[run])]
    for frame in frames:
        for name in (frame.image, frame.cloud):
            if name is not None and not (root / name).is_file():
                raise UserError(f"{root / name} is missing: restore it, or prepare {root} again")
    return Dataset(root, info, tuple(frames))


def table_path(root: Path, run: str) -> Path:
    """File of the frames of a run."""
    return root / run / "frames.parquet"


def _read_info(root: Path) -> tuple[DatasetInfo, dict[str, int]]:
    """DatasetInfo and the number of frames of each run, from dataset.yaml."""
    path = root / "dataset.yaml"
    if not path.is_file():
        if partial_folder(root).exists():
            raise UserError(f"{root} is not finished: repeat the command that writes it, to resume")
        raise UserError(
            f"{path} is missing: give the folder of a prepared or simulated dataset, or the name "
            "of a world from `adafusion world list`"
        )
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise UserError(f"{path} is no YAML ({error}): prepare the dataset again") from error
    if not isinstance(values, dict) or "schema_version" not in values:
        raise UserError(f"{path} has no schema_version: prepare the dataset again")
    if values["schema_version"] != SCHEMA_VERSION:
        raise UserError(
            f"{path} has schema version {values['schema_version']}, this adafusion reads "
            f"{SCHEMA_VERSION}: update adafusion, or prepare the dataset again"
        )
    if "runs" not in values:
        raise UserError(f"{path} is not finished: repeat the command that writes it, to resume")
    values.setdefault("world", "")  # datasets written before it was noted
    expected = {"schema_version", "runs", *_INFO_TYPES}
    if wrong := expected ^ set(values):
        raise UserError(f"{path} lacks or misspells keys: {', '.join(sorted(map(str, wrong)))}")
    for key, kind in (*_INFO_TYPES.items(), ("runs", dict)):
        if not isinstance(values[key], kind):
            raise UserError(f"{path}: {key} is no {kind.__name__}: {values[key]!r}; mend the entry")
    counts = {str(run): count for run, count in values["runs"].items()}
    for run, count in counts.items():
        if type(count) is not int:
            raise UserError(f"{path}: run {run} has {count!r} for a number of frames; mend it")
    try:
        regions = {
            name: [[float(edge) for edge in box] for box in boxes]
            for name, boxes in values["regions"].items()
        }
        return DatasetInfo(
            **{key: values[key] for key in _INFO_TYPES} | {"regions": regions}
        ), counts
    except (ValueError, TypeError) as error:
        raise UserError(f"{path}: {error}; mend the entry") from error


def _read_run(root: Path, run: str, count: int) -> list[Frame]:
    path = table_path(root, run)
    remedy = f"restore it, or prepare {root} again"
    try:
        table = pq.read_table(path, page_checksum_verification=True)
        for name in OPTIONAL:
            if name not in table.column_names:
                field = SCHEMA.field(name)
                table = table.append_column(field, pa.nulls(len(table), field.type))
        table = table.select(SCHEMA.names).cast(SCHEMA)
        image_us, cloud_us = (table[f"{name}_time_us"].to_pylist() for name in ("image", "cloud"))
        images, clouds, zones = (table[name].to_pylist() for name in ("image", "cloud", "zone"))
    except FileNotFoundError:
        raise UserError(f"{path} is missing: {remedy}") from None
    except (pa.ArrowException, OSError, ValueError) as error:
        raise UserError(f"{path} is damaged ({error}): {remedy}") from error
    if len(table) != count:
        raise UserError(f"{path} holds {len(table)} frames, dataset.yaml says {count}: {remedy}")
    timestamps = table["timestamp_us"].to_numpy()
    positions = np.column_stack([table[axis].to_numpy() for axis in "xyz"])
    known, poses = _poses(table, "T_world_body")
    has_ins, ins = _poses(table, "T_world_ins")
    if (np.diff(timestamps) <= 0).any():
        raise UserError(f"{path}: timestamps repeat or do not rise: {remedy}")
    if not np.isfinite(positions).all():
        raise UserError(f"{path}: a position is not finite: {remedy}")
    for name, there, T in (("T_world_body", known, poses), ("T_world_ins", has_ins, ins)):
        if not is_rigid(T[there]):
            bad = next(
                t for t, one in zip(timestamps[there], T[there], strict=True) if not is_rigid(one)
            )
            raise UserError(f"{path}: {name} of frame {bad} is no rigid motion: {remedy}")
    if not np.allclose(poses[known, :3, 3], positions[known], atol=1e-3):
        raise UserError(f"{path}: positions and poses disagree: {remedy}")
    for name in (*images, *clouds):
        if name is not None and (Path(name).is_absolute() or ".." in Path(name).parts):
            raise UserError(f"{path}: {name} lies outside the dataset: {remedy}")
    return [
        Frame(
            run=run,
            timestamp_us=int(timestamps[row]),
            position_m=tuple(positions[row].tolist()),
            T_world_body=poses[row] if known[row] else None,
            T_world_ins=ins[row] if has_ins[row] else None,
            image=images[row],
            cloud=clouds[row],
            zone=zones[row],
            image_time_us=image_us[row],
            cloud_time_us=cloud_us[row],
        )
        for row in range(count)
    ]


def _poses(table: pa.Table, name: str) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, "n 4 4"]]:
    """Which rows have a pose in this column, and the poses (zero where there is none)."""
    column = table[name].combine_chunks()
    known = column.is_valid().to_numpy(zero_copy_only=False)
    poses = np.zeros((len(table), 4, 4))
    poses[known] = column.drop_null().flatten().to_numpy().reshape(-1, 4, 4)
    return known, poses


def partial_folder(root: Path) -> Path:
    """Folder in which the dataset `root` grows until it is whole."""
    return root.parent / f"{root.name}.partial"
