# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""How many frame passes a training takes to a fixed validation recall."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle, pairwise
from pathlib import Path
from typing import Any

from adafusion.experiments.jobs import Job
from adafusion.experiments.picture import picture
from adafusion.experiments.study import Study, Trained
from adafusion.report import plots
from adafusion.training.loop import SELECTED_BY

# Validation recall@1 of world-v1-small's LiDAR branch: 0.37 untrained, 0.67 after 10,800 passes of
# lidar-s.yaml. The levels lie between, and were written down before any other loss was tried.
LEVELS = (0.45, 0.5, 0.55, 0.6, 0.65)

Curve = Sequence[tuple[int, float]]  # frame passes, validation recall@1


def measure_speed(trained: Trained) -> dict[str, Any]:
    """Each row's curve and the passes after which it had reached each level, seed by seed."""
    curves = {
        label: [curve_of(job.record()) for job in jobs] for label, jobs in trained.rows.items()
    }
    return {
        "levels": list(LEVELS),
        "curves": curves,
        "passes": {
            label: [[passes_to(level, curve) for level in LEVELS] for curve in of_seeds]
            for label, of_seeds in curves.items()
        },
        "batches": {label: _batches(jobs) for label, jobs in trained.rows.items()},
    }


def curve_of(record: Mapping[str, Any]) -> list[tuple[int, float]]:
    """Frame passes and validation recall@1 of each evaluation of a training."""
    return [(line["frame_passes"], line[SELECTED_BY]) for line in record["curve"]]


def passes_to(level: float, curve: Curve) -> int | None:
    """Passes done at the first evaluation that shows the level; None where none does."""
    return next((passes for passes, recall in curve if recall >= level), None)


def _batches(jobs: Sequence[Job]) -> dict[str, int]:
    record = jobs[0].record()
    return {"batches": record["batches"], "frame_passes": record["frame_passes"]}


def speed_section(study: Mapping[str, Any]) -> list[str]:
    """A table of the passes to each level."""
    levels = study["levels"]
    step = max(
        b[0] - a[0]
        for of_seeds in study["curves"].values()
        for curve in of_seeds
        for a, b in pairwise(curve)
    )
    lines = [
        "",
        "## Frame passes to a fixed recall",
        "",
        "Frame passes done when an evaluation first showed so much validation recall@1, which was "
        f"looked at every {step:,} passes or more often; by seed where there are several. In "
        "brackets the batches. The levels were fixed before the trainings.",
        "",
        "| loss | untrained | " + " | ".join(f"{100 * v:.0f} %" for v in levels) + " | best |",
        "|---" * (len(levels) + 3) + "|",
    ]
    for label, of_seeds in study["curves"].items():
        ran = study["batches"][label]
        reached = [
            ", ".join(_passes(seed[i], ran) for seed in study["passes"][label])
            for i in range(len(levels))
        ]
        first = ", ".join(f"{100 * curve[0][1]:.1f}" for curve in of_seeds)
        best = ", ".join(f"{100 * max(recall for _, recall in curve):.1f}" for curve in of_seeds)
        lines.append(f"| {label} | {first} | " + " | ".join(reached) + f" | {best} |")
    return lines


def _passes(passes: int | None, ran: Mapping[str, int]) -> str:
    if passes is None:
        return "never"
    return f"{passes:,} ({round(passes * ran['batches'] / ran['frame_passes']):,})"


def draw_speed(results: Mapping[str, Any], path: Path) -> None:
    """Validation recall@1 over frame passes, a line a row, the levels across."""
    study = results["study"]
    colors = cycle((*plots.SYSTEMS.values(), *plots.SPARE))
    with picture(path, results, 4.6) as figure:
        axes = figure.subplots()
        for (label, of_seeds), color in zip(study["curves"].items(), colors, strict=False):
            for seed, curve in enumerate(of_seeds):
                passes, recall = zip(*curve, strict=True)
                axes.plot(
                    passes,
                    [100 * value for value in recall],
                    "o-",
                    markersize=3,
                    color=color,
                    label="_" if seed else label,
                )
        for level in study["levels"]:
            axes.axhline(100 * level, color=plots.FAINT, linewidth=1.0, linestyle=":")
        axes.set_xlabel("frame passes")
        axes.set_ylabel("validation recall@1 (%)")
        axes.set_xlim(left=0)
        figure.legend(loc="outside right upper")


SPEED = Study(measure=measure_speed, section=speed_section, draw=draw_speed)
