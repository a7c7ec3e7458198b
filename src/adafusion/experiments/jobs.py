# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The trainings of an experiment: shared by content, resumed where they were killed.

    <out>/trainings/<name>-seed<n>-<key>/   one training; training.json is written when it is done

The key is that of the effective configuration, the keys of the trainings it starts from, the data
and the version of this code. So another experiment, a longer list of seeds or a repeated command
finds what was trained before.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from filelock import FileLock
from jaxtyping import Int

from adafusion.config import identity, to_plain
from adafusion.evaluation import validation_recall
from adafusion.experiments.budget import batches_of
from adafusion.experiments.plan import Experiment, Training
from adafusion.files import fingerprint, write_json
from adafusion.models import PlaceModel, read_header
from adafusion.models.frozen import describe_frozen
from adafusion.provenance import git_commit, software_versions
from adafusion.training import TrainConfig, train
from adafusion.training.checkpoint import STATE_FILE, read_standing
from adafusion.training.corpus import Corpus
from adafusion.training.loop import MODEL_FILE, SELECTED_BY
from adafusion.types import Descriptions, Progress, silent
from adafusion.workers import map_in_processes

log = logging.getLogger(__name__)

TRAINING_VERSION = 1  # raise it when an equal configuration comes to train to other weights
RECORD_FILE = "training.json"


@dataclass(frozen=True, kw_only=True)
class Job:
    """One training with everything decided."""

    name: str
    key: str
    config: TrainConfig
    passes: int  # planned
    sources: tuple[Job, ...]
    folder: Path

    @property
    def model(self) -> Path:
        """The file that it writes."""
        return self.folder / MODEL_FILE

    @property
    def depth(self) -> int:
        """How many trainings must be done before, one after the other."""
        return 1 + max((source.depth for source in self.sources), default=-1)

    @property
    def state(self) -> str:
        """ "done", "begun" or "to do"."""
        if (self.folder / RECORD_FILE).exists():
            return "done"
        return "begun" if (self.folder / STATE_FILE).exists() else "to do"

    def record(self) -> dict[str, Any]:
        """What training.json says of it."""
        return json.loads((self.folder / RECORD_FILE).read_text(encoding="utf-8"))

    def chain(self) -> Iterator[Job]:
        """All trainings that lead to this one, and this one last."""
        for source in self.sources:
            yield from source.chain()
        yield self


Rows = Mapping[str, tuple[Job, ...]]  # by label, one job a seed


def plan_jobs(experiment: Experiment, seeds: Sequence[int], corpus: Corpus, out: Path) -> Rows:
    """Decide every training of the rows; equal ones are one, under the first one's name."""
    out = out.resolve()  # a training keeps the paths that it starts from
    batches: dict[tuple[object, int], int] = {}
    decided: dict[str, Job] = {}

    def job(training: Training, seed: int) -> Job:
        sources = tuple(job(source, seed) for source in training.starts_from)
        budget = (training.config.sampling, training.passes)
        if budget not in batches:
            batches[budget] = batches_of(corpus, *budget)
        count = batches[budget]
        grows = training.config.sampling.growth is not None  # into who knows how many batches
        optimiser = training.config.optimiser
        rise = min(optimiser.warmup, count // 10)  # a short training has a short rise
        config = replace(
            training.config,
            seed=seed,
            passes=training.passes if grows else None,
            batches=None if grows else count,
            evaluate_every=-(-(training.passes if grows else count) // training.evaluations),
            optimiser=replace(optimiser, warmup=rise),
            init=tuple(str(source.model) for source in sources),
            schedule="joint",  # the plan is the schedule
        )
        named = replace(config, init=tuple(source.key for source in sources))
        key = fingerprint(f"training {TRAINING_VERSION}", identity(named), corpus.fingerprint)
        planned = Job(
            name=f"{training.name}, seed {seed}",
            key=key,
            config=config,
            passes=training.passes,
            sources=sources,
            folder=out / "trainings" / f"{training.name}-seed{seed}-{key}",
        )
        return decided.setdefault(key, planned)

    return {row.label: tuple(job(row.training, seed) for seed in seeds) for row in experiment.rows}


def all_jobs(rows: Rows) -> list[Job]:
    """Every training of the rows once, sources first and the longest of equals first."""
    found = {job.key: job for jobs in rows.values() for last in jobs for job in last.chain()}
    return sorted(found.values(), key=lambda job: (job.depth, -job.passes, job.name))


def train_jobs(
    jobs: Sequence[Job],
    corpus: Corpus,
    cache: Path,
    *,
    workers: int = 1,
    progress: Progress = silent,
) -> Iterator[Job]:
    """Train what is not done, yielding each training as it is; sources come first in `jobs`.

    One worker trains with all threads; several train side by side, each with one thread.
    """
    todo = [job for job in jobs if job.state != "done"]
    for settings in dict.fromkeys(job.config.model.preprocess for job in todo):
        corpus.prepare(settings, cache, progress)  # not by two workers at once
    work = _Work(tuple(dataset.root for dataset in corpus.datasets), cache, progress)
    start = torch.set_num_threads if workers > 1 else None
    arguments = (1,) if workers > 1 else ()
    yield from map_in_processes(work, todo, workers, start=start, arguments=arguments)


@dataclass(frozen=True)
class _Work:
    """`train_job` with what every process needs for it."""

    roots: tuple[Path, ...]
    cache: Path
    progress: Progress

    def __call__(self, job: Job) -> Job:
        corpus = Corpus.open(self.roots)
        for one in job.chain():  # what it starts from may still be trained by another process
            train_job(one, corpus, self.cache, self.progress)
        return job


def train_job(job: Job, corpus: Corpus, cache: Path, progress: Progress = silent) -> None:
    """Train one job to its end, from where it was; another process at the same job is awaited."""
    job.folder.mkdir(parents=True, exist_ok=True)
    with FileLock(job.folder / "lock"):
        if job.state != "done":
            _train(job, corpus, cache, progress)


def _train(job: Job, corpus: Corpus, cache: Path, progress: Progress) -> None:
    data = corpus.prepare(job.config.model.preprocess, cache)
    rows, judges = corpus.rows("train"), corpus.rows("validation")
    resume = job.state == "begun"

    def by_cache(model: PlaceModel, rows: Int[np.ndarray, " n"]) -> Descriptions:
        return describe_frozen(model, data, rows, cache)

    steps = train(
        job.config,
        data,
        rows,
        validation_recall(data, judges, by_cache if job.config.cache_branches else None),
        job.folder,
        points=corpus.points if job.config.augment.jitter_m else None,
        resume=resume,
        cache=cache,
        card={"data": corpus.facts(), "commit": git_commit(), "versions": software_versions()},
    )
    left = job.config.batches  # None where that depends on how batches grow
    if left is not None:  # a new training yields a step before its first batch
        left = left - read_standing(job.folder).batches if resume else left + 1
    for step in progress(steps, total=left, desc=job.name):
        if step.validation is not None:
            log.info("%s, batch %d: %s", job.name, step.batch, step.validation)
    ended = read_standing(job.folder)
    write_json(
        job.folder / RECORD_FILE,
        {
            "name": job.name,
            "key": job.key,
            "config": to_plain(job.config),
            "data": corpus.facts(),
            "batches": ended.batches,
            "frame_passes": ended.passes,
            "mining_passes": ended.mining_passes,
            "validation_passes": len(judges) * len(ended.curve),
            "best": ended.best,
            "curve": ended.curve,
            "seconds": round(ended.seconds, 1),
            "threads": torch.get_num_threads(),
            "device": torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu",
            "software": software_versions(),
            "commit": git_commit(),
        },
    )


def row_curve(jobs: Sequence[Job]) -> list[float]:
    """Validation recall@1 of a row over its training, the mean over its seeds.

    Of the trainings in its chain those count whose model is the row's own: a branch at another
    image size, or alone, has a recall of another kind.
    """
    return _mean_curve([list(_same_model(last)) for last in jobs])


def part_curves(jobs: Sequence[Job]) -> list[list[float]]:
    """Validation recall@1 of each training that leads to a row, the mean over its seeds."""
    chains = zip(*(last.chain() for last in jobs), strict=True)
    return [_mean_curve([[job] for job in of_seeds]) for of_seeds in chains]


def _mean_curve(trainings: Sequence[Sequence[Job]]) -> list[float]:
    """The mean over seeds of what the trainings of each seed, one after the other, recalled."""
    curves = [
        [line[SELECTED_BY] for job in of_seed for line in job.record()["curve"]]
        for of_seed in trainings
    ]
    length = min(map(len, curves))
    return [sum(curve[i] for curve in curves) / len(curves) for i in range(length)]


def kept_after(job: Job) -> float:
    """After which share of its batches a training's model was kept: 0, as it began."""
    return read_header(job.model)[1]["batches"] / job.record()["batches"]


def starts_from_scratch(last: Job) -> bool:
    """Whether the curve of a row begins with weights drawn by chance."""
    return not next(_same_model(last)).sources


def _same_model(last: Job) -> Iterator[Job]:
    return (job for job in last.chain() if job.config.model == last.config.model)


def passes_of(job: Job, count: Callable[[Job], int]) -> dict[str, int]:
    """A count of frame passes over a row's chain, through the network of each sensor.

    What is trained on the outputs of frozen networks sends nothing through them.
    """
    chain = [one for one in job.chain() if not one.config.cache_branches]
    return {
        sensor: sum(count(one) for one in chain if sensor in one.config.model.sensors)
        for sensor in job.config.model.sensors
    }
