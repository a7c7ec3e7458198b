# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""An evaluation as a JSON value that holds everything needed to repeat it."""

from __future__ import annotations

from dataclasses import asdict

from adafusion.evaluation.evaluate import BLOCK_M, Evaluation, SplitResult
from adafusion.evaluation.metrics import recall_at
from adafusion.evaluation.protocols import describe_protocol
from adafusion.provenance import git_commit, software_versions

SCHEMA = 1


def result_record(
    evaluation: Evaluation,
    *,
    model: dict[str, object],
    data: dict[str, object],
    seed: int,
    num_draws: int = 1000,
) -> dict[str, object]:
    """Build the record for `files.write_json`.

    `model` and `data` say what was evaluated: names, fingerprints of weights, preprocessing and
    dataset, chosen runs; anything that is JSON. `seed` draws the places of the intervals. Recalls
    are fractions.
    """
    e = evaluation
    split = e.results[0].split
    return {
        "schema": SCHEMA,
        "protocol": {
            "name": e.protocol,
            "words": describe_protocol(e.protocol, radius_m=e.radius_m, region=e.region),
            "region": e.region,
            "radius_m": e.radius_m,
            "descriptor_distance": f"L{e.p}",
            "exclude_self": split.exclude_self,
            "exclude_query_run": split.exclude_query_run,
        },
        "counts": {
            "splits": len(e.results),
            "splits_without_answerable_query": int((e.answerable.sum(axis=1) == 0).sum()),
            "queries": e.num_queries,
            "unanswerable": e.num_unanswerable,
            "places": e.num_places,
        },
        "recall": {
            name: asdict(value)
            for name, value in e.estimates(seed=seed, num_draws=num_draws).items()
        },
        "pooled_recall": e.pooled_recall,
        "intervals": {
            "confidence": 0.95,
            "method": f"percentiles of a bootstrap over {BLOCK_M:g} m blocks of places",
            "draws": num_draws,
            "seed": seed,
        },
        "splits": [_split_record(result) for result in e.results],
        "model": model,
        "data": data,
        "software": software_versions(),
        "commit": git_commit(),
    }


def _split_record(result: SplitResult) -> dict[str, object]:
    answerable = int((result.first_hit > 0).sum())
    at_1, at_1_percent = (
        recall_at(result.first_hit, (1, result.one_percent)).tolist()
        if answerable
        else (None, None)
    )
    return {
        "name": result.split.name,
        "queries": len(result.first_hit),
        "unanswerable": len(result.first_hit) - answerable,
        "database": len(result.split.database_rows),
        "one_percent": result.one_percent,
        "recall@1": at_1,
        "recall@1%": at_1_percent,
    }
