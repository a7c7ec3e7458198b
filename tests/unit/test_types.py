# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from adafusion.models.config import ModelConfig
from adafusion.types import Frame, lacking


@pytest.mark.parametrize(
    ("image", "cloud", "missing"),
    [
        ("a.png", "a.npy", {"image": (), "lidar": (), "concat": (), "adafusion": ()}),
        ("a.png", None, {"image": (), "lidar": ("lidar",), "concat": ("lidar",)}),
        (None, "a.npy", {"image": ("image",), "lidar": (), "adafusion": ("image",)}),
        (None, None, {"image": ("image",), "adafusion": ("image", "lidar")}),
    ],
)
def test_a_system_of_one_sensor_needs_no_other(
    image: str | None, cloud: str | None, missing: dict[str, tuple[str, ...]]
) -> None:
    frame = Frame(run="day", timestamp_us=0, position_m=(0.0, 0.0, 0.0), image=image, cloud=cloud)
    sensors = {system: ModelConfig(system=system).sensors for system in missing}
    assert {system: lacking(frame, sensors[system]) for system in missing} == missing
