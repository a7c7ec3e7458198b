# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Regions: which part of the world a frame is in, so that training and test never share one.

A split is a file of boxes (`SplitFile`); several that the literature uses come with the package.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from adafusion.config import configs_folder, load_config
from adafusion.types import UserError

TRAIN = "train"  # the region of every place that no box holds
VALIDATION, TEST = "validation", "test"
GUARD = "guard"  # the region that is nobody's, between the others

Box = Sequence[float]  # xmin, ymin, xmax, ymax in the world frame, metres; edges may be infinite
Regions = Mapping[str, Sequence[Box]]  # by name; the first named owns what several hold


def region_of(positions_xy: Float[np.ndarray, "n 2"], regions: Regions) -> Shaped[np.ndarray, " n"]:
    """Name of the region of each position (world frame, metres); "train" where no box holds it.

    A box owns its lower edges and not its upper ones (xmin <= x < xmax), so boxes that touch share
    no place. Where boxes of two regions overlap, the region named first owns the place.
    """
    names = np.full(len(positions_xy), TRAIN, dtype=object)
    x, y = positions_xy.T
    for name in reversed(list(regions)):
        for xmin, ymin, xmax, ymax in regions[name]:
            names[(xmin <= x) & (x < xmax) & (ymin <= y) & (y < ymax)] = name
    return names.astype(np.str_)


def box_gap(a: Box, b: Box) -> float:
    """Metres between two boxes along x or y, whichever is more; below 0 where they overlap."""
    return max(a[0] - b[2], b[0] - a[2], a[1] - b[3], b[1] - a[3])


def with_guard(regions: Regions, guard_m: float) -> dict[str, list[list[float]]]:
    """The regions and a strip of `guard_m` around all their boxes that nobody uses.

    Frames of two regions, or of one and of training, are more than `guard_m` apart then. ValueError
    where boxes of two regions leave no room for that.
    """
    if not 0.0 <= guard_m < np.inf:
        raise ValueError(f"a guard of {guard_m:g} m has no width")
    guarded = {name: [list(box) for box in boxes] for name, boxes in regions.items()}
    if guard_m == 0:
        return guarded
    for (one, boxes), (other, others) in combinations(regions.items(), 2):
        for a, b in ((a, b) for a in boxes for b in others if GUARD not in (one, other)):
            if box_gap(a, b) < guard_m:
                raise ValueError(
                    f"{one} box {list(a)} and {other} box {list(b)} are {box_gap(a, b):g} m apart, "
                    f"less than the {guard_m:g} m that a guard takes"
                )
    strips = [
        [xmin - guard_m, ymin - guard_m, xmax + guard_m, ymax + guard_m]
        for name, boxes in regions.items()
        for xmin, ymin, xmax, ymax in boxes
        if name != GUARD
    ]
    # last, so that the boxes themselves stay what they are
    return guarded | {GUARD: guarded.pop(GUARD, []) + strips}


# ----------------------------------------------------------------------------------- split files


@dataclass(frozen=True, kw_only=True)
class Published:
    """What a paper counts in its split; pairs and queries as rounded there."""

    source: str  # who says so
    train_frames: int
    test_frames: int
    true_pairs: int  # of training frames at most 10 m apart
    wrong_pairs: int  # of training frames at least 50 m apart
    queries: int  # each test frame once for every other run


@dataclass(frozen=True, kw_only=True)
class SplitFile:
    """A split as a file holds it: boxes of one world, and what is known of them."""

    name: str
    words: str
    source: str
    worlds: tuple[str, ...] = ()  # `Dataset.world` of those that it is for; (): any
    guess: str = ""  # what nobody has confirmed; "" where the source leaves nothing open
    regions: dict[str, tuple[tuple[float, float, float, float], ...]]
    guard_m: float = 0.0  # width of the strip around every box that nobody uses
    published: Published | None = None

    def __post_init__(self) -> None:
        if TEST not in self.regions or set(self.regions) - {TEST, VALIDATION}:
            raise ValueError(f"regions are {TEST} and, where there is one, {VALIDATION}")
        check_boxes(self.regions)
        with_guard(self.regions, self.guard_m)

    def boxes(self, guard_m: float | None = None) -> dict[str, list[list[float]]]:
        """Regions as `region_of` takes them, with the guard around; `guard_m` None: the split's."""
        return with_guard(self.regions, self.guard_m if guard_m is None else guard_m)

    def fits(self, world: str) -> bool:
        """Whether its coordinates are those of this world."""
        return not self.worlds or world in self.worlds


def check_boxes(regions: Regions) -> None:
    """ValueError where a box is no [xmin, ymin, xmax, ymax]."""
    for name, boxes in regions.items():
        for box in boxes:
            if len(box) != 4 or not box[0] < box[2] or not box[1] < box[3]:
                raise ValueError(f"region {name!r}: {list(box)} is no [xmin, ymin, xmax, ymax]")


def splits_folder() -> Path:
    """Folder of the splits that come with the package."""
    return configs_folder() / "splits"


def named_splits() -> dict[str, SplitFile]:
    """The splits that come with the package, by name."""
    paths = sorted(splits_folder().glob("*.yaml"))
    return {path.stem: load_config(SplitFile, path) for path in paths}


def load_split(name_or_file: str | Path) -> SplitFile:
    """A split by its name or its file; UserError where there is none or it is no split."""
    path = Path(name_or_file)
    if path.suffix in (".yaml", ".yml") or path.is_file():
        return load_config(SplitFile, path)
    splits = named_splits()
    if str(name_or_file) not in splits:
        raise UserError(
            f"unknown split {str(name_or_file)!r}: choose from {', '.join(splits)}, or give a file"
        )
    return splits[str(name_or_file)]
