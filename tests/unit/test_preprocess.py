# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The gate from arrays to tensors, and the settings that a model file carries."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import torch

from adafusion.config import from_plain, to_plain
from adafusion.preprocess import Crop, Ground, ImageSettings, Preprocess, VoxelGrid

SMALL = Preprocess(
    image=ImageSettings(size=(6, 8), crop=Crop(top=0.1)),
    ground=Ground(method="height", height_m=0.5),
    voxels=VoxelGrid(
        lower_m=(0.0, 0.0, 0.0), upper_m=(2.0, 2.0, 2.0), shape=(2, 2, 2), index="round"
    ),
)


def test_gives_tensors_of_its_own_sizes() -> None:
    image, voxels = Preprocess()(np.zeros((90, 120, 3), np.uint8), np.zeros((5, 3), np.float32))
    assert image is not None
    assert voxels is not None
    assert (image.shape, image.dtype) == ((3, 300, 400), torch.float32)
    assert (voxels.shape, voxels.dtype) == ((1, 72, 72, 48), torch.float32)
    assert voxels.sum() == 1
    assert (image == -1).all()


def test_removes_the_ground_before_it_voxelises() -> None:
    points = np.array([[1, 1, 0.4], [0, 0, 1.2]], dtype=np.float32)
    assert torch.nonzero(SMALL.lidar_tensor(points)).tolist() == [[0, 0, 0, 1]]


def test_a_missing_sensor_stays_missing() -> None:
    image, points = np.zeros((4, 4, 3), np.uint8), np.zeros((1, 3), np.float32)
    assert SMALL(None, None) == (None, None)
    assert SMALL(None, points)[0] is None
    assert SMALL(image, None)[1] is None


def test_survives_the_way_through_json() -> None:
    text = json.dumps(to_plain(SMALL))
    assert from_plain(Preprocess, json.loads(text)) == SMALL
    assert from_plain(Preprocess, json.loads(text)).fingerprint == SMALL.fingerprint


def test_takes_the_default_for_what_is_left_out() -> None:
    made = from_plain(Preprocess, {"voxels": {"index": "round"}})
    assert made == Preprocess(voxels=VoxelGrid(index="round"))


@pytest.mark.parametrize(
    "values",
    [
        {"voxel": {}},
        {"voxels": {"indx": "round"}},
        {"image": {"crop": {"top": 0.1, "up": 0.1}}},
        {"image": [300, 400]},
        {"voxels": {"index": "ceil"}},
        {"voxels": {"occupancy": "maybe"}},
        {"ground": {"method": "ransac"}},
        {"voxels": {"shape": [72, 72]}},
        {"voxels": {"shape": "large"}},
        {"voxels": {"shape": [72, 72, 47.5]}},
        {"voxels": {"lower_m": [-20.0, -20.0], "upper_m": [20.0, 20.0]}},
        {"image": {"size": [300, None]}},
        {"image": {"size": [300.5, 400]}},
    ],
)
def test_refuses_what_it_does_not_know(values: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"Preprocess|unknown|shape|size|number"):
        from_plain(Preprocess, values)


@pytest.mark.parametrize(
    "other",
    [
        Preprocess(image=ImageSettings(size=(300, 401))),
        Preprocess(image=ImageSettings(crop=Crop(left=0.1))),
        Preprocess(ground=Ground(method="height")),
        Preprocess(voxels=VoxelGrid(index="round")),
        Preprocess(voxels=VoxelGrid(occupancy="soft")),
        Preprocess(voxels=VoxelGrid(upper_m=(20.0, 20.0, 5.5))),
    ],
)
def test_every_setting_changes_the_fingerprint(other: Preprocess) -> None:
    assert other.fingerprint != Preprocess().fingerprint


def test_equal_settings_have_equal_fingerprints() -> None:
    minus_zero = VoxelGrid(lower_m=(-20.0, -20.0, -0.0))
    assert Preprocess(voxels=minus_zero).fingerprint == Preprocess().fingerprint
    assert hash(Preprocess(voxels=minus_zero)) == hash(Preprocess())
