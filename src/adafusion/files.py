# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are either whole or not there, and fingerprints of what they hold."""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from adafusion.types import UserError

_TEMPORARY = re.compile(r"\..*\.tmp-[0-9a-f]{16}(\.[^.]*)?")


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a path beside `path` to write to; on success that file takes its place, in one step.

    A reader sees the old file or the new one, never half of one; a failure leaves the old one.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    # the suffix stays last: encoders choose the format by it
    temporary = path.with_name(f".{path.stem}.tmp-{secrets.token_hex(8)}{path.suffix}")
    try:
        temporary.touch(exist_ok=False)
        mode = temporary.stat().st_mode  # as the umask wants it
        yield temporary
        with temporary.open("rb+") as file:  # Windows flushes no file that is open for reading only
            os.fsync(file.fileno())
        temporary.chmod(mode)  # some writers make their files private
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def sweep_temporaries(folder: str | Path) -> None:
    """Delete what writers that were killed inside `atomic_path` left in `folder`, not below it.

    For a folder that nobody else writes to at the time: a living writer would lose its file.
    """
    for path in Path(folder).glob(".*"):
        if path.is_file() and _TEMPORARY.fullmatch(path.name):
            path.unlink()


def make_folder(folder: str | Path) -> None:
    """Make a folder for results before the work; UserError where it cannot be written to."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UserError(
            f"{folder} cannot be written ({error.strerror}): choose another folder"
        ) from error


def claim_folder(folder: str | Path, *marks: str) -> None:
    """Make the folder of an unfinished job, or take it up again where one of `marks` lies in it.

    UserError where it holds files and no mark: they are somebody else's, and would be lost.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    sweep_temporaries(folder)
    if any(folder.iterdir()) and not any((folder / mark).exists() for mark in marks):
        raise UserError(
            f"{folder} holds files that no unfinished job left: move them away, or choose another "
            "folder"
        )


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: str | Path, value: object) -> None:
    """Write JSON atomically, indented, refusing NaN (which is no JSON)."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def fingerprint(*parts: bytes | str) -> str:
    """16 hexadecimal digits of SHA-256 over the parts and their lengths."""
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(data).to_bytes(8, "little"))
        digest.update(data)
    return digest.hexdigest()[:16]
