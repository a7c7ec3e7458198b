# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The command that trains and judges a whole comparison."""

from __future__ import annotations

import json
import shlex
import sys
import time
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from adafusion.cli.common import Cache, bar, cache_folder, open_data, say, split_names

if TYPE_CHECKING:
    from adafusion.experiments import Experiment, Job, Recipe
    from adafusion.experiments.jobs import Rows
    from adafusion.training import TrainConfig

T = TypeVar("T")

LIST = "list"  # in place of a name
LINE_EVERY_S = 60.0
LENGTH, CHAIN = "give --budget", "its rows say what starts from what"
SYSTEM = "its rows say what is compared"
DECIDED = {  # keys of a training that a plan sets, and what to give in place of --set
    "seed": "give --seeds",
    **dict.fromkeys(("epochs", "passes", "batches", "branch_batches", "evaluate_every"), LENGTH),
    **dict.fromkeys(("init", "schedule", "joint_rate", "take_weights", "norms"), CHAIN),
    **dict.fromkeys(("model.system", "stage", "cache_branches"), SYSTEM),
}


def experiment(
    name: Annotated[str, typer.Argument(help="Which comparison; `list` tells them all.")],
    out: Annotated[
        Path, typer.Option(help="Folder for results; experiments that share it share trainings.")
    ] = Path("runs/experiments"),
    world: Annotated[
        str,
        typer.Option(
            help="Named world with the parts train and test, rendered when first asked for; "
            "world-v1-tiny is for trying things out."
        ),
    ] = "world-v1-small",
    train: Annotated[
        list[Path] | None,
        typer.Option(help="Dataset that teaches, with a validation region, in place of --world."),
    ] = None,
    test: Annotated[
        list[Path] | None,
        typer.Option(help="Dataset to judge by, in its test region, in place of --world."),
    ] = None,
    budget: Annotated[
        int | None,
        typer.Option(
            help="Frame passes through each sensor's network of every row; default: 512, 12,000 or "
            "400,000 on world-v1-tiny, -small or world-v1, else 40 for each training frame.",
            min=1,
        ),
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(help="Seeds of each row's trainings, by comma; default: the experiment's."),
    ] = None,
    rows: Annotated[str | None, typer.Option(help="Only these rows, by comma.")] = None,
    plan: Annotated[
        bool, typer.Option("--plan", help="Say what would be trained and what is done; no more.")
    ] = False,
    workers: Annotated[
        int, typer.Option(help="Trainings side by side, each with one thread.", min=1)
    ] = 1,
    change: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a key of every training: --set augment.color=0"),
    ] = None,
    full_size: Annotated[
        bool,
        typer.Option(
            "--full-size",
            help="Networks and inputs of the papers' sizes, for a GPU; default: small.",
        ),
    ] = False,
    results: Annotated[
        Path | None,
        typer.Option(
            help="Folder for NAME.md, .json and .png in place of OUT, where those of another "
            "budget, other rows or seeds are to be kept."
        ),
    ] = None,
    cache: Cache = None,
) -> None:
    """Train and judge every row of a comparison on equal budgets, and write its table.

    Writes NAME.json and NAME.md, and NAME.png where there is a figure, over those of before. What
    was trained and judged before, by this experiment or another in OUT, is taken as it is; after a
    kill the same command goes on where it was.

    \b
    Example: adafusion experiment list
    Example: adafusion experiment headline --world world-v1-tiny --budget 100 --seeds 0
    Example: adafusion experiment headline --plan
    Example: adafusion experiment headline --workers 2
    Example: adafusion experiment table-systems --rows NetVLAD,AdaFusion --budget 20000
    Example: adafusion experiment headline --train data/nclt --test data/nclt --out runs/nclt
    """
    from adafusion import experiments as e
    from adafusion.files import make_folder
    from adafusion.sim.benchmarks import BENCHMARKS
    from adafusion.training.corpus import Corpus, with_camera
    from adafusion.types import UserError

    if name == LIST:
        print(_catalogue())
        return
    if (train is None) != (test is None):
        raise UserError("give both --train and --test, or a --world that has both parts")
    changes = tuple(change or ())
    for key in (text.partition("=")[0] for text in changes):
        if key in DECIDED:
            raise UserError(f"--set {key}: the experiment decides it; {DECIDED[key]}")
    labels = None if rows is None else split_names(rows)

    def build(recipe: Recipe, passes: int) -> Experiment:
        whole = e.build_experiment(name, recipe, passes)
        return whole if labels is None else whole.only(labels)

    packaged = partial(e.packaged_recipe, changes=changes, full_size=full_size)
    rough = build(packaged, 1)
    for text in changes:
        if kept := _without_effect(text, rough):
            say(f"--set {text}: set otherwise by the experiment in {', '.join(kept)}")
    if train is None and world not in BENCHMARKS and not Path(world).is_dir():
        raise UserError(
            f"--world {world}: no such world; choose from {', '.join(BENCHMARKS)}, or give --train "
            "and --test"
        )
    chosen = rough.seeds if seeds is None else _numbers(seeds)  # no mistake waits for a rendering
    teaches = train or [Path(world) / "train"]
    judges = test or [Path(world) / "test"]
    corpus = Corpus(tuple(open_data(path, cache) for path in teaches))
    corpus.rows("validation")  # what lacks a region is refused now, not when all is trained
    if budget is None:
        frames = len(corpus.rows("train"))
        known = None if train else e.BUDGETS.get(world)
        budget = known or e.PASSES_A_FRAME * frames

    def recipe(training: str) -> TrainConfig:
        return with_camera(packaged(training), corpus.datasets)

    asked = build(recipe, budget)
    planned = e.plan_jobs(asked, chosen, corpus, out)
    jobs = e.all_jobs(planned)
    if plan:
        print(_plan(planned, budget, len(corpus.rows("validation"))))
        return
    pages = results or out
    for folder in (out, pages):
        make_folder(folder)
    exams: tuple[e.ExamData, ...] = ()
    if asked.protocols:  # else nothing of the test set is looked at
        exams = tuple(e.ExamData.of(open_data(path, cache)) for path in judges)
    for exam in exams:  # what they lack is told now
        for row in rough.rows:
            with_camera(row.training.config, [corpus.datasets[0], exam.dataset])
        for protocol in asked.protocols:
            exam.splits(protocol)
    progress = bar if workers == 1 else lines
    todo = [job for job in jobs if job.state != "done"]
    say(f"{name}: {len(jobs)} trainings, {len(jobs) - len(todo)} done before")
    trained = e.train_jobs(todo, corpus, cache_folder(cache), workers=workers, progress=progress)
    for count, job in enumerate(trained, 1):
        say(
            f"{count} of {len(todo)}: {job.name}, validation recall@1 {job.record()['best']:.1%}, "
            f"{job.record()['seconds'] / 60:.0f} min"
        )
    found = e.measure(
        asked,
        planned,
        corpus,
        exams,
        cache_folder(cache),
        out,
        passes=budget,
        seeds=chosen,
        command=shlex.join(["adafusion", *sys.argv[1:]]),
        progress=bar,
    )
    text, files = _write(asked, found, pages)
    print(text)
    print("\n".join(map(str, files)))


def _write(
    experiment: Experiment, found: Mapping[str, Any], folder: Path
) -> tuple[str, list[Path]]:
    """Write the results, the figure and the page; the page's text and all files."""
    from adafusion.experiments import page
    from adafusion.files import write_json, write_text

    file, sheet, drawn = (folder / f"{experiment.name}.{end}" for end in ("json", "md", "png"))
    if file.exists() and (old := _asked(file)) != (new := _asked_of(found)):
        say(f"{file} is written over: it was of {old}, and is of {new}")
    write_json(file, found)  # before anything of it is drawn
    files = [file, sheet]
    section: list[str] = []
    if (study := experiment.study) is not None:
        section = study.section(found["study"])
        if study.draw is not None:
            study.draw(found, drawn)
            files.append(drawn)
    text = page(found, section, drawn.name if drawn in files else "")
    write_text(sheet, text)
    return text, files


def lines(items: Iterable[T], *, total: int | None = None, desc: str = "") -> Iterable[T]:
    """Say now and then how far a job is, in lines that several processes may share a screen by."""
    last = time.monotonic()
    for count, item in enumerate(items, 1):
        yield item
        if time.monotonic() - last > LINE_EVERY_S:
            last = time.monotonic()
            say(f"{desc}: {count}" + ("" if total is None else f" of {total}"))


def _without_effect(change: str, experiment: Experiment) -> list[str]:
    """Labels of the rows that a change of every training does not reach everywhere."""
    from adafusion.config import change_config
    from adafusion.types import UserError

    def is_in(config: TrainConfig) -> bool:
        try:
            return change_config(config, (change,)) == config
        except UserError:  # it does not fit what the row sets itself
            return False

    return [
        row.label
        for row in experiment.rows
        if not all(is_in(one.config) for one in row.training.chain())
    ]


def _numbers(text: str) -> tuple[int, ...]:
    from adafusion.types import UserError

    try:
        numbers = tuple(dict.fromkeys(int(word) for word in split_names(text)))
    except ValueError:
        raise UserError(f"--seeds {text!r}: write whole numbers between commas, as 0,1,2") from None
    if not numbers or min(numbers) < 0:
        raise UserError(f"--seeds {text!r}: give at least one, none below 0")
    return numbers


def _catalogue() -> str:
    """Every experiment with what it asks and its rows."""
    from adafusion.experiments import EXPERIMENTS, build_experiment, packaged_recipe

    lines = []
    for name in EXPERIMENTS:
        one = build_experiment(name, packaged_recipe, 1)
        lines += [
            f"{name}  (seeds {', '.join(map(str, one.seeds))})",
            *wrap(one.words, 96, initial_indent="    ", subsequent_indent="    "),
            *wrap("rows: " + "; ".join(row.label for row in one.rows), 96,
                  initial_indent="    ", subsequent_indent="      "),
        ]  # fmt: skip
    return "\n".join(lines)


def _evaluations(job: Job) -> int:
    """How often the training looks at validation, with that before the first batch."""
    config = job.config
    length = config.passes if config.batches is None else config.batches
    return 1 + -(-(length or 0) // config.evaluate_every)


def _asked_of(results: Mapping[str, Any]) -> str:
    """The budget, the seeds and the rows that results are of."""
    return (
        f"{results['budget']:,} passes, seeds {', '.join(map(str, results['seeds']))}, rows "
        + ", ".join(row["label"] for row in results["rows"])
    )


def _asked(file: Path) -> str:
    """The same of results in a file, where they can be read."""
    try:
        return _asked_of(json.loads(file.read_text(encoding="utf-8")))
    except (KeyError, TypeError, ValueError):
        return "another make"


def _batches(job: Job) -> str:
    return "growing" if job.config.batches is None else f"{job.config.batches:,}"


def _plan(planned: Rows, budget: int, num_validation: int) -> str:
    """What would be trained for which rows, what is done, and what it costs."""
    from adafusion.experiments import all_jobs

    jobs = all_jobs(planned)
    serves = {
        job.key: [
            label
            for label, of_seeds in planned.items()
            if any(job.key == one.key for last in of_seeds for one in last.chain())
        ]
        for job in jobs
    }
    wide = max(len(job.name) for job in jobs)
    left = [job for job in jobs if job.state != "done"]
    passes = {job.key: 0 if job.config.cache_branches else job.passes for job in jobs}
    shown = [
        f"{job.name:{wide}}  {passes[job.key]:>10,} passes  {_batches(job):>7} batches  "
        f"{job.state:6}  {job.key}  for {', '.join(serves[job.key])}"
        for job in jobs
    ]
    return "\n".join(
        [
            *shown,
            f"{len(left)} of {len(jobs)} trainings to do: "
            f"{sum(passes[job.key] for job in left):,} of {sum(passes.values()):,} frame "
            f"passes, from a budget of {budget:,} frame passes a row and seed; and some "
            f"{sum(map(_evaluations, left)) * num_validation:,} to validate, which teach nothing "
            "and take about a third of the time each",
        ]
    )
