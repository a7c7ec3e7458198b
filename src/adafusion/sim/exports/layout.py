# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""An export as data: what it says of itself, and its files, each with the function that makes it.

Whatever the layout, one loop writes it: a file that is there already is kept, so a job that was
cut off goes on; the manifest comes last, then the folder takes its name.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from adafusion.files import atomic_path, claim_folder, sweep_temporaries, write_text
from adafusion.types import Progress, UserError, silent

MANIFEST = "manifest.json"
_BEGUN = "manifest.begun.json"  # the same text, while files are still missing


class Piece(NamedTuple):
    """One file of an export."""

    path: str  # relative to the export's folder
    encode: Callable[[], bytes]


class Layout(NamedTuple):
    """One export, not yet written; `pieces` may be a generator that builds the world when asked."""

    manifest: dict[str, object]
    pieces: Iterable[Piece]


def write_layout(layout: Layout, out: str | Path, progress: Progress = silent) -> Path:
    """Write every file of `layout`, then its manifest, and return the folder.

    UserError where `out` exists, where `<out>.partial` was begun with another manifest, and where
    the disk is full or not to be written.
    """
    out = Path(out)
    if out.exists():
        raise UserError(f"{out} exists: choose another folder, or remove it first")
    pieces = list(layout.pieces)  # before anything is written: it may find that there is nothing
    with _draft(out, json.dumps(layout.manifest, indent=2, allow_nan=False) + "\n") as folder:
        todo = [piece for piece in pieces if not (folder / piece.path).exists()]
        for path, encode in progress(todo, total=len(todo), desc="exporting"):
            data = encode()
            with atomic_path(folder / path) as temporary:
                temporary.write_bytes(data)
    return out


@contextmanager
def _draft(out: Path, manifest: str) -> Iterator[Path]:
    """Give the folder to write to; on success it takes the name `out`, else it stays to resume."""
    folder = out.parent / f"{out.name}.partial"
    begun, done = folder / _BEGUN, folder / MANIFEST
    try:
        claim_folder(folder, _BEGUN, MANIFEST)
        # done is there if the end came between the last two steps
        found = next((path for path in (done, begun) if path.exists()), None)
        if found is None:
            write_text(begun, manifest)
        elif found.read_text(encoding="utf-8") != manifest:
            raise UserError(
                f"{folder} was begun with other settings: remove it, or repeat the settings that "
                f"its {found.name} shows"
            )
        for inside in (folder, *(path for path in folder.rglob("*") if path.is_dir())):
            sweep_temporaries(inside)
        yield folder
        write_text(done, manifest)
        begun.unlink(missing_ok=True)
        folder.rename(out)
    except OSError as error:
        raise UserError(
            f"{folder} cannot be written ({error.strerror}): free space or choose another folder, "
            f"then repeat the command; whole files are kept"
        ) from error
