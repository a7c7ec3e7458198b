# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where frames lie to each other: do runs meet, and do training and test stay apart?"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int64
from scipy.spatial import cKDTree

from adafusion.datasets.splits import TEST, TRAIN, VALIDATION
from adafusion.doctor.findings import Finding, examples, ok, percent, skip
from adafusion.doctor.table import Table

JUDGING = (VALIDATION, TEST)  # regions that must not be trained on; others are nobody's
# Queries without a true match are left out of recall: a run that hardly meets another adds nothing.
OVERLAP_SHARE = 0.1
LEAK_FAIL_SHARE = 0.1  # below it the frames lie along a border; above it the regions overlap


def positives(table: Table, radius_m: float) -> Int64[np.ndarray, " n"]:
    """How many frames of other runs lie within the radius of each frame, in the plane."""
    xy = table.xyz[:, :2]
    count = cKDTree(xy).query_ball_point(xy, radius_m, return_length=True)
    for number in range(len(table.runs)):
        own = table.run == number
        count[own] -= cKDTree(xy[own]).query_ball_point(xy[own], radius_m, return_length=True)
    return np.asarray(count, dtype=np.int64)


def overlap(table: Table, positives: Int64[np.ndarray, " n"], radius_m: float) -> Finding:
    """Whether each run comes where another was."""
    check = "overlap of runs"
    why = "A frame without a true match in another run teaches nothing and is left out of recall."
    if len(table.runs) < 2:
        return Finding(
            check=check,
            level="warn",
            what="one run only",
            why="It can become a map. Recall between runs cannot be measured, and training needs "
            "places seen twice.",
            remedy="Add a second run over the same roads, in the same world frame.",
        )
    met = positives > 0
    shares = [float(met[table.run == k].mean()) for k in range(len(table.runs))]
    alone = [k for k, share in enumerate(shares) if share < OVERLAP_SHARE]
    what = (
        f"{percent(float(met.mean()))} of the frames have a true match within {radius_m:g} m in "
        f"another run, {np.median(positives):.0f} in the median"
    )
    if not alone:
        return ok(check, what)
    names = ", ".join(f"{table.runs[k]} ({percent(shares[k])})" for k in alone[:5])
    return Finding(
        check=check,
        level="warn",
        what=f"{what}; hardly any in {names}{' ...' if len(alone) > 5 else ''}",
        why=why,
        remedy="If these runs drove the same roads, their world frames differ: bring them into one "
        "(one UTM zone, one origin). Else leave them out.",
        frames=examples(table, np.flatnonzero(np.isin(table.run, alone))),
    )


def leakage(table: Table, radius_m: float) -> Finding:
    """Whether a frame that judges has a true match among those that teach."""
    check = "train/test leakage"
    xy = table.xyz[:, :2]
    teaching = np.flatnonzero(table.region == TRAIN)
    counts = {name: int((table.region == name).sum()) for name in (TRAIN, *JUDGING)}
    what = ", ".join(f"{n} {name}" for name, n in counts.items()) + " frames"
    judges = [name for name in JUDGING if counts[name]]
    if not judges or not len(teaching):
        return skip(check, f"{what}: nothing to keep apart")
    leaks = {
        name: rows[_nearest_m(xy[teaching], xy[rows]) <= radius_m]
        for name in judges
        for rows in [np.flatnonzero(table.region == name)]
    }
    if not any(len(rows) for rows in leaks.values()):
        return ok(check, f"{what}; no test or validation frame within {radius_m:g} m of training")
    share = max(len(rows) / counts[name] for name, rows in leaks.items())
    found = " and ".join(f"{len(r)} {name}" for name, r in leaks.items() if len(r))
    return Finding(
        check=check,
        level="fail" if share > LEAK_FAIL_SHARE else "warn",
        what=f"{found} frames lie within {radius_m:g} m of a training frame ({what})",
        why="The network has seen these places: recall on them says how well it remembers, not how "
        "well it recognises.",
        remedy="Leave a strip that nobody uses between regions: adafusion split with a --buffer-m "
        "above the radius.",
        frames=examples(table, np.concatenate(list(leaks.values()))),
    )


def _nearest_m(
    xy: Float[np.ndarray, "n 2"], to: Float[np.ndarray, "k 2"]
) -> Float[np.ndarray, " k"]:
    """From each place of `to` to the nearest of `xy`."""
    return np.asarray(cKDTree(xy).query(to)[0])


def regions(table: Table, named: tuple[str, ...]) -> Finding:
    """Whether every region that the dataset names holds frames."""
    check = "regions"
    if not named:
        return skip(check, "none named: every frame teaches, none can judge; see adafusion split")
    counts = {name: int((table.region == name).sum()) for name in (TRAIN, *named)}
    what = ", ".join(f"{name} {n}" for name, n in counts.items()) + " frames"
    empty = [name for name in named if name in JUDGING and not counts[name]]
    if not empty:
        return ok(check, what)
    return Finding(
        check=check,
        level="warn",
        what=f"no frame in {' and '.join(empty)} ({what})",
        why="Training chooses by the validation region and evaluation asks the test region.",
        remedy="Cut regions where the runs drove: adafusion split.",
    )
