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

import errno
import io
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from jaxtyping import Bool, Float, Float32, UInt8

from adafusion.files import atomic_path, claim_folder, fingerprint, write_text
from adafusion.geometry import is_rigid
from adafusion.types import Frame, Observation, UserError

SCHEMA_VERSION = 1
IMAGE_SUFFIXES = (".png", ".jpg")
CONVENTIONS = {
    "body": "x forward, y left, z up; z = 0 is the ground under the vehicle",
    "world": "z up; the same for all runs of the dataset",
    "T_world_body": "4x4, row by row; maps body to world",
    "T_world_ins": "the same as a GPS/INS unit gave it, where the dataset keeps that apart",
    "image": "RGB, undistorted unless the calibration says otherwise",
    "units": "metres, radians, integer microseconds",
}

_SCHEMA = pa.schema(
    [
        pa.field("timestamp_us", pa.int64(), nullable=False),
        *(pa.field(axis, pa.float64(), nullable=False) for axis in "xyz"),
        *(pa.field(name, pa.list_(pa.float64(), 16)) for name in ("T_world_body", "T_world_ins")),
        *(pa.field(name, pa.string()) for name in ("image", "cloud", "zone")),
    ]
)
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
        for name, boxes in self.regions.items():
            for box in boxes:
                if len(box) != 4 or not box[0] < box[2] or not box[1] < box[3]:
                    raise ValueError(f"region {name!r}: {box} is no [xmin, ymin, xmax, ymax]")


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
        tables = [self.root / "dataset.yaml", *(_table(self.root, run) for run in self.runs)]
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


def read_image(path: str | Path) -> UInt8[np.ndarray, "h w 3"]:
    """Read a PNG or JPEG file as RGB; UserError where it is missing, cut short or damaged."""
    return decode_image(read_bytes(Path(path), "image"), path)


def decode_image(data: bytes, path: str | Path) -> UInt8[np.ndarray, "h w 3"]:
    """Decode the bytes of a PNG or JPEG file to RGB; `path` serves the error message only."""
    # decoders differ in what they make of a cut file: a part filled up with grey, or an error
    whole = _is_whole(data)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if whole else None
    if image is None:
        raise _damaged(path, "is damaged or cut short", "image")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def read_cloud(path: str | Path) -> Float32[np.ndarray, "n 3"]:
    """Read a cloud, body frame, metres; UserError where it is damaged, empty or not finite."""
    try:
        with Path(path).open("rb") as file:
            points = np.load(file, allow_pickle=False)
    except FileNotFoundError:
        raise _damaged(path, "is missing", "cloud") from None
    except Exception as error:  # a damaged header is parsed as Python, and fails as anything
        raise _damaged(path, f"is damaged ({error})", "cloud") from error
    if points.dtype != np.float32 or points.ndim != 2 or points.shape[1] != 3:
        raise UserError(
            f"{path} holds {points.dtype} {points.shape}, not float32 (N, 3): save x, y, z alone, "
            "as points[:, :3].astype(np.float32)"
        )
    return check_points(points, path)


def check_points(
    points: Float32[np.ndarray, "n 3"], path: str | Path
) -> Float32[np.ndarray, "n 3"]:
    """Return `points` if there are any and all are finite; else UserError that names `path`."""
    if len(points) == 0:
        raise _damaged(path, "holds no points", "cloud")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise _damaged(path, f"holds NaN or infinite points ({np.sum(~finite)})", "cloud")
    return points


def read_bytes(path: Path, kind: str) -> bytes:
    """All bytes of a sensor file; UserError where it cannot be read. `kind`: "image" or "cloud"."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise _damaged(path, "is missing", kind) from None
    except OSError as error:
        raise _damaged(path, f"cannot be read ({error.strerror})", kind) from error


def _damaged(path: str | Path, what: str, kind: str) -> UserError:
    return UserError(f"{path} {what}: replace it with a whole {kind}, or leave it out")


def _is_whole(data: bytes) -> bool:
    """Whether a PNG has all chunks with right sums up to IEND, a JPEG its end marker."""
    if data.startswith(b"\xff\xd8"):
        return data.rstrip(b"\0").endswith(b"\xff\xd9")  # some cameras pad with zeros
    if not data.startswith(b"\x89PNG\r\n\x1a\n"):
        return len(data) > 0  # another format: the decoder's word is all there is
    start = 8
    while start + 12 <= len(data):
        end = start + 12 + int.from_bytes(data[start : start + 4], "big")
        body, checksum = data[start + 4 : end - 4], data[end - 4 : end]
        if end > len(data) or zlib.crc32(body) != int.from_bytes(checksum, "big"):
            return False
        if body.startswith(b"IEND"):
            return True
        start = end
    return False


def _table(root: Path, run: str) -> Path:
    return root / run / "frames.parquet"


def _read_info(root: Path) -> tuple[DatasetInfo, dict[str, int]]:
    """DatasetInfo and the number of frames of each run, from dataset.yaml."""
    path = root / "dataset.yaml"
    if not path.is_file():
        if _partial(root).exists():
            raise UserError(f"{root} is not finished: repeat the command that writes it, to resume")
        raise UserError(f"{path} is missing: give the folder of a prepared or simulated dataset")
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
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
    path = _table(root, run)
    remedy = f"restore it, or prepare {root} again"
    try:
        table = pq.read_table(path, page_checksum_verification=True)
        if "T_world_ins" not in table.column_names:  # datasets written before it was kept
            at = _SCHEMA.get_field_index("T_world_ins")
            nothing = pa.nulls(len(table), _SCHEMA.field(at).type)
            table = table.add_column(at, _SCHEMA.field(at), nothing)
        table = table.cast(_SCHEMA)
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


# ---------------------------------------------------------------------------------------- writing


def write_observation(
    folder: str | Path,
    run: str,
    timestamp_us: int,
    observation: Observation,
    image_suffix: str = ".png",
) -> tuple[str | None, str | None]:
    """Write what the sensors saw, each file atomically; usable from any process.

    `folder` is the writer's `folder`. Returns the names of image and cloud relative to it, None
    for a sensor that gave nothing.
    """
    image, points = observation.image, observation.points_body
    return (
        None if image is None else write_image(folder, run, timestamp_us, image, image_suffix),
        None if points is None else write_cloud(folder, run, timestamp_us, points),
    )


def write_image(
    folder: str | Path,
    run: str,
    timestamp_us: int,
    image: UInt8[np.ndarray, "h w 3"] | bytes,
    suffix: str = ".png",
) -> str:
    """Write an RGB image, or the bytes of an encoded one as they are; return its relative name."""
    if suffix not in IMAGE_SUFFIXES:
        raise ValueError(f"image suffix {suffix!r} is none of {IMAGE_SUFFIXES}")
    if not isinstance(image, bytes):
        done, encoded = cv2.imencode(suffix, cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        if not done:
            raise ValueError(f"an image of shape {image.shape} cannot be encoded as {suffix}")
        image = encoded.tobytes()
    name = f"{run}/images/{timestamp_us}{suffix}"
    with atomic_path(Path(folder) / name) as temporary:
        temporary.write_bytes(image)
    return name


def write_cloud(
    folder: str | Path, run: str, timestamp_us: int, points_body: Float[np.ndarray, "n 3"]
) -> str:
    """Write a cloud given in the body frame, metres, as float32; return its relative name.

    ValueError where it is empty or not finite: a LiDAR that saw nothing has no cloud, so None.
    """
    if len(points_body) == 0 or not np.isfinite(points_body).all():
        raise ValueError(f"the cloud of {run}/{timestamp_us} is empty or not finite")
    name = f"{run}/clouds/{timestamp_us}.npy"
    encoded = io.BytesIO()  # straight to a file, NumPy would not say that the disk is full
    np.save(encoded, points_body.astype(np.float32, copy=False), allow_pickle=False)
    with atomic_path(Path(folder) / name) as temporary:
        temporary.write_bytes(encoded.getbuffer())
    return name


class DatasetWriter:
    """Writes a dataset that is either whole or not there, and resumes one that was cut off.

        with DatasetWriter(out, info) as writer:
            for frame, observation in drive:
                writer.add(frame, observation)

    Files go to `folder`, which is `<out>.partial`. Leaving the block well writes the tables and
    renames the folder to `out`; leaving it by an exception keeps the folder. A job that resumes
    asks `has` for each frame and records what is there already by `add_written`.
    """

    def __init__(self, out: str | Path, info: DatasetInfo) -> None:
        self.out = Path(out)
        self.info = info
        self.folder = _partial(self.out)
        self._frames: dict[str, Frame] = {}

    def __enter__(self) -> DatasetWriter:
        if self.out.exists():
            raise UserError(f"{self.out} exists: choose another folder, or remove it first")
        draft = self.folder / "dataset.yaml"
        try:
            claim_folder(self.folder, draft.name)
            if not draft.exists():
                write_text(draft, _to_yaml(self.info))
        except OSError as error:
            raise _cannot_write(self.folder, error) from error
        # runs are listed in it if the end came between the last two steps
        begun = draft.read_text(encoding="utf-8").partition("\nruns:\n")[0]
        if begun.rstrip() != _to_yaml(self.info).rstrip():
            raise UserError(
                f"{self.folder} was begun with other settings: remove it, or repeat the settings "
                f"that its dataset.yaml shows"
            )
        return self

    def has(self, run: str, timestamp_us: int, *, image: bool = True, cloud: bool = True) -> bool:
        """Whether the files of this frame are there already, of the sensors that are asked for."""
        images = [self.folder / run / "images" / f"{timestamp_us}{s}" for s in IMAGE_SUFFIXES]
        points = self.folder / run / "clouds" / f"{timestamp_us}.npy"
        return (not image or any(path.exists() for path in images)) and (
            not cloud or points.exists()
        )

    def add(self, frame: Frame, observation: Observation, image_suffix: str = ".png") -> Frame:
        """Write `observation` and record `frame`; return the frame with its file names."""
        check_run_name(frame.run)
        image, cloud = write_observation(
            self.folder, frame.run, frame.timestamp_us, observation, image_suffix
        )
        frame = replace(frame, image=image, cloud=cloud)
        self.add_written(frame)
        return frame

    def add_written(self, frame: Frame) -> None:
        """Record a frame whose files lie in `folder` already, under the names that it gives."""
        check_run_name(frame.run)
        if frame.key in self._frames:
            raise ValueError(f"frame {frame.key} is written twice")
        for name in (frame.image, frame.cloud):
            if name is not None and not (self.folder / name).is_file():
                raise ValueError(f"frame {frame.key} names {name}, which nobody wrote")
        self._frames[frame.key] = frame

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, OSError) and error.errno in _DISK_FULL:
            raise _cannot_write(self.folder, error) from error
        if error is None:
            try:
                self._finish()
            except OSError as late:
                raise _cannot_write(self.folder, late) from late

    def _finish(self) -> None:
        if not self._frames:
            raise UserError(f"{self.out}: there is no frame to write; nothing was made")
        runs: dict[str, list[Frame]] = {}
        for frame in sorted(self._frames.values(), key=lambda f: (f.run, f.timestamp_us)):
            runs.setdefault(frame.run, []).append(frame)
        self._remove_strays()
        for run, frames in runs.items():
            with atomic_path(_table(self.folder, run)) as temporary:
                pq.write_table(_to_table(frames), temporary, write_page_checksum=True)
        counts = {run: len(frames) for run, frames in runs.items()}
        write_text(self.folder / "dataset.yaml", _to_yaml(self.info, counts))
        open_dataset(self.folder)  # nothing takes the name of a dataset that cannot be opened
        self.folder.rename(self.out)

    def _remove_strays(self) -> None:
        """Delete what no frame names: temporaries of a killed process, frames since left out."""
        named = {name for f in self._frames.values() for name in (f.image, f.cloud)}
        for path in list(self.folder.rglob("*")):
            name = path.relative_to(self.folder).as_posix()
            if path.is_file() and name not in named and name != "dataset.yaml":
                path.unlink()


_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


def _cannot_write(folder: Path, error: OSError) -> UserError:
    return UserError(
        f"{folder} cannot be written ({error.strerror}): free space or choose another folder, then "
        f"repeat the command; whole frames are kept"
    )


def check_run_name(run: str) -> None:
    """UserError where a run's name cannot name a folder of its own."""
    if not run or run.startswith(".") or Path(run).name != run or "\\" in run:
        raise UserError(f"run name {run!r} cannot name a folder: use letters, digits, - and _")


def _partial(root: Path) -> Path:
    return root.parent / f"{root.name}.partial"


def _to_yaml(info: DatasetInfo, counts: dict[str, int] | None = None) -> str:
    values: dict[str, object] = {"schema_version": SCHEMA_VERSION, **asdict(info)}
    if counts is not None:
        values["runs"] = counts
    return yaml.safe_dump(values, sort_keys=False, allow_unicode=True)


def _to_table(frames: Sequence[Frame]) -> pa.Table:

    def column(poses: Iterable[Float[np.ndarray, "4 4"] | None]) -> list[list[float] | None]:
        return [None if T is None else T.ravel().tolist() for T in poses]

    return pa.table(
        {
            "timestamp_us": [f.timestamp_us for f in frames],
            **{axis: [f.position_m[i] for f in frames] for i, axis in enumerate("xyz")},
            "T_world_body": column(f.T_world_body for f in frames),
            "T_world_ins": column(f.T_world_ins for f in frames),
            "image": [f.image for f in frames],
            "cloud": [f.cloud for f in frames],
            "zone": [f.zone for f in frames],
        },
        schema=_SCHEMA,
    )
