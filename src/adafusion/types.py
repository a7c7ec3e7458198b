# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The values that travel through the package, from a frame on disk to a descriptor.

Body frame everywhere: x forward, y left, z up, z = 0 the ground under the vehicle.
Metres, radians, integer microseconds.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Float, Int, UInt8

if TYPE_CHECKING:
    from torch import Tensor  # only annotations name it, and `adafusion --help` shall not wait

T = TypeVar("T")

SENSORS = ("image", "lidar")  # in the order of alpha


class UserError(Exception):
    """Bad input or wrong usage: the message names file and remedy, the CLI exits with 2."""


class JobFailed(Exception):
    """A job that began rightly and cannot go on; the CLI exits with 1."""


@runtime_checkable
class Progress(Protocol):
    """Wraps an iterable to show how far a job is: `tqdm` from the CLI, else `silent`."""

    def __call__(
        self, items: Iterable[T], *, total: int | None = None, desc: str = ""
    ) -> Iterable[T]:
        """Yield from `items`, reporting each."""
        ...


def silent(items: Iterable[T], *, total: int | None = None, desc: str = "") -> Iterable[T]:
    """Return `items` unchanged: the progress of a library call that nobody watches."""
    return items


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One instant of one run: where it was and which files hold what was seen; nothing loaded."""

    run: str
    timestamp_us: int
    position_m: tuple[float, float, float]  # in the dataset's world frame
    T_world_body: Float[np.ndarray, "4 4"] | None = None  # None where only a position is known
    T_world_ins: Float[np.ndarray, "4 4"] | None = None  # what a GPS/INS unit said, if apart
    image: str | None = None  # file names relative to the dataset's folder
    cloud: str | None = None
    zone: str | None = None  # what kind of place this is, where the source says so
    image_time_us: int | None = None  # when the camera saw it, where that is not `timestamp_us`
    cloud_time_us: int | None = None  # the same of the LiDAR

    @property
    def key(self) -> str:
        """`run/timestamp_us`: unique within a dataset, and what a map stores."""
        return f"{self.run}/{self.timestamp_us}"


def lacking(frame: Frame, sensors: Collection[str]) -> tuple[str, ...]:
    """Which of `sensors` the frame has no file of; () where it can be used."""
    files = dict(zip(SENSORS, (frame.image, frame.cloud), strict=True))
    return tuple(name for name in SENSORS if name in sensors and not files[name])


@dataclass(frozen=True, slots=True)
class Observation:
    """What the sensors saw at one frame, raw."""

    image: UInt8[np.ndarray, "h w 3"] | None  # RGB; None where the camera gave nothing
    points_body: Float[np.ndarray, "n 3"] | None  # metres; x forward, y left, z up


class Description(NamedTuple):
    """What a model says of a batch of places. A part that a system does not have is None."""

    fused: (
        Float[Tensor, "b d"] | None
    )  # the descriptor that is searched; None when a sensor is missing
    image_half: Float[Tensor, "b half"] | None  # before weighting
    lidar_half: Float[Tensor, "b half"] | None
    alpha: Float[Tensor, "b 2"] | None  # trust in (image, LiDAR), each in (0, 1)


class Descriptions(NamedTuple):
    """`Description` of many frames on the NumPy side, one row a frame, float32."""

    fused: Float[np.ndarray, "n d"] | None
    image_half: Float[np.ndarray, "n half"] | None
    lidar_half: Float[np.ndarray, "n half"] | None
    alpha: Float[np.ndarray, "n 2"] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Split:
    """One query set against one database: an evaluation protocol written as data.

    Rows index the frames (and descriptors) that the protocol was made from. Several splits (one a
    pair of runs) make a protocol; see `adafusion.evaluation.protocols`.
    """

    name: str  # "night->day": queries of the night against the map of the day
    protocol: str  # "cross-run", "union", "union-strict", "pointnetvlad"
    region: str = "test"  # the part of the world that the queries lie in
    radius_m: float
    query_rows: Int[np.ndarray, " q"]
    database_rows: Int[np.ndarray, " n"]
    exclude_self: bool = False  # the query's own frame may not answer
    exclude_query_run: bool = False  # no frame of the query's run may answer
    run_ids: Int[np.ndarray, " frames"] | None = None  # run of every frame, where a run is excluded


@dataclass(frozen=True, slots=True)
class Estimate:
    """A measured number and, where known, its 95 % interval."""

    value: float
    interval: tuple[float, float] | None = None

    def in_percent(self, sign: str = "") -> str:
        """Print a fraction as `81.3 [78.1, 84.0]`; sign "+" for a difference, in points."""
        percent = (round(100 * x, 1) + 0.0 for x in (self.value, *(self.interval or ())))  # no -0.0
        value, *ends = (f"{x:{sign}.1f}" for x in percent)
        return f"{value} [{', '.join(ends)}]" if ends else value


@dataclass(frozen=True, slots=True)
class AlphaSummary:
    """The weights of some frames, as (image, LiDAR)."""

    num_frames: int
    mean: tuple[float, float]
    std: tuple[float, float]  # of the frames themselves (divided by n)
