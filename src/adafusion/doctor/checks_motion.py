# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Times and poses of all frames: can a vehicle have moved like this?"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.lib.stride_tricks import sliding_window_view

from adafusion.doctor.findings import Finding, by_run, examples, judge, ok, percent, skip
from adafusion.doctor.table import Table

# Median speed of a run that moves. Slower than any robot, faster than any car on a road: then
# positions are not metres (degrees, kilometres) or times not microseconds.
SLOWEST_M_S, FASTEST_M_S = 0.05, 70.0
MOVING_M = 0.05  # a step below this is noise of a vehicle that stands

# Travel between image, cloud and pose of one frame. Half a metre is a voxel of the usual grid;
# at five metres the sensors show different places.
APART_WARN_M, APART_FAIL_M = 0.5, 5.0
APART_SHARE = 0.01  # of the frames; a lost message now and then does no harm

# A jump is a step much longer than its neighbours that no vehicle can make: it accelerates
# harder than tyres hold (about 1 g), or it is far faster than the run mostly is.
JUMP_STEPS, JUMP_EXTRA_M = 2.0, 2.0  # longer than twice the local step, and 2 m
JUMP_M_S2, JUMP_SPEEDS = 9.81, 3.0  # times the upper quartile of the run's speed
JUMP_WINDOW = 11  # steps that are local
JUMP_FAIL_SHARE = 0.01

# Angle between body x and the direction of travel, median of a run. Bends and side slip stay
# below the first; beyond the second the axes are others than the package's.
HEADING_WARN_RAD, HEADING_FAIL_RAD = np.deg2rad(15), np.deg2rad(45)
HEADING_STEP_M = 1.0  # shorter steps have no direction worth the name

# Roads and ramps stay below 30 degrees (58 %): beyond it axes are mixed up or angles in degrees.
TILT_RAD, TILT_SHARE = np.deg2rad(30), 0.01
TILT_MEDIAN_RAD = np.deg2rad(10)  # on the whole a run is level

STILL_M, STILL_SHARE = 0.1, 0.2  # frames of one place teach nothing new and weigh twice


def speed(table: Table) -> Finding:
    """Whether positions are metres and times microseconds."""
    check, wrong = "speed", []
    told = []
    for run, own in by_run(table, table.steps):
        moved = own & (table.step_m > MOVING_M)
        steps = moved if moved.any() else own
        median = float(np.median((table.step_m / table.step_s)[steps]))
        told.append(median)
        if not SLOWEST_M_S <= median <= FASTEST_M_S:
            wrong.append(f"{run}: {median:.3g} m/s")
    if not told:
        return skip(check, "no run has two frames")
    if not wrong:
        return ok(check, f"runs move at {min(told):.1f} to {max(told):.1f} m/s (median of each)")
    return Finding(
        check=check,
        level="fail",
        what=f"median speed {'; '.join(wrong[:3])}{' ...' if len(wrong) > 3 else ''}",
        why="No vehicle moves so: positions are not metres (degrees? kilometres? scaled?) or times "
        "not microseconds. Every distance, so every true match, is wrong.",
        remedy="Convert positions to metres (UTM or a local plane) and times to microseconds, then "
        "prepare again.",
    )


def time_sync(table: Table) -> Finding:
    """Image, cloud and pose of a frame are of one moment."""
    check = "time sync"
    has = {
        sensor: np.array([getattr(f, sensor) is not None for f in table.frames])
        for sensor in ("image", "cloud")
    }
    told = np.array([(f.image_time_us, f.cloud_time_us) != (None, None) for f in table.frames])
    if not told.any():
        return skip(check, "the dataset gives image, cloud and pose one common time")
    image_us = np.where(has["image"], table.image_us, table.time_us)
    cloud_us = np.where(has["cloud"], table.cloud_us, table.time_us)
    times = np.stack([table.time_us, image_us, cloud_us])
    gap_s = np.ptp(times, axis=0) * 1e-6
    travel_m = gap_s * table.speed_m_s
    both = has["image"] & has["cloud"]
    offset_ms = float(np.median((image_us - cloud_us)[both])) * 1e-3 if both.any() else 0.0
    what = (
        f"image - cloud {offset_ms:+.0f} ms in the median; all three within {1e3 * gap_s.max():.0f}"
        f" ms and {travel_m.max():.2f} m of travel at worst"
    )
    far, apart = (np.mean(travel_m > limit) > APART_SHARE for limit in (APART_FAIL_M, APART_WARN_M))
    if not apart:
        return ok(check, what)
    return Finding(
        check=check,
        level="fail" if far else "warn",
        what=f"{what}; {percent(float(np.mean(travel_m > APART_WARN_M)))} of the frames above "
        f"{APART_WARN_M} m",
        why="Image and cloud show different places: the fused descriptor describes neither, and "
        "projections are off.",
        remedy="Correct the constant offset of a sensor's clock, or prepare with a smaller "
        "--slop-ms.",
        frames=examples(table, np.argsort(-travel_m)),
    )


def jumps(table: Table) -> Finding:
    """Positions that no vehicle can have driven."""
    check = "pose jumps"
    rows = table.steps[_jump_steps(table)]
    # a single wrong pose makes a step to it and one back: one event
    events = rows[np.diff(rows, prepend=-9) > 1]
    if not len(table.steps):
        return skip(check, "no run has two frames")
    if not len(events):
        return ok(check, f"none in {len(table.steps)} steps")
    return Finding(
        check=check,
        level=judge(len(events) / len(table.steps), warn=0.0, fail=JUMP_FAIL_SHARE),
        what=f"{len(events)} in {len(table.steps)} steps; the longest step "
        f"{table.step_after[rows].max():.0f} m",
        why="Frames after a jump bear the place of another: true matches become wrong ones, and "
        "the map answers with false poses.",
        remedy="Take smoothed or RTK poses, or cut the run where they jump.",
        frames=examples(table, events + 1),
    )


def _jump_steps(table: Table) -> Bool[np.ndarray, " s"]:
    """Which of the table's steps are jumps."""
    found = np.zeros(len(table.steps), dtype=bool)
    velocity = (table.xyz[table.steps + 1] - table.xyz[table.steps]) / table.step_s[:, None]
    for _, own in by_run(table, table.steps):
        step_m, step_s, v = table.step_m[own], table.step_s[own], velocity[own]
        pace = np.linalg.norm(v, axis=1)
        long = step_m > JUMP_STEPS * _local_median(step_m) + JUMP_EXTRA_M
        change = np.linalg.norm(np.diff(v, axis=0), axis=1) / ((step_s[1:] + step_s[:-1]) / 2)
        harsh = np.zeros(len(v), dtype=bool)
        harsh[1:] |= change > JUMP_M_S2
        harsh[:-1] |= change > JUMP_M_S2
        fast = pace > JUMP_SPEEDS * np.quantile(pace, 0.75)
        found[own] = (long & (harsh | fast)) | (pace > FASTEST_M_S)
    return found


def _local_median(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    reach = min(JUMP_WINDOW, len(values)) // 2
    padded = np.pad(values, reach, mode="reflect") if reach < len(values) else values
    if len(padded) < 2 * reach + 1:
        return np.full(len(values), np.median(values))
    return np.asarray(np.median(sliding_window_view(padded, 2 * reach + 1), axis=1))[: len(values)]


def heading(table: Table) -> Finding:
    """Whether the vehicle drives the way its body frame looks."""
    check = "heading"
    use = (table.step_m > HEADING_STEP_M) & table.has_pose[table.steps]
    use &= table.has_pose[table.steps + 1]
    rows = table.steps[use]
    if not len(rows):
        return skip(check, "no pose has an orientation, or nothing moves")
    angle = _drift_rad(table, rows)
    worst = 0.0
    runs_of: dict[str, list[str]] = {}  # by what is wrong with them: mostly the same thing
    for run, own in by_run(table, rows):
        off = float(np.median(np.abs(angle[own])))
        worst = max(worst, off)
        if off > HEADING_WARN_RAD:
            runs_of.setdefault(_in_words(angle[own]), []).append(run)
    level = judge(worst, warn=HEADING_WARN_RAD, fail=HEADING_FAIL_RAD)
    if level == "ok":
        return ok(check, f"body x within {np.rad2deg(worst):.0f} deg of the travel in every run")
    return Finding(
        check=check,
        level=level,
        what="; ".join(f"{', '.join(runs[:3])}: {words}" for words, runs in runs_of.items()),
        why="The body frame is x forward, y left, z up. With other axes the clouds lie turned in "
        "the voxel grid, runs disagree, and poses given out are wrong.",
        remedy="Check that poses map body to world (not the reverse), the order of the quaternion "
        "(x y z w), and the axes of the unit that gave them.",
        frames=examples(table, rows[np.argsort(-np.abs(angle))]),
    )


def _drift_rad(table: Table, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """From where the body looks (mean of both ends) to where it goes, counter-clockwise."""
    go = (table.xyz[rows + 1] - table.xyz[rows])[:, :2]
    look = table.T_world_body[rows, :2, 0] + table.T_world_body[rows + 1, :2, 0]
    cross = look[:, 0] * go[:, 1] - look[:, 1] * go[:, 0]
    return np.arctan2(cross, (look * go).sum(axis=1))


def _in_words(angle: Float[np.ndarray, " n"]) -> str:
    mean = np.exp(1j * angle).mean()
    degrees = np.rad2deg(np.angle(mean))
    if abs(mean) < 0.7:
        return "no constant angle between body x and the travel (poses inverted? xyzw mixed up?)"
    if abs(degrees) > 135:
        return f"the vehicle seems to drive backwards ({degrees:+.0f} deg)"
    if abs(degrees) > 45:
        return f"the vehicle seems to drive sideways ({degrees:+.0f} deg)"
    return f"body x is {degrees:+.0f} deg off the travel"


def tilt(table: Table) -> Finding:
    """Roll and pitch that a road allows."""
    check = "tilt"
    rows = np.flatnonzero(table.has_pose)
    if not len(rows):
        return skip(check, "no pose has an orientation")
    angle = np.arccos(np.clip(table.T_world_body[rows, 2, 2], -1, 1))
    share, median = float(np.mean(angle > TILT_RAD)), float(np.median(angle))
    what = f"median {np.rad2deg(median):.1f} deg, at most {np.rad2deg(angle.max()):.1f} deg"
    if share <= TILT_SHARE and median <= TILT_MEDIAN_RAD:
        return ok(check, what)
    return Finding(
        check=check,
        level="fail" if share > TILT_SHARE else "warn",
        what=f"{what}; {percent(share)} of the frames above {np.rad2deg(TILT_RAD):.0f} deg",
        why="The z axis of body or world does not point up, or angles are in the wrong unit or "
        "order: clouds lie askew in the voxel grid.",
        remedy="Turn z-down frames (north-east-down) over; check roll, pitch, yaw for unit and "
        "order.",
        frames=examples(table, rows[np.argsort(-angle)]),
    )


def ins(table: Table, radius_m: float) -> Finding:
    """How far what a GPS/INS unit said is from the pose that counts as true."""
    check = "GPS/INS"
    rows = np.array([i for i, f in enumerate(table.frames) if f.T_world_ins is not None], np.int64)
    if not len(rows):
        return skip(check, "no pose of a GPS/INS unit is kept apart")
    there = np.array([f.T_world_ins for f in table.frames if f.T_world_ins is not None])
    off_m = np.linalg.norm(there[:, :2, 3] - table.xyz[rows, :2], axis=1)
    median, high = np.quantile(off_m, (0.5, 0.95))
    what = f"{median:.1f} m from the pose in the median, 95 % within {high:.1f} m"
    # within half the radius it errs as units do; a median beyond it is another world frame
    if high <= radius_m / 2:
        return ok(check, what)
    return Finding(
        check=check,
        level="fail" if median > radius_m else "warn",
        what=what,
        why=f"One of the two is wrong by as much as true matches may be apart ({radius_m:g} m): "
        "which pairs are true depends on which is believed.",
        remedy="Check that both are in one world frame and of one time; train on the better one.",
        frames=examples(table, rows[np.argsort(-off_m)]),
    )


def standing(table: Table) -> Finding:
    """Frames taken while the vehicle stood."""
    check = "standing still"
    if not len(table.steps):
        return skip(check, "no run has two frames")
    still = table.step_m < STILL_M
    what = (
        f"{percent(float(still.mean()))} of the frames are within {STILL_M} m of the one before; "
        f"a step is {np.median(table.step_m):.1f} m in the median"
    )
    if still.mean() <= STILL_SHARE:
        return ok(check, what)
    return Finding(
        check=check,
        level="warn",
        what=what,
        why="Places where the vehicle waited weigh more than others, in training and in recall, "
        "and fill the map.",
        remedy="Prepare with --every-m 5 or so: one frame for so many metres of travel.",
        frames=examples(table, table.steps[still] + 1),
    )
