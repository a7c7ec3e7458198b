# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where the identical passages lie: corridors west and east, halls north, tunnels south of town.

Each stands alone on level ground with a paved court before either door, so that a LiDAR inside
sees the same from every end; footpaths lead there.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from adafusion.sim.town.plan import Passage, Plan, Rect, Street, Zone, arc, overlaps

AWAY_M = 36.0  # from the town's outer crossings
NODE_M = 9.0  # from a door to the node before it
COURT_M = 21.0  # from a door to the end of its court
COURT_HALF_M = 15.0  # half the width of a court, and half the pitch of corridors side by side
CLEAR_HALF_M = 20.0  # half the width that nothing else enters before a door


@dataclass(frozen=True)
class PassageKind:
    """What all passages of a kind share, beside their length."""

    width_m: float
    height_m: float
    outer_m: float  # width over all
    light: float  # ambient radiance inside: the lamps, bounced off the walls


PASSAGE_KINDS = {
    "corridor": PassageKind(2.6, 2.8, 11.0, 0.006),
    "hall": PassageKind(24.0, 6.0, 24.8, 0.006),
    "tunnel": PassageKind(8.0, 5.0, 26.0, 0.004),
}
HALL_M, TUNNEL_M = 40.0, 70.0


def lay_out_passages(plan: Plan, occupied: Sequence[Rect]) -> None:
    """Find room for all passages outside the town, clear of what is `occupied`, and join them.

    The crossings are the nodes so far, column by column.
    """
    spec, rects = plan.spec, list(occupied)
    grid = np.arange(spec.columns * spec.rows).reshape(spec.columns, spec.rows)
    east = spec.corridors // 2
    for kind, length, crossings, sign, count in (
        ("corridor", spec.corridor_m, grid[0], -1, spec.corridors - east),
        ("corridor", spec.corridor_m, grid[-1], 1, east),
        ("hall", HALL_M, grid[:, -1], 1, spec.halls),
        ("tunnel", TUNNEL_M, grid[:, 0], -1, spec.tunnels),
    ):
        if count:
            _stand_beside(plan, rects, crossings.tolist(), sign, kind, length, count)


def _stand_beside(
    plan: Plan,
    occupied: list[Rect],
    crossings: Sequence[int],
    sign: int,
    kind: str,
    length: float,
    count: int,
) -> None:
    """Place passages outside the outer `crossings` of one side of the town, and join them.

    They stand end to end on a way from crossing to crossing; corridors, and others where the town
    is too narrow, side by side, so that two are a round trip from one crossing.
    """
    side = 1 if kind == "corridor" else 0  # the axis along this side of the town
    at = np.array([plan.nodes[n] for n in crossings])
    in_line = length + 2 * COURT_M
    abreast = kind == "corridor" or count * in_line > np.ptp(at[:, side]) + 2.5 * AWAY_M
    step = 2 * COURT_HALF_M if abreast else in_line
    span = length if abreast else step * count
    # the two crossings whose distance suits best
    low, high = min(
        itertools.combinations(range(len(crossings)), 2),
        key=lambda pair: abs(at[pair[1], side] - at[pair[0], side] - span),
    )
    middle = float(at[[low, high], side].mean())

    def stand(out: float) -> list[Passage]:
        passages = []
        for k in range(count):
            along = round(middle if abreast else middle + (k - (count - 1) / 2) * step)
            across = round(out + sign * k * step if abreast else out)
            x, y = (across, along) if side == 1 else (along, across)
            passages.append(Passage(kind, x, y, side, length))
        return passages

    out = sign * (float((sign * at[:, 1 - side]).max()) + AWAY_M)
    while any(overlaps(p.rect(COURT_M, COURT_HALF_M), occupied) for p in stand(out)):
        out += sign * 4.0
    passages = stand(out)
    occupied.extend(p.rect(COURT_M, COURT_HALF_M) for p in passages)
    doors = [_add_passage(plan, passage) for passage in passages]
    # a way from the town comes to a court at right angles, lest it cuts through the building
    edge = np.array([-sign, 0.0] if side == 1 else [0.0, -sign]) * COURT_HALF_M
    _add_path(plan, crossings[low], doors[0][0], edge)
    if abreast and count == 2:
        _add_path(plan, doors[0][1], doors[1][1])
        _add_path(plan, doors[1][0], doors[0][0])
        return
    for (_, a), (b, _) in itertools.pairwise(doors):
        _add_path(plan, a, b)
    _add_path(plan, crossings[high], doors[-1][1], edge)


def _add_passage(plan: Plan, passage: Passage) -> tuple[int, int]:
    """Enter a passage and the way through it; gives the nodes before its doors."""
    kind, half = PASSAGE_KINDS[passage.kind], passage.length_m / 2
    across = kind.width_m / 2
    box = passage.place(np.array([(-half, -across, -0.5), (half, across, kind.height_m + 0.05)]))
    (x0, y0, z0), (x1, y1, z1) = box.min(axis=0).tolist(), box.max(axis=0).tolist()
    plan.zones.append(Zone((x0, y0, z0), (x1, y1, z1), passage.kind, True, kind.light))
    plan.passages.append(passage)
    plan.solid.append(passage.rect(0.0, kind.outer_m / 2 + 1.0))
    plan.solid.extend(court_rects(passage, CLEAR_HALF_M))
    first = len(plan.nodes)
    for x, y, _ in passage.place(np.array([(-half - NODE_M, 0, 0), (half + NODE_M, 0, 0)])):
        plan.nodes.append((float(x), float(y)))
    line = arc(np.array(plan.nodes[first]), np.array(plan.nodes[first + 1]))
    plan.streets.append(Street((first, first + 1), line, passage.kind))
    return first, first + 1


def court_rects(passage: Passage, half_width: float) -> list[Rect]:
    """The ground before either door."""
    yaw, middle = passage.quarter * math.pi / 2, (passage.length_m + COURT_M) / 2
    centres = passage.place(np.array([(-middle, 0.0, 0.0), (middle, 0.0, 0.0)]))[:, :2]
    return [(x, y, yaw, COURT_M / 2, half_width) for x, y in centres.tolist()]


def _add_path(plan: Plan, a: int, b: int, edge: Float64[np.ndarray, " 2"] | None = None) -> None:
    """A straight footpath from node a to b; with `edge` by that point, seen from b."""
    start, end = np.array(plan.nodes[a]), np.array(plan.nodes[b])
    line = arc(start, end)
    if edge is not None:
        line = np.concatenate([arc(start, end + edge)[:-1], arc(end + edge, end)])
    plan.streets.append(Street((a, b), line, "path"))
