# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""From evaluations to the plain values that a report shows."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from adafusion.cli.evaluation import EvaluateConfig, trained_on
from adafusion.config import dump_config
from adafusion.datasets import Dataset
from adafusion.evaluation import (
    Judged,
    SplitResult,
    alpha_by,
    answer_groups,
    compare,
    contribution_shares,
    describe_protocol,
)
from adafusion.provenance import git_commit, software_versions
from adafusion.report import (
    AlphaTrace,
    Candidate,
    MeanAlpha,
    PairDistances,
    ProtocolFacts,
    ReportData,
    Retrieval,
    RouteView,
    SeenPlace,
    SplitCount,
    SystemResult,
)
from adafusion.search import pairwise_distances

RETRIEVALS = 3  # hits, and as many misses, that a report shows
ROUTES = 2  # splits drawn as a map
HISTOGRAM_SEED = 0
HISTOGRAM_PAIRS = 20_000  # of wrong pairs, at most; there are millions
WRONG_M = 50.0  # pairs farther apart than this are wrong ones in the histogram


def report_data(
    judged: Sequence[Judged], dataset: Dataset, config: EvaluateConfig, command: str
) -> ReportData:
    """Fill a report from evaluations of one dataset; the first model is the one it speaks of."""
    first = judged[0]
    e = first.evaluation
    split = e.results[0].split
    facts = {
        "dataset fingerprint": dataset.fingerprint,
        "source": dataset.info.source,
        "interval seed": str(config.seed),
        "torch": software_versions()["torch"],
        "commit": git_commit(),
        "left out, a sensor is lacking": f"{first.num_lacking} frames" * bool(first.num_lacking),
    }
    return ReportData(
        title=f"Place recognition on {dataset.info.name}",
        created=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        dataset=f"{dataset.info.name} {dataset.info.version}",
        synthetic=dataset.info.synthetic,
        protocol=ProtocolFacts(
            name=e.protocol,
            words=describe_protocol(e.protocol, radius_m=e.radius_m, region=e.region),
            radius_m=e.radius_m,
            distance=f"L{e.p}",
            splits=tuple(
                SplitCount(
                    name=r.split.name,
                    queries=len(r.first_hit),
                    left_out=int((r.first_hit == 0).sum()),
                    database=len(r.split.database_rows),
                )
                for r in e.results
            ),
            exclude_self=split.exclude_self,
            exclude_query_run=split.exclude_query_run,
            intervals=f"bootstrap over {e.num_places} blocks of 50 m of ground, seed "
            f"{config.seed}; differences are paired",
        ),
        systems=tuple(
            _system(j, first, config.seed, trained_on(name, dataset))
            for j, name in zip(judged, config.models, strict=True)
        ),
        headline=first.name,
        facts={name: value for name, value in facts.items() if value},
        routes=tuple(_route(first, r, dataset) for r in e.results[:ROUTES]),
        mean_alpha=tuple(
            MeanAlpha(
                system=j.name,
                by_run=alpha_by(j, dataset, "run"),
                by_zone=alpha_by(j, dataset, "zone"),
            )
            for j in judged
            if j.descriptions.alpha is not None
        ),
        alpha=_traces(first, dataset),
        retrievals=_retrievals(first, dataset),
        distances=tuple(_distances(j, dataset) for j in judged),
        command=command,
        config=dump_config(config),
    )


def _system(judged: Judged, first: Judged, seed: int, is_at_home: bool) -> SystemResult:
    e = judged.evaluation
    estimates = e.estimates(seed=seed)
    parameters = sum(p.numel() for p in judged.model.parameters())
    return SystemResult(
        name=judged.name,
        recall={k: estimates[f"AR@{k}"] for k in e.ks},
        recall_at_1_percent=estimates["AR@1%"],
        gap=None if judged is first else compare(first.evaluation, e, seed=seed)["AR@1"],
        fingerprint=judged.model.fingerprint,
        note=f"{parameters / 1e6:.2f} M parameters"
        + (", trained on this dataset" if is_at_home else ""),
    )


def _route(judged: Judged, result: SplitResult, dataset: Dataset) -> RouteView:
    xy = dataset.positions_m[:, :2]
    return RouteView(
        system=judged.name,
        split=result.split.name,
        database_xy_m=xy[result.split.database_rows],
        query_xy_m=xy[result.split.query_rows],
        is_hit=result.first_hit == 1,
        is_answerable=result.first_hit > 0,
        top1_xy_m=xy[result.top_row],
    )


def _traces(judged: Judged, dataset: Dataset) -> tuple[AlphaTrace, ...]:
    """Alpha along each run, in the order of driving."""
    alpha = judged.descriptions.alpha
    if alpha is None:
        return ()
    traces = []
    for run in dataset.runs:
        rows = [
            i
            for i, frame in enumerate(dataset.frames)
            if frame.run == run and np.isfinite(alpha[i, 0])
        ]
        if not rows:
            continue
        rows.sort(key=lambda i: dataset.frames[i].timestamp_us)
        steps = np.linalg.norm(np.diff(dataset.positions_m[rows, :2], axis=0), axis=1)
        traces.append(
            AlphaTrace(
                system=judged.name,
                run=run,
                along_m=np.concatenate([[0.0], np.cumsum(steps)]),
                alpha=alpha[rows],
                zones=tuple(dataset.frames[i].zone for i in rows),
            )
        )
    return tuple(traces)


def _retrievals(judged: Judged, dataset: Dataset) -> tuple[Retrieval, ...]:
    """A few hits and a few misses, spread evenly over the queries so that nobody picked them."""
    shown = []
    for wanted in (True, False):
        found = [
            (result, i)
            for result in judged.evaluation.results
            for i in np.flatnonzero(result.first_hit > 0).tolist()
            if (result.first_hit[i] == 1) == wanted
        ]
        spread = np.unique(np.linspace(0, len(found) - 1, RETRIEVALS).round().astype(int))
        shown += [_retrieval(judged, dataset, *found[i]) for i in spread if found]
    return tuple(shown)


def _retrieval(judged: Judged, dataset: Dataset, result: SplitResult, i: int) -> Retrieval:
    query = int(result.split.query_rows[i])
    top, true, rank = int(result.top_row[i]), int(result.hit_row[i]), int(result.first_hit[i])
    return Retrieval(
        system=judged.name,
        query=_seen(judged, dataset, query),
        top1=_candidate(judged, dataset, query, top, rank=1),
        true=_candidate(judged, dataset, query, true, rank=rank),
        is_hit=rank == 1,
    )


def _seen(judged: Judged, dataset: Dataset, row: int) -> SeenPlace:
    frame = dataset.frames[row]
    seen = dataset.load(frame)
    alpha = judged.descriptions.alpha
    return SeenPlace(
        key=frame.key,
        image=seen.image,
        points_body=seen.points_body,
        alpha=None if alpha is None else (float(alpha[row, 0]), float(alpha[row, 1])),
    )


def _candidate(judged: Judged, dataset: Dataset, query: int, row: int, rank: int) -> Candidate:
    fused, p = _fused(judged), judged.evaluation.p
    both = judged.descriptions.image_half is not None and judged.descriptions.lidar_half is not None
    # an L1 distance is the sum of what each sensor adds; no other is
    share = contribution_shares(fused[[query]], fused[[row]])[0, 0] if both and p == 1 else np.nan
    away = np.linalg.norm(dataset.positions_m[query, :2] - dataset.positions_m[row, :2])
    return Candidate(
        place=_seen(judged, dataset, row),
        rank=rank,
        distance=float(pairwise_distances(fused[[query]], fused[[row]], p=p)[0, 0]),
        away_m=float(away),
        image_share=None if np.isnan(share) else float(share),
    )


def _distances(judged: Judged, dataset: Dataset) -> PairDistances:
    """Descriptor distances of true and of wrong pairs of a query and a frame that may answer it."""
    e = judged.evaluation
    fused, xy = _fused(judged), dataset.positions_m[:, :2]
    rng = np.random.default_rng(HISTOGRAM_SEED)
    true, wrong = [], []
    for result in e.results:
        q, n = result.split.query_rows, result.split.database_rows
        asking, answering = answer_groups(result.split, q)
        may_answer = asking[:, None] != answering
        apart = cdist(xy[q], xy[n])
        distance = pairwise_distances(fused[q], fused[n], p=e.p)
        true.append(distance[(apart <= e.radius_m) & may_answer])
        far = distance[(apart > WRONG_M) & may_answer]
        some = min(len(far), -(-HISTOGRAM_PAIRS // len(e.results)))
        wrong.append(rng.choice(far, size=some, replace=False))
    return PairDistances(system=judged.name, true=np.concatenate(true), wrong=np.concatenate(wrong))


def _fused(judged: Judged) -> Float[np.ndarray, "n d"]:
    assert judged.descriptions.fused is not None
    return judged.descriptions.fused
