# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The trainings of an experiment: shared by content, resumed where they were killed.

    <out>/trainings/<name>-seed<n>-<key>/   one training; training.json is written when it is done

The key is that of the effective configuration, the keys of the trainings it starts from, the data
and the version of this code. So another experiment, a longer list of seeds or a repeated command
finds what was trained before.
"""

from __future__ import annotations

import functools
import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from filelock import FileLock, Timeout
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
from adafusion.training.settings import Sampling
from adafusion.types import Descriptions, Progress, UserError, silent
from adafusion.workers import map_in_processes

log = logging.getLogger(__name__)

TRAINING_VERSION = 1  # raise it when an equal configuration comes to train to other weights
RECORD_FILE = "training.json"
LATEST_MINING = 4  # mining that would begin after the last batch begins after a quarter of them


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
    decided: dict[str, Job] = {}

    @functools.cache
    def count_batches(sampling: Sampling, passes: int) -> int:
        return batches_of(corpus, sampling, passes)

    def job(training: Training, seed: int) -> Job:
        if training.passes < 1:
            raise UserError(f"the budget leaves no frame pass for {training.name}: give more")
        sources = tuple(job(source, seed) for source in training.starts_from)
        sampling = training.config.sampling
        count = count_batches(sampling, training.passes)
        if sampling.mining is not None and sampling.mining.after >= count:
            mining = replace(sampling.mining, after=count // LATEST_MINING)
            sampling = replace(sampling, mining=mining)
            count = count_batches(sampling, training.passes)
        grows = sampling.growth is not None  # into who knows how many batches
        optimiser = training.config.optimiser
        rise = min(optimiser.warmup, count // 10)  # a short training has a short rise
        config = _checked(
            training,
            seed=seed,
            sampling=sampling,
            passes=training.passes if grows else None,
            batches=None if grows else count,
            evaluate_every=-(-(training.passes if grows else count) // training.evaluations),
            optimiser=replace(optimiser, warmup=rise),
            init=tuple(str(source.model) for source in sources),
            schedule="joint",  # the plan is the schedule
        )
        named = replace(config, init=tuple(source.key for source in sources))
        key = fingerprint(f"training {TRAINING_VERSION}", identity(named), corpus.fingerprint)
        kept = next((out / "trainings").glob(f"*-{key}"), None)  # perhaps by another name
        planned = Job(
            name=f"{training.name}, seed {seed}",
            key=key,
            config=config,
            passes=training.passes,
            sources=sources,
            folder=kept or out / "trainings" / f"{training.name}-seed{seed}-{key}",
        )
        return decided.setdefault(key, planned)

    return {row.label: tuple(job(row.training, seed) for seed in seeds) for row in experiment.rows}


def _checked(training: Training, **decided: Any) -> TrainConfig:
    """The training's settings with what a plan decides; UserError where they do not fit."""
    try:
        return replace(training.config, **decided)
    except ValueError as error:
        raise UserError(f"{training.name}: {error}") from None


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
    lock = FileLock(job.folder / "lock")
    try:
        held = lock.acquire(timeout=0)
    except Timeout:
        log.warning("%s: waiting for another process that trains it", job.name)
        held = lock.acquire()
    with held:
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
    return _mean_curve(
        [[one for one in last.chain() if one.config.model == last.config.model] for last in jobs]
    )


def part_curves(jobs: Sequence[Job], *, scratch: bool = False) -> list[list[float]]:
    """Validation recall@1 of each training that leads to a row, the mean over its seeds.

    With `scratch` of those alone that began with weights drawn by chance.
    """
    chains = zip(*(last.chain() for last in jobs), strict=True)
    return [
        _mean_curve([[job] for job in of_seeds])
        for of_seeds in chains
        if not (scratch and (of_seeds[0].sources or of_seeds[0].config.imagenet))
    ]


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


def through_networks(last: Job) -> list[Job]:
    """The trainings of a chain, without those on outputs of frozen networks, which are kept."""
    return [one for one in last.chain() if not one.config.cache_branches]


def passes_of(last: Job, count: Callable[[Job], int]) -> dict[str, int]:
    """A count of frame passes over a row's chain, through the network of each sensor."""
    chain = through_networks(last)
    return {
        sensor: sum(count(one) for one in chain if sensor in one.config.model.sensors)
        for sensor in last.config.model.sensors
    }
