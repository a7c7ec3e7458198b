# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The comparisons of the paper, each one resumable command: planned, trained, judged, written."""

from adafusion.experiments.catalogue import (
    BUDGETS,
    EXPERIMENTS,
    PASSES_A_FRAME,
    build_experiment,
    packaged_recipe,
)
from adafusion.experiments.jobs import Job, all_jobs, plan_jobs, train_jobs
from adafusion.experiments.judging import ExamData
from adafusion.experiments.page import page
from adafusion.experiments.plan import Experiment, Recipe
from adafusion.experiments.results import measure

__all__ = [
    "BUDGETS",
    "EXPERIMENTS",
    "PASSES_A_FRAME",
    "ExamData",
    "Experiment",
    "Job",
    "Recipe",
    "all_jobs",
    "build_experiment",
    "measure",
    "packaged_recipe",
    "page",
    "plan_jobs",
    "train_jobs",
]
