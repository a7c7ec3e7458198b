# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A synthetic world in a recording's layout: what it says of itself, so that it is never real."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from adafusion.datasets.native import DatasetInfo
from adafusion.readers.text import read_text
from adafusion.types import UserError

MANIFEST = "manifest.json"
_REMEDY = "export the world again, or remove the file"


def is_synthetic(src: Path) -> bool:
    """Whether a manifest at `src` says that no real sensor saw it; UserError for a damaged one."""
    return _read(src) is not None


def mark_synthetic(info: DatasetInfo, src: Path, *, same_world: bool) -> DatasetInfo:
    """`info` as it is for recorded data; where a manifest at `src` says so, that of a world.

    The source says of which world, and goes on as that of `info`, with the reader's settings.
    `same_world`: whether positions are those of the world rendered as a dataset, so that the two
    share a map.
    """
    made = _read(src)
    if made is None:
        return info
    known = made.keys() >= {"generator", "seed", "profile"}
    generator, seed, profile = (made.get(n, "unknown") for n in ("generator", "seed", "profile"))
    version = generator.rpartition(" ")[2]
    return replace(
        info,
        name=f"synthetic world in {info.name} layout",
        version=version,
        source=f"{generator}, seed {seed}, profile {profile}; in the layout of {info.source}",
        licence=made.get("licence", "unknown"),
        synthetic=True,
        world=f"synthetic world {seed} profile {profile} version {version}"
        if same_world and known
        else "",
    )


def _read(src: Path) -> dict[str, str] | None:
    path = src / MANIFEST
    if not path.is_file():
        return None
    try:
        manifest = json.loads(read_text(path, _REMEDY))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path} is no JSON ({error}): {_REMEDY}") from error
    if not isinstance(manifest, dict) or manifest.get("synthetic") is not True:
        return None
    return {str(name): str(value) for name, value in manifest.items()}
