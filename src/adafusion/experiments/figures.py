# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Recall over the number of candidates, and what the judged row gains there."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from adafusion.experiments.page import NOT_RANKED
from adafusion.files import atomic_path
from adafusion.report import plots


def draw_recall(results: Mapping[str, Any], path: Path) -> None:
    """Write the figure: AR@N of every row, and beside it the judged row's gain with intervals."""
    try:
        from matplotlib.figure import Figure
        from matplotlib.style import context
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "charts need matplotlib: pip install 'adafusion[report]'"
        ) from error

    protocol = next(iter(results["protocols"]))
    colors = plots.system_colors(row["system"] for row in results["rows"])
    color_of = {row["label"]: colors[row["system"]] for row in results["rows"]}
    with context(["default", plots.STYLE]):
        figure = Figure((plots.WIDE, 3.7), layout="constrained")
        recall, gain = figure.subplots(1, 2)
        for row in results["rows"]:
            measures = row["recall"][protocol]
            label = row["label"] + ("" if row["converged"] else f" ({NOT_RANKED})")
            _curve(recall, measures, color_of[row["label"]], label)
        for other, gains in results["gains"].items():
            _curve(gain, gains["at"], color_of[other], f"over {other}")
        gain.axhline(0.0, color=plots.FAINT, linewidth=1.0)
        recall.set_ylabel(f"recall@N (%), {protocol}")
        gain.set_ylabel("gain in recall@N (points)")
        for axes in (recall, gain):
            axes.set_xlabel("N, number of candidates looked at")
            axes.legend()
        if any(data["synthetic"] for data in results["test_data"]):
            figure.suptitle("SYNTHETIC data")
        with atomic_path(path) as temporary:
            figure.savefig(temporary, dpi=150, facecolor="white")


def _curve(axes: Any, measures: Mapping[str, Any], color: str, label: str) -> None:
    n = sorted(int(name[3:]) for name in measures if name[3:].isdigit())
    values = [measures[f"AR@{k}"] for k in n]
    axes.plot(n, [100 * value["value"] for value in values], color=color, label=label)
    if all(value["interval"] is not None for value in values):
        low, high = 100 * np.transpose([value["interval"] for value in values])
        axes.fill_between(n, low, high, color=color, alpha=0.13, linewidth=0)
