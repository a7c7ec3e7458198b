# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The synthetic world written in the raw layouts of recorded data sets: never called real.

Each module states the constants of its format itself, as a recording would: what reads these files
has its own. `manifest.json` at the top of an export says that it is synthetic, from what it was
made, and where it is simpler than a recording.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from adafusion.sim.exports import nclt, pointnetvlad, robotcar
from adafusion.sim.exports.layout import Layout, write_layout
from adafusion.sim.run.conditions import Conditions
from adafusion.sim.simulate import WORLD_VERSION
from adafusion.sim.studio import Job, make_job
from adafusion.types import Progress, UserError, silent

EXPORTS: dict[str, Callable[[Job], Layout]] = {
    "nclt": nclt.lay_out,
    "robotcar": robotcar.lay_out,
    "pointnetvlad": pointnetvlad.lay_out,
}


def export(
    kind: str,
    out: str | Path,
    *,
    seed: int,
    runs: Sequence[str] | Mapping[str, Conditions],
    profile: str = "tiny",
    places: int | None = None,
    progress: Progress = silent,
) -> Path:
    """Drive `runs` through the world of `seed` and write them to `out` in the layout of `kind`.

    `kind` is "nclt", "robotcar" or "pointnetvlad"; the rest is as in `simulate`. The same arguments
    give the same bytes, and a job that was cut off goes on where it was. UserError for an unknown
    kind, preset or profile, where `out` exists, and where the disk is full or not to be written.
    """
    if kind not in EXPORTS:
        raise UserError(f"unknown layout {kind!r}; choose from {', '.join(EXPORTS)}")
    job = make_job(seed, runs, profile, places)
    layout = EXPORTS[kind](job)
    manifest: dict[str, object] = {
        "synthetic": True,
        "what": f"a synthetic world in the raw layout of {kind}: no real sensor saw it",
        "layout": kind,
        "generator": f"adafusion synthetic world, version {WORLD_VERSION}",
        "licence": "CC0-1.0",
        "seed": job.seed,
        "profile": job.profile,
        "places": job.places,
        "runs": [run for run, _ in job.runs],
        "conditions": {run: asdict(conditions) for run, conditions in job.runs},
        **layout.manifest,
    }
    return write_layout(layout._replace(manifest=manifest), out, progress)
