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

from adafusion.geometry import rotation_from_rpy
from adafusion.sim.numeric import keyed_rng
from adafusion.sim.run.conditions import Conditions
from adafusion.sim.town.plan import offset_line
from adafusion.sim.town.world import World, zone_labels

STEP_M = 0.5  # of the dense path
LANE_M = -1.2  # lateral middle of the lane driven: right of the street's middle line
LEAD_M = 15.0  # of route beyond the last of a given number of places
YAW_RAD_S = 1.0  # nobody turns faster
SIDEWAYS_M_S2 = 1.5  # acceleration that a driver allows in a bend


@dataclass(frozen=True, eq=False)
class Drive:
    """Keyframes of one run, and the dense path that they lie on."""

    T_world_body: Float64[np.ndarray, "n 4 4"]
    T_world_ins: Float64[np.ndarray, "n 4 4"]  # what a GPS/INS unit says of the same moments
    timestamp_us: Int64[np.ndarray, " n"]
    zone: tuple[str, ...]  # "street", "park", "path", "corridor" ...
    speed_m_s: Float64[np.ndarray, " n"]
    yaw_rate_rad_s: Float64[np.ndarray, " n"]  # to the left
    path: Float64[np.ndarray, "m 2"]  # where the vehicle went, every half metre
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
            through = world.streets[k].kind not in ("street", "path")
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
    way_seed: int,
    *,
    keyframe_m: float = 10.0,
    places: int | None = None,
) -> Drive:
    """Drive the route once; every random number belongs to `way_seed`.

    A frame about every `keyframe_m` metres, the first at a phase of the run's own; with `places`
    only so many of the route's first, in either direction. Offset from the lane and heading wander
    smoothly, less so indoors; for `conditions.other_lane` of the way the vehicle is in the lane
    beside its own. A vehicle in reverse keeps to its own right: the other side of the street.
    """
    middle, lane = plan_route(world)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(middle, axis=0).T))])
    end = along[-1] if places is None else min(along[-1], places * keyframe_m + LEAD_M)
    s = np.arange(0.0, end, STEP_M)
    if conditions.reverse:
        s = s[::-1]
    xy = np.column_stack([np.interp(s, along, middle[:, 0]), np.interp(s, along, middle[:, 1])])
    lateral = gaussian_filter1d(np.interp(s, along, lane), 6.0 / STEP_M)
    narrow = np.zeros(len(s))  # 1 indoors and at the doors
    for zone in world.zones:
        if zone.indoor:
            narrow = np.maximum(narrow, [zone.contains(x, y, 8.0) for x, y in xy])
    narrow = gaussian_filter1d(narrow.astype(float), 4.0 / STEP_M)
    xy = gaussian_filter1d(xy, 3.0 / STEP_M, axis=0, mode="nearest")  # corners are driven round

    def wander(purpose: str, sigma_m: float) -> Float64[np.ndarray, " n"]:
        noise = keyed_rng(way_seed, "drive", purpose).standard_normal(len(s))
        smooth = gaussian_filter1d(noise, sigma_m / STEP_M, mode="wrap")
        return smooth / max(float(smooth.std()), 1e-9)

    rng = keyed_rng(way_seed, "drive")
    bias = float(rng.uniform(-1.2, 1.2))
    shift = conditions.path_offset_m * np.tanh(bias + 0.5 * wander("offset", 25.0))
    if conditions.other_lane > 0.0:
        noise = wander("lane", 20.0)
        beside = noise > np.quantile(noise, 1.0 - conditions.other_lane)
        lateral = lateral * (1.0 - 2.0 * gaussian_filter1d(beside.astype(float), 5.0 / STEP_M))
    lateral = lateral * (1 - narrow) + shift * ((1 - narrow) + 0.25 * narrow)
    path = offset_line(xy, lateral)
    path = gaussian_filter1d(path, 1.0 / STEP_M, axis=0, mode="nearest")
    ahead = np.gradient(gaussian_filter1d(path, 2.0 / STEP_M, axis=0, mode="nearest"), axis=0)
    noise = conditions.heading_noise_rad * wander("heading", 6.0)
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])) + noise * (1 - 0.5 * narrow)
    tilt = np.column_stack([wander("roll", 1.5), wander("pitch", 1.5)]) * math.radians(0.45)

    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    # two rounds of the same spacing would put their frames at the same points
    keys = np.arange(float(rng.uniform(0.0, keyframe_m)), driven[-1], keyframe_m)
    keys = keys + rng.uniform(-0.15, 0.15, len(keys)) * keyframe_m
    rows = np.unique(np.clip(np.searchsorted(driven, keys), 0, len(s) - 1))
    # a turn on the spot folds the path: what comes back to the frame before is no new place
    apart = np.hypot(*np.diff(path[rows], axis=0, prepend=np.inf).T) > 0.5 * keyframe_m
    rows = rows[apart][:places]
    speed = (4.5 + 1.5 * np.tanh(wander("speed", 40.0))) * (1.0 - 0.5 * narrow)
    step = np.maximum(np.diff(driven, prepend=-STEP_M), 0.05)
    bend = np.abs(np.gradient(gaussian_filter1d(heading, 2.0 / STEP_M))) / step
    speed = np.minimum(speed, np.sqrt(SIDEWAYS_M_S2 / np.maximum(bend, 1e-3)))
    clock = np.cumsum(step / speed)
    # a day of its own for every run, within one year from 2026-01-01
    begin = 1_767_225_600_000_000 + int(rng.integers(0, 365 * 86_400 * 10)) * 100_000
    T_world_body = _stand(world, path[rows], heading[rows], tilt[rows])
    return Drive(
        T_world_body,
        _ins(T_world_body, driven[rows], keyed_rng(way_seed, "drive", "ins")),
        begin + np.round(clock[rows] * 1e6).astype(np.int64),
        zone_labels(world, path[rows]),
        speed[rows],
        np.clip(np.gradient(heading, clock)[rows], -YAW_RAD_S, YAW_RAD_S),
        path,
        heading,
        tilt,
        begin + np.round(clock * 1e6).astype(np.int64),
    )


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
