# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are either whole or not there, and fingerprints of what they hold."""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
