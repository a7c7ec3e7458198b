# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The datasets that a training learns from or is chosen by, row by row."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from adafusion.datasets import Dataset, open_dataset
from adafusion.datasets.splits import region_of
from adafusion.files import fingerprint
from adafusion.preprocess import Preprocess
from adafusion.preprocess.cache import PreparedFrames, PreparedSet, prepare_cache
from adafusion.preprocess.elevation import RigCamera, one_camera, rig_camera
from adafusion.training.settings import TrainConfig
from adafusion.types import SENSORS, Progress, UserError, lacking, silent


@dataclass(frozen=True, eq=False)
class Corpus:
    """Opened datasets; rows run through the frames of all of them, one dataset after the other."""

    datasets: tuple[Dataset, ...]

    @classmethod
    def open(cls, roots: Sequence[Path]) -> Corpus:
        """Open dataset folders."""
        return cls(tuple(open_dataset(root) for root in roots))

    @cached_property
    def fingerprint(self) -> str:
        """Identity of everything that could teach."""
        return fingerprint(*(dataset.fingerprint for dataset in self.datasets))

    def rows(self, region: str | None, sensors: Collection[str] = SENSORS) -> Int[np.ndarray, " n"]:
        """Rows in the region (None: anywhere) that have the sensors; UserError for none."""
        frames = [frame for dataset in self.datasets for frame in dataset.frames]
        kept = np.array([not lacking(frame, sensors) for frame in frames])
        if region is not None:
            names = [region_of(ds.positions_m[:, :2], ds.info.regions) for ds in self.datasets]
            kept &= np.concatenate(names) == region
        rows = np.flatnonzero(kept)
        if not len(rows):
            other = ", or choose by another dataset (`adafusion train --validation`)"
            raise UserError(
                f"{', '.join(str(ds.root) for ds in self.datasets)}: no frame with "
                f"{' and '.join(sensors)} in the {region or 'whole'} region: cut it with "
                "`adafusion split`" + (other if region == "validation" else "")
            )
        return rows

    def prepare(
        self, settings: Preprocess, cache: Path, progress: Progress = silent
    ) -> PreparedSet:
        """Preprocess what the cache does not hold yet."""
        return PreparedSet(
            tuple(prepare_cache(ds, settings, cache, progress=progress) for ds in self.datasets)
        )

    def points(self, row: int) -> Float[np.ndarray, "n 3"]:
        """The raw cloud of a row, for jitter."""
        starts = np.cumsum([0, *(len(ds.frames) for ds in self.datasets)])
        world = int(np.searchsorted(starts, row, side="right")) - 1
        dataset = self.datasets[world]
        frame = dataset.frames[row - int(starts[world])]
        cloud = dataset.load(replace(frame, image=None)).points_body
        assert cloud is not None  # `rows` gives only rows that have one
        return cloud

    def facts(self) -> list[dict[str, object]]:
        """What a model card says of the data."""
        return [
            {
                "name": dataset.info.name,
                "version": dataset.info.version,
                "fingerprint": dataset.fingerprint,
                "synthetic": dataset.info.synthetic,
            }
            for dataset in self.datasets
        ]

    @cached_property
    def unread(self) -> PreparedSet:
        """Where and when frames were taken, without anything that the sensors saw."""
        return PreparedSet(
            tuple(
                PreparedFrames(Path(), ds.frames, Preprocess(), {}, np.zeros(0), {})
                for ds in self.datasets
            )
        )


def with_camera(settings: TrainConfig, datasets: Sequence[Dataset]) -> TrainConfig:
    """Settings whose elevation map, where there is one, knows the camera of the datasets' rig.

    UserError where they have different ones, or no image.
    """
    preprocess = settings.model.preprocess
    if preprocess.lidar != "elevation" or preprocess.elevation.camera is not None:
        return settings
    camera = one_camera({str(one.root): _camera(one, settings.model.system) for one in datasets})
    return replace(
        settings,
        model=replace(
            settings.model,
            preprocess=replace(preprocess, elevation=replace(preprocess.elevation, camera=camera)),
        ),
    )


def _camera(dataset: Dataset, system: str) -> RigCamera:
    seen = next((frame for frame in dataset.frames if frame.image is not None), None)
    if seen is None:
        raise UserError(f"{dataset.root}: {system} looks for the map's cells in images")
    image = dataset.load(replace(seen, cloud=None)).image
    assert image is not None
    height, width = image.shape[:2]
    return rig_camera(dataset.info.calibration, (height, width))
