# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What learnt weights gain over fixed ones on the same frozen branches, and what could be gained.

A fixed share s describes a frame by [s f_I; (1 - s) f_P]. Equal weights are s = 1/2; the best fixed
share is chosen on the validation region, for each seed. Two lines are no systems, for they know
what a robot does not. The oracle takes for each query, after the fact, whichever share answers it
rightly: what no choice of one share for a query and all its candidates can exceed, luck included.
The share by condition is one for each zone and kind of run pair, chosen for each 50 m block by the
queries at least 100 m from it: about what weights can gain that know these and nothing else,
without the luck. Its like is one share for all that is chosen in the same way. Learnt weights are
each frame's own and are bound by none of these.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree

from adafusion.evaluation import evaluate_splits
from adafusion.evaluation.validation import region_recall
from adafusion.experiments.describing import describe_frames, load_trained
from adafusion.experiments.jobs import Job
from adafusion.experiments.judging import answerable_of
from adafusion.experiments.page import in_percent
from adafusion.experiments.picture import marked, picture
from adafusion.experiments.studies.described import at_weights
from adafusion.experiments.study import Study, Trained
from adafusion.experiments.verdict import (
    Asked,
    by_seed,
    estimate_share,
    judge_difference,
    plain_verdict,
)
from adafusion.models.frozen import describe_frozen
from adafusion.report import plots

SHARES = tuple(i / 20 for i in range(21))  # of the image; the LiDAR has the rest
EQUAL = SHARES.index(0.5)
FAR_M = 100.0  # shows nothing of a place: two blocks, five radii of a true match
BEST, ORACLE = "best fixed share", "oracle"
BY_CONDITION, FOR_ALL = "best share by condition", "best share for all, chosen alike"


@dataclass(frozen=True, eq=False)
class FixedShares:
    """What each fixed share answers with one seed's branches."""

    validation: Float64[np.ndarray, " share"]  # recall@1
    hits: Int64[np.ndarray, "share q"]  # of the test queries: 1 where the first answer is right

    @property
    def best(self) -> int:
        """The share that validation chooses; the most even one of equals."""
        top = np.flatnonzero(self.validation == self.validation.max())
        return int(top[np.argmin(np.abs(top - EQUAL))])


def measure_weighting(trained: Trained) -> dict[str, Any]:
    """Recall of fixed shares, each row's gain over them, and what its weights are like.

    The shares are of the branches of the first row that was trained on frozen ones.
    """
    frozen = {
        label: jobs
        for label, jobs in trained.rows.items()
        if jobs[0].config.cache_branches and not jobs[0].config.model.attend_features
    }
    fixed = [fixed_shares(job, trained) for job in next(iter(frozen.values()))]
    asked, answerable = answerable_of(next(iter(trained.said.values())), trained.questions)
    hits = np.stack([one.hits for one in fixed])[:, :, answerable]  # (seed, share, q)
    conditions = trained.questions.conditions()[answerable]
    equal = hits[:, EQUAL]
    best = np.stack([of_seed[one.best] for of_seed, one in zip(hits, fixed, strict=True)])

    is_far = far_from_blocks(asked, trained.questions.xy_m[answerable])

    def chosen(condition: Int64[np.ndarray, " q"]) -> Int64[np.ndarray, "seed q"]:
        shares = [
            shares_by_condition(of_seed, one.best, condition, asked.block, is_far)
            for of_seed, one in zip(hits, fixed, strict=True)
        ]
        return np.stack(shares)

    for_all, by_condition = chosen(np.zeros_like(conditions)), chosen(conditions)
    ranked = next(iter(frozen)) in trained.converged  # all fixed shares are of these branches
    unlearnt = {
        "LiDAR alone": hits[:, 0],
        "image alone": hits[:, -1],
        "equal weights": equal,
        BEST: best,
        FOR_ALL: for_all,
        BY_CONDITION: by_condition,
        ORACLE: hits.max(axis=1),
    }
    rows = {}
    for label, said in trained.said.items():
        right = np.stack([one.hits(1)[answerable] for one in said])
        judged = label in trained.converged
        rows[label] = {
            "over equal": plain_verdict(judge_difference(right, equal, asked), ranked=judged),
            "over best": plain_verdict(judge_difference(right, best, asked), ranked=judged),
            "alpha": _alpha(trained, label),
        }
    return {
        "shares": list(SHARES),
        "recall_by_share": [float(np.mean(by_seed(hits[:, i], asked))) for i in range(len(SHARES))],
        "validation_by_share": np.mean([one.validation for one in fixed], axis=0).tolist(),
        "best_share": [SHARES[one.best] for one in fixed],
        "unlearnt": {
            name: {
                "recall": asdict(estimate_share(right, asked)),
                "over equal": plain_verdict(judge_difference(right, equal, asked), ranked=ranked),
            }
            for name, right in unlearnt.items()
        },
        "by condition over all": plain_verdict(
            judge_difference(by_condition, for_all, asked), ranked=ranked
        ),
        "rows": rows,
    }


def fixed_shares(job: Job, trained: Trained) -> FixedShares:
    """Judge every share by the unweighted halves of a training on frozen branches."""
    model = load_trained(job.name, job.model)
    data = trained.corpus.prepare(model.config.preprocess, trained.cache)
    rows = trained.corpus.rows("validation")
    judge = region_recall(data, rows)
    seen = describe_frozen(model, data, rows, trained.cache, trained.progress)
    alphas = [(share, 1.0 - share) for share in SHARES]
    p = model.config.p
    validation = np.array([judge(at_weights(seen, alpha, model.config), p) for alpha in alphas])
    hits: list[list[np.ndarray]] = [[] for _ in SHARES]
    for exam in trained.exams:
        splits = exam.splits(trained.experiment.protocols[0])
        seen = describe_frames(
            model, exam.dataset, trained.cache, trained.out, trained.progress, frozen=True
        )
        for of_share, alpha in zip(hits, alphas, strict=True):
            fused = at_weights(seen, alpha, model.config)
            answered = evaluate_splits(fused, exam.dataset.positions_m, splits, ks=[1], p=p)
            of_share += [(one.first_hit == 1).astype(np.int64) for one in answered.results]
    return FixedShares(validation, np.stack([np.concatenate(of_share) for of_share in hits]))


def far_from_blocks(asked: Asked, xy_m: Float64[np.ndarray, "q 2"]) -> Bool[np.ndarray, "block q"]:
    """Which queries lie at least `FAR_M` from all of a block's, or in another world."""
    is_far = np.ones((int(asked.block.max()) + 1, len(xy_m)), np.bool_)
    for block in np.unique(asked.block):
        here = asked.block == block
        nearest_m, _ = KDTree(xy_m[here]).query(xy_m)
        is_far[block] = (nearest_m >= FAR_M) | (asked.world != asked.world[here][0])
    return is_far


def shares_by_condition(
    hits: Int64[np.ndarray, "share q"],
    otherwise: int,
    condition: Int64[np.ndarray, " q"],
    block: Int64[np.ndarray, " q"],
    is_far: Bool[np.ndarray, "block q"],
) -> Int64[np.ndarray, " q"]:
    """What is answered by the share that answers most of the far queries of the same condition.

    Of equal shares the one next to `otherwise` is taken, which is also the one where no far query
    has the condition.
    """
    chosen = np.empty(hits.shape[1], np.int64)
    near = -np.abs(np.arange(len(hits)) - otherwise)
    for one in np.unique(condition):
        alike = condition == one
        for place in np.unique(block[alike]):
            right = hits[:, alike & is_far[place]].sum(axis=1)
            chosen[alike & (block == place)] = np.lexsort((near, right))[-1]
    return hits[chosen, np.arange(hits.shape[1])]


def _alpha(trained: Trained, label: str) -> dict[str, list[float]] | None:
    """Mean weights over all test frames, and their spread, (image, LiDAR); the mean over seeds."""
    summaries = [alpha["all"] for alpha in trained.alpha[label] if alpha is not None]
    if not summaries:
        return None
    return {
        name: np.mean([one[name] for one in summaries], axis=0).tolist() for name in ("mean", "std")
    }


def weighting_section(study: Mapping[str, Any]) -> list[str]:
    """Fixed weights, then every row's gain over them and its weights."""
    lines = ["", "## What fixed weights give on the same frozen branches", ""]
    lines += ["| weights | recall@1 | minus equal weights |", "|---|---|---|"]
    for name, one in study["unlearnt"].items():
        lines.append(f"| {name} | {in_percent(one['recall'])} | {_gain(one['over equal'])} |")
    shares = ", ".join(f"{share:.2f}" for share in study["best_share"])
    lines += [
        "",
        f"Best shares of the image on validation, by seed: {shares}. The oracle chooses the best "
        f"of {len(study['shares'])} shares for each query after the fact: no system, but a bound "
        "of what a share that a query and its candidates have in common can give, luck included. "
        f"The {BY_CONDITION} is one for each zone of the query and kind of run pair (with night, "
        "rain, ..., in opposite directions), chosen for each 50 m block by the queries at least "
        f"{FAR_M:g} m from it: no system either, for a frame knows nothing of the other run, but "
        "about what there is to gain for weights that know conditions and no more. Against one "
        f"share for all that is chosen in the same way: {_gain(study['by condition over all'])}.",
        "",
        "## What each row gains, and its weights",
        "",
        "| row | minus equal weights | minus best fixed share | alpha of image | of LiDAR |",
        "|---|---|---|---|---|",
    ]
    for label, row in study["rows"].items():
        cells = ["-", "-"]
        if row["alpha"] is not None:
            pairs = zip(row["alpha"]["mean"], row["alpha"]["std"], strict=True)
            cells = [f"{mean:.3f} ± {std:.3f}" for mean, std in pairs]
        lines.append(
            f"| {label} | {_gain(row['over equal'])} | {_gain(row['over best'])} | "
            + " | ".join(cells)
            + " |"
        )
    return [*lines, "", "Weights: mean ± spread over the test frames, mean over seeds."]


def _gain(verdict: Mapping[str, Any]) -> str:
    return f"{in_percent(verdict['difference'], '+')} {verdict['verdict']}"


def draw_weighting(results: Mapping[str, Any], path: Path) -> None:
    """Write the figure: recall over the fixed share, and every row's gain over equal weights."""
    study = results["study"]
    gains = {label: row["over equal"]["difference"] for label, row in study["rows"].items()}
    gains |= {
        name: study["unlearnt"][name]["over equal"]["difference"]
        for name in (BEST, BY_CONDITION)  # the oracle is so far off that it would hide the rest
    }
    with picture(path, results, 1.2 + 0.28 * len(gains)) as figure:
        by_share, gained = figure.subplots(1, 2, width_ratios=(2, 3))
        named = marked(results)
        for key, word, style in (
            ("recall_by_share", "test", "-"),
            ("validation_by_share", "validation", "--"),
        ):
            by_share.plot(
                study["shares"], 100 * np.array(study[key]), style, color=plots.INK, label=word
            )
        by_share.set_xlabel("fixed share of the image")
        by_share.set_ylabel("recall@1 (%)")
        by_share.legend()
        for i, difference in enumerate(gains.values()):
            gained.plot(100 * difference["value"], i, "o", color=plots.INK, markersize=4)
            if difference["interval"] is not None:
                low, high = difference["interval"]
                gained.plot([100 * low, 100 * high], [i, i], color=plots.INK, linewidth=1.2)
        gained.axvline(0.0, color=plots.FAINT, linewidth=1.0)
        gained.set_yticks(range(len(gains)), [named.get(label, label) for label in gains])
        gained.invert_yaxis()
        gained.set_xlabel("recall@1 minus that of equal weights (points)")


WEIGHTING = Study(measure=measure_weighting, section=weighting_section, draw=draw_weighting)
