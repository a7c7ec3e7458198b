# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A drive through a world: which streets in which order, and where exactly one run's frames are."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from adafusion.geometry import rotation_from_rpy
from adafusion.sim.numeric import keyed_rng
from adafusion.sim.run.conditions import Conditions
from adafusion.sim.town.plan import INDOORS, along, offset_line, resampled
from adafusion.sim.town.world import World, zone_labels

STEP_M = 0.5  # of the dense path, along the route's middle line
KEYFRAME_M = 10.0
LANE_M = -1.2  # lateral middle of the lane driven: right of the street's middle line
LEAD_M = 15.0  # of route beyond the last of a given number of places
YAW_RAD_S = 1.0  # largest rate that the motion blur is told of; the path itself may turn faster
SIDEWAYS_M_S2 = 1.5  # acceleration that a driver allows in a bend


@dataclass(frozen=True, eq=False)
class Drive:
    """Keyframes of one run, and the dense path that they lie on."""

    T_world_body: Float64[np.ndarray, "n 4 4"]
    T_world_ins: Float64[np.ndarray, "n 4 4"]  # what a GPS/INS unit says of the same moments
    timestamp_us: Int64[np.ndarray, " n"]
    zone: tuple[str, ...]  # "street", "park", "path", "corridor" ...
    speed_m_s: Float64[np.ndarray, " n"]
    yaw_rate_rad_s: Float64[np.ndarray, " n"]  # to the left, `YAW_RAD_S` at most
    path: Float64[np.ndarray, "m 2"]  # where the vehicle went, about every half metre
    path_heading_rad: Float64[np.ndarray, " m"]  # without jumps of a whole turn
    path_tilt_rad: Float64[np.ndarray, "m 2"]  # roll and pitch on its springs
    path_time_us: Int64[np.ndarray, " m"]


def plan_route(world: World) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
    """Middle line of a drive over every street and passage, and the lane's lateral offset on it.

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
            through = world.streets[k].kind in INDOORS
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
    world: World, conditions: Conditions, way_seed: int, *, places: int | None = None
) -> Drive:
    """Drive the route once; every random number belongs to `way_seed`.

    A frame about every `KEYFRAME_M`, the first at a phase of the run's own; with `places` only so
    many of the route's first, in either direction. Offset from the lane and heading wander
    smoothly, less so indoors; for `conditions.other_lane` of the way the vehicle is in the lane
    beside its own. A vehicle in reverse keeps to its own right: the other side of the street.
    """
    rng = keyed_rng(way_seed, "drive")  # drawn from in this order: path, keyframes, first moment
    path = _path(_lane(world, conditions, places), conditions, way_seed, rng)
    rows = _keyframes(path, rng)[:places]
    speed, elapsed_s = _timing(path, way_seed)
    begin_us = _first_moment_us(rng)
    T_world_body = _stand(world, path.xy[rows], path.heading_rad[rows], path.tilt_rad[rows])
    yaw_rate = np.gradient(path.heading_rad, elapsed_s)[rows]
    return Drive(
        T_world_body=T_world_body,
        T_world_ins=_ins(T_world_body, path.driven_m[rows], keyed_rng(way_seed, "drive", "ins")),
        timestamp_us=begin_us + np.round(elapsed_s[rows] * 1e6).astype(np.int64),
        zone=zone_labels(world, path.xy[rows]),
        speed_m_s=speed[rows],
        yaw_rate_rad_s=np.clip(yaw_rate, -YAW_RAD_S, YAW_RAD_S),
        path=path.xy,
        path_heading_rad=path.heading_rad,
        path_tilt_rad=path.tilt_rad,
        path_time_us=begin_us + np.round(elapsed_s * 1e6).astype(np.int64),
    )


class _Lane(NamedTuple):
    """The part of the route that a run drives, every half metre in the run's direction."""

    middle: Float64[np.ndarray, "m 2"]  # of the streets, its corners rounded
    lateral_m: Float64[np.ndarray, " m"]  # of the lane's own middle, to the left
    narrow: Float64[np.ndarray, " m"]  # 1 indoors and at the doors, 0 elsewhere


class _Path(NamedTuple):
    """Where the vehicle goes, about every half metre, and how it stands there."""

    xy: Float64[np.ndarray, "m 2"]
    heading_rad: Float64[np.ndarray, " m"]
    tilt_rad: Float64[np.ndarray, "m 2"]
    driven_m: Float64[np.ndarray, " m"]  # from the first point
    narrow: Float64[np.ndarray, " m"]


def _lane(world: World, conditions: Conditions, places: int | None) -> _Lane:
    """The same for all runs in one direction: nothing is drawn here."""
    middle, lane = plan_route(world)
    s_m = along(middle)
    end = s_m[-1] if places is None else min(s_m[-1], places * KEYFRAME_M + LEAD_M)
    s = np.arange(0.0, end, STEP_M)
    if conditions.reverse:
        s = s[::-1]
    xy = resampled(middle, s)
    narrow = np.zeros(len(s))
    for zone in world.zones:
        if zone.indoor:
            narrow = np.maximum(narrow, [zone.contains(x, y, 8.0) for x, y in xy])
    return _Lane(
        gaussian_filter1d(xy, 3.0 / STEP_M, axis=0, mode="nearest"),
        gaussian_filter1d(np.interp(s, s_m, lane), 6.0 / STEP_M),
        gaussian_filter1d(narrow.astype(float), 4.0 / STEP_M),
    )


def _path(lane: _Lane, conditions: Conditions, way_seed: int, rng: np.random.Generator) -> _Path:
    """Wander about the lane, now and then in the one beside it."""
    n, narrow, lateral = len(lane.narrow), lane.narrow, lane.lateral_m
    bias = float(rng.uniform(-1.2, 1.2))
    shift = conditions.path_offset_m * np.tanh(bias + 0.5 * _wander(way_seed, "offset", n, 25.0))
    if conditions.other_lane > 0.0:
        noise = _wander(way_seed, "lane", n, 20.0)
        beside = noise > np.quantile(noise, 1.0 - conditions.other_lane)
        lateral = lateral * (1.0 - 2.0 * gaussian_filter1d(beside.astype(float), 5.0 / STEP_M))
    lateral = lateral * (1 - narrow) + shift * ((1 - narrow) + 0.25 * narrow)
    xy = offset_line(lane.middle, lateral)
    xy = gaussian_filter1d(xy, 1.0 / STEP_M, axis=0, mode="nearest")
    ahead = np.gradient(gaussian_filter1d(xy, 2.0 / STEP_M, axis=0, mode="nearest"), axis=0)
    noise = conditions.heading_noise_rad * _wander(way_seed, "heading", n, 6.0)
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])) + noise * (1 - 0.5 * narrow)
    tilt = [_wander(way_seed, axis, n, 1.5) for axis in ("roll", "pitch")]
    return _Path(xy, heading, np.column_stack(tilt) * math.radians(0.45), along(xy), narrow)


def _wander(way_seed: int, purpose: str, n: int, sigma_m: float) -> Float64[np.ndarray, " n"]:
    """Noise of deviation 1 along n points of a path, smooth over `sigma_m`."""
    noise = keyed_rng(way_seed, "drive", purpose).standard_normal(n)
    smooth = gaussian_filter1d(noise, sigma_m / STEP_M, mode="wrap")
    return smooth / max(float(smooth.std()), 1e-9)


def _keyframes(path: _Path, rng: np.random.Generator) -> Int64[np.ndarray, " k"]:
    """Rows of the path, about `KEYFRAME_M` apart."""
    # two rounds of the same spacing would put their frames at the same points
    keys = np.arange(float(rng.uniform(0.0, KEYFRAME_M)), path.driven_m[-1], KEYFRAME_M)
    keys = keys + rng.uniform(-0.15, 0.15, len(keys)) * KEYFRAME_M
    rows = np.unique(np.clip(np.searchsorted(path.driven_m, keys), 0, len(path.xy) - 1))
    # a turn on the spot folds the path: what comes back to the frame before is no new place
    apart = np.hypot(*np.diff(path.xy[rows], axis=0, prepend=np.inf).T)
    return rows[apart > 0.5 * KEYFRAME_M]


def _timing(
    path: _Path, way_seed: int
) -> tuple[Float64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
    """Speed at each point of the path, slow indoors and in bends, and the seconds to there."""
    wander = _wander(way_seed, "speed", len(path.xy), 40.0)
    speed = (4.5 + 1.5 * np.tanh(wander)) * (1.0 - 0.5 * path.narrow)
    step = np.maximum(np.diff(path.driven_m, prepend=-STEP_M), 0.05)
    bend = np.abs(np.gradient(gaussian_filter1d(path.heading_rad, 2.0 / STEP_M))) / step
    speed = np.minimum(speed, np.sqrt(SIDEWAYS_M_S2 / np.maximum(bend, 1e-3)))
    return speed, np.cumsum(step / speed)


def _first_moment_us(rng: np.random.Generator) -> int:
    """A day of its own for every run, within one year from 2026-01-01."""
    return 1_767_225_600_000_000 + int(rng.integers(0, 365 * 86_400 * 10)) * 100_000


def pose_along(
    world: World, way: Drive, time_us: Int64[np.ndarray, " k"]
) -> Float64[np.ndarray, "k 4 4"]:
    """Poses of the vehicle at any times within the drive; ValueError for times outside it."""
    t = way.path_time_us
    if len(time_us) and not t[0] <= time_us.min() <= time_us.max() <= t[-1]:
        raise ValueError(f"the drive lasts from {t[0]} to {t[-1]} us")
    at, knots = (time_us - t[0]).astype(float), (t - t[0]).astype(float)
    x, y, heading, roll, pitch = (
        np.interp(at, knots, values)
        for values in (*way.path.T, way.path_heading_rad, *way.path_tilt_rad.T)
    )
    return _stand(world, np.column_stack([x, y]), heading, np.column_stack([roll, pitch]))


def _stand(
    world: World,
    xy: Float64[np.ndarray, "n 2"],
    heading: Float64[np.ndarray, " n"],
    tilt: Float64[np.ndarray, "n 2"],
) -> Float64[np.ndarray, "n 4 4"]:
    """Poses of a vehicle on the ground, tilted by the slope and a little by its springs."""
    n = len(xy)
    beside = xy[:, None] + np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    z = world.hills(beside.reshape(-1, 2)).reshape(n, 3)
    up = np.column_stack([z[:, 0] - z[:, 1], z[:, 0] - z[:, 2], np.ones(n)])
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    forward = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(n)])
    left = np.column_stack([-forward[:, 1], forward[:, 0], np.zeros(n)])
    up += tilt[:, 1:] * forward + tilt[:, :1] * left
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    forward -= (forward * up).sum(axis=1, keepdims=True) * up
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = np.stack([forward, np.cross(up, forward), up], axis=2)
    T[:, :2, 3], T[:, 2, 3] = xy, z[:, 0]
    return T


def _ins(
    T_world_body: Float64[np.ndarray, "n 4 4"],
    driven_m: Float64[np.ndarray, " n"],
    rng: np.random.Generator,
) -> Float64[np.ndarray, "n 4 4"]:
    """Poses as a GPS/INS unit gives them: off by an error that drifts smoothly over about 60 m.

    About 1.2 m off sideways, 2 m in height, half a degree in heading; between fixes such a unit
    goes by its gyros, so its track is off but hardly bent.
    """
    sigma = np.array([0.85, 0.85, 2.0, 0.004, 0.004, 0.009])  # x, y, z, roll, pitch, yaw
    gap = driven_m[:, None] - driven_m[None]
    covariance = np.exp(-0.5 * (gap / 60.0) ** 2) + 1e-4 * np.eye(len(gap))
    error = np.linalg.cholesky(covariance) @ rng.standard_normal((len(gap), 6)) * sigma
    T = T_world_body.copy()
    for k, (x, y, z, *rpy) in enumerate(error.tolist()):
        T[k, :3, 3] += (x, y, z)
        T[k, :3, :3] = T[k, :3, :3] @ rotation_from_rpy(*rpy)
    return T
