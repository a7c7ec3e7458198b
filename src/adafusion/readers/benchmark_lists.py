# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Lists of submaps that PointNetVLAD and MinkLoc publish as pickles beside their data.

training_queries_*.pickle               PointNetVLAD: {row: {query, positives, negatives}}
                                        MinkLoc: {row: TrainingTuple}
*_evaluation_{database,query}.pickle    [run: {row: {query, northing, easting, run: [rows]}}]
lidar2image_ndx.pickle                  MinkLoc++: {time of a submap: [times of images]}
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Int64

from adafusion.readers.pickles import load_pickle
from adafusion.types import UserError

T = TypeVar("T")
_Numbers = Callable[[Any, str], Int64[np.ndarray, " n"]]


@dataclass(frozen=True, slots=True)
class TrainingQuery:
    """A submap to train with; rows count the submaps of the same file, from 0."""

    file: str  # relative to the benchmark's folder
    positives: Int64[np.ndarray, " p"]  # rows of the same place, without its own
    # PointNetVLAD lists the other places, MinkLoc the ones too near to be one, its own among them
    negatives: Int64[np.ndarray, " n"] | None
    non_negatives: Int64[np.ndarray, " n"] | None


@dataclass(frozen=True, slots=True)
class EvaluationFrame:
    """A submap that is searched for or searched in."""

    file: str
    northing_m: float
    easting_m: float
    # of a query: run -> rows of that run's database that are true matches; of a database: {}
    matches: dict[int, Int64[np.ndarray, " m"]]


def read_training_queries(path: str | Path) -> list[TrainingQuery]:
    """Submaps to train with, of PointNetVLAD or MinkLoc; UserError where it is anything else."""
    query = _once(partial(_training_query, numbers=_once(_row_numbers)))
    return [query(row, where) for row, where in _rows(load_pickle(path), str(path))]


def read_evaluation_sets(path: str | Path) -> list[list[EvaluationFrame]]:
    """Submaps of each run, queries or database; UserError where the file is anything else."""
    runs = load_pickle(path)
    if not isinstance(runs, list):
        raise _other(path)
    frame = _once(partial(_evaluation_frame, numbers=_once(_row_numbers)))
    frames = _once(lambda rows, where: [frame(row, at) for row, at in _rows(rows, where)])
    return [frames(rows, f"{path}: run {run}") for run, rows in enumerate(runs)]


def read_file_names(path: str | Path) -> set[str]:
    """Submaps that a list of training or evaluation names; what it says of them is not read."""
    runs = load_pickle(path)
    once = {id(rows): rows for rows in (runs if isinstance(runs, list) else [runs])}
    return {_file(row, at) for rows in once.values() for row, at in _rows(rows, str(path))}


def read_image_index(path: str | Path) -> dict[int, Int64[np.ndarray, " k"]]:
    """Times of the images of each submap by its time, nearest first, microseconds."""
    index = load_pickle(path)
    if not isinstance(index, dict):
        raise _other(path)
    if not all(type(time_us) is int for time_us in index):
        raise _other(path)
    numbers = _once(_row_numbers)
    return {time_us: numbers(images, str(path)) for time_us, images in index.items()}


def _once(convert: Callable[[Any, str], T]) -> Callable[[Any, str], T]:
    """`convert`, done once an object: a few bytes of a pickle name a large one again."""
    done: dict[int, tuple[object, T]] = {}

    def converted(value: Any, where: str) -> T:
        if id(value) not in done:
            done[id(value)] = value, convert(value, where)  # kept alive, it keeps its id
        return done[id(value)][1]

    return converted


def _training_query(row: dict[Any, Any], where: str, numbers: _Numbers) -> TrainingQuery:
    return TrainingQuery(
        file=_file(row, where),
        positives=numbers(row.get("positives"), where),
        negatives=numbers(row["negatives"], where) if "negatives" in row else None,
        non_negatives=numbers(row["non_negatives"], where) if "non_negatives" in row else None,
    )


def _evaluation_frame(row: dict[Any, Any], where: str, numbers: _Numbers) -> EvaluationFrame:
    return EvaluationFrame(
        file=_file(row, where),
        northing_m=_number(row.get("northing"), where),
        easting_m=_number(row.get("easting"), where),
        matches={run: numbers(v, where) for run, v in row.items() if isinstance(run, int)},
    )


def _rows(value: Any, where: str) -> Iterator[tuple[dict[Any, Any], str]]:
    """The dicts in a dict whose keys count from 0, each with where it stands."""
    if not isinstance(value, dict) or list(value) != list(range(len(value))):
        raise _other(where)
    if not all(isinstance(row, dict) for row in value.values()):
        raise _other(where)
    for number, row in value.items():
        yield row, f"{where}, entry {number}"


def _row_numbers(value: Any, where: str) -> Int64[np.ndarray, " n"]:
    if isinstance(value, list) and all(type(number) is int for number in value):
        if any(abs(number) >= 2**63 for number in value):
            raise _other(where)
        value = np.array(value, dtype=np.int64)
    if not isinstance(value, np.ndarray) or value.ndim != 1 or value.dtype.kind not in "iu":
        raise _other(where)
    return value.astype(np.int64, copy=False)


def _number(value: Any, where: str) -> float:
    if type(value) not in (int, float) or not -1e9 < value < 1e9:
        raise _other(where)
    return float(value)


def _file(row: dict[Any, Any], where: str) -> str:
    file = row.get("query", row.get("rel_scan_filepath"))
    if not isinstance(file, str):
        raise _other(where)
    return file


def _other(where: str | Path) -> UserError:
    return UserError(
        f"{where} is not what its name says: take the file that the published code made, or "
        "remove it"
    )
