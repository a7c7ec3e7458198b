# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The frame of every study's picture."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from adafusion.experiments.page import in_words, is_synthetic
from adafusion.files import atomic_path
from adafusion.report import plots

if TYPE_CHECKING:
    from matplotlib.figure import Figure
else:  # drawing is optional
    Figure: TypeAlias = Any


def marked(results: Mapping[str, Any]) -> dict[str, str]:
    """Each row's label as a picture shows it: with the reason where the row is not ranked."""
    return {
        row["label"]: row["label"] + ("" if row["converged"] else f" ({row['why_not_ranked']})")
        for row in results["rows"]
    }


@contextmanager
def picture(
    path: Path, results: Mapping[str, Any], height: float, width: float = plots.WIDE
) -> Iterator[Figure]:
    """A figure of so many inches to draw on, in the reports' style; written when all went well.

    Names experiment, budget and seeds, and says that the data are synthetic where they are.
    """
    try:
        from matplotlib import figure as drawn
        from matplotlib.style import context
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "charts need matplotlib: pip install 'adafusion[report]'"
        ) from error

    with context(["default", plots.STYLE]):
        figure = drawn.Figure((width, height), layout="constrained")
        yield figure
        if is_synthetic(results):
            figure.suptitle(f"{results['experiment']}, SYNTHETIC data")
        figure.supxlabel(
            f"{results['budget']:,} frame passes a row, {in_words(results['seeds'])}",
            fontsize=7.5,
            color=plots.FAINT,
        )
        with atomic_path(path) as temporary:
            figure.savefig(temporary, dpi=150, facecolor="white")
