# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a report shows, as plain values: arrays, numbers and words, whoever measured them.

Fractions are inside [0, 1]; they become percent only on the page. Whatever is None or empty is left
out of the page, never invented.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, UInt8

from adafusion.types import AlphaSummary, Estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class SystemResult:
    """How well one system found places."""

    name: str  # "adafusion", "image", "lidar", "concat", ... also decides the colour
    recall: Mapping[int, Estimate]  # recall@N by N, fractions; 1 is among the N
    recall_at_1_percent: Estimate | None = None  # AR@1%: among the best 1 % of the database
    gap: Estimate | None = None  # recall@1 of the headline system minus this one's, paired
    fingerprint: str = ""  # of the model file
    note: str = ""  # one remark for the table, "2.1 M parameters"

    def __post_init__(self) -> None:
        if 1 not in self.recall or not all(0 <= e.value <= 1 for e in self.recall.values()):
            raise ValueError(f"{self.name}: recall holds fractions in [0, 1] by N, and that of N=1")


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitCount:
    """How many frames asked and how many could answer in one split of the protocol."""

    name: str  # "night->day": night's queries asked of day's database
    queries: int
    left_out: int  # of these queries: without a true match, so nobody could be right
    database: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ProtocolFacts:
    """The evaluation protocol. A recall without these means nothing."""

    name: str  # "cross-run"
    words: str  # what asks what, what a true match is, how splits become one number
    radius_m: float
    distance: str  # between descriptors, "L1"
    splits: tuple[SplitCount, ...] = ()
    exclude_self: bool = False
    exclude_query_run: bool = False
    intervals: str = ""  # how the intervals were made


@dataclass(frozen=True, slots=True, kw_only=True)
class RouteView:
    """Where the queries of one split were taken, and which of them were answered rightly."""

    system: str
    split: str  # "night->day"
    database_xy_m: Float[np.ndarray, "n 2"]
    query_xy_m: Float[np.ndarray, "q 2"]
    is_hit: Bool[np.ndarray, " q"]  # top-1 within the radius
    is_answerable: Bool[np.ndarray, " q"] | None = None  # False: left out, no true match; None: all
    top1_xy_m: Float[np.ndarray, "q 2"] | None = None  # where the best database frame was taken


@dataclass(frozen=True, slots=True, kw_only=True)
class MeanAlpha:
    """The weights of one system over all frames of a run, and over all frames of a zone."""

    system: str
    by_run: Mapping[str, AlphaSummary]
    by_zone: Mapping[str, AlphaSummary] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class AlphaTrace:
    """The two weights at every frame of one run, in the order of driving."""

    system: str
    run: str
    along_m: Float[np.ndarray, " n"]  # metres travelled since the start of the run
    alpha: Float[np.ndarray, "n 2"]  # (image, LiDAR)
    zones: tuple[str | None, ...] = ()  # one a frame, or empty

    def __post_init__(self) -> None:
        if len(self.along_m) == 0 or (self.zones and len(self.zones) != len(self.along_m)):
            raise ValueError(f"run {self.run}: a trace needs frames, and one zone a frame or none")


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenPlace:
    """A frame as the sensors saw it."""

    key: str
    image: UInt8[np.ndarray, "h w 3"] | None = None  # RGB
    points_body: Float[np.ndarray, "n 3"] | None = None  # metres
    alpha: tuple[float, float] | None = None  # (image, LiDAR)


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A frame of the database beside a query."""

    place: SeenPlace
    rank: int  # 1 is the best
    distance: float  # between the descriptors
    away_m: float  # between the places
    image_share: float | None = None  # of the distance, in [0, 1], the rest is the LiDAR's;
    # None for one sensor, and for a distance of 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Retrieval:
    """One query, the answer it got and the answer it should have got."""

    system: str
    query: SeenPlace
    top1: Candidate
    true: Candidate | None  # a true match, the best ranked or the nearest; None: unknown
    is_hit: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class PairDistances:
    """Descriptor distances of pairs of frames at the same place and of pairs apart."""

    system: str
    true: Float[np.ndarray, " t"]
    wrong: Float[np.ndarray, " w"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportData:
    """Everything one report shows."""

    title: str
    created: str  # date, as it shall be printed
    dataset: str  # name and version
    synthetic: bool  # the data came out of a simulator: printed large
    protocol: ProtocolFacts
    systems: tuple[SystemResult, ...]
    headline: str = ""  # name of the system that the first sentence speaks of; default the last
    facts: Mapping[str, str] = field(default_factory=dict)  # fingerprints, commit, seed, versions
    routes: tuple[RouteView, ...] = ()
    mean_alpha: tuple[MeanAlpha, ...] = ()
    alpha: tuple[AlphaTrace, ...] = ()
    retrievals: tuple[Retrieval, ...] = ()
    distances: tuple[PairDistances, ...] = ()
    command: str = ""  # that makes these numbers again
    config: str = ""  # the effective configuration, YAML

    def __post_init__(self) -> None:
        names = [system.name for system in self.systems]
        if not names or len(set(names)) != len(names):
            raise ValueError(f"a report needs systems, each with its own name; got {names}")
        if self.headline and self.headline not in names:
            raise ValueError(f"headline {self.headline!r} is none of the systems {names}")
