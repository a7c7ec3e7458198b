# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""All that is known of all frames without opening an image or a cloud, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Int64, Shaped

from adafusion.datasets import Dataset
from adafusion.datasets.splits import region_of
from adafusion.types import Frame


@dataclass(frozen=True, eq=False)
class Table:
    """Frames run after run by rising time; a row of every array is a frame."""

    frames: tuple[Frame, ...]
    runs: tuple[str, ...]
    run: Int[np.ndarray, " n"]  # index into `runs`
    time_us: Int64[np.ndarray, " n"]
    image_us: Int64[np.ndarray, " n"]
    cloud_us: Int64[np.ndarray, " n"]
    xyz: Float[np.ndarray, "n 3"]
    T_world_body: Float[np.ndarray, "n 4 4"]  # NaN where only a position is known
    region: Shaped[np.ndarray, " n"]

    @classmethod
    def of(cls, dataset: Dataset) -> Table:
        """Gather the columns of a dataset."""
        frames = dataset.frames
        number = {run: k for k, run in enumerate(dataset.runs)}
        unknown = np.full((4, 4), np.nan)
        poses = [unknown if f.T_world_body is None else f.T_world_body for f in frames]
        xyz = dataset.positions_m
        return cls(
            frames=frames,
            runs=dataset.runs,
            run=np.array([number[f.run] for f in frames], dtype=np.int64),
            time_us=np.array([f.timestamp_us for f in frames], dtype=np.int64),
            image_us=_times([f.image_time_us for f in frames], frames),
            cloud_us=_times([f.cloud_time_us for f in frames], frames),
            xyz=xyz,
            T_world_body=np.array(poses, dtype=np.float64).reshape(-1, 4, 4),
            region=region_of(xyz[:, :2], dataset.info.regions),
        )

    @cached_property
    def has_pose(self) -> Bool[np.ndarray, " n"]:
        """Which frames say how the vehicle was turned."""
        return np.isfinite(self.T_world_body[:, 0, 0])

    @cached_property
    def steps(self) -> Int64[np.ndarray, " s"]:
        """Rows that are followed by another frame of their run."""
        return np.flatnonzero(self.run[:-1] == self.run[1:])

    @cached_property
    def step_m(self) -> Float[np.ndarray, " s"]:
        """How far the vehicle moved in each of `steps`."""
        return np.linalg.norm(self.xyz[self.steps + 1] - self.xyz[self.steps], axis=1)

    @cached_property
    def step_s(self) -> Float[np.ndarray, " s"]:
        """How long each of `steps` took; above 0, as times rise."""
        return (self.time_us[self.steps + 1] - self.time_us[self.steps]) * 1e-6

    @cached_property
    def step_after(self) -> Float[np.ndarray, " n"]:
        """Metres from each frame to the next of its run; 0 where it is the last."""
        moved = np.zeros(len(self.frames))
        moved[self.steps] = self.step_m
        return moved

    @cached_property
    def speed_m_s(self) -> Float[np.ndarray, " n"]:
        """Speed about each frame: the faster of the steps to and from it; 0 in a run of one."""
        speed = np.zeros(len(self.frames))
        for rows in (self.steps, self.steps + 1):
            speed[rows] = np.maximum(speed[rows], self.step_m / self.step_s)
        return speed


def _times(given: list[int | None], frames: tuple[Frame, ...]) -> Int64[np.ndarray, " n"]:
    filled = [f.timestamp_us if t is None else t for t, f in zip(given, frames, strict=True)]
    return np.array(filled, dtype=np.int64)
