# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The Velodyne HDL-32E of NCLT: scans that are ready, and the stream of packets they came from.

A hit is 8 bytes: x, y, z as uint16, intensity and laser as uint8; metres = value * 0.005 - 100.
`velodyne_sync/<utime>.bin` holds the hits of the turn that ended at <utime>, freed of the robot's
motion, in the robot's frame. `velodyne_hits.bin` holds packets of some 0.5 ms one after another,
each a header of 24 bytes (44444 four times as uint16, number of hits as uint32, microseconds as
uint64, four bytes of nothing) and its hits as they were measured, in the sensor's frame.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float, Float32, Float64, Shaped

from adafusion.datasets.sensor_files import check_points, read_bytes
from adafusion.geometry import invert, pose, rotation_from_rpy, transform
from adafusion.readers.sensors import T_FLU_FRD
from adafusion.readers.track import Track
from adafusion.types import UserError

# the robot's frame of NCLT has x forward, y right, z down; its origin is on the ground: T_FLU_FRD
# the sensor hangs upside down, so its own z points down too; the paper gives degrees
T_NCLT_VELODYNE = pose(
    rotation_from_rpy(*np.radians([0.807, 0.166, -90.703])), (0.002, -0.004, -0.957)
)
T_BODY_VELODYNE = T_FLU_FRD @ T_NCLT_VELODYNE

# The turn that a frame shows ended at its time and took 0.1 s, as in velodyne_sync. The robot went
# straight between these times; there must be packets between any two.
TURN_EDGES_US = np.arange(-100_000, 1, 20_000)

_HIT = np.dtype([("xyz", "<u2", 3), ("intensity", "u1"), ("laser", "u1")])
_STEP_M, _LEAST_M = 0.005, -100.0
# the sensor sees nothing nearer than 1 m; a shot that came back from nowhere is put at its centre
_NEAREST_M = 0.5
_MAGIC = struct.pack("<4H", 44444, 44444, 44444, 44444)
_HEADER = struct.Struct("<8sIQ4x")  # magic, hits, microseconds
_MOST_HITS = 4096  # the sensor sends 384 at a time
_LARGEST = _HEADER.size + _MOST_HITS * _HIT.itemsize
_LARGEST_TURN = 16_000_000  # bytes; a real one has some 0.5 MB
_LARGEST_HOLE = 16_000_000  # bytes that no packet begins in
_REMEDY = "unpack the archive of the day again, or leave the run out"


def read_scan(path: Path) -> Float32[np.ndarray, "n 3"]:
    """Points of a `velodyne_sync` file in our body frame; UserError where it is damaged."""
    data = read_bytes(path, "cloud")
    if len(data) % _HIT.itemsize:
        raise UserError(
            f"{path} is cut short: {len(data)} bytes are no whole number of {_HIT.itemsize}-byte "
            f"hits; unpack it again, or leave it out"
        )
    points_nclt = _as_points(np.frombuffer(data, _HIT), sensor_m=T_NCLT_VELODYNE[:3, 3])
    return check_points(transform(T_FLU_FRD, points_nclt), path)


@dataclass(frozen=True, eq=False)
class Turn:
    """The packets of one turn in `velodyne_hits.bin`."""

    path: Path
    begin: int  # bytes
    end: int
    T_end_body: Track  # where the body was during the turn, seen from where it was at its end


def find_turn(path: Path, end_us: int, T_world_body: Float64[np.ndarray, "k 4 4"]) -> Turn | None:
    """The turn that ended at a time, by the poses at `TURN_EDGES_US`; None where it has a gap.

    Packets stand by rising time, so each edge is found by halving a file of tens of gigabytes.
    """
    edges_us = end_us + TURN_EDGES_US
    with _open(path) as file:
        size = path.stat().st_size
        begin = _find_packet(file, path, int(edges_us[0]), 0, size)
        end = _find_packet(file, path, int(edges_us[-1]), begin, size)
        between = [_find_packet(file, path, t, begin, end) for t in edges_us[1:-1].tolist()]
    if (np.diff([begin, *between, end]) <= 0).any():
        return None
    if end - begin > _LARGEST_TURN:
        raise UserError(
            f"{path}: bytes {begin} to {end} are too many for the turn that ends at {end_us}: "
            f"{_REMEDY}"
        )
    return Turn(path, begin, end, Track(edges_us, invert(T_world_body[-1]) @ T_world_body))


def read_turn(turn: Turn) -> Float32[np.ndarray, "n 3"]:
    """Points of a turn in our body frame, as a robot that stood still at its end had seen them.

    Each packet is moved by where the robot was at the packet's time.
    """
    path = turn.path
    first_us, last_us = turn.T_end_body.time_us[[0, -1]].tolist()
    with _open(path) as file:
        file.seek(turn.begin)
        data = file.read(turn.end - turn.begin)
    times, packets, at = [], [], 0
    while at < turn.end - turn.begin:
        if data[at : at + len(_MAGIC)] != _MAGIC or at + _HEADER.size > len(data):
            raise UserError(f"{path}: no packet begins at byte {turn.begin + at}: {_REMEDY}")
        _, count, utime = _HEADER.unpack_from(data, at)
        if not first_us <= utime <= last_us or at + _size(count) > len(data):
            raise UserError(
                f"{path}: the packet at byte {turn.begin + at} claims {count} hits at {utime}, "
                f"which do not fit the turn that ends at {last_us}: {_REMEDY}"
            )
        times.append(utime)
        packets.append(np.frombuffer(data, _HIT, count, at + _HEADER.size))
        at += _size(count)
    poses = turn.T_end_body.at(np.array(times, dtype=np.int64)) @ T_BODY_VELODYNE
    clouds = [
        transform(T_end_velodyne, _as_points(hits, sensor_m=np.zeros(3)))
        for T_end_velodyne, hits in zip(poses, packets, strict=True)
    ]
    return check_points(np.concatenate(clouds), path)


def _as_points(
    hits: Shaped[np.ndarray, " n"], sensor_m: Float[np.ndarray, " 3"]
) -> Float32[np.ndarray, "m 3"]:
    """Hits in metres, in the frame of the file; without those that are no measurement."""
    codes = hits["xyz"]
    points = (codes * _STEP_M + _LEAST_M).astype(np.float32)
    far = ((points - sensor_m) ** 2).sum(axis=1) > _NEAREST_M**2
    clamped = (codes == 0).any(axis=1)  # at the lower end of what 16 bits can say
    return points[far & ~clamped]


def _find_packet(file: BinaryIO, path: Path, at_us: int, low: int, high: int) -> int:
    """Offset of the first packet in bytes `low` to `high` that is not before a time, else `high`.

    All packets that begin before `low` are earlier.
    """
    found = high
    while low < high:
        middle = (low + high) // 2
        packet = _next_packet(file, path, middle, high)
        if packet is None:
            high = middle
        elif packet[1] < at_us:
            low = packet[2]
        else:
            found, high = packet[0], middle
    return found


def _next_packet(file: BinaryIO, path: Path, at: int, limit: int) -> tuple[int, int, int] | None:
    """Offset, microseconds and end of the first whole packet that begins in bytes `at` to `limit`.

    UserError where none is near and there should be one: the stream is damaged. Shorter holes,
    which a disk fills with zeros, are searched through.
    """
    last = min(limit, at + _LARGEST_HOLE)
    for start in range(at, last, _LARGEST):
        file.seek(start)
        data = file.read(_LARGEST + _HEADER.size)
        found = data.find(_MAGIC)
        while 0 <= found < min(_LARGEST, last - start) and found + _HEADER.size <= len(data):
            _, count, utime = _HEADER.unpack_from(data, found)
            end = start + found + _size(count)
            if count <= _MOST_HITS and _begins_packet(file, end):
                return start + found, utime, end
            found = data.find(_MAGIC, found + 1)
    if last < limit:
        raise UserError(f"{path}: no packet begins within {_LARGEST_HOLE} bytes of {at}: {_REMEDY}")
    return None


def _begins_packet(file: BinaryIO, at: int) -> bool:
    """Whether another packet begins there, or the file ends."""
    file.seek(at - 1)  # a byte before, which is there only if the packet before it is whole
    near = file.read(1 + len(_MAGIC))
    return len(near) == 1 or near[1:] == _MAGIC


def _size(count: int) -> int:
    """Bytes of a packet."""
    return _HEADER.size + count * _HIT.itemsize


def _open(path: Path) -> BinaryIO:
    try:
        return path.open("rb")
    except OSError as error:
        raise UserError(f"{path} cannot be read ({error.strerror}): {_REMEDY}") from error
