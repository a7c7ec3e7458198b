# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Models compared on a dataset: described once each, evaluated on the same splits."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from adafusion.datasets import Dataset
from adafusion.datasets.splits import region_of
from adafusion.evaluation.evaluate import Evaluation, evaluate_splits
from adafusion.evaluation.protocols import make_splits
from adafusion.evaluation.weights import summarize_alpha
from adafusion.models import PlaceModel, describe, prepared_batches
from adafusion.preprocess.cache import prepare_cache
from adafusion.types import (
    AlphaSummary,
    Descriptions,
    Frame,
    Progress,
    Split,
    UserError,
    lacking,
    silent,
)

logger = logging.getLogger(__name__)

BATCH = 8


@dataclass(frozen=True)
class Judged:
    """One model's descriptions of a dataset's frames, and what they were worth."""

    model: PlaceModel
    descriptions: Descriptions  # one row a frame of the dataset; NaN where no split asked
    evaluation: Evaluation
    num_lacking: int  # frames of the splits left out, for they lack a sensor some model needs

    @property
    def name(self) -> str:
        """The model's name, as tables print it."""
        return self.model.name


def dataset_splits(
    dataset: Dataset,
    protocol: str,
    *,
    region: str = "test",
    runs: Sequence[str] | None = None,
    radius_m: float | None = None,
) -> list[Split]:
    """Write a protocol out for a dataset (see `make_splits`).

    A dataset without regions is one region, whole; that is logged.
    """
    names = region_of(dataset.positions_m[:, :2], dataset.info.regions)
    if not dataset.info.regions:
        logger.warning("%s names no regions: every frame counts as %s", dataset.root, region)
        names = np.full(len(dataset.frames), region)
    return make_splits(protocol, dataset.frames, names, radius_m=radius_m, runs=runs, region=region)


def judge(
    models: Sequence[PlaceModel],
    dataset: Dataset,
    splits: Sequence[Split],
    cache_dir: str | Path,
    *,
    p: int | None = None,
    progress: Progress = silent,
) -> list[Judged]:
    """Describe the frames that the splits speak of with every model, and evaluate by Lp.

    `p` None is each model's own: 1 or 2, whichever its system is trained by.

    All models answer the same queries from the same database: a frame that lacks a sensor which
    one of them needs is left out for all and counted. Preprocessed frames are kept in `cache_dir`.

    Raises UserError where two models share a name or no frame has the sensors.
    """
    names = [model.name for model in models]
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise UserError(
            f"two models are called {', '.join(repeated)} and tables could not tell them apart: "
            "give one of the files another name"
        )
    asked = _rows(splits)
    wanted = {sensor for model in models for sensor in model.sensors}
    lacks = np.array([bool(lacking(f, wanted)) for f in dataset.frames])
    splits = [split for full in splits if (split := _without(full, lacks, dataset.frames))]
    if not splits:
        raise UserError(
            f"{dataset.root}: no two runs have frames with all sensors that {', '.join(names)} "
            "need: compare models of the sensors that are there"
        )
    rows = _rows(splits)
    judged = []
    for model in models:
        prepared = prepare_cache(dataset, model.config.preprocess, cache_dir, progress=progress)
        batches = progress(
            prepared_batches(prepared, rows, BATCH),
            total=-(-len(rows) // BATCH),
            desc=f"describing by {model.name}",
        )
        described = describe(model, batches)
        descriptions = Descriptions(*(_spread(part, rows, len(lacks)) for part in described))
        assert descriptions.fused is not None  # every frame has the sensors
        evaluation = evaluate_splits(
            descriptions.fused,
            dataset.positions_m,
            splits,
            p=model.config.p if p is None else p,
        )
        judged.append(Judged(model, descriptions, evaluation, int(lacks[asked].sum())))
    return judged


def alpha_by(
    judged: Judged, dataset: Dataset, what: Literal["run", "zone"]
) -> dict[str, AlphaSummary]:
    """Summarise alpha of each run or zone over the frames that were described.

    Empty for a system without weights.
    """
    alpha = judged.descriptions.alpha
    if alpha is None:
        return {}
    rows = np.flatnonzero(np.isfinite(alpha[:, 0]))
    return summarize_alpha(alpha[rows], [getattr(dataset.frames[row], what) for row in rows])


def _rows(splits: Sequence[Split]) -> Int[np.ndarray, " rows"]:
    """Every frame that one of the splits speaks of, once, rising."""
    return np.unique(np.concatenate([np.r_[s.query_rows, s.database_rows] for s in splits]))


def _without(
    split: Split, left_out: Bool[np.ndarray, " n"], frames: Sequence[Frame]
) -> Split | None:
    """The split without some frames; None where that leaves none of a run it compares."""
    less = replace(
        split,
        query_rows=split.query_rows[~left_out[split.query_rows]],
        database_rows=split.database_rows[~left_out[split.database_rows]],
    )
    before, after = ({frames[row].run for row in _rows([s])} for s in (split, less))
    return less if before == after else None


def _spread(
    part: Float[np.ndarray, "rows d"] | None, rows: Int[np.ndarray, " rows"], num_frames: int
) -> Float32[np.ndarray, "n d"] | None:
    """Put the rows that were described to their frames, NaN to the others."""
    if part is None:
        return None
    whole = np.full((num_frames, part.shape[1]), np.nan, dtype=np.float32)
    whole[rows] = part
    return whole
