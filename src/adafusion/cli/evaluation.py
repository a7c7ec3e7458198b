# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The command that evaluates models under a named protocol, and the files it writes."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from adafusion.cli.common import Cache, bar, cache_folder, check_unit, open_data, say, split_names

if TYPE_CHECKING:
    from adafusion.datasets import Dataset
    from adafusion.evaluation import Judged

RESULT_FILE, CONFIG_FILE, REPORT_FILE = "result.json", "evaluate.yaml", "report.html"


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig:
    """Everything an evaluation was asked for, with what was left to defaults filled in."""

    dataset: str
    models: tuple[str, ...]  # shipped names or files; the first is the one a report speaks of
    protocol: str
    region: str
    runs: tuple[str, ...]
    radius_m: float
    distance: Literal["l1", "l2", "native"] = "native"  # native: what each system is trained by
    seed: int = 0  # of the bootstrap that makes the intervals

    @property
    def p(self) -> int | None:
        """The distance as the order of its norm; None: each model's own."""
        return None if self.distance == "native" else int(self.distance[1])


def evaluate(
    dataset: Annotated[Path, typer.Argument(help="A dataset, or world-v1-small/test.")],
    out: Annotated[Path, typer.Argument(help="Folder for the result, its settings and report.")],
    model: Annotated[
        list[str] | None,
        typer.Option(help="Shipped name or .safetensors file; repeat it to compare models."),
    ] = None,
    protocol: Annotated[
        str, typer.Option(help="cross-run, union, union-strict or pointnetvlad.")
    ] = "cross-run",
    region: Annotated[str, typer.Option(help="Region whose frames are the queries.")] = "test",
    runs: Annotated[str | None, typer.Option(help="Only these runs, by comma.")] = None,
    radius_m: Annotated[
        float | None, typer.Option(help="A true match is so near; default: the protocol's.")
    ] = None,
    distance: Annotated[
        Literal["l1", "l2", "native"],
        typer.Option(help="Distance between descriptors; native: what each was trained by."),
    ] = "native",
    seed: Annotated[int, typer.Option(help="Seed of the intervals' bootstrap.", min=0)] = 0,
    cache: Cache = None,
    report: Annotated[bool, typer.Option(help="Write report.html.")] = True,
) -> None:
    """Measure recall@N of one or more models under an exact, named protocol.

    Prints recall@1, recall@5 and recall@1% with 95 % intervals (a bootstrap over 50 m blocks of
    places), and, for the first model against each other, the paired difference. Writes
    OUT/result.json, OUT/evaluate.yaml (the effective settings) and OUT/report.html. Frames that
    lack a sensor which one of the models needs are left out for all, and counted.

    \b
    Example: adafusion evaluate data/world-7 results/w7 --model adafusion-s --model image-s
    Example: adafusion evaluate data/nclt results/nclt --model mine.safetensors --protocol union
    """
    from adafusion.evaluation import dataset_splits, judge
    from adafusion.files import make_folder
    from adafusion.models import load_model
    from adafusion.types import UserError

    if (out / RESULT_FILE).exists():
        raise UserError(f"{out} holds a result: choose another folder, or remove it first")
    opened = open_data(dataset, cache)
    chosen = None if runs is None else split_names(runs)
    splits = dataset_splits(opened, protocol, region=region, runs=chosen, radius_m=radius_m)
    config = EvaluateConfig(
        dataset=str(dataset),
        models=tuple(model or ["adafusion-s"]),
        protocol=protocol,
        region=region,
        runs=tuple(opened.runs if chosen is None else chosen),
        radius_m=splits[0].radius_m,
        distance=distance,
        seed=seed,
    )
    models = [load_model(name) for name in config.models]
    for loaded in models:
        check_unit(opened, loaded.config, f"model {loaded.name!r}")
    for name in config.models:
        if trained_on(name, opened):
            say(
                f"warning: {name} was trained on this dataset: only what lies outside its training "
                "region is new to it, and the look of the place is not"
            )
    make_folder(out)  # what cannot be written is said before the work
    judged = judge(models, opened, splits, cache_folder(cache), p=config.p, progress=bar)
    print(table(judged, seed))
    print("\n".join(map(str, write_results(judged, opened, config, out, report=report))))


def trained_on(name_or_path: str, dataset: Dataset) -> bool:
    """Whether the model's card names this very dataset among those it learnt from."""
    from adafusion.models.store import model_path, read_header

    _, card = read_header(model_path(name_or_path))
    return dataset.fingerprint in [data.get("fingerprint") for data in card.get("data", [])]


def table(judged: Sequence[Judged], seed: int) -> str:
    """Recall of each model with intervals, and how the first one differs from the others."""
    from adafusion.evaluation import compare

    measures = {"recall@1": "AR@1", "recall@5": "AR@5", "recall@1%": "AR@1%"}
    first, *others = judged
    wide = max(len(j.name) for j in judged)
    lines = [f"{'model':{wide}}  " + "".join(f"{word:22}" for word in measures)]
    for j in judged:
        estimates = j.evaluation.estimates(seed=seed)
        cells = [f"{estimates[measure].in_percent():22}" for measure in measures.values()]
        lines.append(f"{j.name:{wide}}  " + "".join(cells))
    for j in others:
        gap = compare(first.evaluation, j.evaluation, seed=seed)["AR@1"]
        lines.append(f"{first.name} minus {j.name}: recall@1 {gap.in_percent('+')} points")
    e = first.evaluation
    lines.append(
        f"percent with 95 % intervals over {e.num_places} blocks of 50 m; {e.protocol}, radius "
        f"{e.radius_m:g} m, L{e.p}: {e.num_queries} queries, {e.num_unanswerable} of them without "
        "a true match left out"
    )
    if first.num_lacking:
        lines.append(f"left out: {first.num_lacking} frames that lack a sensor a model needs")
    return "\n".join(line.rstrip() for line in lines)


def write_results(
    judged: Sequence[Judged],
    dataset: Dataset,
    config: EvaluateConfig,
    out: Path,
    *,
    report: bool = True,
) -> list[Path]:
    """Write result.json, evaluate.yaml and, last, report.html; give their paths."""
    from adafusion.config import save_config, to_plain
    from adafusion.evaluation import alpha_by, result_record
    from adafusion.files import write_json

    data = {
        "name": dataset.info.name,
        "version": dataset.info.version,
        "synthetic": dataset.info.synthetic,
        "fingerprint": dataset.fingerprint,
        "runs": list(config.runs),
        "left_out_for_lack_of_a_sensor": judged[0].num_lacking,
    }
    records = []
    for j, name in zip(judged, config.models, strict=True):
        alpha = {
            what: {label: asdict(summary) for label, summary in alpha_by(j, dataset, what).items()}
            for what in ("run", "zone")
        }
        model = {
            "name": j.name,
            "fingerprint": j.model.fingerprint,
            "preprocess_fingerprint": j.model.preprocess_fingerprint,
            "config": to_plain(j.model.config),
            "trained_on_this_dataset": trained_on(name, dataset),
            "alpha": alpha if j.descriptions.alpha is not None else None,
        }
        records.append(result_record(j.evaluation, model=model, data=data, seed=config.seed))
    command = shlex.join(["adafusion", *sys.argv[1:]])
    files = [out / RESULT_FILE, out / CONFIG_FILE]
    write_json(files[0], {"command": command, "results": records})
    save_config(config, files[1])
    if report:
        from adafusion.cli.reporting import report_data
        from adafusion.report import write_report

        files.append(write_report(out / REPORT_FILE, report_data(judged, dataset, config, command)))
    return files
