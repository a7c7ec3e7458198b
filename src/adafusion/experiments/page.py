# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The Markdown page of an experiment, from its results."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from adafusion.experiments.convergence import NEVER_BEGAN, RISING
from adafusion.experiments.verdict import NOT_RANKED
from adafusion.types import Estimate


def ranking(rows: Sequence[Mapping[str, Any]], protocol: str) -> list[Mapping[str, Any]]:
    """Converged rows by recall@1, best first; then the others as they come."""
    done = [row for row in rows if row["converged"]]
    done.sort(key=lambda row: -row["recall"][protocol]["AR@1"]["value"])
    return [*done, *(row for row in rows if not row["converged"])]


def page(results: Mapping[str, Any], section: Sequence[str] = (), picture: str = "") -> str:
    """Write the page; `section` is what a study says, `picture` the name of a file beside it."""
    seeds = results["seeds"]
    judged = bool(results["protocols"])
    exploratory = " Exploratory: one seed, which decides nothing." if len(seeds) == 1 else ""
    synthetic = "SYNTHETIC data: " if is_synthetic(results) else "Data: "
    software = results["software"]
    lines = [
        f"# {results['experiment']}, {results['date']}",
        "",
        results["words"] + exploratory,
        "",
        f"`{results['command']}`, commit {results['commit']}.",
        "",
        synthetic
        + "trained on "
        + ", ".join(
            f"{d['name']} {d['version']} ({d['fingerprint']})" for d in results["training_data"]
        )
        + "; judged on "
        + (", ".join(map(_exam, results["test_data"])) or "its validation region")
        + ".",
        "",
        f"Machine: {software['platform']}, {results['machine']['processors']} processors, "
        f"{results['machine']['device']}; Python {software['python']}, torch {software['torch']}. "
        f"{in_words(seeds).capitalize()}. From a budget of "
        f"{results['budget']:,} frame passes"
        + ("; what each seed of a row spent, in whole batches, stands in the table" * judged)
        + ". The trainings took "
        f"{_duration(results['training_seconds'])}, added up.",
        *(_of_test(results) if judged else []),
        *section,
    ]
    if picture:
        first = re.split(r"[.:;?]", results["words"])[0]
        lines += ["", f"![{results['experiment']}: {first}]({picture})"]
    return "\n".join(lines) + "\n"


def _of_test(results: Mapping[str, Any]) -> list[str]:
    """All that rests on the test set."""
    seeds = results["seeds"]
    return [
        "",
        *_table(results),
        "",
        "AR@N: the share of queries with a true match among the N nearest, mean over the pairs; "
        "AR@1%: among the nearest 1 % of the database, at least 1. In percent, with 95 % intervals "
        "from a bootstrap over 50 m blocks of places"
        + (" and over seeds" if len(seeds) > 1 else "")
        + f" ({results['draws']} draws). A row whose validation recall@1 still rose in the last "
        "quarter of its evaluations, by more than the 95 % half-width of "
        f'{results["validation_answers"]} answers, is marked "{RISING}", one with a training from '
        f'scratch whose best is within that of its start "{NEVER_BEGAN}"; both stand below the '
        "others in no order and have no verdict. Every training of a row's chain is looked at. "
        "Rates fall to "
        f"zero{_but_not(results['rows'])}, which levels a curve by itself: a row without a mark "
        "had learnt what this budget teaches, and a larger one may still lift it. The paper's "
        "numbers are its own, on Oxford RobotCar under several protocols: they compare with "
        "nothing here.",
        "",
        *(f"- {name}: {words}" for name, words in results["protocols"].items()),
        *_apart(results["rows"]),
        *_kept(results["rows"]),
        *_alpha(results["rows"]),
        *_verdicts(results),
    ]


def _but_not(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows whose rate does not fall to zero."""
    others = [row["label"] for row in rows if not row["rate_falls_to_zero"]]
    return f" (but not those of {', '.join(others)})" if others else ""


def _duration(seconds: float) -> str:
    return f"{seconds / 60:.1f} min" if seconds < 3600 else f"{seconds / 3600:.1f} h"


def _exam(data: Mapping[str, Any]) -> str:
    return (
        f"{data['name']} {data['version']} ({data['fingerprint']}, {data['frames']} frames in "
        f"{len(data['runs'])} runs, {data['left_out_for_lack_of_a_sensor']} left out for lack of a "
        "sensor)"
    )


def _table(results: Mapping[str, Any]) -> list[str]:
    protocols = list(results["protocols"])
    rows = ranking(results["rows"], protocols[0])
    measured = [(p, m) for p in protocols for m in ("AR@1", "AR@1%")]
    head = ["system", "parameters", "descriptor", "passes, image / LiDAR"]
    head += [f"{p} {m}" for p, m in measured]
    head += [f"{protocols[0]} AR@1 by seed", "paper, Oxford AR@1 / AR@1%"]
    ranked = [row for row in rows if row["converged"]]
    best = {
        (p, m): max((row["recall"][p][m]["value"] for row in ranked), default=None)
        for p, m in measured
    }
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for row in rows:
        marks = ["reconstruction"] * row["reconstruction"]
        marks += ["from ImageNet"] * row["pretrained"]
        marks += [row["why_not_ranked"]] * (not row["converged"])
        cells = [row["label"] + (f" ({', '.join(marks)})" if marks else "")]
        cells += [f"{row['parameters']:,}", f"{row['length']:,}"]
        passes = row["frame_passes"]
        cells.append(
            " / ".join(f"{passes[s]:,}" if s in passes else "-" for s in ("image", "lidar"))
        )
        for p, m in measured:
            cell = in_percent(row["recall"][p][m])
            is_best = row in ranked and row["recall"][p][m]["value"] == best[p, m]
            is_best &= len(ranked) > 1
            cells.append(f"**{cell}**" if is_best else cell)
        cells.append(", ".join(f"{100 * value:.1f}" for value in row["recall@1_by_seed"]))
        cells.append(_published(row["published_oxford_percent"]))
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _published(numbers: Mapping[str, float | None] | None) -> str:
    if numbers is None:
        return "-"
    return " / ".join(
        "-" if value is None else f"{value:.2f}"
        for value in (numbers["at_1"], numbers["at_1_percent"])
    )


def _apart(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Passes that taught nothing, reported apart from the budget."""
    return [
        "",
        "Frame passes beside the budget, of one seed: "
        + "; ".join(
            f"{row['label']} {row['validation_passes']:,} for validation"
            + (f", {row['mining_passes']:,} for mining" if row["mining_passes"] else "")
            for row in rows
        )
        + ".",
    ]


def _kept(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """When the best model on validation was met: at 0 % the last training brought nothing."""
    said = (
        f"{row['label']} {', '.join(f'{100 * share:.0f} %' for share in row['kept_after'])}"
        for row in rows
    )
    return [
        "",
        f"Kept, by validation, after this share of the last training: {'; '.join(said)}. At 0 % "
        "it brought nothing, and the row is what it started from.",
    ]


def _alpha(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = []
    for row in rows:
        if weights := [alpha["all"] for alpha in row["alpha"] if alpha]:
            said = ", ".join(
                f"{w['mean'][0]:.2f} / {w['mean'][1]:.2f} (spread {w['std'][0]:.3f} / "
                f"{w['std'][1]:.3f})"
                for w in weights
            )
            lines += ["", f"Mean weights of {row['label']}, image / LiDAR, by seed: {said}."]
    return lines


def _verdicts(results: Mapping[str, Any]) -> list[str]:
    verdicts = results["verdicts"]
    if not verdicts:
        return []
    if all(verdict["verdict"] == NOT_RANKED for verdict in verdicts):
        return ["", "No verdict: of each pair at least one row is not ranked."]
    protocol = next(iter(results["protocols"]))
    lines = [
        "",
        "## Verdicts",
        "",
        f"Difference of recall@1 in points under {protocol}, paired by place and by seed, with the "
        "interval that the verdict rests on: above or below where it leaves 0 out, else undecided. "
        "The first line of a table answers the question; each of the others errs in one case of "
        "twenty.",
    ]
    for judged in dict.fromkeys(v["row"] for v in verdicts):
        said = {(v["group"], v["against"]): v for v in verdicts if v["row"] == judged}
        others = list(dict.fromkeys(other for _, other in said))
        lines += [
            "",
            f"| {judged} | queries | " + " | ".join(f"minus {other}" for other in others) + " |",
            "|---|---" + "|---" * len(others) + "|",
        ]
        for group in dict.fromkeys(group for group, _ in said):
            row = [said[group, other] for other in others]
            cells = [f"{in_percent(v['difference'], '+')} {v['verdict']}" for v in row]
            lines.append(f"| {group} | {row[0]['queries']} | " + " | ".join(cells) + " |")
    return lines


def is_synthetic(results: Mapping[str, Any]) -> bool:
    """Whether any of the data that taught or judged are."""
    return any(data["synthetic"] for data in (*results["training_data"], *results["test_data"]))


def in_words(seeds: Sequence[int]) -> str:
    """ "seed 0" or "seeds 0, 1"."""
    return f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}"


def in_percent(estimate: Mapping[str, Any], sign: str = "") -> str:
    """An estimate of the results as text, with its interval where it has one."""
    interval = estimate["interval"]
    known = None if interval is None else (interval[0], interval[1])
    return Estimate(estimate["value"], known).in_percent(sign)
