# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""From which budget on more frame passes bring no more.

Looked at on validation alone: a budget is a choice, and none is made by the test set.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

from adafusion.experiments.budget import validation_answers
from adafusion.experiments.convergence import half_width
from adafusion.experiments.jobs import row_curve
from adafusion.experiments.picture import picture
from adafusion.experiments.study import Study, Trained
from adafusion.report import plots

Found = Mapping[str, Mapping[str, float]]  # best recall@1, by system and by budget in digits


def row_of(system: str, passes: int) -> str:
    """The label of a system's row at a budget."""
    return f"{system} {passes}"


def measure_levels(trained: Trained) -> dict[str, Any]:
    """Best validation recall@1 of every system at each of its budgets, the mean over seeds."""
    best: dict[str, dict[str, float]] = {}
    systems: dict[str, str] = {}
    for label, jobs in trained.rows.items():
        name, passes = label.split(" ")
        best.setdefault(name, {})[passes] = max(row_curve(jobs))
        systems[name] = jobs[0].config.model.system
    return {"answers": validation_answers(trained.corpus), "best": best, "systems": systems}


def levels_off_at(best: Mapping[str, float], num_answers: int) -> int | None:
    """The least budget from which no larger one brings more than chance; None where each does.

    Chance is the half-width that also says whether one training had levelled off. The largest
    budget has none above it to be tried by, so it is no answer.
    """
    tried = sorted((int(passes), recall) for passes, recall in best.items())
    for i, (passes, recall) in enumerate(tried[:-1]):
        margin = half_width(recall, num_answers)
        if all(more - recall <= margin for _, more in tried[i + 1 :]):
            return passes
    return None


def levels_section(study: Mapping[str, Any]) -> list[str]:
    """A table of the best recall at each budget, and where each system levels off."""
    best: Found = study["best"]
    answers = study["answers"]
    budgets = sorted({int(passes) for of_system in best.values() for passes in of_system})
    lines = [
        "",
        "## Where more passes bring no more",
        "",
        "Best validation recall@1 in percent, the mean over seeds, by budget; in brackets what the "
        "budget before it lacked. A system levels off at the least budget that no larger one "
        f"exceeds by more than the 95 % half-width of {answers:,} answers. Nothing here is of the "
        "test set.",
        "",
        "| system | "
        + " | ".join(f"{passes:,}" for passes in budgets)
        + " | half-width | levels off at |",
        "|---" * (len(budgets) + 3) + "|",
    ]
    for name, of_system in best.items():
        tried = sorted(map(int, of_system))
        gains = {b: of_system[str(b)] - of_system[str(a)] for a, b in pairwise(tried)}
        cells = [
            "-"
            if passes not in tried
            else f"{100 * of_system[str(passes)]:.1f}"
            + (f" ({100 * gains[passes]:+.1f})" if passes in gains else "")
            for passes in budgets
        ]
        margin = half_width(max(of_system.values()), answers)
        found = levels_off_at(of_system, answers)
        said = f"{found:,}" if found is not None else f"above {tried[-1]:,}, or there"
        lines.append(f"| {name} | " + " | ".join(cells) + f" | {100 * margin:.1f} | {said} |")
    return lines


def draw_levels(results: Mapping[str, Any], path: Path) -> None:
    """Best validation recall@1 over the budget, a line a system."""
    study = results["study"]
    colors = plots.system_colors(study["systems"].values())
    with picture(path, results, 3.4, 5.0) as figure:
        axes = figure.subplots()
        for name, of_system in study["best"].items():
            passes = sorted(map(int, of_system))
            recall = [100 * of_system[str(one)] for one in passes]
            axes.plot(passes, recall, "o-", color=colors[study["systems"][name]], label=name)
        budgets = sorted({int(p) for of_system in study["best"].values() for p in of_system})
        axes.set_xscale("log")
        axes.set_xticks(budgets, [f"{one:,}" for one in budgets])
        axes.minorticks_off()
        axes.set_xlabel("frame passes")
        axes.set_ylabel("best validation recall@1 (%)")
        axes.legend()


LEVELS_OFF = Study(measure=measure_levels, section=levels_section, draw=draw_levels)
