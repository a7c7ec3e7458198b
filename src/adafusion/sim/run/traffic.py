# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What moves while a run goes on: vehicles on the streets and people on the pavements.

Each goes round its street for ever, out on one side and back on the other, so that where it is
is a function of time: no frame depends on the one before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, Int64

from adafusion.sim.numeric import keyed_rng
from adafusion.sim.run.instances import Instance, place, standing
from adafusion.sim.run.people import STRIDE_M, STRIDES, clothes_of, person
from adafusion.sim.run.vehicles import VEHICLE_ODDS, VEHICLES, paint_of, vehicle
from adafusion.sim.town.plan import KERB_M, along
from adafusion.sim.town.shapes import Soup
from adafusion.sim.town.world import World

END_M = 12.0  # nobody comes nearer to the end of a street
TRAFFIC_LANE_M = -1.95  # lateral middle of a vehicle on its way: it keeps to the right
SLOT_M = 18.0  # of the way round a street, for one vehicle
WALK_M = (6.75, 7.3)  # lateral place of people, between the lamps and what stands at the walls
NEAREST_M = 3.5  # nothing comes nearer to the run's own vehicle


@dataclass(frozen=True, eq=False)
class Movers:
    """n things of one kind that go round their streets."""

    begin_m: Float64[np.ndarray, " n"]  # where on the `Tracks` their part of a street begins ...
    span_m: Float64[np.ndarray, " n"]  # ... and how long it is: the way round is twice that
    lateral_m: Float64[np.ndarray, " n"]  # of the street's middle line, to the left of their way
    speed_m_s: Float64[np.ndarray, " n"]
    phase_m: Float64[np.ndarray, " n"]  # how far on the way round they are at time 0
    model: Int64[np.ndarray, " n"]  # number in `VEHICLES`; 0 for people
    size: Float64[np.ndarray, " n"]  # over the size of the prototype
    tints: Float64[np.ndarray, "n k 3"]


@dataclass(frozen=True, eq=False)
class Tracks:
    """Middle lines of all streets in one row, so that one search finds everybody."""

    xy: Float64[np.ndarray, "p 2"]
    s_m: Float64[np.ndarray, " p"]  # grows along a street and jumps by a metre to the next


@dataclass(frozen=True, eq=False)
class Traffic:
    """Who is on the move during a run."""

    tracks: Tracks
    vehicles: Movers
    people: Movers


Mover = tuple[float, float, float, float, float, int, float, Float64[np.ndarray, "k 3"]]


def plan_traffic(world: World, seed: int, vehicles: float, people: float) -> Traffic:
    """Put `vehicles` per 40 m of street and `people` per 10 m of pavement on their ways.

    Vehicles of one street share its speed, 3 to 9 m/s, lest one drives through another; people
    walk at 0.8 to 1.8 m/s. All of it belongs to `seed`.
    """
    driving: list[Mover] = []
    walking: list[Mover] = []
    start, s_m = 0.0, []
    for e, street in enumerate(world.streets):
        s_m.append(start + along(street.line))
        begin, span = start + END_M, float(s_m[-1][-1]) - start - 2.0 * END_M
        start = float(s_m[-1][-1]) + 1.0
        if street.kind != "street" or 2.0 * span < SLOT_M:
            continue
        rng = keyed_rng(seed, "street", e, "vehicles")
        speed, slots = float(rng.uniform(3.0, 9.0)), int(2.0 * span / SLOT_M)
        count = min(int(rng.poisson(vehicles * span / 40.0)), slots)
        for k in rng.permutation(slots)[:count].tolist():
            model = int(rng.choice(len(VEHICLES), p=VEHICLE_ODDS))
            lateral = TRAFFIC_LANE_M + float(rng.uniform(-0.15, 0.15))
            phase = (k + float(rng.uniform(0.0, 0.3))) * 2.0 * span / slots
            tint = paint_of(VEHICLES[model], rng)
            driving.append((begin, span, lateral, speed, phase, model, 1.0, tint))
        rng = keyed_rng(seed, "street", e, "people")
        for _ in range(int(rng.poisson(people * 2.0 * span / 10.0))):
            lateral = float(rng.choice([-1.0, 1.0]) * rng.uniform(*WALK_M))
            child = rng.random() < 0.1
            size = float(rng.uniform(0.65, 0.85) if child else rng.uniform(0.92, 1.08))
            speed, phase = float(rng.uniform(0.8, 1.8)), float(rng.uniform(0.0, 2.0 * span))
            walking.append((begin, span, lateral, speed, phase, 0, size, clothes_of(rng)))
    tracks = Tracks(
        np.concatenate([np.zeros((0, 2)), *(street.line for street in world.streets)]),
        np.concatenate([np.zeros(0), *s_m]),
    )
    return Traffic(tracks, _collect(driving, 1), _collect(walking, 4))


def _collect(movers: list[Mover], tints: int) -> Movers:
    """Columns of a list of movers with so many tints each."""
    begin, span, lateral, speed, phase, model, size, colours = (
        zip(*movers, strict=True) if movers else [()] * 8
    )
    return Movers(
        begin_m=np.array(begin, float),
        span_m=np.array(span, float),
        lateral_m=np.array(lateral, float),
        speed_m_s=np.array(speed, float),
        phase_m=np.array(phase, float),
        model=np.array(model, np.int64),
        size=np.array(size, float),
        tints=np.array(colours, float).reshape(-1, tints, 3),
    )


def positions(
    tracks: Tracks, movers: Movers, time_s: float
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
    """Where movers are at a time, in metres, and where they head, in radians."""
    gone = np.mod(movers.phase_m + movers.speed_m_s * time_s, 2.0 * movers.span_m)
    back = gone >= movers.span_m
    s = movers.begin_m + np.where(back, 2.0 * movers.span_m - gone, gone)
    k = np.searchsorted(tracks.s_m, s) - 1
    d = tracks.xy[k + 1] - tracks.xy[k]
    yaw = np.arctan2(d[:, 1], d[:, 0]) + np.where(back, np.pi, 0.0)
    left = np.stack([-np.sin(yaw), np.cos(yaw)], axis=1)
    share = (s - tracks.s_m[k]) / (tracks.s_m[k + 1] - tracks.s_m[k])
    return tracks.xy[k] + d * share[:, None] + left * movers.lateral_m[:, None], yaw


def traffic_at(
    world: World,
    traffic: Traffic,
    time_s: float,
    T_world_body: Float[np.ndarray, "4 4"],
    reach_m: float = 90.0,
) -> Soup:
    """What moves within `reach_m` of the run's own vehicle at a time, in seconds of any clock.

    What would be nearer than `NEAREST_M` is left out: nobody brakes for the run's vehicle.
    """
    own, things = T_world_body[:2, 3], []
    movers = traffic.vehicles
    xy, yaw = positions(traffic.tracks, movers, time_s)
    halves = np.array([(shape.length / 2, shape.half_width) for shape in VEHICLES])
    seen = _near(own, xy, yaw, halves[movers.model], reach_m)
    for i, T in zip(seen, standing(world.hills, xy[seen], yaw[seen]), strict=True):
        shape = vehicle(VEHICLES[movers.model[i]], lit=True)
        things.append(Instance(shape, T, movers.tints[i]))
    movers = traffic.people
    xy, yaw = positions(traffic.tracks, movers, time_s)
    seen = _near(own, xy, yaw, np.full((len(xy), 2), 0.3), reach_m)
    poses = standing(world.hills, xy[seen], yaw[seen], upright=True)
    poses[:, 2, 3] += KERB_M
    poses[:, :3, :3] *= movers.size[seen, None, None]
    steps = (movers.phase_m + movers.speed_m_s * time_s) / (STRIDE_M * movers.size) * STRIDES
    for i, T in zip(seen, poses, strict=True):
        things.append(Instance(person(int(steps[i]) % STRIDES), T, movers.tints[i]))
    return place(things)


def _near(
    own: Float[np.ndarray, " 2"],
    xy: Float64[np.ndarray, "n 2"],
    yaw: Float64[np.ndarray, " n"],
    half: Float64[np.ndarray, "n 2"],
    reach_m: float,
) -> Int64[np.ndarray, " m"]:
    """Rows of the rectangles (half length, half width) that are near to a point, not too near."""
    d, c, s = own - xy, np.cos(yaw), np.sin(yaw)
    inside = np.stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0]], axis=1)
    distance = np.linalg.norm(np.maximum(np.abs(inside) - half, 0.0), axis=1)
    return np.flatnonzero((distance >= NEAREST_M) & (distance <= reach_m))
