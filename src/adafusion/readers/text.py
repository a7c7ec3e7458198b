# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of numbers in text files, refused by file and line where they are not what they should."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float64

from adafusion.datasets.sensor_files import open_regular
from adafusion.types import UserError

_LARGEST_BYTES = 2**31  # of a table; a day of poses at 200 Hz, 100 bytes each, is smaller


def read_text(path: str | Path, remedy: str) -> str:
    """All of a UTF-8 file (a leading byte order mark is dropped); UserError with the remedy."""
    try:
        with open_regular(path, _LARGEST_BYTES) as file, _decoded(file) as text:
            return text.read()
    except FileNotFoundError:
        raise UserError(f"{path} is missing: {remedy}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path} cannot be read ({error}): {remedy}") from error


def _decoded(file: BinaryIO) -> io.TextIOWrapper:
    return io.TextIOWrapper(file, encoding="utf-8-sig")


def read_numbers(
    path: str | Path,
    columns: int | None,
    *,
    remedy: str,
    delimiter: str | None = None,
    skip_lines: int = 0,
    allow_nan: bool = False,
) -> Float64[np.ndarray, "rows columns"]:
    """Rows of `columns` numbers (None: as many as the first row); blank lines and `#` are skipped.

    `delimiter` None is any white space. Microseconds since the epoch are exact in float64 below
    2^53. UserError names file and line.
    """
    table = _read_plain(path, delimiter, skip_lines)
    plain = table is not None and columns in (None, table.shape[1])
    if table is not None and plain and (allow_nan or np.isfinite(table).all()):
        return table
    rows: list[list[float]] = []
    for number, line in enumerate(read_text(path, remedy).splitlines(), start=1):
        if number <= skip_lines or not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            row = [float(word) for word in line.strip().split(delimiter)]
        except ValueError:
            row = []
        columns = columns or len(row)
        if len(row) != columns or not row or not (allow_nan or np.isfinite(row).all()):
            wanted = f"{columns} finite" if columns else "finite"
            raise UserError(f"{path}: line {number} is not {wanted} numbers: {remedy}")
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(len(rows), columns or 0)


def _read_plain(
    path: str | Path, delimiter: str | None, skip_lines: int
) -> Float64[np.ndarray, "rows columns"] | None:
    """A table without a fault or a comment, many times faster; None where it has either."""
    try:
        with (
            open_regular(path, _LARGEST_BYTES) as file,
            _decoded(file) as text,
            warnings.catch_warnings(action="error", category=UserWarning),  # of a file without rows
        ):
            return np.loadtxt(
                text, delimiter=delimiter, skiprows=skip_lines, comments=None, ndmin=2
            )
    except (ValueError, OSError, UserWarning):
        return None


def read_records(
    path: str | Path, columns: Sequence[str], *, remedy: str
) -> Iterator[tuple[int, dict[str, str]]]:
    """Rows of a csv file with a header, each with its line number, in any order of columns.

    UserError names the file where one of `columns` is not in the header, and the line of a row
    that is too short or too long.
    """
    lines = read_text(path, remedy).splitlines()
    header = [word.strip() for word in lines[0].split(",")] if lines else []
    if lacking := [name for name in columns if name not in header]:
        raise UserError(f"{path} has no column {', '.join(lacking)}: {remedy}")
    if twice := [name for name in header if name and header.count(name) > 1]:
        raise UserError(f"{path} has two columns {twice[0]}: {remedy}")
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        words = [word.strip() for word in line.split(",")]
        if len(words) != len(header):
            raise UserError(
                f"{path}: line {number} has {len(words)} fields, its header {len(header)}: {remedy}"
            )
        yield number, dict(zip(header, words, strict=True))


def path_inside(root: str | Path, name: str, named_by: str | Path) -> Path:
    """`root / name`; UserError where a name that a table gives leads out of `root`."""
    parts = Path(name).parts
    if not parts or Path(name).anchor or ".." in parts or "\\" in name or "\0" in name:
        raise UserError(f"{named_by} names {name!r}, which is no file below {root}: mend the table")
    return Path(root) / name
