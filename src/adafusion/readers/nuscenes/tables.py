# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The tables of nuScenes: JSON lists of records, of any length, read a record at a time."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from adafusion.geometry import pose
from adafusion.readers.sensors import check_rigid
from adafusion.types import UserError

_CHUNK = 1 << 20  # characters in memory; no record is that long
_BETWEEN = re.compile(r"[,\s]*")
_FETCH = "fetch the metadata of nuScenes again"


def read_table(path: Path) -> Iterator[dict[str, Any]]:
    """Records of a table, one at a time; UserError where it is cut short or no list of records."""
    decode = json.JSONDecoder().raw_decode
    try:
        with path.open(encoding="utf-8") as file:
            text, done = file.read(_CHUNK).lstrip(), 0
            if not text.startswith("["):
                raise UserError(f"{path} is no list of records: {_FETCH}")
            at = 1
            while True:
                if between := _BETWEEN.match(text, at):
                    at = between.end()
                if text[at : at + 1] == "]":
                    return
                try:
                    record, at = decode(text, at)
                except ValueError:  # the record goes on in the next chunk
                    more = file.read(_CHUNK)
                    if not more or len(text) - at > _CHUNK:
                        raise UserError(
                            f"{path} is cut short or damaged after {done} records: {_FETCH}"
                        ) from None
                    text, at = text[at:] + more, 0
                    continue
                if not isinstance(record, dict):
                    raise UserError(f"{path} is no list of records: {_FETCH}")
                done += 1
                yield record
    except FileNotFoundError:
        raise UserError(f"{path} is missing: {_FETCH}") from None
    except RecursionError:
        raise UserError(f"{path} is no list of records: {_FETCH}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path} cannot be read ({error}): {_FETCH}") from error


def word(record: Mapping[str, Any], name: str, path: Path) -> str:
    """A text of a record; UserError names the table where it has none."""
    value = record.get(name)
    if not isinstance(value, str):
        raise UserError(f"{path}: a record has no {name}: {_FETCH}")
    return value


def numbers(
    record: Mapping[str, Any], name: str, path: Path, shape: tuple[int, ...]
) -> Float64[np.ndarray, "*n"]:
    """An array of a record; UserError names the table where it has none of this shape."""
    try:
        values = np.array(record.get(name), dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        values = np.array(np.nan)
    if values.shape != shape or not np.isfinite(values).all():
        raise UserError(f"{path}: a record has no {name} of {shape} numbers: {_FETCH}")
    return values


def motion(record: Mapping[str, Any], path: Path) -> Float64[np.ndarray, "4 4"]:
    """A pose given as translation and quaternion w x y z; UserError where it is none."""
    w, x, y, z = numbers(record, "rotation", path, (4,)).clip(-2.0, 2.0)
    if abs(w * w + x * x + y * y + z * z - 1.0) > 0.01:
        raise UserError(f"{path}: a record has a rotation that is no unit quaternion: {_FETCH}")
    T = pose(
        Rotation.from_quat((x, y, z, w)).as_matrix(), numbers(record, "translation", path, (3,))
    )
    check_rigid(T, f"{path}: a record", _FETCH)
    return T
