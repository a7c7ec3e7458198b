# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What an experiment looks at beside the table of recalls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from adafusion.experiments.jobs import Rows
from adafusion.experiments.judging import Answers, ExamData, Questions
from adafusion.experiments.plan import Experiment
from adafusion.training.corpus import Corpus
from adafusion.types import Progress, silent


@dataclass(frozen=True, eq=False, kw_only=True)
class Trained:
    """An experiment whose rows are trained and judged."""

    experiment: Experiment
    rows: Rows
    corpus: Corpus
    exams: tuple[ExamData, ...]
    questions: Questions  # of the first protocol
    said: Mapping[str, tuple[Answers, ...]]  # by label, the answers to them of each seed
    converged: frozenset[str]  # labels
    num_answers: int  # queries of the validation region that can be answered
    # by label, of each seed's weights the summaries by zone and of "all"; None without weights
    alpha: Mapping[str, Sequence[Mapping[str, Any] | None]] = field(default_factory=dict)
    cache: Path
    out: Path
    progress: Progress = silent


@dataclass(frozen=True)
class Study:
    """Three functions: from trained rows to plain values, to lines of the page, to a picture."""

    measure: Callable[[Trained], dict[str, Any]]  # kept as results["study"], as JSON can hold it
    section: Callable[[Mapping[str, Any]], list[str]]  # Markdown, of results["study"]
    draw: Callable[[Mapping[str, Any], Path], None] | None = None  # of all results
