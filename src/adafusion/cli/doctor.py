# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The command that looks a dataset over before anybody trains on it."""

from __future__ import annotations

import json
import shutil
import textwrap
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from adafusion.cli.common import Cache, bar, open_data, say

if TYPE_CHECKING:
    from adafusion.doctor import Diagnosis, Finding

NARROW, WIDE = 72, 100  # columns of the table, as far as the terminal allows
CHECK = 20  # columns of a check's name


def doctor(
    dataset: Annotated[Path, typer.Argument(help="A dataset, or world-v1-small/test.")],
    html: Annotated[
        Path | None, typer.Option(help="Write a page with map, histograms and samples as well.")
    ] = None,
    samples: Annotated[
        int, typer.Option(help="Frames of each run whose image and cloud are opened.", min=2)
    ] = 60,
    every_frame: Annotated[bool, typer.Option("--all", help="Open every frame.")] = False,
    radius_m: Annotated[float, typer.Option(help="A true match is so near.", min=0.1)] = 20.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print findings as JSON.")] = False,
    seed: Annotated[int, typer.Option(help="Which frames are opened.", min=0)] = 0,
    cache: Cache = None,
) -> None:
    """Look a dataset over: times, poses, calibration, images, clouds, regions, true matches.

    Prints one line a check, and for what is wrong what it means and what to do. Times, poses and
    files are checked for all frames, images and clouds for a sample. Nothing is changed.
    Exit codes: 0 nothing failed (warnings may be there), 1 a check failed, 2 the dataset cannot be
    opened.

    \b
    Example: adafusion doctor data/mine --html doctor.html
    Example: adafusion doctor data/mine --all --json
    """
    from adafusion.doctor import examine
    from adafusion.doctor.page import write_page
    from adafusion.files import make_folder

    opened = open_data(dataset, cache)
    if html is not None:
        make_folder(html.absolute().parent)  # said before the work
    diagnosis = examine(
        opened,
        radius_m=radius_m,
        samples=None if every_frame else samples,
        seed=seed,
        progress=bar,
    )
    print(_to_json(diagnosis) if as_json else _to_text(diagnosis))
    if html is not None:
        say(f"page: {write_page(html, diagnosis)}")
    if diagnosis.level == "fail":
        raise typer.Exit(1)


def _to_json(diagnosis: Diagnosis) -> str:
    values = {
        "dataset": str(diagnosis.dataset.root),
        "fingerprint": diagnosis.dataset.fingerprint,
        "synthetic": diagnosis.dataset.info.synthetic,
        "frames": len(diagnosis.table.frames),
        "opened": len(diagnosis.looks),
        "radius_m": diagnosis.radius_m,
        "level": diagnosis.level,
        "findings": [asdict(finding) for finding in diagnosis.findings],
    }
    return json.dumps(values, indent=2, allow_nan=False)


def _to_text(diagnosis: Diagnosis) -> str:
    columns = max(NARROW, min(shutil.get_terminal_size((WIDE, 24)).columns, WIDE))
    count = {
        level: sum(f.level == level for f in diagnosis.findings)
        for level in ("fail", "warn", "ok", "skip")
    }
    return "\n".join(
        [
            f"{diagnosis.dataset.root}: {len(diagnosis.table.frames)} frames in "
            f"{len(diagnosis.table.runs)} runs, {len(diagnosis.looks)} frames opened"
            + " (synthetic)"
            * diagnosis.dataset.info.synthetic,
            "",
            *(_lines(finding, columns) for finding in diagnosis.findings),
            "",
            f"{count['fail']} fail, {count['warn']} warn, {count['ok']} ok, {count['skip']} - (not "
            "judged)",
        ]
    )


def _lines(finding: Finding, columns: int) -> str:
    """`warn  check   what was found`, and below it, indented, the meaning and the remedy."""
    mark = "-" if finding.level == "skip" else finding.level
    indent = " " * (6 + CHECK)
    parts = [finding.what, finding.why, f"To do: {finding.remedy}" if finding.remedy else ""]
    if finding.frames:
        parts.append(f"Frames: {', '.join(finding.frames[:3])}")
    first, *rest = [
        textwrap.fill(part, columns - len(indent), break_on_hyphens=False, break_long_words=False)
        for part in parts
        if part
    ]
    body = "\n".join([first, *rest])
    return f"{mark:6}{finding.check:{CHECK}}" + textwrap.indent(body, indent).lstrip()
