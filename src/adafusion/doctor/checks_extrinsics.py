# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration: is it whole, and does it put the cloud into the image?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from adafusion.doctor.calibration import CameraModel
from adafusion.doctor.findings import Finding, by_run, examples, judge, ok, percent, skip
from adafusion.doctor.looks import Look
from adafusion.doctor.table import Table

# Share of a cloud's points in the image, median of a run. A camera of 60 degrees sees a sixth of
# a full turn; a telephoto lens on a rear half still a few percent.
VIEW_WARN, VIEW_FAIL = 0.02, 0.002
# The optical axis pierces the image near its middle. Beyond the middle half K is of another
# size of the image: it was resized or cropped without K.
MIDDLE = (0.25, 0.75)
# Stored upright, an image has its down side down, give or take the slant of a mount.
UPRIGHT_RAD = np.deg2rad(45)
HEIGHTS_M = (-0.5, 6.0)  # of a camera above the ground under its vehicle


def check_extrinsics(
    table: Table,
    looks: Sequence[Look],
    cameras: Mapping[str, CameraModel | str],
    *,
    metric: bool,
) -> list[Finding]:
    """Intrinsics against the image's size, then points in view; `metric`: clouds are metres."""
    lacking = [why for why in cameras.values() if isinstance(why, str)]
    if len(lacking) == len(cameras):
        why = f"not checked: {lacking[0]}"
        return [skip(name, why) for name in ("intrinsics", "camera pose", "projection")]
    models = {run: c for run, c in cameras.items() if not isinstance(c, str)}
    inner, outer = intrinsics(table, looks, models), camera_pose(models)
    if not metric:
        return [inner, outer, skip("projection", "not judged: clouds are no metres")]
    if inner.level == "fail":
        return [inner, outer, skip("projection", "not judged: see intrinsics")]
    return [inner, outer, projection(table, looks)]


def intrinsics(table: Table, looks: Sequence[Look], cameras: Mapping[str, CameraModel]) -> Finding:
    """Whether K belongs to images of this size."""
    check = "intrinsics"
    wrong: Counter[str] = Counter()
    rows = []
    fields = []
    for look in looks:
        camera = cameras.get(table.frames[look.row].run)
        if look.image is None or camera is None:
            continue
        height, width = look.image.size
        centre = camera.K[0, 2] / width, camera.K[1, 2] / height
        fields.append(2 * np.rad2deg(np.arctan(width / 2 / camera.K[0, 0])))
        if not all(MIDDLE[0] <= c <= MIDDLE[1] for c in centre):
            rows.append(look.row)
            cx, cy = camera.K[:2, 2]
            wrong[f"{width} x {height}, but K centred on {cx:.0f}, {cy:.0f}"] += 1
    if not fields:
        return skip(check, "no image with a calibration was opened")
    if not rows:
        return ok(check, f"centred; {np.median(fields):.0f} deg wide")
    return Finding(
        check=check,
        level="fail",
        what=f"images are {wrong.most_common(1)[0][0]} ({len(rows)} of {len(fields)})",
        why="K is of another size: images were resized or cropped and K was not. Points are "
        "projected to wrong pixels.",
        remedy="Scale fx, cx by the width's factor, fy, cy by the height's; take the corner of the "
        "crop off cx, cy.",
        frames=examples(table, rows),
    )


def camera_pose(cameras: Mapping[str, CameraModel]) -> Finding:
    """Whether the camera sits on a vehicle and its images stand upright."""
    check = "camera pose"
    wrong, words = [], ""
    for run, camera in cameras.items():
        R, (x, y, z) = camera.T_body_camera[:3, :3], camera.T_body_camera[:3, 3]
        ahead, left, up = R[:, 2]
        aside, above = (
            np.rad2deg(np.arctan2(left, ahead)),
            np.rad2deg(np.arcsin(np.clip(up, -1, 1))),
        )
        words = (
            f"at x {x:.2f}, y {y:.2f}, z {z:.2f} m; looks {_turned(aside, 'left', 'right')} of "
            f"ahead, {_turned(above, 'up', 'down')}"
        )
        if -R[2, 1] < np.cos(UPRIGHT_RAD):
            wrong.append(f"{run}: the image's down side is not down; {words}")
        elif not HEIGHTS_M[0] <= z <= HEIGHTS_M[1]:
            wrong.append(f"{run}: {words}")
    if not wrong:
        return ok(check, words)
    return Finding(
        check=check,
        level="warn",
        what=wrong[0],
        why="T_body_camera is of the sensor's own frame (z up?), inverted, or images lie on their "
        "side.",
        remedy="T_body_camera maps the camera's axes (x right, y down, z forward) to the body (x "
        "forward, y left, z up, origin on the ground). Turn images upright, and K with them.",
    )


def _turned(degrees: float, positive: str, negative: str) -> str:
    shown = round(degrees, 1)
    return f"{abs(shown):.1f} deg {positive if shown >= 0 else negative}"


def projection(table: Table, looks: Sequence[Look]) -> Finding:
    """Whether the camera looks at what the LiDAR sees."""
    check = "projection"
    seen = [(k.row, k.cloud.in_view) for k in looks if k.cloud and k.cloud.in_view is not None]
    if not seen:
        return skip(check, "no frame with image, cloud and calibration was opened")
    rows = np.array([row for row, _ in seen])
    shares = np.array([share for _, share in seen])
    run, least = min(
        ((run, float(np.median(shares[own]))) for run, own in by_run(table, rows)),
        key=lambda pair: pair[1],
    )
    level = judge(-least, warn=-VIEW_WARN, fail=-VIEW_FAIL)
    what = f"{percent(least)} of the points fall into the image (median of {run})"
    if level == "ok":
        return ok(check, f"{what}; whether onto the right things only pictures show")
    return Finding(
        check=check,
        level=level,
        what=what,
        why="The camera would look where the LiDAR sees nothing: T_body_camera is inverted, its "
        "axes are not x right, y down, z forward, or it is of another vehicle.",
        remedy="T_body_camera maps camera to body. Its third column is where the camera looks, in "
        "the body frame: about (1, 0, 0) for a camera that looks ahead.",
        frames=examples(table, rows[np.argsort(shares)]),
    )
