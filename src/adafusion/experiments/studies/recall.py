# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Recall over the number of candidates, and what the judged row gains there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from adafusion.experiments.judging import KS, answerable_of
from adafusion.experiments.page import in_percent
from adafusion.experiments.picture import marked, picture
from adafusion.experiments.study import Study, Trained
from adafusion.experiments.verdict import estimate, judge_difference, plain_verdict
from adafusion.report import plots


def measure_gains(trained: Trained) -> dict[str, Any]:
    """The gain at every N with its interval, and by how much it is larger at 1 than at the last."""
    gains = {}
    for ours, theirs in trained.experiment.verdicts:
        asked, answerable = answerable_of(trained.said[ours], trained.questions)
        both = list(zip(trained.said[ours], trained.said[theirs], strict=True))
        gain = {n: np.stack([(a.hits(n) - b.hits(n))[answerable] for a, b in both]) for n in KS}
        more = judge_difference(gain[KS[0]], gain[KS[-1]], asked)
        gains[theirs] = {
            "at": {f"AR@{n}": asdict(estimate(values, asked)) for n, values in gain.items()},
            "first_minus_last": plain_verdict(more, ranked={ours, theirs} <= trained.converged),
        }
    return {"gains": gains}


def gains_section(study: Mapping[str, Any]) -> list[str]:
    """A table of the gains at some N."""
    lines = ["", "## Is the gain larger at small N?", ""]
    shown = ("AR@1", "AR@5", "AR@10", "AR@25")
    lines += [
        "| gain over | " + " | ".join(shown) + " | gain at 1 minus gain at 25 |",
        "|---" * (len(shown) + 2) + "|",
    ]
    for other, gain in study["gains"].items():
        cells = [in_percent(gain["at"][name], "+") for name in shown]
        more = gain["first_minus_last"]
        cells.append(f"{in_percent(more['difference'], '+')} {more['verdict']}")
        lines.append(f"| {other} | " + " | ".join(cells) + " |")
    return lines


def draw_recall(results: Mapping[str, Any], path: Path) -> None:
    """Write the figure: AR@N of every row, and beside it the judged row's gain with intervals."""
    protocol = next(iter(results["protocols"]))
    colors = plots.system_colors(row["system"] for row in results["rows"])
    color_of = {row["label"]: colors[row["system"]] for row in results["rows"]}
    named = marked(results)
    with picture(path, results, 3.7) as figure:
        recall, gain = figure.subplots(1, 2)
        for row in results["rows"]:
            measures = row["recall"][protocol]
            _curve(recall, measures, color_of[row["label"]], named[row["label"]])
        for other, gains in results["study"]["gains"].items():
            _curve(gain, gains["at"], color_of[other], f"over {other}")
        gain.axhline(0.0, color=plots.FAINT, linewidth=1.0)
        recall.set_ylabel(f"recall@N (%), {protocol}")
        gain.set_ylabel("gain in recall@N (points)")
        for axes in (recall, gain):
            axes.set_xlabel("N, number of candidates looked at")
            if axes.get_legend_handles_labels()[0]:  # no gain where its rows were left away
                axes.legend()


def _curve(axes: Any, measures: Mapping[str, Any], color: str, label: str) -> None:
    n = sorted(int(name[3:]) for name in measures if name[3:].isdigit())
    values = [measures[f"AR@{k}"] for k in n]
    axes.plot(n, [100 * value["value"] for value in values], color=color, label=label)
    if all(value["interval"] is not None for value in values):
        low, high = 100 * np.transpose([value["interval"] for value in values])
        axes.fill_between(n, low, high, color=color, alpha=0.13, linewidth=0)


RECALL = Study(measure=measure_gains, section=gains_section, draw=draw_recall)
