# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A drive through a world: which streets in which order, and where exactly one run's frames are."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from adafusion.geometry import pose
from adafusion.sim.conditions import Conditions
from adafusion.sim.numeric import keyed_rng
from adafusion.sim.plan import offset_line
from adafusion.sim.world import World

STEP_M = 0.5  # of the dense path
LANE_M = -1.2  # lateral middle of the lane driven: right of the street's middle line
PARK_REACH_M = 22.0  # a frame this near to a park counts as one of it


@dataclass(frozen=True, eq=False)
class Drive:
    """Keyframes of one run."""

    T_world_body: Float64[np.ndarray, "n 4 4"]
    timestamp_us: Int64[np.ndarray, " n"]
    zone: tuple[str, ...]  # "street", "park", "path", "corridor"
    path: Float64[np.ndarray, "m 2"]  # where the vehicle went, densely, metres


def plan_route(world: World) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
    """Middle line of a drive over every street and corridor, and the lane's lateral offset on it.

    Goes on to the nearest street not yet driven; the same for all runs of a world.
    """
    weights, rows, columns = [], [], []
    for street in world.streets:
        weights.append(float(np.hypot(*np.diff(street.line, axis=0).T).sum()))
        rows.append(street.ends[0])
        columns.append(street.ends[1])
    n = len(world.nodes)
    graph = coo_array((weights, (rows, columns)), shape=(n, n)).tocsr()
    distance, previous = dijkstra(graph, directed=False, return_predecessors=True)
    by_ends = {frozenset(street.ends): k for k, street in enumerate(world.streets)}
    waiting = set(range(len(world.streets)))
    corridors = [k for k, street in enumerate(world.streets) if street.kind == "corridor"]
    # begin at the way into the first corridor: short drives have one too
    node = world.streets[corridors[0]].ends[0] if corridors else 0
    order: list[tuple[int, bool]] = []  # street, driven backwards
    arrived_from = -1
    while waiting:
        here = node

        def cost(k: int, here: int = here, back: int = arrived_from) -> tuple[float, bool, int]:
            a, b = world.streets[k].ends
            turn = 60.0 if back in (a, b) and here in (a, b) else 0.0  # no U-turns where avoidable
            through = world.streets[k].kind == "corridor"
            return min(distance[here, a], distance[here, b]) + turn, not through, k

        target = min(waiting, key=cost)
        a, b = world.streets[target].ends
        goal = a if distance[node, a] <= distance[node, b] else b
        hops = [goal]
        while hops[-1] != node:
            hops.append(int(previous[node, hops[-1]]))
        hops = [*hops[::-1], b if goal == a else a]
        for start, end in itertools.pairwise(hops):
            k = by_ends[frozenset((start, end))]
            order.append((k, world.streets[k].ends[0] != start))
            waiting.discard(k)
            arrived_from = start
        node = hops[-1]
    lines, lanes = [], []
    for k, backwards in order:
        street = world.streets[k]
        line = street.line[::-1] if backwards else street.line
        lines.append(line[:-1])
        lanes.append(np.full(len(line) - 1, LANE_M if street.kind == "street" else 0.0))
    lines.append(world.nodes[[node]])
    lanes.append(lanes[-1][-1:])
    return np.concatenate(lines), np.concatenate(lanes)


def drive(
    world: World,
    conditions: Conditions,
    run_seed: int,
    *,
    keyframe_m: float = 10.0,
    places: int | None = None,
) -> Drive:
    """Drive the route once; every random number belongs to `run_seed`.

    A frame about every `keyframe_m` metres, the first at a phase of the run's own; with `places`
    only so many. Offset from the lane and heading wander smoothly, less so indoors.
    """
    middle, lane = plan_route(world)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(middle, axis=0).T))])
    s = np.arange(0.0, along[-1], STEP_M)
    xy = np.column_stack([np.interp(s, along, middle[:, 0]), np.interp(s, along, middle[:, 1])])
    lateral = gaussian_filter1d(np.interp(s, along, lane), 6.0 / STEP_M)
    narrow = np.zeros(len(s))  # 1 indoors and at the doors
    for zone in world.zones:
        if zone.indoor:
            narrow = np.maximum(narrow, [zone.contains(x, y, 8.0) for x, y in xy])
    narrow = gaussian_filter1d(narrow.astype(float), 4.0 / STEP_M)
    xy = gaussian_filter1d(xy, 3.0 / STEP_M, axis=0, mode="nearest")  # corners are driven round

    def wander(purpose: str, sigma_m: float) -> Float64[np.ndarray, " n"]:
        noise = keyed_rng(run_seed, "drive", purpose).standard_normal(len(s))
        smooth = gaussian_filter1d(noise, sigma_m / STEP_M, mode="wrap")
        return smooth / max(float(smooth.std()), 1e-9)

    rng = keyed_rng(run_seed, "drive")
    bias = float(rng.uniform(-0.6, 0.6))
    shift = conditions.path_offset_m * np.tanh(bias + 0.5 * wander("offset", 25.0))
    lateral = lateral * (1 - narrow) + shift * ((1 - narrow) + 0.25 * narrow)
    path = offset_line(xy, lateral)
    path = gaussian_filter1d(path, 1.0 / STEP_M, axis=0, mode="nearest")
    ahead = np.gradient(gaussian_filter1d(path, 2.0 / STEP_M, axis=0, mode="nearest"), axis=0)
    heading = np.arctan2(ahead[:, 1], ahead[:, 0])
    noise = conditions.heading_noise_rad * wander("heading", 6.0)
    heading = heading + noise * (1 - 0.5 * narrow)

    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    # two rounds of the same spacing would put their frames at the same points
    keys = np.arange(float(rng.uniform(0.0, keyframe_m)), driven[-1], keyframe_m)
    keys = keys + rng.uniform(-0.15, 0.15, len(keys)) * keyframe_m
    rows = np.unique(np.clip(np.searchsorted(driven, keys), 0, len(s) - 1))[:places]
    speed = 4.5 + 1.5 * np.tanh(wander("speed", 40.0))
    clock = np.cumsum(STEP_M / speed)
    # a day of its own for every run, within one year from 2026-01-01
    begin = 1_767_225_600_000_000 + int(rng.integers(0, 365 * 86_400 * 10)) * 100_000
    jitter = rng.uniform(-math.radians(0.8), math.radians(0.8), (len(rows), 2))
    poses = np.stack(
        [
            _stand(world, path[row], heading[row], *tilt)
            for row, tilt in zip(rows, jitter, strict=True)
        ]
    )
    return Drive(
        poses,
        begin + np.round(clock[rows] * 1e6).astype(np.int64),
        tuple(zone_label(world, *path[row]) for row in rows),
        path,
    )


def _stand(
    world: World, xy: Float64[np.ndarray, " 2"], heading: float, roll: float, pitch: float
) -> Float64[np.ndarray, "4 4"]:
    """Pose of a vehicle on the ground, tilted by the slope and a little by its springs."""
    z = world.hills(xy + np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]))
    up = np.array([z[0] - z[1], z[0] - z[2], 1.0])
    forward = np.array([math.cos(heading), math.sin(heading), 0.0])
    left = np.array([-forward[1], forward[0], 0.0])
    up = up / np.linalg.norm(up) + 0.5 * (pitch * forward + roll * left)
    up /= np.linalg.norm(up)
    forward = forward - (forward @ up) * up
    forward /= np.linalg.norm(forward)
    return pose(np.column_stack([forward, np.cross(up, forward), up]), (*xy.tolist(), float(z[0])))


def zone_label(world: World, x: float, y: float) -> str:
    """What kind of place (x, y) is."""
    for zone in world.zones:
        if zone.indoor and zone.contains(x, y):
            return zone.kind
    for zone in world.zones:
        if not zone.indoor and zone.contains(x, y, PARK_REACH_M):
            return zone.kind
    nearest = min(
        (street for street in world.streets if street.kind != "corridor"),
        key=lambda street: float(np.hypot(*(street.line - (x, y)).T).min()),
    )
    return nearest.kind
