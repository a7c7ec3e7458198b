# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds that were opened: scale, size, height, and how they sit in the voxel grid.

One wrong scale or height spoils every number after it, so the checks are asked in order and those
behind a failure are skipped.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from adafusion.doctor.findings import Finding, by_run, examples, judge, ok, percent, skip
from adafusion.doctor.looks import CloudLook, Look
from adafusion.doctor.table import Table
from adafusion.preprocess import VoxelGrid

# 99th percentile of the range, median of a run. Submaps scaled into [-1, 1] reach at most
# sqrt(3); a scan in the narrowest corridor reaches further. No LiDAR of a vehicle reaches 500 m:
# beyond are millimetres, or world coordinates.
SMALLEST_M, LARGEST_M = 1.8, 500.0
FEW_POINTS = 400  # a voxel grid with fewer shows a handful of things
FEW_OF_USUAL = 0.2  # of the run's median: a scan cut off
FEW_FAIL_SHARE = 0.1

# |z| of the ground, median of a run. Sound drives stay below 0.1 m (camber, the vehicle's springs,
# one height of the sensor for all vehicles); at 0.25 m what stands lies two layers of the usual
# grid off.
GROUND_WARN_M, GROUND_FAIL_M = 0.25, 1.0

BOX_WARN, BOX_FAIL = 0.1, 0.02  # share of the points in the voxel box, median of a run
CELLS_WARN, CELLS_FAIL = 150.0, 30.0  # occupied cells, median of a run

# Median over pairs of neighbouring frames of Look.misfit. Right poses give 0.1 to 0.3, fog 0.5;
# wrong axes give 1 and more.
MISFIT_WARN, MISFIT_FAIL = 0.6, 0.85
MISFIT_PAIRS = 5  # with fewer one strange pair decides


def check_clouds(
    table: Table, looks: Sequence[Look], grid: VoxelGrid, *, normalised: bool
) -> list[Finding]:
    """All checks of clouds; `normalised` where the dataset says that clouds have no metres."""
    seen = [(look.row, look.cloud) for look in looks if look.cloud]
    if not seen:
        return [skip("cloud scale", "no cloud was opened")]
    rows = np.array([row for row, _ in seen])
    clouds = [cloud for _, cloud in seen]
    size = few_points(table, rows, clouds)
    if normalised:
        why = "not applicable: clouds are scaled into [-1, 1], as the dataset says"
        return [size, *(skip(name, why) for name in ("cloud scale", "ground", "voxel grid"))]
    reach, height = scale(table, rows, clouds), ground(table, rows, clouds)
    if reach.level == "fail":
        why = "not judged: see cloud scale"
        return [size, reach, skip("ground", why), skip("voxel grid", why)]
    if height.level == "fail":
        return [size, reach, height, skip("voxel grid", "not judged: see ground")]
    return [size, reach, height, voxels(table, rows, clouds, grid)]


def few_points(table: Table, rows: Int[np.ndarray, " n"], clouds: Sequence[CloudLook]) -> Finding:
    """Whether clouds hold enough points."""
    points = np.array([cloud.points for cloud in clouds])
    few = points < FEW_POINTS
    for _, own in by_run(table, rows):
        few |= own & (points < FEW_OF_USUAL * np.median(points[own]))
    check = "cloud size"
    what = f"{points.min():,} to {points.max():,} points, {np.median(points):,.0f} in the median"
    if not few.any():
        return ok(check, what)
    return Finding(
        check=check,
        level=judge(float(few.mean()), warn=0.0, fail=FEW_FAIL_SHARE),
        what=f"{few.sum()} of {len(few)} clouds are tiny ({what})",
        why="A scan that was cut off or lost its packets describes no place.",
        remedy="Leave these frames out, or join several scans; look at the LiDAR's driver.",
        frames=examples(table, rows[few]),
    )


def scale(table: Table, rows: Int[np.ndarray, " n"], clouds: Sequence[CloudLook]) -> Finding:
    """Whether clouds are metres around the vehicle."""
    check = "cloud scale"
    reach = _medians(table, rows, [cloud.range_m for cloud in clouds])
    wrong = {run: r for run, r in reach.items() if not SMALLEST_M <= r <= LARGEST_M}
    if not wrong:
        return ok(check, f"99 % of the points within {max(reach.values()):.0f} m of the vehicle")
    run, value = next(iter(wrong.items()))
    return Finding(
        check=check,
        level="fail",
        what=f"{len(wrong)} of {len(reach)} runs; in {run} 99 % of the points lie within "
        f"{value:.3g} of the origin",
        why="These are no metres in the body frame: the voxel box (metres) holds one cell of such a"
        " cloud, or none.",
        remedy="Scaled into [-1, 1]: multiply by the metres of the scale, or say sensors: "
        "{cloud_unit: normalised} in dataset.yaml. Millimetres: divide. World coordinates: take "
        "off the pose.",
        frames=examples(table, rows),
    )


def ground(table: Table, rows: Int[np.ndarray, " n"], clouds: Sequence[CloudLook]) -> Finding:
    """Whether z = 0 is the ground under the vehicle."""
    check = "ground"
    heights = _medians(table, rows, [cloud.ground_m for cloud in clouds])
    known = {run: h for run, h in heights.items() if np.isfinite(h)}
    if not known:
        return skip(check, "no cloud shows enough of it to find it")
    run = max(known, key=lambda r: abs(known[r]))
    own = rows[table.run[rows] == table.runs.index(run)]
    level = judge(abs(known[run]), warn=GROUND_WARN_M, fail=GROUND_FAIL_M)
    what = f"at z = {round(known[run], 2) + 0.0:+.2f} m in {run}, median over its frames"
    if hangs := _hanging(table, rows, clouds):
        return Finding(
            check=check,
            level="fail",
            what=f"more lies below z = -1 m than above z = 1 m, in {', '.join(hangs[:3])}",
            why="Clouds are upside down: the voxel box begins at the ground and holds none of it.",
            remedy="Turn them over: x forward, y left, z up (y and z change their signs).",
            frames=examples(table, rows[table.run[rows] == table.runs.index(hangs[0])]),
        )
    if level == "ok":
        return ok(check, f"{what}; near enough to 0")
    return Finding(
        check=check,
        level=level,
        what=what,
        why="The body frame has z = 0 on the ground. The voxel box begins there: what is below is "
        "cut off, and weights trained elsewhere see shifted layers.",
        remedy=f"Prepare with the LiDAR {abs(known[run]):.2f} m "
        f"{'higher' if known[run] < 0 else 'lower'} (--lidar-height-m), or mend T_body_lidar.",
        frames=examples(table, own),
    )


def _hanging(table: Table, rows: Int[np.ndarray, " n"], clouds: Sequence[CloudLook]) -> list[str]:
    """Runs whose ground is about where it should be, and under which everything hangs."""
    heights = _medians(table, rows, [cloud.ground_m for cloud in clouds])
    excess = _medians(table, rows, [cloud.below - cloud.above for cloud in clouds])
    return [run for run in excess if excess[run] > 0 and abs(heights[run]) <= GROUND_FAIL_M]


def voxels(
    table: Table, rows: Int[np.ndarray, " n"], clouds: Sequence[CloudLook], grid: VoxelGrid
) -> Finding:
    """Whether the voxel grid holds the cloud."""
    check = "voxel grid"
    inside = _medians(table, rows, [cloud.in_box for cloud in clouds])
    cells = _medians(table, rows, [float(cloud.occupied) for cloud in clouds])
    run = min(inside, key=lambda r: (min(inside[r] / BOX_WARN, 1), cells[r]))
    level = max(
        judge(-inside[run], warn=-BOX_WARN, fail=-BOX_FAIL),
        judge(-cells[run], warn=-CELLS_WARN, fail=-CELLS_FAIL),
        key=("ok", "warn", "fail").index,
    )
    total = int(np.prod(grid.shape))
    what = (
        f"{percent(inside[run])} of the points in the box, {cells[run]:,.0f} cells occupied "
        f"({100 * cells[run] / total:.2f} %), medians of {run}"
    )
    if level == "ok":
        return ok(check, what)
    return Finding(
        check=check,
        level=level,
        what=what,
        why="The network sees an almost empty grid: nothing tells places apart.",
        remedy=f"Fit the box (x {grid.lower_m[0]:g} to {grid.upper_m[0]:g}, z {grid.lower_m[2]:g} "
        f"to {grid.upper_m[2]:g} m) to the scene: model.preprocess.voxels. Check that clouds are "
        "centred on the vehicle.",
        frames=examples(table, rows[table.run[rows] == table.runs.index(run)]),
    )


def motion(table: Table, looks: Sequence[Look]) -> Finding:
    """Whether clouds of neighbouring frames fit where the poses put them."""
    check = "clouds and poses"
    pairs = [(look.row, look.misfit) for look in looks if look.misfit is not None]
    if not pairs:
        return skip(check, "no two neighbouring clouds to compare, or nothing stands about them")
    rows = np.array([row for row, _ in pairs])
    misfit = np.array([value for _, value in pairs])
    worst = {
        run: float(np.median(misfit[own]))
        for run, own in by_run(table, rows)
        if own.sum() >= MISFIT_PAIRS
    }
    if not worst:
        return skip(check, f"{len(pairs)} pairs of neighbouring clouds are too few to judge")
    run = max(worst, key=lambda r: worst[r])
    level = judge(worst[run], warn=MISFIT_WARN, fail=MISFIT_FAIL)
    what = (
        f"moved as the poses say, neighbouring clouds lie {worst[run]:.2f} times as far apart as "
        f"unmoved (median of {run})"
    )
    if level == "ok":
        return ok(check, what)
    return Finding(
        check=check,
        level=level,
        what=what,
        why="Poses do not describe the motion that the LiDAR saw: axes of cloud or pose are mixed "
        "up, the cloud is mirrored, or pose and cloud are of different times.",
        remedy="Check T_body_lidar (x forward, y left, z up), that poses map body to world, and the"
        " clock of the poses.",
        frames=examples(table, rows[np.argsort(-misfit)]),
    )


def _medians(
    table: Table, rows: Int[np.ndarray, " n"], values: Sequence[float]
) -> dict[str, float]:
    """Median of the known values of each run; NaN where there is none."""
    array: Float[np.ndarray, " n"] = np.array(values)
    medians = {}
    for run, own in by_run(table, rows):
        known = array[own][np.isfinite(array[own])]
        medians[run] = float(np.median(known)) if len(known) else float("nan")
    return medians
