# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Do the shipped models beat their untrained twins on a world that nobody trained on?

    adafusion simulate data/world-301 --seed 301 --runs day,day-2,dusk,night,fog
    python benchmarks/shipped_models.py data/world-301 [--output docs/results/shipped-models.md]

A twin has the shipped model's sizes and fresh weights. All are judged under cross-run in the test
region, over all pairs of runs and over those pairs alone in which one run is by night or in fog.
"""

from __future__ import annotations

import argparse
from datetime import UTC, datetime
from pathlib import Path

from adafusion.cli.common import bar, cache_folder
from adafusion.datasets import open_dataset
from adafusion.evaluation import dataset_splits, evaluate_splits, judge
from adafusion.models import SHIPPED, AdaFusion, load_model
from adafusion.provenance import git_commit
from adafusion.training import untrained_twin

INTERVAL_SEED = 0


def main() -> None:
    """Evaluate and print one Markdown page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--cache", type=Path, help="folder of preprocessed frames")
    parser.add_argument("--output", type=Path, help="Markdown file to write as well")
    arguments = parser.parse_args()
    dataset = open_dataset(arguments.dataset)
    models = [model for name in SHIPPED for model in _both(load_model(name))]
    splits = dataset_splits(dataset, "cross-run")
    kinds = {
        "all pairs": splits,
        "with night": [split for split in splits if "night" in split.name],
        "with fog": [split for split in splits if "fog" in split.name],
        "neither": [s for s in splits if "night" not in s.name and "fog" not in s.name],
    }
    lines = [
        f"# Shipped models on a world nobody trained on, {datetime.now(UTC):%Y-%m-%d}",
        "",
        f"`python benchmarks/shipped_models.py data/{arguments.dataset.name}`, commit "
        f"{git_commit()}.",
        "",
        f"SYNTHETIC data: {dataset.info.source}, version {dataset.info.version}, fingerprint "
        f"{dataset.fingerprint}. Protocol cross-run, test region, 20 m, L1; recall@1 in percent "
        f"with 95 % intervals from a bootstrap over 50 m blocks of places (seed {INTERVAL_SEED}).",
        "",
        f"| model | fingerprint | {' | '.join(kinds)} |",
        "|---|---|" + "---|" * len(kinds),
    ]
    for judged in judge(models, dataset, splits, cache_folder(arguments.cache), progress=bar):
        assert judged.descriptions.fused is not None
        cells = []
        for chosen in kinds.values():
            if not chosen:
                cells.append("-")
                continue
            evaluation = evaluate_splits(judged.descriptions.fused, dataset.positions_m, chosen)
            cells.append(evaluation.estimates(seed=INTERVAL_SEED)["AR@1"].in_percent())
        lines.append(f"| {judged.name} | {judged.model.fingerprint} | {' | '.join(cells)} |")
    first = kinds["all pairs"]
    lines += ["", f"{sum(len(split.query_rows) for split in first)} queries in {len(first)} pairs."]
    text = "\n".join(lines) + "\n"
    print(text)
    if arguments.output:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        arguments.output.write_text(text, encoding="utf-8")


def _both(model: AdaFusion) -> list[AdaFusion]:
    return [model, untrained_twin(model)]


if __name__ == "__main__":
    main()
