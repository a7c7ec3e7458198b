# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Places of one or more runs with what a model said of each: a value in memory, a store on disk.

On disk a map is a folder that holds one LanceDB table, a place a row. The header travels in the
table's schema, so rows and header can never part. LanceDB is imported on first use and starts
threads: processes that use a map should be spawned, not forked.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from datetime import timedelta
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from filelock import FileLock
from jaxtyping import Float, Float32, Float64

from adafusion.datasets import Dataset
from adafusion.files import fingerprint
from adafusion.models import PlaceModel
from adafusion.types import Descriptions, Frame, UserError

FORMAT = 2  # of the table; raised when an older reader would misread it
TABLE = "places"
HEADER_KEY = b"adafusion"
LOCK = "writer.lock"
UNREADABLE = (
    "cannot be read",
    "check its permissions; if it is damaged, restore it from a copy or build it again",
)
UNWRITABLE = ("cannot be written", "check free space and permissions")


@dataclass(frozen=True, slots=True, kw_only=True)
class MapHeader:
    """What all places of a map share, and a run or query must share to be compared with them."""

    model: str = field(compare=False)  # for messages: the fingerprint decides
    model_fingerprint: str
    preprocess_fingerprint: str
    synthetic: bool  # simulated places; a map never mixes them with real ones
    world: str  # the frame of all positions, which compare with those of no other world
    p: int = 1  # places are ranked by the Lp distance between descriptors: 1 or 2

    def __post_init__(self) -> None:
        if self.p not in (1, 2):
            raise ValueError(f"p {self.p} must be 1 or 2")

    @classmethod
    def of(cls, model: PlaceModel, dataset: Dataset, p: int | None = None) -> MapHeader:
        """Head a map of places that `model` describes from frames of `dataset`.

        `p` None is the distance that the model's system is searched by.
        """
        return cls(
            model=model.name,
            model_fingerprint=model.fingerprint,
            preprocess_fingerprint=model.preprocess_fingerprint,
            synthetic=dataset.info.synthetic,
            world=dataset.world,
            p=model.config.p if p is None else p,
        )

    def differences(self, other: MapHeader) -> list[str]:
        """Say where `other` departs from this header: "p 2 instead of 1"."""
        return [
            f"{f.name.replace('_', ' ')} {theirs!r} instead of {ours!r}"
            for f in fields(self)
            if f.compare and (ours := getattr(self, f.name)) != (theirs := getattr(other, f.name))
        ]

    def require(self, other: MapHeader, path: str | Path) -> None:
        """Raise UserError unless places under `other` may join the map at `path`, this one's."""
        if differences := self.differences(other):
            raise UserError(
                f"{path} is a map of model {self.model!r}, which places of model {other.model!r} "
                f"do not fit: {'; '.join(differences)}. Describe them with the map's model "
                "and settings, from a dataset in its world, or build a map of their own"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaceMap:
    """Places, one a row, all in memory; its arrays are read-only.

    header: what the places share: model, preprocessing, distance.
    keys: `run/timestamp_us` of each place, unique.
    datasets: name of the dataset each place comes from; the runs share one map frame.
    zones: what kind of place it is, where the dataset says so.
    positions_m: (N, 3) metres in the map frame, which is the datasets' world frame.
    T_map_body: (N, 4, 4); a place whose position alone is known holds NaN.
    descriptions: N rows each; `fused` is always there, the rest where the system has it.

    Raises UserError for a key that comes twice, ValueError for parts that do not fit together.
    """

    header: MapHeader
    keys: tuple[str, ...]
    datasets: tuple[str, ...]
    zones: tuple[str | None, ...]
    positions_m: Float64[np.ndarray, "n 3"]
    T_map_body: Float64[np.ndarray, "n 4 4"]
    descriptions: Descriptions

    def __post_init__(self) -> None:
        set_field = object.__setattr__  # the dataclass is frozen, and its arrays shall be too
        set_field(self, "positions_m", _frozen(self.positions_m, np.float64))
        set_field(self, "T_map_body", _frozen(self.T_map_body, np.float64))
        parts = (None if part is None else _frozen(part, np.float32) for part in self.descriptions)
        set_field(self, "descriptions", Descriptions(*parts))
        self._check()

    def _check(self) -> None:
        n, d = len(self.keys), self.descriptions
        if n == 0:
            raise ValueError("a map needs at least one place")
        if d.fused is None:
            raise ValueError("a map needs fused descriptors")
        columns = (
            self.datasets,
            self.zones,
            self.positions_m,
            self.T_map_body,
            *self.parts.values(),
        )
        if any(len(column) != n for column in columns):
            raise ValueError(f"{n} keys, but columns of {[len(column) for column in columns]} rows")
        for name, values in {"positions_m": self.positions_m, **self.parts}.items():
            bad = ~np.isfinite(values).all(axis=1)
            if bad.any():
                raise ValueError(f"{name} of {self.keys[int(bad.argmax())]} is not finite")
        unknown, known = np.isnan(self.T_map_body), np.isfinite(self.T_map_body)
        if not (unknown.all(axis=(1, 2)) | known.all(axis=(1, 2))).all():
            raise ValueError("a pose in T_map_body must be finite, or all NaN where it is unknown")
        _refuse_repeated([key for key, count in Counter(self.keys).items() if count > 1])

    @classmethod
    def from_descriptions(
        cls,
        frames: Sequence[Frame],
        descriptions: Descriptions,
        *,
        header: MapHeader,
        dataset: str,
    ) -> PlaceMap:
        """Make the map of `frames` of one dataset from what the model said of them, row by row."""
        nowhere = np.full((4, 4), np.nan)
        poses = [nowhere if f.T_world_body is None else f.T_world_body for f in frames]
        return cls(
            header=header,
            keys=tuple(frame.key for frame in frames),
            datasets=(dataset,) * len(frames),
            zones=tuple(frame.zone for frame in frames),
            positions_m=np.array([f.position_m for f in frames], np.float64).reshape(-1, 3),
            T_map_body=np.array(poses, np.float64).reshape(-1, 4, 4),
            descriptions=descriptions,
        )

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def parts(self) -> dict[str, Float32[np.ndarray, "n _"]]:
        """The parts of the descriptions that the map's system has, by name."""
        named = self.descriptions._asdict()
        return {name: part for name, part in named.items() if part is not None}

    @cached_property
    def fingerprint(self) -> str:
        """Identity of the content, to the last bit; opening keeps it, an append changes it."""
        arrays = {"positions_m": self.positions_m, "T_map_body": self.T_map_body, **self.parts}
        names = [asdict(self.header), self.keys, self.datasets, self.zones, list(arrays)]
        return fingerprint(json.dumps(names), *(array.tobytes() for array in arrays.values()))

    @classmethod
    def open(cls, path: str | Path) -> PlaceMap:
        """Read a whole map into memory; the store is not touched again.

        Raises UserError where there is no map, or a damaged or newer one; creates nothing.
        """
        table, header = _open_table(path)
        with _blaming(path, *UNREADABLE):
            return _from_arrow(table.to_arrow(), header)

    def save(self, path: str | Path) -> None:
        """Create the map's store. It appears whole or not at all.

        Raises UserError where `path` exists already or cannot be written.
        """
        path = require_free(path)
        with _blaming(path, *UNWRITABLE):
            path.parent.mkdir(parents=True, exist_ok=True)
            partial = Path(
                tempfile.mkdtemp(prefix=f"{path.name}.", suffix=".partial", dir=path.parent)
            )
            try:
                whole = partial / "map"  # a level below, as mkdtemp makes its folder private
                _lancedb().connect(whole).create_table(TABLE, _to_arrow(self))
                (whole / LOCK).touch()  # now, so that a refused append adds no file
                whole.rename(path)
            finally:
                shutil.rmtree(partial, ignore_errors=True)

    @staticmethod
    def append(path: str | Path, addition: PlaceMap) -> None:
        """Add all places of `addition` (a run, as a rule) to the map at `path`, in one step.

        Once this returns the places outlive the process; if it raises, the map is as it was.
        Raises UserError where there is no map, where `addition` was made by another model or
        preprocessing or lies in another world, or where the map has one of its keys already.
        """
        table, header = _open_table(path)
        header.require(addition.header, path)
        rows = _to_arrow(addition)
        if rows.schema != table.schema:
            raise UserError(
                f"{path}: the places do not fit: columns {_columns(rows.schema)} instead of "
                f"{_columns(table.schema)}; describe them with the map's own model"
            )
        # one process at a time, or two could add the same run; a dead one holds nothing
        with _blaming(path, *UNWRITABLE), FileLock(Path(path) / LOCK):
            table.checkout_latest()  # another writer may have been here since
            known = set(table.search().select(["key"]).to_arrow()["key"].to_pylist())
            _refuse_repeated([key for key in addition.keys if key in known], path)
            table.add(rows)


@dataclass(frozen=True, kw_only=True)
class MapInfo:
    """What a map holds, for a person to look at."""

    header: MapHeader
    fingerprint: str  # of the content
    places: int
    runs: dict[str, int]  # places a run
    datasets: tuple[str, ...]
    dims: dict[str, int]  # length of each part of a description
    lower_m: tuple[float, float, float]  # box around all positions, in the map frame
    upper_m: tuple[float, float, float]
    versions: int  # states kept on disk; `compact` drops the old ones
    bytes_on_disk: int

    def to_dict(self) -> dict[str, Any]:
        """Give plain values for JSON."""
        return asdict(self)


def info(path: str | Path) -> MapInfo:
    """Read what the map at `path` holds. Raises as `PlaceMap.open` does."""
    table, _ = _open_table(path)
    place_map = PlaceMap.open(path)
    lower, upper = place_map.positions_m.min(axis=0), place_map.positions_m.max(axis=0)
    return MapInfo(
        header=place_map.header,
        fingerprint=place_map.fingerprint,
        places=len(place_map),
        runs=dict(Counter(key.rpartition("/")[0] for key in place_map.keys)),
        datasets=tuple(dict.fromkeys(place_map.datasets)),
        dims={name: part.shape[1] for name, part in place_map.parts.items()},
        lower_m=(float(lower[0]), float(lower[1]), float(lower[2])),
        upper_m=(float(upper[0]), float(upper[1]), float(upper[2])),
        versions=len(table.list_versions()),
        bytes_on_disk=sum(f.stat().st_size for f in Path(path).rglob("*") if f.is_file()),
    )


def compact(path: str | Path, keep: timedelta = timedelta(hours=1)) -> None:
    """Join the pieces that appends left behind and drop states older than `keep`.

    The content stays as it is. A process that is just opening the map may still be reading an
    older state, so `keep` should exceed the time that takes. Raises as `PlaceMap.open` does.
    """
    table, _ = _open_table(path)
    with _blaming(path, *UNWRITABLE):
        table.optimize(cleanup_older_than=keep)


def require_free(path: str | Path) -> Path:
    """Give `path` back where nothing is there yet, so that a new map can be; else UserError."""
    path = Path(path)
    if path.exists():
        raise UserError(f"{path} exists; add to it, or choose another path")
    return path


def _frozen(array: Float[np.ndarray, " *any"], dtype: type) -> Float[np.ndarray, " *any"]:
    """Give a read-only array, copying only what a caller could still write to."""
    if array.flags.writeable or array.dtype != dtype or not array.flags.c_contiguous:
        array = np.array(array, dtype, order="C")
        array.flags.writeable = False
    return array


def _refuse_repeated(keys: list[str], path: str | Path | None = None) -> None:
    if keys:
        where = "a map" if path is None else str(path)
        raise UserError(
            f"{where}: {len(keys)} places would be there twice, the first {keys[0]!r}; "
            "leave out runs that the map has already"
        )


# --- the table --------------------------------------------------------------------------------


def _to_arrow(place_map: PlaceMap) -> pa.Table:
    # The pose is a list of variable length, as LanceDB takes every long list of fixed length for
    # a vector to be searched, in which it allows no null.
    known = np.isfinite(place_map.T_map_body).all(axis=(1, 2))
    flat = place_map.T_map_body.reshape(-1, 16)
    poses = [pose if is_known else None for pose, is_known in zip(flat, known, strict=True)]
    columns = {
        "key": pa.array(place_map.keys, pa.string()),
        "dataset": pa.array(place_map.datasets, pa.string()),
        "zone": pa.array(place_map.zones, pa.string()),
        "position_m": _rows_to_arrow(place_map.positions_m),
        "T_map_body": pa.array(poses, pa.list_(pa.float64())),  # row by row; null where unknown
        **{name: _rows_to_arrow(part) for name, part in place_map.parts.items()},
    }
    header = json.dumps({"format": FORMAT, **asdict(place_map.header)})
    return pa.table(columns).replace_schema_metadata({HEADER_KEY: header})


def _from_arrow(table: pa.Table, header: MapHeader) -> PlaceMap:
    n = table.num_rows
    poses = table["T_map_body"].combine_chunks()
    T_map_body = np.full((n, 4, 4), np.nan)
    known = poses.is_valid().to_numpy(zero_copy_only=False)
    T_map_body[known] = poses.flatten().to_numpy(zero_copy_only=False).reshape(-1, 4, 4)
    T_map_body.flags.writeable = False
    parts = {name: table[name] for name in Descriptions._fields if name in table.column_names}
    return PlaceMap(
        header=header,
        keys=tuple(table["key"].to_pylist()),
        datasets=tuple(table["dataset"].to_pylist()),
        zones=tuple(table["zone"].to_pylist()),
        positions_m=_rows_to_numpy(table["position_m"]),
        T_map_body=T_map_body,
        descriptions=Descriptions(
            *(
                _rows_to_numpy(parts[name]) if name in parts else None
                for name in Descriptions._fields
            )
        ),
    )


def _rows_to_arrow(rows: Float[np.ndarray, "n d"]) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(rows.reshape(-1)), rows.shape[1])


def _rows_to_numpy(column: pa.ChunkedArray) -> Float[np.ndarray, "n d"]:
    return column.combine_chunks().flatten().to_numpy().reshape(len(column), -1)


def _columns(schema: pa.Schema) -> str:
    return ", ".join(f"{field.name}: {field.type}" for field in schema)


# --- the store --------------------------------------------------------------------------------


def _lancedb() -> Any:
    try:
        import lancedb
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("maps need lancedb: pip install 'adafusion[map]'") from error
    return lancedb


def _open_table(path: str | Path) -> tuple[Any, MapHeader]:
    """Open the table of places and read its header, touching nothing that is no map."""
    path = Path(path)  # to look first matters: LanceDB creates the folder it is sent to
    if not path.exists():
        raise UserError(f"{path}: there is no such map; check the path, or build the map first")
    if not (path / f"{TABLE}.lance").is_dir():
        raise UserError(f"{path} is not a map: it holds no table of places; check the path")
    with _blaming(path, *UNREADABLE):
        table = _lancedb().connect(path).open_table(TABLE)
        header = json.loads((table.schema.metadata or {}).get(HEADER_KEY, "{}"))
        found = header.pop("format", None)
        if found == FORMAT:
            return table, MapHeader(**header)
    if found is None:
        raise UserError(f"{path} is not a map: its table was not made by adafusion; check the path")
    raise UserError(
        f"{path} is a map of format {found}, and this version of adafusion reads {FORMAT}; "
        "use the version that wrote it, or build the map again"
    )


@contextmanager
def _blaming(path: str | Path, verdict: str, remedy: str) -> Iterator[None]:
    """Turn what the store or the system raises into a word about the map at `path`."""
    try:
        yield
    except (OSError, RuntimeError, ValueError, TypeError, KeyError) as error:
        raise UserError(f"{path} {verdict} ({error}); {remedy}") from error
