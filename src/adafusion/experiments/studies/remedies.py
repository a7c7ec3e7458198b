# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What keeps the weights from gaining, measured alike for every row and seed.

What they are (spread, saturation), what they work on (length of the halves, the image's share of
the distances), how they are taught (the gradient of the row's own loss), and what they bring:
recall@1 against the same model whose weights never change, each sensor's mean over the test frames.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from adafusion.experiments.jobs import kept_after
from adafusion.experiments.judging import answerable_of
from adafusion.experiments.page import in_percent
from adafusion.experiments.picture import marked, picture
from adafusion.experiments.studies.described import described_by_seed
from adafusion.experiments.studies.remedy_facts import (
    GRADIENT_BATCHES,
    NETS,
    SATURATED,
    gradients,
    look,
    under_fixed_weights,
)
from adafusion.experiments.study import Study, Trained
from adafusion.experiments.verdict import by_seed, judge_difference, plain_verdict
from adafusion.models import load_model
from adafusion.report import plots


def measure_remedies(trained: Trained) -> dict[str, Any]:
    """Look at every row, at each of its seeds."""
    protocol = trained.experiment.protocols[0]
    worlds = [(exam.dataset.positions_m, exam.splits(protocol)) for exam in trained.exams]
    validation = trained.corpus.rows("validation")
    rows = {}
    for label, jobs in trained.rows.items():
        data = trained.corpus.prepare(jobs[0].config.model.preprocess, trained.cache)
        seeds, fixed = [], []
        for job, described in zip(jobs, described_by_seed(trained, label), strict=True):
            taught = gradients(load_model(job.model), job.config, data, validation)
            facts = look(described, worlds, job.config.model.p)
            seeds.append({**facts, "gradient": taught, "kept": kept_after(job)})
            fixed.append(under_fixed_weights(described, worlds, job.config.model) == 1)
        rows[label] = {"seeds": seeds, "recall": _recalls(trained, label, np.stack(fixed))}
    return {"rows": rows}


def _recalls(
    trained: Trained, label: str, fixed: Bool[np.ndarray, "seed q"]
) -> dict[str, dict[str, Any]]:
    """Recall@1 under the learnt and under fixed weights, by kind of run pair and by zone."""
    said = trained.said[label]
    asked, answerable = answerable_of(said, trained.questions)
    learnt = np.stack([one.hits(1) for one in said])[:, answerable]
    fixed = fixed[:, answerable].astype(np.int64)
    found = {}
    for group, mask in trained.questions.groups().items():
        chosen = mask[answerable]
        if not chosen.any():
            continue
        where = asked.where(chosen)
        gain = judge_difference(learnt[:, chosen], fixed[:, chosen], where)
        found[group] = {
            "learnt": float(np.mean(by_seed(learnt[:, chosen], where))),
            "fixed": float(np.mean(by_seed(fixed[:, chosen], where))),
            "gain": plain_verdict(gain, ranked=label in trained.converged),
        }
    return found


def remedies_section(study: Mapping[str, Any]) -> list[str]:
    """Three tables: what the weights are, how they are taught, what they bring."""
    rows = study["rows"]
    lines = [
        "",
        "## What keeps the weights from gaining",
        "",
        "Kept: after which share of the last training's batches the model was best on validation, "
        "by seed; at 0 nothing was learnt there. "
        "Image / LiDAR over all test frames, the mean over seeds. Spread: standard deviation over "
        f"frames. Saturated: share of frames whose weight lies within {SATURATED} of 0 or 1. "
        "Length: mean L1 length of the halves. Image's share: of the L1 distance of a query to its "
        "nearest true and its nearest wrong match.",
        "",
        "| row | kept (%) | weight | spread | saturated (%) | length | weighed | image's share, "
        "true (%) | wrong |",
        "|---" * 9 + "|",
    ]
    for label, row in rows.items():
        alpha = [_over_seeds(row, "alpha", key) for key in ("mean", "std", "saturated")]
        mean, std, saturated = alpha
        kept = " ".join(f"{100 * seed['kept']:.0f}" for seed in row["seeds"])
        cells = [kept, _pair(mean, 2), _pair(std, 3), _pair(saturated, 1, 100.0)]
        cells += [_pair(_over_seeds(row, "length", key), 1) for key in ("unweighed", "weighed")]
        shares = [_over_seeds(row, "image_share", kind) for kind in ("true", "wrong")]
        cells += [_number(None if share is None else share[0], 1, 100.0) for share in shares]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    lines += [
        "",
        f"The gradient of each row's own loss over {GRADIENT_BATCHES} batches of the validation "
        "region, at the trained weights: L2 norm of a batch's, and in brackets how far batches "
        "agree (norm of the mean over mean norm; at random "
        f"{GRADIENT_BATCHES**-0.5:.2f}).",
        "",
        "| row | " + " | ".join(part.replace("lidar", "LiDAR") for part in NETS) + " |",
        "|---" * (1 + len(NETS)) + "|",
    ]
    for label, row in rows.items():
        cells = []
        for part in NETS:
            pulls = [one["gradient"].get(part) for one in row["seeds"]]
            norm, agreement = (
                None if None in pulls else float(np.mean([pull[key] for pull in pulls]))
                for key in ("norm", "agreement")
            )
            cells.append(f"{_number(norm, 3)} ({_number(agreement, 2)})")
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    groups = [g for g in next(iter(rows.values()))["recall"] if not g.startswith("zone ")]
    lines += [
        "",
        "Recall@1 (%) under the learnt weights, and its gain over fixed ones: each sensor's mean, "
        "never changing. The interval is of the gain over all pairs of runs.",
        "",
        "| row | " + " | ".join(groups) + " | learnt - fixed | |",
        "|---" * (3 + len(groups)) + "|",
    ]
    for label, row in rows.items():
        cells = [
            f"{100 * found['learnt']:.1f} ({100 * (found['learnt'] - found['fixed']):+.1f})"
            for found in (row["recall"][group] for group in groups)
        ]
        gain = row["recall"][groups[0]]["gain"]
        cells += [in_percent(gain["difference"], "+"), gain["verdict"]]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return lines


def _over_seeds(row: Mapping[str, Any], measure: str, key: str) -> list[float] | None:
    """The mean of a measure's numbers over the seeds; None where a model has no such."""
    found = [seed[measure][key] for seed in row["seeds"] if seed[measure] is not None]
    if len(found) < len(row["seeds"]) or None in found:
        return None
    return np.reshape(found, (len(found), -1)).mean(axis=0).tolist()


def _pair(values: Sequence[float] | None, digits: int, scale: float = 1.0) -> str:
    return " / ".join(_number(value, digits, scale) for value in values or (None, None))


def _number(value: float | None, digits: int, scale: float = 1.0) -> str:
    return "-" if value is None else f"{scale * value:.{digits}f}"


def draw_remedies(results: Mapping[str, Any], path: Path) -> None:
    """Recall@1 under learnt and under fixed weights, and where the weights of each row lie."""
    study = results["study"]["rows"]
    named = marked(results)
    labels = list(study)[::-1]  # the first on top
    at = np.arange(len(labels))
    with picture(path, results, 1.2 + 0.34 * len(labels)) as figure:
        recall, weight = figure.subplots(1, 2, sharey=True)
        everything = [next(iter(study[label]["recall"].values())) for label in labels]
        learnt, fixed = (
            100 * np.array([found[key] for found in everything]) for key in ("learnt", "fixed")
        )
        recall.hlines(at, learnt, fixed, color=plots.FAINT, linewidth=1.2)
        recall.plot(fixed, at, "o", color=plots.INK, markerfacecolor="white", label="fixed weights")
        recall.plot(learnt, at, "o", color=plots.INK, label="learnt weights")
        recall.set_xlabel("recall@1 (%)")
        recall.set_yticks(at, [named[label] for label in labels])
        for side, (sensor, color) in enumerate((("image", plots.IMAGE), ("LiDAR", plots.LIDAR))):
            for y, label in enumerate(labels):
                alphas = [one["alpha"] for one in study[label]["seeds"] if one["alpha"]]
                for n, alpha in enumerate(alphas):
                    height = y + 0.2 * (0.5 - side) + 0.08 * (n - (len(alphas) - 1) / 2)
                    mean, std = alpha["mean"][side], alpha["std"][side]
                    weight.errorbar(mean, height, xerr=std, fmt="o", ms=3, color=color)
            weight.plot([], [], "o", ms=3, color=color, label=sensor)
        weight.set_xlim(0, 1)
        weight.set_xlabel("weight: mean and spread over test frames, each seed")
        for axes in (recall, weight):
            axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)


REMEDIED = Study(measure=measure_remedies, section=remedies_section, draw=draw_remedies)
