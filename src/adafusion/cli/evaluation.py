# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The command that evaluates models under a named protocol, and the report it fills."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from adafusion.cli.common import bar, cache_folder, say, split_names

if TYPE_CHECKING:
    import numpy as np

    from adafusion.datasets import Dataset
    from adafusion.evaluation import AlphaSummary, Evaluation
    from adafusion.models import AdaFusion
    from adafusion.types import Descriptions, Split

INTERVAL_SEED = 0


def evaluate(
    dataset: Annotated[Path, typer.Argument(help="A dataset in the package's own form.")],
    out: Annotated[Path, typer.Argument(help="Folder for result.json and report.html.")],
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
    cache: Annotated[Path | None, typer.Option(help="Folder of preprocessed frames.")] = None,
    report: Annotated[bool, typer.Option(help="Write report.html.")] = True,
) -> None:
    """Measure recall@N of one or more models under an exact, named protocol.

    Prints recall@1, recall@5 and recall@1% with 95 % intervals (a bootstrap over 50 m blocks of
    places), and, for the first model against each other, the paired difference. Searches by L1.

    \b
    Example: adafusion evaluate data/world-7 results/w7 --model adafusion-s --model image-s
    Example: adafusion evaluate data/nclt results/nclt --model mine.safetensors --protocol union
    """
    from adafusion.datasets import open_dataset
    from adafusion.models import load_model

    opened = open_dataset(dataset)
    models = [load_model(name) for name in model or ["adafusion-s"]]
    splits = make_splits(opened, protocol, region, runs, radius_m)
    judged = judge(models, opened, splits, cache_folder(cache))
    print(table(judged))
    files = write_results(judged, opened, out, report=report)
    print("\n".join(str(file) for file in files))


@dataclass(frozen=True)
class Judged:
    """One model's descriptions of a dataset's frames, and what they were worth."""

    model: AdaFusion
    descriptions: Descriptions  # one row a frame of the dataset; NaN where no split asked
    evaluation: Evaluation

    @property
    def name(self) -> str:
        """The model's name, as tables print it."""
        return self.model.name


def make_splits(
    dataset: Dataset,
    protocol: str,
    region: str = "test",
    runs: str | None = None,
    radius_m: float | None = None,
) -> list[Split]:
    """Write a protocol out for a dataset; a dataset without regions is one region, whole."""
    from adafusion import evaluation
    from adafusion.datasets.splits import region_of

    regions = dataset.info.regions
    names = region_of(dataset.positions_m[:, :2], regions)
    if not regions:
        say(f"{dataset.root} names no regions: every frame counts as {region}")
        names[:] = region
    return evaluation.make_splits(
        protocol,
        dataset.frames,
        names,
        radius_m=radius_m,
        runs=None if runs is None else split_names(runs),
        region=region,
    )


def judge(
    models: Sequence[AdaFusion], dataset: Dataset, splits: list[Split], cache: Path
) -> list[Judged]:
    """Describe the frames that the splits speak of with every model, and evaluate."""
    import numpy as np

    from adafusion.evaluation import evaluate_splits
    from adafusion.models import describe, prepared_batches
    from adafusion.preprocess.cache import prepare_cache
    from adafusion.types import Descriptions, UserError

    rows = np.unique(np.concatenate([np.r_[s.query_rows, s.database_rows] for s in splits]))
    batch = 8
    judged = []
    for model in models:
        prepared = prepare_cache(dataset, model.config.preprocess, cache, progress=bar)
        for net, has, sensor in (
            (model.image_net, prepared.has_image, "an image"),
            (model.voxel_net, prepared.has_cloud, "a cloud"),
        ):
            if net is not None and not has[rows].all():
                lacking = prepared.frames[rows[int(np.argmin(has[rows]))]].key
                raise UserError(
                    f"{dataset.root}: frame {lacking} lacks {sensor}; {model.name} needs it"
                )
        batches = bar(
            prepared_batches(prepared, rows, batch),
            total=-(-len(rows) // batch),
            desc=f"describing by {model.name}",
        )
        found = describe(model, batches)

        def spread(part: np.ndarray | None) -> np.ndarray | None:
            if part is None:
                return None
            whole = np.full((len(dataset.frames), part.shape[1]), np.nan, dtype=np.float32)
            whole[rows] = part
            return whole

        descriptions = Descriptions(*(spread(part) for part in found))
        assert descriptions.fused is not None
        evaluation = evaluate_splits(descriptions.fused, dataset.positions_m, splits)
        judged.append(Judged(model, descriptions, evaluation))
    return judged


def table(judged: Sequence[Judged]) -> str:
    """Recall of each model with intervals, and how the first one differs from the others."""
    from adafusion.evaluation import compare

    first = judged[0]
    wide = max(len(j.name) for j in judged)
    lines = [f"{'model':{wide}}  recall@1              recall@5              recall@1%"]
    for j in judged:
        estimates = j.evaluation.estimates(seed=INTERVAL_SEED)
        cells = []
        for measure in ("AR@1", "AR@5", "AR@1%"):
            low, high = estimates[measure].interval
            cells.append(f"{estimates[measure].value:6.1%} [{low:6.1%}, {high:6.1%}]")
        lines.append(f"{j.name:{wide}}  " + "  ".join(cells))
    for j in judged[1:]:
        gain = compare(first.evaluation, j.evaluation, seed=INTERVAL_SEED)["AR@1"]
        low, high = gain.interval
        lines.append(
            f"{first.name} minus {j.name}: recall@1 {100 * gain.value:+.1f} points "
            f"[{100 * low:+.1f}, {100 * high:+.1f}]"
        )
    e = first.evaluation
    lines.append(
        f"{e.protocol}, radius {e.radius_m:g} m, L{e.p}: {e.num_queries} queries, "
        f"{e.num_unanswerable} of them without a true match left out; 95 % intervals over "
        f"{e.num_places} blocks of 50 m"
    )
    return "\n".join(lines)


def write_results(
    judged: Sequence[Judged], dataset: Dataset, out: Path, *, report: bool = True
) -> list[Path]:
    """Write result.json and report.html; give their paths."""
    from adafusion.config import to_plain
    from adafusion.evaluation import result_record
    from adafusion.files import write_json

    data = {
        "name": dataset.info.name,
        "version": dataset.info.version,
        "synthetic": dataset.info.synthetic,
        "fingerprint": dataset.fingerprint,
        "runs": list(dataset.runs),
    }
    records = [
        result_record(
            j.evaluation,
            model={
                "name": j.name,
                "fingerprint": j.model.fingerprint,
                "preprocess_fingerprint": j.model.preprocess_fingerprint,
                "config": to_plain(j.model.config),
                "alpha": _alpha_record(j, dataset),
            },
            data=data,
            seed=INTERVAL_SEED,
        )
        for j in judged
    ]
    write_json(out / "result.json", {"command": _command(), "results": records})
    if not report:
        return [out / "result.json"]
    from adafusion.cli.reporting import report_data
    from adafusion.report import write_report

    return [
        out / "result.json",
        write_report(out / "report.html", report_data(judged, dataset, _command())),
    ]


def _alpha_record(judged: Judged, dataset: Dataset) -> dict[str, object] | None:
    from dataclasses import asdict

    return {
        what: {label: asdict(summary) for label, summary in alpha_by(judged, dataset, what).items()}
        for what in ("run", "zone")
        if judged.descriptions.alpha is not None
    } or None


def alpha_by(judged: Judged, dataset: Dataset, what: str) -> dict[str, AlphaSummary]:
    """Summaries of alpha by "run" or "zone" over the frames that were described."""
    import numpy as np

    from adafusion.evaluation import summarize_alpha

    alpha = judged.descriptions.alpha
    if alpha is None:
        return {}
    rows = np.flatnonzero(np.isfinite(alpha[:, 0]))
    return summarize_alpha(alpha[rows], [getattr(dataset.frames[row], what) for row in rows])


def _command() -> str:
    return shlex.join(["adafusion", *sys.argv[1:]])
