# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What the models of one row say of the test frames, seed by seed."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from adafusion.experiments.describing import describe_frames
from adafusion.experiments.study import Trained
from adafusion.models import load_model
from adafusion.types import Descriptions, UserError

WEIGHED = "AdaFusion"  # the row that has weights


def described_by_seed(trained: Trained, label: str) -> Iterator[tuple[Descriptions, ...]]:
    """Of each seed's model the descriptions of every test dataset, one row a frame.

    UserError where the row was not trained.
    """
    if label not in trained.rows:
        raise UserError(f"{trained.experiment.name} looks at row {label}: leave it among the rows")
    device = "cuda" if torch.cuda.is_available() else "cpu"
    for job in trained.rows[label]:
        model = load_model(job.model, device)
        model.name = job.name
        yield tuple(
            describe_frames(model, exam.dataset, trained.cache, trained.out, trained.progress)
            for exam in trained.exams
        )
