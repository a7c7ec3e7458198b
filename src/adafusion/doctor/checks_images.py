# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Images that were opened: sizes, and whether there is anything to see."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from adafusion.doctor.findings import Finding, examples, judge, ok, percent, skip
from adafusion.doctor.looks import ImageLook, Look
from adafusion.doctor.table import Table

# Grey values, 0 to 255. Unlit streets by night stay above it somewhere in the upper 5 % of the
# image; a covered lens, a failed trigger or an exposure stuck at its least does not.
BLACK = 12.0
WHITE_SHARE = 0.5  # of the pixels at the upper end: sun or a stuck exposure wipes the scene out
BLANK_SPREAD = 2.0  # less is one colour and noise
SPOILT_FAIL_SHARE = 0.3  # of the images of the sample


def sizes(table: Table, looks: Sequence[Look]) -> Finding:
    """Whether all images have one size."""
    check = "image size"
    found = Counter(look.image.size for look in looks if look.image)
    if not found:
        return skip(check, "no image was opened")
    words = ", ".join(f"{w} x {h} ({n})" for (h, w), n in found.most_common(4))
    if len(found) == 1:
        return ok(check, words)
    usual = found.most_common(1)[0][0]
    return Finding(
        check=check,
        level="warn",
        what=f"{len(found)} sizes: {words}",
        why="All are resized to what the network takes: another shape is stretched another way, "
        "and one K cannot be right for two sizes.",
        remedy="Prepare all runs from one camera at one resolution.",
        frames=examples(table, [k.row for k in looks if k.image and k.image.size != usual]),
    )


def exposure(table: Table, looks: Sequence[Look]) -> Finding:
    """Whether images show anything."""
    check = "exposure"
    seen = [look for look in looks if look.image]
    if not seen:
        return skip(check, "no image was opened")
    spoilt: dict[str, list[int]] = {"black": [], "white": [], "blank": []}
    for look in seen:
        if look.image is not None and (name := _spoilt(look.image)):
            spoilt[name].append(look.row)
    rows = sorted(row for rows in spoilt.values() for row in rows)
    bright = np.median([look.image.bright for look in seen if look.image])
    if not rows:
        return ok(check, f"none of {len(seen)} black, white or blank; bright parts at {bright:.0f}")
    words = ", ".join(f"{len(rows)} {name}" for name, rows in spoilt.items() if rows)
    return Finding(
        check=check,
        level=judge(len(rows) / len(seen), warn=0.0, fail=SPOILT_FAIL_SHARE),
        what=f"{words} of {len(seen)} images ({percent(len(rows) / len(seen))})",
        why="The camera gives nothing there: the fused descriptor rests on the LiDAR alone.",
        remedy="Look at them. A dead camera: leave the frames out. Night or glare: keep them, the "
        "weights are to learn it; see --html.",
        frames=examples(table, rows),
    )


def _spoilt(image: ImageLook) -> str:
    if image.bright < BLACK:
        return "black"
    if image.white > WHITE_SHARE:
        return "white"
    return "blank" if image.spread < BLANK_SPREAD else ""
