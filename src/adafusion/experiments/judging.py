# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What each trained row answers on the test worlds, kept by content.

<out>/evaluations/<model>-<data>-<protocol>-<version>.json   a result record with every answer
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64, Shaped

from adafusion.config import to_plain
from adafusion.datasets import Dataset
from adafusion.evaluation import (
    Evaluation,
    dataset_splits,
    evaluate_splits,
    result_record,
    summarize_alpha,
)
from adafusion.evaluation.evaluate import BLOCK_M
from adafusion.evaluation.metrics import place_blocks
from adafusion.experiments.describing import describe_frames, load_trained
from adafusion.experiments.verdict import Asked
from adafusion.files import write_json
from adafusion.models import PlaceModel
from adafusion.types import SENSORS, Descriptions, Progress, Split, UserError, lacking, silent

EVALUATION_VERSION = 2  # raise it when equal models and data come to give another record
INTERVAL_SEED = 0
KS = range(1, 26)  # numbers of candidates looked at

# what tells pairs of runs apart, by words in the runs' names
CONDITIONS = ("night", "dusk", "rain", "snow", "fog")
OPPOSITE, PLAIN = "opposite directions", "none of these"


@dataclass(frozen=True)
class ExamData:
    """A test dataset without the frames that lack a sensor: all rows answer the same queries."""

    dataset: Dataset
    num_left_out: int

    @classmethod
    def of(cls, dataset: Dataset) -> ExamData:
        """Leave out what is not complete; UserError where that is all."""
        whole = tuple(frame for frame in dataset.frames if not lacking(frame, SENSORS))
        if not whole:
            raise UserError(f"{dataset.root}: no frame has both an image and a cloud")
        left_out = len(dataset.frames) - len(whole)
        return cls(replace(dataset, frames=whole) if left_out else dataset, left_out)

    def splits(self, protocol: str) -> list[Split]:
        """The protocol, written out."""
        return dataset_splits(self.dataset, protocol)


@dataclass(frozen=True, eq=False)
class Questions:
    """All queries of a protocol over the test worlds, in the order in which answers are kept."""

    asked: Asked
    xy_m: Float64[np.ndarray, "q 2"]  # in their worlds
    zone: Shaped[np.ndarray, " q"]  # "" where the source names none
    kinds: tuple[frozenset[str], ...]  # of each split

    def conditions(self) -> Int64[np.ndarray, " q"]:
        """A number for each query: equal where the zone and the kinds of the run pair are."""
        of_split = [" ".join(sorted(kinds)) for kinds in self.kinds]
        named = np.stack([self.zone, np.array(of_split)[self.asked.split]], axis=1)
        return np.unique(named, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)

    def groups(self) -> dict[str, Shaped[np.ndarray, " q"]]:
        """Masks of the queries by kind of run pair and by zone, beside all of them."""
        groups = {"all pairs": np.ones(len(self.zone), np.bool_)}
        for kind in (*(f"with {word}" for word in CONDITIONS), OPPOSITE, PLAIN):
            chosen = np.array([kind in kinds for kinds in self.kinds], np.bool_)
            groups[kind] = chosen[self.asked.split]
        for zone in sorted(set(self.zone.tolist()) - {""}):
            groups[f"zone {zone}"] = self.zone == zone
        told_apart = {name: m for name, m in groups.items() if m.any() and not m.all()}
        return {"all pairs": groups["all pairs"], **told_apart}


NO_QUESTIONS = Questions(
    Asked(*np.zeros((3, 0), np.int64)), np.zeros((0, 2)), np.zeros(0, np.str_), ()
)


@dataclass(frozen=True, eq=False)
class Answers:
    """Of each query the rank of its best true match, 0 where none may answer; and N of 1 %."""

    first_hit: Int64[np.ndarray, " q"]
    one_percent: Int64[np.ndarray, " q"]

    def hits(self, n: int | None) -> Int64[np.ndarray, " q"]:
        """1 where a true match is among the first n; None: among the first 1 %."""
        limit = self.one_percent if n is None else n
        return ((self.first_hit > 0) & (self.first_hit <= limit)).astype(np.int64)


def ask(worlds: Sequence[ExamData], protocol: str) -> Questions:
    """Number splits, blocks and worlds of all queries."""
    split, rows, zone = [], [], []
    kinds: list[frozenset[str]] = []
    for test in worlds:
        splits = test.splits(protocol)
        rows.append(np.concatenate([one.query_rows for one in splits]).astype(np.int64))
        lengths = [len(one.query_rows) for one in splits]
        split.append(np.repeat(len(kinds) + np.arange(len(splits)), lengths))
        zone += [test.dataset.frames[row].zone or "" for row in rows[-1]]
        kinds += [pair_kinds(one.name) for one in splits]
    block, world = blocks_and_worlds(worlds, rows)
    xy_m = np.concatenate(
        [test.dataset.positions_m[here, :2] for test, here in zip(worlds, rows, strict=True)]
    )
    asked = Asked(np.concatenate(split), block, world)
    return Questions(asked, xy_m, np.array(zone), tuple(kinds))


def blocks_and_worlds(
    worlds: Sequence[ExamData], rows: Sequence[Int64[np.ndarray, " n"]]
) -> tuple[Int64[np.ndarray, " q"], Int64[np.ndarray, " q"]]:
    """Numbers of the 50 m block and of the world of some rows of each world, joined."""
    blocks = []
    count = 0
    for test, here in zip(worlds, rows, strict=True):
        blocks.append(count + place_blocks(test.dataset.positions_m[here, :2], BLOCK_M))
        count = int(blocks[-1].max()) + 1
    world = np.repeat(np.arange(len(rows)), [len(here) for here in rows])
    return np.concatenate(blocks).astype(np.int64), world


def pair_kinds(split_name: str) -> frozenset[str]:
    """What tells a pair of runs apart, by the runs' names: "day->night-reverse"."""
    runs = re.split(r"->|\+", split_name)
    begun = [rf"(?<![a-z]){word}" for word in CONDITIONS]  # a word's own begin: no rain in train
    kinds = {
        f"with {word}"
        for word, begin in zip(CONDITIONS, begun, strict=True)
        if any(re.search(begin, run) for run in runs)
    }
    if len({"reverse" in run for run in runs}) > 1:
        kinds.add(OPPOSITE)
    return frozenset(kinds or {PLAIN})


def evaluate_model(
    name: str,
    file: Path,
    worlds: Sequence[ExamData],
    protocols: Sequence[str],
    cache: Path,
    out: Path,
    progress: Progress = silent,
    *,
    frozen: bool = False,
) -> dict[str, list[dict[str, Any]]]:
    """Result records of a model file: see `evaluate_loaded`."""
    model = load_trained(name, file)
    return evaluate_loaded(model, worlds, protocols, cache, out, progress, frozen=frozen)


def evaluate_loaded(
    model: PlaceModel,
    worlds: Sequence[ExamData],
    protocols: Sequence[str],
    cache: Path,
    out: Path,
    progress: Progress = silent,
    *,
    frozen: bool = False,
) -> dict[str, list[dict[str, Any]]]:
    """Result records of a model by protocol, one a world; described once, and only if need be.

    Of a model that shares its branches with others (`frozen`), what those give is computed once.
    """
    records: dict[str, list[dict[str, Any]]] = {protocol: [] for protocol in protocols}
    for test in worlds:
        described: Descriptions | None = None
        for protocol in protocols:
            stem = (model.fingerprint, test.dataset.fingerprint, protocol, EVALUATION_VERSION)
            path = out / "evaluations" / f"{'-'.join(map(str, stem))}.json"
            if not path.exists():
                if described is None:
                    described = describe_frames(
                        model, test.dataset, cache, out, progress, frozen=frozen
                    )
                write_json(path, _record(model, test, described, protocol))
            records[protocol].append(json.loads(path.read_text(encoding="utf-8")))
    return records


def answers(records: Sequence[Mapping[str, Any]]) -> Answers:
    """The answers that the records of one model hold, world after world."""
    first_hit, one_percent = [], []
    for record in records:
        for split, said in zip(record["splits"], record["first_hits"], strict=True):
            ranks = np.array(said.split(), np.int64)
            first_hit.append(ranks)
            one_percent.append(np.full(len(ranks), split["one_percent"], np.int64))
    return Answers(np.concatenate(first_hit), np.concatenate(one_percent))


def answerable_of(
    seeds: Sequence[Answers], questions: Questions
) -> tuple[Asked, Bool[np.ndarray, " q"]]:
    """The queries that have a true match, and their mask: the same for every model."""
    answerable = seeds[0].first_hit > 0
    return questions.asked.where(answerable), answerable


def pooled_alpha(records: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]] | None:
    """Weights over the frames of all worlds, by zone and of "all"; None for a model without."""
    summaries = [record["model"]["alpha"] for record in records]
    if len(summaries) == 1 or summaries[0] is None:
        return summaries[0]
    pooled = {}
    for name in dict.fromkeys(name for summary in summaries for name in summary):
        parts = [summary[name] for summary in summaries if name in summary]
        count = np.array([part["num_frames"] for part in parts])
        mean, std = (np.array([part[key] for part in parts]) for key in ("mean", "std"))
        middle = np.average(mean, axis=0, weights=count)
        spread = np.sqrt(np.average(std**2 + (mean - middle) ** 2, axis=0, weights=count))
        pooled[name] = {
            "num_frames": int(count.sum()),
            "mean": middle.tolist(),
            "std": spread.tolist(),
        }
    return pooled


def _record(
    model: PlaceModel, test: ExamData, described: Descriptions, protocol: str
) -> dict[str, object]:
    dataset = test.dataset
    assert described.fused is not None  # every frame has the sensors
    evaluation: Evaluation = evaluate_splits(
        described.fused, dataset.positions_m, test.splits(protocol), p=model.config.p
    )
    alpha = None
    if described.alpha is not None:
        zones = [frame.zone for frame in dataset.frames]
        by_zone = summarize_alpha(described.alpha) | summarize_alpha(described.alpha, zones)
        alpha = {name: asdict(summary) for name, summary in by_zone.items()}
    record = result_record(
        evaluation,
        model={
            "name": model.name,
            "fingerprint": model.fingerprint,
            "preprocess_fingerprint": model.preprocess_fingerprint,
            "config": to_plain(model.config),
            "parameters": sum(p.numel() for p in model.parameters()),
            "length": described.fused.shape[1],
            "alpha": alpha,
        },
        data={
            "name": dataset.info.name,
            "version": dataset.info.version,
            "synthetic": dataset.info.synthetic,
            "fingerprint": dataset.fingerprint,
            "runs": list(dataset.runs),
            "frames": len(dataset.frames),
            "left_out_for_lack_of_a_sensor": test.num_left_out,
        },
        seed=INTERVAL_SEED,
    )
    ranks = [" ".join(map(str, result.first_hit.tolist())) for result in evaluation.results]
    return {**record, "first_hits": ranks}  # of each split's queries, in their order
