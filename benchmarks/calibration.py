# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Is the synthetic world as hard as real ones are, for each sensor alone?

    python benchmarks/calibration.py world-v1-small/test [--image image-s] [--lidar lidar-s] \
        [--output docs/results/calibration.md]

Single branches only, trained and untrained: the world may not be chosen by what fusion gains on it.
Recall@1 under cross-run, over pairs of runs by condition and over queries by zone. Chance is what
an answer drawn at random from the database finds; in a zone also what one finds that knows the
zone and nothing else.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Shaped

from adafusion.cli.common import bar, cache_folder, open_data
from adafusion.datasets import Dataset
from adafusion.evaluation import Judged, dataset_splits, evaluate_splits, judge
from adafusion.files import write_text
from adafusion.models import load_model
from adafusion.provenance import git_commit
from adafusion.sim.town.plan import INDOORS
from adafusion.training import untrained_twin
from adafusion.types import Split

DARK = ("night",)  # presets that are no normal run
INTERVAL_SEED = 0


def preset_of(run: str) -> str:
    """The preset that a run is named after."""
    return run.split("-")[0]


def asked_in(splits: Sequence[Split], is_asked: Bool[np.ndarray, " frames"]) -> list[Split]:
    """The splits with those of their queries that lie at the frames chosen."""
    less = [replace(s, query_rows=s.query_rows[is_asked[s.query_rows]]) for s in splits]
    return [split for split in less if len(split.query_rows)]


def condition_rows(
    splits: Sequence[Split], zones: Shaped[np.ndarray, " frames"]
) -> dict[str, list[Split]]:
    """Pairs of runs by what they have in common."""
    outdoors = ~np.isin(zones, INDOORS)  # indoors is lit day and night

    def chosen(keep: Callable[[str, str], bool]) -> list[Split]:
        return [split for split in splits if keep(*split.name.split("->"))]

    def normal(a: str, b: str) -> bool:
        return preset_of(a) not in DARK and preset_of(b) not in DARK

    def same_way(a: str, b: str) -> bool:
        return ("reverse" in a) == ("reverse" in b)

    rows = {
        "normal runs": chosen(normal),
        "normal, same direction": chosen(lambda a, b: normal(a, b) and same_way(a, b)),
        "normal, opposite direction": chosen(lambda a, b: normal(a, b) and not same_way(a, b)),
        "normal, outdoors": asked_in(chosen(normal), outdoors),
        "with night": chosen(lambda a, b: not normal(a, b)),
        "with night, outdoors": asked_in(chosen(lambda a, b: not normal(a, b)), outdoors),
        "with night, same direction": chosen(lambda a, b: not normal(a, b) and same_way(a, b)),
    }
    presets = {preset_of(run) for split in splits for run in split.name.split("->")}
    for preset in sorted(presets - set(DARK)):
        rows[f"normal, with {preset}"] = chosen(
            lambda a, b, p=preset: normal(a, b) and p in (preset_of(a), preset_of(b))
        )
    return {name: row for name, row in rows.items() if row}


def zone_rows(
    splits: Sequence[Split], zones: Shaped[np.ndarray, " frames"]
) -> dict[str, list[Split]]:
    """Queries of one kind of zone, asked of the whole database."""
    rows = {f"in {zone}": asked_in(splits, zones == zone) for zone in sorted(set(zones))}
    return {name: row for name, row in rows.items() if row}


def chance(
    splits: Sequence[Split], dataset: Dataset, zones: Shaped[np.ndarray, " frames"] | None
) -> float:
    """Mean share of true matches in the database; with `zones` in the query's zone of it."""
    shares = []
    xy = dataset.positions_m[:, :2]
    for split in splits:
        gap = np.hypot(*(xy[split.query_rows, None] - xy[None, split.database_rows]).T).T
        near = gap <= split.radius_m
        pool = np.ones_like(near)
        if zones is not None:
            pool = zones[split.query_rows, None] == zones[None, split.database_rows]
        share = (near & pool).sum(axis=1) / np.maximum(pool.sum(axis=1), 1)
        shares.append(share[near.any(axis=1)].mean())
    return float(np.mean(shares))


def cell(judged: Judged, dataset: Dataset, splits: Sequence[Split]) -> str:
    """Recall@1 of one model over some splits."""
    assert judged.descriptions.fused is not None
    evaluation = evaluate_splits(judged.descriptions.fused, dataset.positions_m, splits, ks=[1])
    return evaluation.estimates(seed=INTERVAL_SEED)["AR@1"].in_percent()


def main() -> None:
    """Judge and print one Markdown page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--image", help="trained image branch", default="image-s")
    parser.add_argument("--lidar", help="trained LiDAR branch", default="lidar-s")
    parser.add_argument("--cache", type=Path, help="folder of preprocessed frames")
    parser.add_argument("--output", type=Path, help="Markdown file to write as well")
    arguments = parser.parse_args()
    cache = cache_folder(arguments.cache)
    dataset = open_data(arguments.dataset, cache)
    trained = [load_model(arguments.image), load_model(arguments.lidar)]
    models = [twin for model in trained for twin in (model, untrained_twin(model))]
    splits = dataset_splits(dataset, "cross-run")
    judged = judge(models, dataset, splits, cache, progress=bar)
    zones = np.array([frame.zone for frame in dataset.frames])
    by_condition = condition_rows(splits, zones)
    lines = [
        f"# The synthetic world, one sensor at a time, {datetime.now(UTC):%Y-%m-%d}",
        "",
        f"`python benchmarks/calibration.py {arguments.dataset} --image {arguments.image} --lidar "
        f"{arguments.lidar}`, commit {git_commit()}.",
        "",
        f"SYNTHETIC data: {dataset.info.source}, version {dataset.info.version}, geometry "
        f"{dataset.info.sensors['geometry']}, fingerprint {dataset.fingerprint}. Protocol "
        "cross-run, 20 m, L1; recall@1 in percent with 95 % intervals from a bootstrap over 50 m "
        f"blocks of places (seed {INTERVAL_SEED}).",
        "",
        "| pairs of runs | queries | " + " | ".join(j.name for j in judged) + " | chance |",
        "|---|---:|" + "---|" * len(judged) + "---:|",
    ]
    for name, row in by_condition.items():
        cells = " | ".join(cell(j, dataset, row) for j in judged)
        count = sum(len(split.query_rows) for split in row)
        lines.append(f"| {name} | {count} | {cells} | {chance(row, dataset, None):.1%} |")
    lines += [
        "",
        "Queries by zone, over normal pairs of the same direction:",
        "",
        "| zone | queries | "
        + " | ".join(j.name for j in judged)
        + " | chance | chance, zone known |",
        "|---|---:|" + "---|" * len(judged) + "---:|---:|",
    ]
    for name, row in zone_rows(by_condition.get("normal, same direction", []), zones).items():
        cells = " | ".join(cell(j, dataset, row) for j in judged)
        count = sum(len(split.query_rows) for split in row)
        lines.append(
            f"| {name} | {count} | {cells} | {chance(row, dataset, None):.1%} "
            f"| {chance(row, dataset, zones):.1%} |"
        )
    lines += ["", "Models:", ""]
    lines += [f"- {j.name}: fingerprint {j.model.fingerprint}" for j in judged]
    text = "\n".join(lines) + "\n"
    print(text)
    if arguments.output:
        write_text(arguments.output, text)


if __name__ == "__main__":
    main()
