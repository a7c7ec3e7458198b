# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What regions make of a dataset in numbers, to be held against those that a paper prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Shaped
from scipy.spatial import cKDTree

from adafusion.datasets.splits import (
    GUARD,
    TEST,
    TRAIN,
    VALIDATION,
    Published,
    Regions,
    region_of,
)
from adafusion.evaluation.protocols import make_splits
from adafusion.types import Frame

TRUE_M, WRONG_M = 10.0, 50.0  # pairs of training frames, as the paper has them


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitCounts:
    """Frames, pairs and queries of a dataset under some regions."""

    frames: dict[str, int]  # by region; those that no frame lies in are 0
    true_pairs: int  # of training frames at most 10 m apart, over all runs, each pair once
    wrong_pairs: int  # of training frames at least 50 m apart
    queries: int  # under protocol cross-run: each test frame once for every other run
    answerable: int  # of these, with a true match in the run that is asked
    nearest_m: float  # from a test frame to a training frame; infinite where there is no pair

    def differences(self, published: Published) -> dict[str, float]:
        """What is here less what is published, as a share of that."""
        here = {
            "train_frames": self.frames[TRAIN],
            "test_frames": self.frames[TEST],
            "true_pairs": self.true_pairs,
            "wrong_pairs": self.wrong_pairs,
            "queries": self.queries,
        }
        return {name: value / getattr(published, name) - 1.0 for name, value in here.items()}

    def distance(self, published: Published) -> float:
        """How far the numbers of training and test frames are off on the mean, as a share.

        Pairs and queries follow from the frames, and papers round them.
        """
        off = self.differences(published)
        return (abs(off["train_frames"]) + abs(off["test_frames"])) / 2


def count_split(
    frames: Sequence[Frame], positions_m: Float[np.ndarray, "n xy_or_xyz"], regions: Regions
) -> SplitCounts:
    """Count frames, pairs and queries; distances are in the plane, no matrix of them is made."""
    xy = np.ascontiguousarray(positions_m[:, :2], np.float64)
    names = region_of(xy, regions)
    counted = dict.fromkeys((TRAIN, VALIDATION, GUARD, TEST, *regions), 0)
    counted |= {str(name): int((names == name).sum()) for name in np.unique(names)}
    true_pairs, wrong_pairs = _count_pairs(xy[names == TRAIN])
    queries, answerable = _count_queries(frames, xy, names)
    train, test = xy[names == TRAIN], xy[names == TEST]
    apart = cKDTree(train).query(test)[0] if len(train) and len(test) else [np.inf]
    return SplitCounts(
        frames=counted,
        true_pairs=true_pairs,
        wrong_pairs=wrong_pairs,
        queries=queries,
        answerable=answerable,
        nearest_m=float(np.min(apart)),
    )


def possible_pairs(num_frames: int) -> int:
    """Unordered pairs of so many frames."""
    return num_frames * (num_frames - 1) // 2


def _count_pairs(xy: Float[np.ndarray, "n 2"]) -> tuple[int, int]:
    """Pairs at most TRUE_M and at least WRONG_M apart."""
    if not len(xy):
        return 0, 0
    tree, n = cKDTree(xy), len(xy)
    # ordered pairs at most so far apart, with each frame and itself
    near = int(tree.count_neighbors(tree, TRUE_M))
    middle = int(tree.count_neighbors(tree, np.nextafter(WRONG_M, 0.0)))
    return (near - n) // 2, possible_pairs(n) - (middle - n) // 2


def _count_queries(
    frames: Sequence[Frame], xy: Float[np.ndarray, "n 2"], names: Shaped[np.ndarray, " n"]
) -> tuple[int, int]:
    """Queries of protocol cross-run, and those that have a true match."""
    runs = sorted({frame.run for frame, name in zip(frames, names, strict=True) if name == TEST})
    if len(runs) < 2:
        return 0, 0
    queries = answerable = 0
    for split in make_splits("cross-run", frames, names, runs=runs):
        apart = np.asarray(cKDTree(xy[split.database_rows]).query(xy[split.query_rows])[0])
        queries += len(apart)
        answerable += int((apart <= split.radius_m).sum())
    return queries, answerable
