# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""All checks of one dataset: tables of all frames, images and clouds of a sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64

from adafusion.datasets import Dataset
from adafusion.doctor import (
    checks_clouds,
    checks_files,
    checks_images,
    checks_motion,
    checks_places,
)
from adafusion.doctor.calibration import CameraModel, camera_of
from adafusion.doctor.checks_extrinsics import check_extrinsics
from adafusion.doctor.findings import LEVELS, Finding, Level, skip
from adafusion.doctor.looks import Look, choose_rows, look_at
from adafusion.doctor.table import Table
from adafusion.preprocess import Preprocess
from adafusion.types import Progress, silent


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found, and the numbers behind it."""

    dataset: Dataset
    preprocess: Preprocess
    radius_m: float
    findings: tuple[Finding, ...]
    table: Table
    positives: Int64[np.ndarray, " n"]  # true matches of each frame in other runs
    looks: tuple[Look, ...]  # of the frames that were opened

    @property
    def level(self) -> Level:
        """The worst of all findings, "ok" at least."""
        return max((finding.level for finding in self.findings), key=LEVELS.index)


def examine(
    dataset: Dataset,
    preprocess: Preprocess | None = None,
    *,
    radius_m: float = 20.0,
    samples: int | None = 60,
    seed: int = 0,
    progress: Progress = silent,
) -> Diagnosis:
    """Check a dataset; nothing is changed.

    Times, poses and files are those of all frames. Images and clouds are opened for about `samples`
    frames of each run, in pairs spread along it by `seed`; None opens all. `radius_m` is how far
    apart a true match may be; `preprocess` gives the voxel box.
    """
    preprocess = preprocess or Preprocess()
    table = Table.of(dataset)
    rng = np.random.default_rng(seed)
    rows = choose_rows(table, samples, rng).tolist()
    cameras = {run: camera_of(dataset.info, run) for run in dataset.runs}
    models = {run: camera for run, camera in cameras.items() if isinstance(camera, CameraModel)}
    opened = progress(
        look_at(dataset, table, rows, preprocess, models, rng), total=len(rows), desc="looking"
    )
    looks = tuple(opened)
    positives = checks_places.positives(table, radius_m)
    same = checks_files.same_files(table, dataset.root)
    normalised = not dataset.info.in_metres
    clouds = checks_clouds.check_clouds(table, looks, preprocess.voxels, normalised=normalised)
    metric = not normalised and ("cloud scale", "fail") not in [(f.check, f.level) for f in clouds]
    findings = (
        checks_files.sensors(table),
        checks_files.readable(table, looks),
        checks_files.duplicates(table, same),
        checks_files.frozen(table, same, looks),
        *_motion(table, looks, radius_m, normalised),
        checks_places.overlap(table, positives, radius_m),
        checks_places.regions(table, tuple(dataset.info.regions)),
        checks_places.leakage(table, radius_m),
        checks_images.sizes(table, looks),
        checks_images.exposure(table, looks),
        *clouds,
        *check_extrinsics(table, looks, cameras, metric=metric),
    )
    return Diagnosis(dataset, preprocess, radius_m, findings, table, positives, looks)


def _motion(
    table: Table, looks: Sequence[Look], radius_m: float, normalised: bool
) -> list[Finding]:
    """Times and poses; without a speed that can be, none of the others means anything."""
    speed = checks_motion.speed(table)
    if speed.level == "fail":
        names = ("time sync", "pose jumps", "heading", "standing still", "clouds and poses")
        return [speed, *(skip(name, "not judged: see speed") for name in names)]
    return [
        speed,
        checks_motion.time_sync(table),
        checks_motion.jumps(table),
        checks_motion.heading(table),
        checks_motion.tilt(table),
        checks_motion.ins(table, radius_m),
        checks_motion.standing(table),
        skip("clouds and poses", "not applicable: clouds are scaled into [-1, 1]")
        if normalised
        else checks_clouds.motion(table, looks),
    ]
