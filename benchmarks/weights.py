# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Do the weights move as the paper says, when one cause alone is changed?

    python benchmarks/weights.py data/sweeps --model runs/a/model.safetensors \
        --model runs/b/model.safetensors --world 5101 --world 5102 --world 5103 \
        [--output docs/results/weights.md]

Every place is seen again and again from the same pose, with the same cars and clouds; only one
factor differs: darkness, fog that only the camera or only the laser feels, the parked cars (a
nuisance), a blanked sensor, and, along the way, the entry into a corridor. The first model sees all
worlds, the others the first one. What was expected is in docs/adr/0007-weight-experiment.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64

from adafusion.cli.common import bar, cache_folder
from adafusion.datasets import Dataset, open_dataset
from adafusion.evaluation.metrics import draw_blocks, percentile_interval, place_blocks
from adafusion.files import write_text
from adafusion.models import AdaFusion, describe, load_model, prepared_batches
from adafusion.preprocess.cache import PreparedFrames, prepare_cache
from adafusion.provenance import git_commit
from adafusion.search import pairwise_distances
from adafusion.sim.run.conditions import PRESETS, Conditions, between, with_seeds
from adafusion.sim.simulate import describe_world, simulate
from adafusion.sim.studio import Studio, make_job
from adafusion.sim.town.plan import INDOORS
from adafusion.types import Descriptions, Estimate, UserError

PLACES = 120  # of each run
RADIUS_M = 20.0
SEED = 0  # of the bootstrap
READINGS = ("trust in the image", "image's share of the distance", "the same, equal weights")
NEAR_DOOR = 5  # frames before the entry into a corridor, and as many after its exit
LEAST_INSIDE = 5  # frames of a corridor that count as a passage through it
LIGHT = (
    "sun_elevation_rad", "sun_rgb", "zenith_rgb", "horizon_rgb", "cloud_rgb", "street_lamps",
    "headlights", "lit_windows", "window_rgb",
)  # fmt: skip
BASE = with_seeds(PRESETS["day"], 1)
FIXED_SHARES = np.linspace(0.0, 1.0, 21)  # of the image, for weights that never change


def sweep_runs() -> dict[str, Conditions]:
    """The runs of one world: a map, the same drive again under each level of each factor."""
    runs = {"map": replace(BASE, way_seed=2, parked_seed=2, traffic_seed=2), "base": BASE}
    for level in (25, 50, 75, 100):
        mixed = between(BASE, PRESETS["night"], level / 100)
        runs[f"dark-{level}"] = replace(BASE, **{name: getattr(mixed, name) for name in LIGHT})
    for level in (20, 50, 100):
        runs[f"fog-{level}"] = replace(BASE, fog_per_m=level / 1000)
        runs[f"laser fog-{level}"] = replace(
            BASE, lidar_fog_per_m=level / 1000, lidar_scatter_per_m=0.15 * level / 1000
        )
    runs["cars-2"] = replace(BASE, parked_seed=2)
    runs["cars-3"] = replace(BASE, parked_seed=3)
    return runs


@dataclass(frozen=True, eq=False)
class Seen:
    """What one model says of one run of a sweep, one row a place."""

    descriptions: Descriptions
    xy: Float64[np.ndarray, "n 2"]
    zone: tuple[str | None, ...]

    @property
    def trust(self) -> Float64[np.ndarray, " n"]:
        """alpha_I / (alpha_I + alpha_P) of each place."""
        alpha = self.descriptions.alpha
        assert alpha is not None
        return alpha[:, 0].astype(float) / alpha.sum(axis=1)


def see(model: AdaFusion, dataset: Dataset, cache: Path) -> dict[str, Seen]:
    """Describe every run, and the base run again with either sensor blanked."""
    prepared = prepare_cache(dataset, model.config.preprocess, cache, progress=bar)
    seen = {}
    for run in sweep_runs():
        rows = np.array([i for i, frame in enumerate(dataset.frames) if frame.run == run])
        seen[run] = _describe(model, dataset, rows, prepared)
    rows = np.array([i for i, frame in enumerate(dataset.frames) if frame.run == "base"])
    for name, sensor in (("no image", 0), ("no LiDAR", 1)):
        seen[name] = _describe(model, dataset, rows, prepared, blank=sensor)
    return seen


def _describe(
    model: AdaFusion,
    dataset: Dataset,
    rows: np.ndarray,
    prepared: PreparedFrames,
    blank: int | None = None,
) -> Seen:
    def batches() -> Iterator[tuple[torch.Tensor | None, torch.Tensor | None]]:
        for image, voxels in prepared_batches(prepared, rows):
            assert image is not None
            assert voxels is not None
            # black is -1 for the image, no hit 0 for the voxels
            yield (
                torch.full_like(image, -1.0) if blank == 0 else image,
                torch.zeros_like(voxels) if blank == 1 else voxels,
            )

    frames = [dataset.frames[row] for row in rows]
    return Seen(
        describe(model, batches()),
        dataset.positions_m[rows, :2],
        tuple(frame.zone for frame in frames),
    )


# ------------------------------------------------------------------------------------ measures


def distance_share(
    query: Seen, database: Seen, *, weighted: bool = True
) -> Float64[np.ndarray, " n"]:
    """The image's mean share of a query's distance to all places of the map.

    |alpha_I f_I - alpha'_I f'_I|_1 over the same sum with the LiDAR's part: what the weights and
    the scale of the features make of it together; or the features alone, with equal weights.
    """
    image, lidar = _parts(query, database, weighted)
    return np.mean(image / np.maximum(image + lidar, 1e-12), axis=1)


def _parts(
    query: Seen, database: Seen, weighted: bool = True
) -> tuple[Float64[np.ndarray, "q n"], Float64[np.ndarray, "q n"]]:
    """L1 distances of the image halves and of the LiDAR halves."""
    parts = []
    for i in range(2):
        halves = []
        for seen in (query, database):
            d = seen.descriptions
            half = d.image_half if i == 0 else d.lidar_half
            assert half is not None
            assert d.alpha is not None
            halves.append(half * d.alpha[:, i : i + 1] if weighted else half)
        parts.append(pairwise_distances(*halves, p=1).astype(float))
    return parts[0], parts[1]


def recalls(query: Seen, database: Seen) -> dict[str, float]:
    """Recall@1 of the learnt weights beside equal ones, the best fixed ones and an oracle."""
    true = np.hypot(*(query.xy[:, None] - database.xy[None]).transpose(2, 0, 1)) <= RADIUS_M
    asked = true.any(axis=1)

    def hits(distance: Float64[np.ndarray, "q n"]) -> Bool[np.ndarray, " q"]:
        return true[np.arange(len(true)), distance.argmin(axis=1)][asked]

    image, lidar = _parts(query, database, weighted=False)
    fixed = np.stack([hits(share * image + (1.0 - share) * lidar) for share in FIXED_SHARES])
    return {
        "learnt": float(hits(np.add(*_parts(query, database))).mean()),
        "equal": float(hits(image + lidar).mean()),
        "best fixed": float(fixed.mean(axis=1).max()),
        "oracle": float(fixed.any(axis=0).mean()),
        "image": float(fixed[-1].mean()),
        "LiDAR": float(fixed[0].mean()),
    }


def mean_by_places(values: Float64[np.ndarray, " n"], xy: Float64[np.ndarray, "n 2"]) -> Estimate:
    """Mean of a value of each place, with a 95 % interval from a bootstrap over 50 m blocks."""
    block = place_blocks(xy)
    count = int(block.max()) + 1
    total = np.bincount(block, values, minlength=count)
    size = np.bincount(block, minlength=count)
    draws = draw_blocks(count, 2000, SEED)
    interval = percentile_interval((draws @ total) / np.maximum(draws @ size, 1.0))
    return Estimate(float(values.mean()), interval)


def corridor_steps(base: Seen, value: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " k"]:
    """Mean inside each corridor minus the mean of the frames just outside its two doors.

    A corridor of which the drive holds fewer than `LEAST_INSIDE` frames is left out. ValueError
    where none is left.
    """
    inside = np.array([zone == "corridor" for zone in base.zone])
    indoor = np.array([zone in INDOORS for zone in base.zone])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    steps = []
    for start, stop in edges.reshape(-1, 2):
        near = np.r_[max(start - NEAR_DOOR, 0) : start, stop : min(stop + NEAR_DOOR, len(inside))]
        near = near[~indoor[near]]
        if stop - start >= LEAST_INSIDE and len(near):
            steps.append(value[start:stop].mean() - value[near].mean())
    if not steps:
        raise ValueError("the drive passes no corridor; raise PLACES")
    return np.array(steps)


# -------------------------------------------------------------------------------------- report


def effects(seen: Mapping[str, Seen]) -> dict[str, tuple[Estimate, ...]]:
    """Change of each of `READINGS` against the base run, by level."""
    base, database = seen["base"], seen["map"]

    def read(run: Seen) -> list[Float64[np.ndarray, " n"]]:
        shares = [distance_share(run, database, weighted=weighted) for weighted in (True, False)]
        return [run.trust, *shares]

    rows = {}
    before = read(base)
    for name, other in seen.items():
        if name not in ("map", "base"):
            rows[name] = tuple(
                mean_by_places(now - was, base.xy)
                for now, was in zip(read(other), before, strict=True)
            )
    steps = [corridor_steps(base, value) for value in before]
    rng = np.random.default_rng(SEED)
    picks = rng.integers(len(steps[0]), size=(2000, len(steps[0])))
    rows["corridor"] = tuple(
        Estimate(float(step.mean()), percentile_interval(step[picks].mean(axis=1)))
        for step in steps
    )
    return rows


def in_units(estimate: Estimate) -> str:
    """Three decimals with a sign, and the interval."""
    assert estimate.interval is not None
    low, high = estimate.interval
    return f"{estimate.value:+.3f} [{low:+.3f}, {high:+.3f}]"


def draw(results: Mapping[str, Mapping[str, tuple[Estimate, ...]]], path: Path) -> None:
    """Plot the change of trust by level of each factor, one line a model and world."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 4, figsize=(13.5, 3.8), width_ratios=(3, 2, 2, 3.4))
    for axis in axes[1:3]:  # the controls have a scale of their own
        axis.sharey(axes[0])
    for name, rows in results.items():
        for axis, factor in zip(axes, ("dark", "fog", "laser fog"), strict=False):
            levels = [row for row in rows if row.rpartition("-")[0] == factor]
            x = [0] + [int(row.rpartition("-")[2]) for row in levels]
            values = [Estimate(0.0, (0.0, 0.0))] + [rows[row][0] for row in levels]
            order = np.argsort(x)
            y = np.array([values[i].value for i in order])
            low, high = np.array([values[i].interval for i in order]).T
            (line,) = axis.plot(np.array(x)[order], y, marker="o", ms=3, label=name)
            axis.fill_between(np.array(x)[order], low, high, color=line.get_color(), alpha=0.15)
    words = ("darkness, % of the way to night", "visual fog, 1/km", "laser fog, 1/km")
    for axis, word in zip(axes, words, strict=False):
        axis.set_xlabel(word)
        axis.axhline(0.0, color="0.7", lw=0.8, zorder=0)
    controls = ["corridor", "cars-2", "cars-3", "no image", "no LiDAR"]
    for k, (_, rows) in enumerate(results.items()):
        at = np.arange(len(controls)) + 0.12 * (k - (len(results) - 1) / 2)
        y = np.array([rows[c][0].value for c in controls])
        ends = np.array([rows[c][0].interval for c in controls]).T
        axes[3].errorbar(at, y, np.abs(ends - y), fmt="o", ms=3, lw=1)
    axes[3].set_xticks(range(len(controls)), controls, rotation=30, ha="right")
    axes[3].axhline(0.0, color="0.7", lw=0.8, zorder=0)
    axes[0].set_ylabel("change of $α_I / (α_I + α_P)$")
    for axis in axes[1:3]:
        axis.tick_params(labelleft=False)
    axes[0].legend(fontsize=7, frameon=False)
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
    figure.suptitle("SYNTHETIC worlds: how the image's weight answers to one cause at a time")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def sweep(path: Path, seed: int, workers: int) -> Dataset:
    """Open the sweep of one world, or simulate it; UserError where `path` holds another one."""
    if not path.exists():
        return simulate(
            path, seed=seed, runs=sweep_runs(), profile="small", places=PLACES,
            regions="all-test", workers=workers, progress=bar,
        )  # fmt: skip
    dataset = open_dataset(path)
    wanted = describe_world(Studio(make_job(seed, sweep_runs(), "small", PLACES)), "all-test")
    if dataset.info != wanted:
        raise UserError(f"{path} holds another sweep or version: remove it, to simulate it anew")
    return dataset


def main() -> None:
    """Simulate what is missing, describe, and print one Markdown page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="keeps the sweeps that were rendered")
    parser.add_argument("--model", action="append", required=True)
    parser.add_argument("--world", action="append", type=int, required=True, help="seeds")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--cache", type=Path, help="folder of preprocessed frames")
    parser.add_argument("--output", type=Path, help="Markdown file; the plot lies beside it")
    arguments = parser.parse_args()
    cache = cache_folder(arguments.cache)
    worlds = {}
    for seed in arguments.world:
        worlds[seed] = sweep(arguments.folder / f"sweep-{seed}", seed, arguments.workers)
    models = [load_model(name) for name in arguments.model]
    first_world = arguments.world[0]
    todo = [(models[0], seed) for seed in arguments.world]
    todo += [(model, first_world) for model in models[1:]]
    results, recall, level = {}, {}, {}
    for model, seed in todo:
        seen = see(model, worlds[seed], cache)
        name = f"{model.name}, world {seed}"
        results[name] = effects(seen)
        recall[name] = {
            run: recalls(seen[run], seen["map"])
            for run in ("base", "dark-50", "dark-100", "fog-100", "laser fog-100")
        }
        level[name] = seen["base"].descriptions.alpha
    text = page(results, recall, level, worlds, models)
    print(text)
    if arguments.output:
        write_text(arguments.output, text)
        draw(results, arguments.output.with_suffix(".png"))


def page(
    results: Mapping[str, Mapping[str, tuple[Estimate, ...]]],
    recall: Mapping[str, Mapping[str, Mapping[str, float]]],
    level: Mapping[str, Float[np.ndarray, "n 2"] | None],
    worlds: Mapping[int, Dataset],
    models: list[AdaFusion],
) -> str:
    """The Markdown page."""
    lines = [
        f"# The weight experiment, {datetime.now(UTC):%Y-%m-%d}",
        "",
        f"`python benchmarks/weights.py ...`, commit {git_commit()}. SYNTHETIC data, profile small,"
        f" {PLACES} places a run: "
        + "; ".join(
            f"world {seed}, version {ds.info.version}, geometry {ds.info.sensors['geometry']}, "
            f"fingerprint {ds.fingerprint}"
            for seed, ds in worlds.items()
        )
        + ".",
        "",
        "Models: " + "; ".join(f"{model.name} {model.fingerprint}" for model in models) + ".",
        "",
        "Changes against the same places on the base run (a day): of trust, alpha_I / (alpha_I + "
        "alpha_P); of the image's share of the distance to all places of the map; and of that "
        "share under equal weights, which is what the scale of the features does alone. Means "
        "with 95 % intervals from a bootstrap over 50 m blocks (corridor: over corridors).",
        "",
    ]
    names = list(results)
    for what, word in enumerate(READINGS):
        lines += [f"| {word} | " + " | ".join(names) + " |", "|---|" + "---|" * len(names)]
        for row in results[names[0]]:
            cells = " | ".join(in_units(results[name][row][what]) for name in names)
            lines.append(f"| {row} | {cells} |")
        lines.append("")
    lines += ["Weights by day (mean, spread over places):", ""]
    for name, alpha in level.items():
        assert alpha is not None
        (i, p), (si, sp) = alpha.mean(axis=0), alpha.std(axis=0)
        lines.append(f"- {name}: image {i:.3f} ({si:.3f}), LiDAR {p:.3f} ({sp:.3f})")
    lines += [
        "",
        "Recall@1 (%) of the same halves under other weights, queries of the run on the map:",
        "",
        "| model, world | run | learnt | equal | best fixed | oracle | image | LiDAR |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    for name, runs in recall.items():
        for run, values in runs.items():
            cells = " | ".join(f"{100 * v:.1f}" for v in values.values())
            lines.append(f"| {name} | {run} | {cells} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
