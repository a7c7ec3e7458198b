# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""From trained rows to the numbers of a table, as plain values that JSON can hold."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Int64

from adafusion.evaluation import describe_protocol
from adafusion.experiments.budget import validation_answers
from adafusion.experiments.convergence import best_before, half_width, why_not_ranked
from adafusion.experiments.jobs import (
    Job,
    Rows,
    all_jobs,
    kept_after,
    part_curves,
    passes_of,
    row_curve,
    through_networks,
)
from adafusion.experiments.judging import (
    KS,
    NO_QUESTIONS,
    Answers,
    ExamData,
    Questions,
    answerable_of,
    answers,
    ask,
    evaluate_model,
    pooled_alpha,
)
from adafusion.experiments.plan import Experiment, Row
from adafusion.experiments.study import Trained
from adafusion.experiments.verdict import (
    DRAWS,
    Asked,
    by_seed,
    estimate_share,
    judge_difference,
    plain_verdict,
)
from adafusion.provenance import git_commit, software_versions
from adafusion.training.corpus import Corpus
from adafusion.types import Progress, silent

SCHEMA = 1
TABLE = ("AR@1", "AR@5", "AR@1%")

Values = Callable[[Answers], np.ndarray]


def measure(
    experiment: Experiment,
    rows: Rows,
    corpus: Corpus,
    exams: Sequence[ExamData],
    cache: Path,
    out: Path,
    *,
    passes: int,
    seeds: Sequence[int],
    command: str,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Evaluate every trained row that is not yet evaluated, and put the results together.

    An experiment without protocols is judged on validation alone: no exam is looked at.
    """
    protocols = experiment.protocols
    questions = {protocol: ask(exams, protocol) for protocol in protocols}
    num_answers = validation_answers(corpus)
    table: list[dict[str, Any]] = []
    said: dict[str, tuple[Answers, ...]] = {}  # under the first protocol
    data: list[Any] = []
    for row in experiment.rows:
        jobs = rows[row.label]
        learnt = _learnt(row, jobs, num_answers)
        if not protocols:
            table.append(learnt)
            continue
        records = [
            evaluate_model(
                job.name,
                job.model,
                exams,
                protocols,
                cache,
                out,
                progress,
                frozen=job.config.cache_branches,
            )
            for job in jobs
        ]
        given = {p: tuple(answers(record[p]) for record in records) for p in protocols}
        said[row.label] = given[protocols[0]]
        data = [record["data"] for record in records[0][protocols[0]]]
        first = records[0][protocols[0]][0]
        recall = {
            protocol: {
                name: asdict(estimate_share(*_hits(given[protocol], questions[protocol], values)))
                for name, values in _measures(protocol == protocols[0]).items()
            }
            for protocol in protocols
        }
        table.append(
            {
                **learnt,
                "parameters": first["model"]["parameters"],
                "length": first["model"]["length"],  # numbers in a descriptor
                "models": [record[protocols[0]][0]["model"]["fingerprint"] for record in records],
                "alpha": [pooled_alpha(record[protocols[0]]) for record in records],
                "recall": recall,
                "recall@1_by_seed": by_seed(
                    *_hits(said[row.label], questions[protocols[0]], _within(1))
                ),
            }
        )
    trained = Trained(
        experiment=experiment,
        rows=rows,
        corpus=corpus,
        exams=tuple(exams),
        questions=questions[protocols[0]] if protocols else NO_QUESTIONS,
        said=said,
        alpha={row["label"]: row["alpha"] for row in table if protocols},
        converged=frozenset(row["label"] for row in table if row["converged"]),
        num_answers=num_answers,
        cache=cache,
        out=out,
        progress=progress,
    )
    return {
        "schema": SCHEMA,
        "experiment": experiment.name,
        "words": experiment.words,
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "command": command,
        "commit": git_commit(),
        "software": software_versions(),
        "machine": {
            "processors": os.cpu_count(),
            "device": torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu",
        },
        "seeds": list(seeds),
        "budget": passes,
        "training_seconds": sum(job.record()["seconds"] for job in all_jobs(rows)),
        "training_data": corpus.facts(),
        "test_data": data,
        "validation_answers": num_answers,
        "protocols": {protocol: describe_protocol(protocol) for protocol in protocols},
        "draws": DRAWS,
        "rows": table,
        "verdicts": _verdicts(trained),
        "study": {} if experiment.study is None else experiment.study.measure(trained),
    }


def _measures(is_first: bool) -> dict[str, Values]:
    """What is measured under a protocol: recall at every N under the first, else the table's."""
    every = {f"AR@{k}": _within(k) for k in KS} | {"AR@1%": _within(None)}
    return every if is_first else {name: every[name] for name in TABLE}


def _within(n: int | None) -> Values:
    return lambda said: said.hits(n)


def _hits(
    seeds: Sequence[Answers], questions: Questions, values: Values
) -> tuple[Int64[np.ndarray, "seed q"], Asked]:
    """The values of each seed's answers to the queries that have a true match, and where."""
    asked, answerable = answerable_of(seeds, questions)
    return np.stack([values(one)[answerable] for one in seeds]), asked


def _learnt(row: Row, jobs: Sequence[Job], num_answers: int) -> dict[str, Any]:
    """What the table says of a row's training; counts of passes are those of one seed."""
    records = {job.key: job.record() for job in jobs[0].chain()}
    curve = row_curve(jobs)
    why_not = why_not_ranked(
        curve, num_answers, parts=part_curves(jobs), scratch=part_curves(jobs, scratch=True)
    )
    return {
        "label": row.label,
        "system": jobs[0].config.model.system,
        "reconstruction": row.reconstruction,
        "pretrained": row.pretrained,
        "published_oxford_percent": None if row.published is None else asdict(row.published),
        "trainings": [[one.key for one in job.chain()] for job in jobs],
        "frame_passes": passes_of(jobs[0], lambda job: records[job.key]["frame_passes"]),
        "mining_passes": sum(record["mining_passes"] for record in records.values()),
        "validation_passes": sum(
            records[job.key]["validation_passes"] for job in through_networks(jobs[0])
        ),
        "rate_falls_to_zero": all(
            job.config.optimiser.schedule == "cosine" for job in jobs[0].chain()
        ),
        "converged": not why_not,
        "why_not_ranked": why_not,
        "validation_curve": curve,
        "kept_after": [kept_after(job) for job in jobs],
        "rising_by_more_than": half_width(best_before(curve), num_answers),
    }


def _verdicts(trained: Trained) -> list[dict[str, Any]]:
    """Rows set against each other: over all pairs of runs, by kind of pair, by zone."""
    verdicts = []
    for ours, theirs in trained.experiment.verdicts:
        asked, answerable = answerable_of(trained.said[ours], trained.questions)
        right = {
            label: np.stack([one.hits(1)[answerable] for one in trained.said[label]])
            for label in (ours, theirs)
        }
        for group, mask in trained.questions.groups().items():
            chosen = mask[answerable]
            if not chosen.any():
                continue
            verdict = judge_difference(
                right[ours][:, chosen], right[theirs][:, chosen], asked.where(chosen)
            )
            said = plain_verdict(verdict, ranked={ours, theirs} <= trained.converged)
            verdicts.append({"row": ours, "against": theirs, "group": group, **said})
    return verdicts
