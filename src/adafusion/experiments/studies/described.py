# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What the models of one row say of the test frames, seed by seed."""

from __future__ import annotations

from collections.abc import Iterator

from adafusion.experiments.describing import describe_frames, load_trained
from adafusion.experiments.study import Trained
from adafusion.types import Descriptions, UserError

WEIGHED = "AdaFusion"  # the row that has weights


def described_by_seed(trained: Trained, label: str) -> Iterator[tuple[Descriptions, ...]]:
    """Of each seed's model the descriptions of every test dataset, one row a frame.

    UserError where the row was not trained.
    """
    if label not in trained.rows:
        raise UserError(f"{trained.experiment.name} looks at row {label}: leave it among the rows")
    for job in trained.rows[label]:
        model = load_trained(job.name, job.model)
        yield tuple(
            describe_frames(model, exam.dataset, trained.cache, trained.out, trained.progress)
            for exam in trained.exams
        )
