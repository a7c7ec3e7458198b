# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""From which budget on more frame passes bring no more.

Looked at on validation alone: a budget is a choice, and none is made by the test set.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from adafusion.experiments.convergence import half_width
from adafusion.experiments.jobs import passes_of, row_curve
from adafusion.experiments.picture import picture
from adafusion.experiments.study import Study, Trained
from adafusion.report import plots


def measure_levels(trained: Trained) -> dict[str, Any]:
    """Best validation recall@1 of every system at each of its budgets, the mean over seeds."""
    systems: dict[str, dict[str, Any]] = {}
    for label, jobs in trained.rows.items():
        name = label.rpartition(" x")[0]
        one = systems.setdefault(name, {"system": jobs[0].config.model.system, "tried": []})
        planned = max(passes_of(jobs[0], lambda job: job.passes).values())
        tried = {
            "passes": planned,
            "best": max(row_curve(jobs)),
            "rising": label not in trained.converged,
        }
        one["tried"] = sorted([*one["tried"], tried], key=lambda each: each["passes"])
    return {"answers": trained.num_answers, "rows": systems}


def levels_off_at(tried: Sequence[Mapping[str, Any]], num_answers: int) -> int | None:
    """The least budget from which no larger one brings more than chance; None where each does.

    Chance is the half-width that also says whether a training had levelled off; how much two
    trainings differ by their seeds is not in it. A budget at whose end the row still rose is no
    answer, nor is the largest, which has none above it to be tried by.
    """
    for i, one in enumerate(tried[:-1]):
        margin = half_width(one["best"], num_answers)
        above = (other["best"] - one["best"] for other in tried[i + 1 :])
        if not one["rising"] and all(more <= margin for more in above):
            return int(one["passes"])
    return None


def levels_section(study: Mapping[str, Any]) -> list[str]:
    """A table of the best recall at each budget, and where each system levels off."""
    answers = study["answers"]
    rows: Mapping[str, Mapping[str, Any]] = study["rows"]
    budgets = sorted({one["passes"] for row in rows.values() for one in row["tried"]})
    lines = [
        "",
        "## Where more passes bring no more",
        "",
        "Best validation recall@1 in percent, the mean over seeds, by budget; in brackets what it "
        "gained over the budget before. A system levels off at the least budget that no larger one "
        "exceeds by more than the 95 % half-width of its recall on "
        f"{answers:,} answers, unless it still rose when that budget ended, or had learnt nothing "
        "(^). What one training differs from another by its seed is not in the half-width. Nothing "
        "on this page is of the test set.",
        "",
        "| system | " + " | ".join(f"{passes:,}" for passes in budgets) + " | levels off at |",
        "|---" * (len(budgets) + 2) + "|",
    ]
    for name, row in rows.items():
        tried = row["tried"]
        cells = {one["passes"]: f"{100 * one['best']:.1f}" for one in tried}
        for before, one in pairwise(tried):
            cells[one["passes"]] += f" ({100 * (one['best'] - before['best']):+.1f})"
        for one in tried:
            cells[one["passes"]] += "^" * one["rising"]
        found = levels_off_at(tried, answers)
        said = f"{found:,}" if found is not None else f"{tried[-1]['passes']:,} or above"
        lines.append(
            f"| {name} | " + " | ".join(cells.get(one, "-") for one in budgets) + f" | {said} |"
        )
    return lines


def draw_levels(results: Mapping[str, Any], path: Path) -> None:
    """Best validation recall@1 over the budget, a line a system."""
    rows = results["study"]["rows"]
    colors = plots.system_colors(row["system"] for row in rows.values())
    with picture(path, results, 3.4, 5.0) as figure:
        axes = figure.subplots()
        for name, row in rows.items():
            passes = [one["passes"] for one in row["tried"]]
            recall = [100 * one["best"] for one in row["tried"]]
            axes.plot(passes, recall, "o-", color=colors[row["system"]], label=name)
        budgets = sorted({one["passes"] for row in rows.values() for one in row["tried"]})
        axes.set_xscale("log")
        axes.set_xticks(budgets, [f"{one:,}" for one in budgets])
        axes.minorticks_off()
        axes.set_xlabel("frame passes")
        axes.set_ylabel("best validation recall@1 (%)")
        axes.legend()


LEVELS_OFF = Study(measure=measure_levels, section=levels_section, draw=draw_levels)
