# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What is left of recall where the input is of another size than in training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from adafusion.experiments.describing import load_trained
from adafusion.experiments.jobs import Job
from adafusion.experiments.judging import Answers, answerable_of, answers, evaluate_loaded
from adafusion.experiments.page import in_percent
from adafusion.experiments.study import Study, Trained
from adafusion.experiments.verdict import estimate_share, judge_difference
from adafusion.models import PlaceModel, build_system
from adafusion.preprocess import Preprocess
from adafusion.types import UserError

TIMES = (0.75, 1.0, 1.25)  # of the size in training, along every axis


def measure_sizes(trained: Trained) -> dict[str, Any]:
    """Recall@1 of every row at every size, and how much it gains or loses against its own size.

    None where the network takes no other size.
    """
    rows: dict[str, list[dict[str, Any] | None]] = {}
    for label, jobs in trained.rows.items():
        own = trained.said[label]
        asked, answerable = answerable_of(own, trained.questions)
        right = np.stack([one.hits(1)[answerable] for one in own])
        rows[label] = []
        for times in TIMES:
            said = own if times == 1.0 else _said(trained, jobs, times)
            if said is None:
                rows[label].append(None)
                continue
            there = np.stack([one.hits(1)[answerable] for one in said])
            change = judge_difference(there, right, asked).difference
            at_1 = asdict(estimate_share(there, asked))
            rows[label].append({"AR@1": at_1, "change": asdict(change)})
    return {"times": list(TIMES), "rows": rows}


def _said(trained: Trained, jobs: Sequence[Job], times: float) -> tuple[Answers, ...] | None:
    """What the models of a row answer at another size; None where they take no other."""
    protocol = trained.experiment.protocols[0]
    given = []
    for job in jobs:
        model = at_size(load_trained(job.name, job.model), times)
        if model is None:
            return None
        model.name = f"{job.name}, x{times:g}"
        where = (trained.cache, trained.out, trained.progress)
        records = evaluate_loaded(model, trained.exams, [protocol], *where)
        given.append(answers(records[protocol]))
    return tuple(given)


def at_size(model: PlaceModel, times: float) -> PlaceModel | None:
    """The same weights as a model of input of another size.

    None where they are bound to theirs, and where the other would be too small for the branches.
    That model's configuration says its size, so preprocessing, caches and the check of sizes are
    those of any other model.
    """
    if model.config.pooling == "fc":
        return None
    config = replace(model.config, preprocess=resized(model.config.preprocess, times))
    try:
        other = build_system(config, model.name)
    except UserError:
        return None
    other.load_state_dict(model.state_dict())
    return other.to(next(model.parameters()).device).eval().requires_grad_(False)


def resized(settings: Preprocess, times: float) -> Preprocess:
    """So many times the pixels of the same view, and cells in the same box, along every axis."""
    height, width = (max(1, round(n * times)) for n in settings.image.size)
    x, y, z = (max(1, round(n * times)) for n in settings.voxels.shape)
    return replace(
        settings,
        image=replace(settings.image, size=(height, width)),
        voxels=replace(settings.voxels, shape=(x, y, z)),
    )


def sizes_section(study: Mapping[str, Any]) -> list[str]:
    """A table of recall at each size, and of the change against the size in training."""
    names = [f"x{times:g}" for times in study["times"]]
    others = [name for name in names if name != "x1"]
    lines = [
        "",
        "## At another size",
        "",
        "Recall@1 where images and voxel grids have so many times the pixels and cells along every "
        'axis as in training, over the same view and the same box; "-": the network takes no other '
        "size. A change is paired by place.",
        "",
        "| pooling | "
        + " | ".join([*names, *(f"{name}, change in points" for name in others)])
        + " |",
        "|---" * (1 + len(names) + len(others)) + "|",
    ]
    for label, at in study["rows"].items():
        found = dict(zip(names, at, strict=True))
        cells = [_cell(found[name], "AR@1") for name in names]
        cells += [_cell(found[name], "change", "+") for name in others]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return lines


def _cell(found: Mapping[str, Any] | None, what: str, sign: str = "") -> str:
    return "-" if found is None else in_percent(found[what], sign)


SIZES = Study(measure=measure_sizes, section=sizes_section)
