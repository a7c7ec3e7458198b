# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Do the weights differ more between wrong matches than between true ones (the paper's figure 1)?

If they do, they help to tell places apart beside telling which sensor to trust. For every
answerable query: how far its alpha is from that of a true match, and from that of a wrong one.

What is picked as nearest is picked by a distance that the weights are part of, and from many wrong
frames but few true ones, so the nearest wrong match is like the query in its weights as well. A
true and a wrong match drawn at random are free of that; and as a frame just beyond the radius shows
much of the same place, one comparison takes the nearest wrong match from elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64

from adafusion.evaluation.protocols import PROTOCOLS
from adafusion.experiments.page import in_percent
from adafusion.experiments.picture import picture
from adafusion.experiments.studies.described import WEIGHED, described_by_seed
from adafusion.experiments.study import Study, Trained
from adafusion.experiments.verdict import (
    Asked,
    estimate,
    estimate_share,
    judge_difference,
    plain_verdict,
    within,
)
from adafusion.report import plots
from adafusion.search import pairwise_distances
from adafusion.types import Descriptions, Split, UserError

PROTOCOL = "cross-run"
ELSEWHERE_M = 50.0  # frames so far from the query do not show its place
SEED = 0  # of the matches drawn at random
READINGS = {"image": "image", "lidar": "LiDAR", "both": "both (L1)"}
COMPARISONS = {  # (true match, wrong match), each a name of `choose_matches`
    "nearest": ("nearest true", "nearest wrong"),
    "nearest, elsewhere": ("nearest true", "nearest elsewhere"),
    "nearest, random": ("nearest true", "random wrong"),
    "random, random": ("random true", "random wrong"),
}
SHOWN = ("nearest", "random, random")  # as curves in the picture
WORDS = {"above": "yes", "below": "no, less"}
QUANTILES = np.linspace(0.0, 1.0, 101)

Matches = Mapping[str, Int64[np.ndarray, " q"]]


def choose_matches(
    distance: Float32[np.ndarray, "q n"],
    apart_m: Float64[np.ndarray, "q n"],
    radius_m: float,
    rng: np.random.Generator,
) -> dict[str, Int64[np.ndarray, " q"]]:
    """Columns of each query's true and wrong matches: the nearest by descriptor, and any.

    True matches lie within `radius_m`, wrong ones beyond, elsewhere beyond `ELSEWHERE_M` as well.
    ValueError where a query has no match of one kind.
    """
    is_true = apart_m <= radius_m
    is_elsewhere = apart_m > max(radius_m, ELSEWHERE_M)
    if not (is_true.any(axis=1) & is_elsewhere.any(axis=1)).all():
        raise ValueError("a query has no true match, or no wrong one elsewhere")
    lot = rng.random(distance.shape)
    return {
        "nearest true": _least(distance, is_true),
        "nearest wrong": _least(distance, ~is_true),
        "nearest elsewhere": _least(distance, is_elsewhere),
        "random true": _least(lot, is_true),
        "random wrong": _least(lot, ~is_true),
    }


def _least(
    value: Float[np.ndarray, "q n"], allowed: Bool[np.ndarray, "q n"]
) -> Int64[np.ndarray, " q"]:
    return np.where(allowed, value, np.inf).argmin(axis=1)


def weight_distances(
    described: Descriptions,
    xy_m: Float64[np.ndarray, "n 2"],
    split: Split,
    rng: np.random.Generator,
    p: int = 1,
) -> tuple[Bool[np.ndarray, " q"], dict[str, Float64[np.ndarray, "asked 3"]]]:
    """How far each query's alpha is from that of each of its matches, by kind of match.

    Columns are |alpha_I - alpha'_I|, the same of the LiDAR, and their sum. The mask says which
    queries of the split have a true match and a wrong one elsewhere; the others have no row.
    """
    assert described.fused is not None
    assert described.alpha is not None
    query, database = split.query_rows, split.database_rows
    apart_m = np.hypot(*np.moveaxis(xy_m[query, None] - xy_m[None, database], -1, 0))
    asked = (apart_m <= split.radius_m).any(axis=1)
    asked &= (apart_m > max(split.radius_m, ELSEWHERE_M)).any(axis=1)
    distance = pairwise_distances(described.fused[query[asked]], described.fused[database], p=p)
    matches = choose_matches(distance, apart_m[asked], split.radius_m, rng)
    alpha = described.alpha.astype(np.float64)
    found = {}
    for name, columns in matches.items():
        each = np.abs(alpha[query[asked]] - alpha[database[columns]])
        found[name] = np.column_stack([each, each.sum(axis=1)])
    return asked, found


def measure_idea(trained: Trained) -> dict[str, Any]:
    """Distances of alpha under cross-run: their means, which are larger, and their quantiles."""
    questions = trained.questions
    by_seed = []
    p = trained.rows[WEIGHED][0].config.model.p
    for descriptions in described_by_seed(trained, WEIGHED):
        rng = np.random.default_rng(SEED)  # the same matches at random for every seed
        parts = [
            weight_distances(described, exam.dataset.positions_m[:, :2], split, rng, p)
            for exam, described in zip(trained.exams, descriptions, strict=True)
            for split in exam.splits(PROTOCOL)
        ]
        by_seed.append({kind: np.concatenate([f[kind] for _, f in parts]) for kind in parts[0][1]})
    chosen = np.concatenate([asked for asked, _ in parts])  # by place: the same for every seed
    if not chosen.any():
        raise UserError(f"no query has a true match, and a wrong one {ELSEWHERE_M:g} m away")
    asked, zone = questions.asked.where(chosen), questions.zone[chosen]
    apart = {kind: np.stack([of_seed[kind] for of_seed in by_seed]) for kind in by_seed[0]}
    is_ranked = WEIGHED in trained.converged
    comparisons = {}
    for name, (true, wrong) in COMPARISONS.items():
        readings = {
            reading: _compare(apart[true][..., i], apart[wrong][..., i], asked, is_ranked)
            for i, reading in enumerate(READINGS)
        }
        zones = {
            str(z): _compare(
                apart[true][:, zone == z, -1],
                apart[wrong][:, zone == z, -1],
                asked.where(zone == z),
                is_ranked,
            )
            for z in np.unique(zone)
            if z
        }
        comparisons[name] = {"true": true, "wrong": wrong, "readings": readings, "zones": zones}
    return {
        "queries": int(chosen.sum()),
        "radius_m": PROTOCOLS[PROTOCOL].radius_m,
        "elsewhere_m": ELSEWHERE_M,
        "comparisons": comparisons,
        "quantiles": {k: np.quantile(v[..., -1], QUANTILES).tolist() for k, v in apart.items()},
    }


def _compare(
    true: Float64[np.ndarray, "seed q"],
    wrong: Float64[np.ndarray, "seed q"],
    asked: Asked,
    is_ranked: bool,
) -> dict[str, Any]:
    """Means of both, wrong minus true, and the share of queries whose wrong match is farther."""
    return {
        "true": asdict(within(estimate(true, asked), 0.0, math.inf)),
        "wrong": asdict(within(estimate(wrong, asked), 0.0, math.inf)),
        "wrong_minus_true": plain_verdict(judge_difference(wrong, true, asked), ranked=is_ranked),
        "share": asdict(estimate_share((wrong > true).astype(np.float64), asked)),
    }


def idea_section(study: Mapping[str, Any]) -> list[str]:
    """Tables of the comparisons, and of both weights together by zone of the query."""
    lines = [
        "",
        "## Do the weights differ more for wrong matches?",
        "",
        f"Mean difference of alpha between a query and its match, in thousandths, {PROTOCOL}, "
        f"{study['queries']} queries; 95 % intervals over 50 m blocks, and over seeds where there "
        "are several. True matches lie "
        f"within {study['radius_m']:g} m, wrong ones beyond, elsewhere beyond "
        f"{study['elsewhere_m']:g} m; nearest by descriptor. The share is that of queries whose "
        "wrong match differs more (50 %: no use).",
        "",
        "| matches | weights | true | wrong | wrong minus true | share, % | differ more? |",
        "|---|---|---|---|---|---|---|",
    ]
    for comparison in study["comparisons"].values():
        pair = f"{comparison['true']}, {comparison['wrong']}"
        for reading, words in READINGS.items():
            found = comparison["readings"][reading]
            cells = [_thousandths(found["true"]), _thousandths(found["wrong"]), *_judged(found)]
            lines.append(f"| {pair} | {words} | " + " | ".join(cells) + " |")
    lines += [
        "",
        "Both weights by zone of the query:",
        "",
        "| matches | zone | wrong minus true | share, % | differ more? |",
        "|---|---|---|---|---|",
    ]
    for name in SHOWN:
        comparison = study["comparisons"][name]
        pair = f"{comparison['true']}, {comparison['wrong']}"
        for zone, found in comparison["zones"].items():
            lines.append(f"| {pair} | {zone} | " + " | ".join(_judged(found)) + " |")
    return lines


def _judged(found: Mapping[str, Any]) -> list[str]:
    verdict = found["wrong_minus_true"]
    return [
        _thousandths(verdict["difference"], "+"),
        in_percent(found["share"]),
        WORDS.get(verdict["verdict"], verdict["verdict"]),
    ]


def _thousandths(estimate: Mapping[str, Any], sign: str = "") -> str:
    numbers = (estimate["value"], *(estimate["interval"] or ()))
    value, *ends = (f"{1000 * x:{sign}.1f}" for x in numbers)
    return f"{value} [{', '.join(ends)}]" if ends else value


def draw_idea(results: Mapping[str, Any], path: Path) -> None:
    """Distributions of both differences, and wrong minus true of every comparison."""
    study = results["study"]
    with picture(path, results, 3.7) as figure:
        shares, gaps = figure.subplots(1, 2)
        for name, style in zip(SHOWN, ("-", ":"), strict=True):
            comparison = study["comparisons"][name]
            for which, color in (("true", plots.RIGHT), ("wrong", plots.WRONG)):
                kind = comparison[which]
                values = 1000 * np.array(study["quantiles"][kind])
                shares.plot(values, 100 * QUANTILES, style, color=color, label=kind)
        highest = max(study["quantiles"][kind][-2] for kind in study["quantiles"])
        shares.set_xlim(0.0, 1000 * highest)
        shares.set_ylim(0.0, 101.0)
        shares.set_xlabel("difference of alpha, image + LiDAR, in thousandths")
        shares.set_ylabel("queries with at most so much (%)")
        shares.legend()
        looks = {"image": plots.IMAGE, "lidar": plots.LIDAR, "both": plots.INK}
        for i, (reading, color) in enumerate(looks.items()):
            for k, comparison in enumerate(study["comparisons"].values()):
                found = comparison["readings"][reading]["wrong_minus_true"]["difference"]
                y = k + 0.2 * (i - 1)
                label = READINGS[reading] if k == 0 else None
                gaps.plot(1000 * found["value"], y, "o", color=color, markersize=4, label=label)
                if found["interval"] is not None:
                    ends = 1000 * np.array(found["interval"])
                    gaps.plot(ends, (y, y), color=color, linewidth=1.5)
        gaps.axvline(0.0, color=plots.FAINT, linewidth=1.0)
        names = [f"{c['true']},\n{c['wrong']}" for c in study["comparisons"].values()]
        gaps.set_yticks(range(len(names)), names)
        gaps.invert_yaxis()
        gaps.set_xlabel("difference of alpha, wrong minus true, in thousandths")
        gaps.legend()


IDEA = Study(measure=measure_idea, section=idea_section, draw=draw_idea)
