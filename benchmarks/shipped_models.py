# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Do the shipped models beat their untrained twins on a world that nobody trained on?

    python benchmarks/shipped_models.py [--output docs/results/shipped-models.md]

A twin has the shipped sizes and fresh weights. All are judged on `world-v1-small/test` under
cross-run: over all pairs of runs, over those alone in which one run is by night or in which the two
drive in opposite directions, and over what is left.
"""

from __future__ import annotations

import argparse
from datetime import UTC, datetime
from pathlib import Path

from adafusion.cli.common import bar, cache_folder, open_data
from adafusion.evaluation import dataset_splits, evaluate_splits, judge
from adafusion.files import write_text
from adafusion.models import SHIPPED, AdaFusion, load_model
from adafusion.provenance import git_commit
from adafusion.training import untrained_twin

INTERVAL_SEED = 0


def main() -> None:
    """Evaluate and print one Markdown page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path, nargs="?", default=Path("world-v1-small/test"))
    parser.add_argument("--cache", type=Path, help="folder of preprocessed frames")
    parser.add_argument("--output", type=Path, help="Markdown file to write as well")
    arguments = parser.parse_args()
    cache = cache_folder(arguments.cache)
    dataset = open_data(arguments.dataset, cache)
    models = [model for name in SHIPPED for model in _both(load_model(name))]
    splits = dataset_splits(dataset, "cross-run")
    kinds = {
        "all pairs": splits,
        "with night": [split for split in splits if "night" in split.name],
        "opposite directions": [s for s in splits if s.name.count("reverse") == 1],
        "neither": [s for s in splits if "night" not in s.name and s.name.count("reverse") != 1],
    }
    lines = [
        f"# Shipped models on a world nobody trained on, {datetime.now(UTC):%Y-%m-%d}",
        "",
        f"`python benchmarks/shipped_models.py {arguments.dataset}`, commit {git_commit()}.",
        "",
        f"SYNTHETIC data: {dataset.info.source}, version {dataset.info.version}, fingerprint "
        f"{dataset.fingerprint}. Protocol cross-run, test region, 20 m, L1; recall@1 in percent "
        f"with 95 % intervals from a bootstrap over 50 m blocks of places (seed {INTERVAL_SEED}).",
        "",
        f"| model | fingerprint | {' | '.join(kinds)} |",
        "|---|---|" + "---|" * len(kinds),
    ]
    for judged in judge(models, dataset, splits, cache, progress=bar):
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
        write_text(arguments.output, text)


def _both(model: AdaFusion) -> list[AdaFusion]:
    return [model, untrained_twin(model)]


if __name__ == "__main__":
    main()
