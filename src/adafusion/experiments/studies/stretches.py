# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where the paper's demonstration says something of the weights: decided before any is known.

Each claim is found by the frames' zones, runs and positions alone. Dark to bright is the way from a
street at night into a lit hall or tunnel, for by day the camera's exposure makes both sides about
equally bright; the same doors by day stand beside it, since what else changes at a door changes
there too. Both sensors are poor between blank walls at night: no light, and no shape along the way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from jaxtyping import Int64

from adafusion.sim.town.plan import INDOORS
from adafusion.types import Frame

LEAST = 3  # frames on each side of a door without which nothing is compared there
SHOWN = 8  # frames to either side of the middle of a stretch
GAP_M = 30.0  # frames farther apart do not follow one another

Rows = Int64[np.ndarray, "_"]  # of frames; each as long as it is
Is = Callable[[Frame], bool]


@dataclass(frozen=True, kw_only=True)
class Claim:
    """Something said of alpha over its mean: at doors if there is a `before`, else inside."""

    name: str
    words: str
    reads: Literal["image", "lidar", "lead"]  # lead: the image's ratio minus the LiDAR's
    expected: Literal["above", "below", "equal", ""]  # 0; "": nothing is claimed
    inside: Is
    before: Is | None = None
    less: Claim | None = None  # its steps at the same doors are taken off
    shown: bool = True  # as a panel of the picture


def is_indoors(frame: Frame) -> bool:
    """Whether the zone is one of those with a roof."""
    return frame.zone in INDOORS


def is_outdoors(frame: Frame) -> bool:
    """Whether the zone is known and has no roof."""
    return frame.zone is not None and not is_indoors(frame)


def is_dark(frame: Frame) -> bool:
    """Whether the run was driven at night, by its name; at dusk the exposure makes up for it."""
    return "night" in frame.run


DARK_TO_BRIGHT = Claim(
    name="dark to bright",
    words="from outdoors at night into a lit hall or tunnel, the image's weight rises",
    reads="image",
    expected="above",
    before=lambda frame: is_outdoors(frame) and is_dark(frame),
    inside=lambda frame: frame.zone in ("hall", "tunnel") and is_dark(frame),
)
SAME_DOORS = Claim(
    name="the same without dark",
    words="in the other runs, where it is not dark outside",
    reads="image",
    expected="",
    before=lambda frame: is_outdoors(frame) and not is_dark(frame),
    inside=lambda frame: frame.zone in ("hall", "tunnel") and not is_dark(frame),
    shown=False,
)
CLAIMS = (
    DARK_TO_BRIGHT,
    SAME_DOORS,
    replace(
        DARK_TO_BRIGHT,
        name="what light adds",
        words="dark to bright less the steps of the other runs at the same doors is above 0",
        less=SAME_DOORS,
        shown=False,
    ),
    Claim(
        name="into a corridor",
        words="from outdoors into a narrow corridor, the LiDAR's weight falls",
        reads="lidar",
        expected="below",
        before=is_outdoors,
        inside=lambda frame: frame.zone == "corridor",
    ),
    Claim(
        name="indoor",
        words="the camera leads",
        reads="lead",
        expected="above",
        inside=is_indoors,
    ),
    Claim(
        name="outdoor",
        words="the LiDAR leads",
        reads="lead",
        expected="below",
        inside=is_outdoors,
    ),
    Claim(
        name="both poor",
        words="between blank walls at night the ratios are about equal",
        reads="lead",
        expected="equal",
        inside=lambda frame: frame.zone == "blank wall" and is_dark(frame),
    ),
)


@dataclass(frozen=True, eq=False)
class Stay:
    """Consecutive frames inside, and those just before them that lie outside; rows of frames."""

    before: Rows  # the last one lies next to the first inside; empty where there is no door
    inside: Rows


def stays(claim: Claim, frames: Sequence[Frame]) -> list[Stay]:
    """Every longest piece of consecutive frames that the claim is about.

    Frames are in the order of each run's time. With a `before`, only pieces entered from there,
    and both sides at least `LEAST` frames long.
    """
    is_inside = [claim.inside(frame) for frame in frames]
    is_before = [claim.before is not None and claim.before(frame) for frame in frames]
    follows = [False, *(_follows(a, b) for a, b in pairwise(frames))]
    found = []
    for row, inside in enumerate(is_inside):
        if not inside or (follows[row] and is_inside[row - 1]):
            continue  # not the first of its piece
        stop, start = row + 1, row
        while stop < len(frames) and follows[stop] and is_inside[stop]:
            stop += 1
        while follows[start] and is_before[start - 1]:
            start -= 1
        if claim.before is None or min(row - start, stop - row) >= LEAST:
            found.append(Stay(np.arange(start, row), np.arange(row, stop)))
    return found


def _follows(a: Frame, b: Frame) -> bool:
    apart = np.hypot(*np.subtract(b.position_m, a.position_m)[:2])
    return a.run == b.run and bool(apart <= GAP_M)


def choose_stretch(claim: Claim, frames: Sequence[Frame]) -> tuple[Rows, int | None] | None:
    """Rows of the stretch to show, and which of them is the first behind the door.

    The one with the most frames to show, the first of equals: `SHOWN` to either side of the door,
    or from the middle of the longest stay. None where the frames have no such stretch.
    """
    found = stays(claim, frames)
    if not found:
        return None
    if claim.before is None:
        inside = max((stay.inside for stay in found), key=len)
        middle = len(inside) // 2
        return inside[max(middle - SHOWN, 0) : middle + SHOWN], None
    sides = [(stay.before[-SHOWN:], stay.inside[:SHOWN]) for stay in found]
    before, inside = max(sides, key=lambda side: len(side[0]) + len(side[1]))
    return np.concatenate([before, inside]), len(before)
