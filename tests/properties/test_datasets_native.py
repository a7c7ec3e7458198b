# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from adafusion.datasets.native import DatasetInfo, open_dataset
from adafusion.datasets.writer import DatasetWriter
from adafusion.geometry import pose, rotation_from_rpy
from adafusion.types import Frame, Observation

INFO = DatasetInfo(name="any", version="1", source="drawn", licence="CC0-1.0", synthetic=True)

angles = st.floats(-4.0, 4.0)
positions = st.tuples(*[st.floats(-1e5, 1e5)] * 3)


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    position_m = draw(positions)
    rotation = rotation_from_rpy(draw(angles), draw(angles), draw(angles))
    return Frame(
        run=draw(st.sampled_from(["2012-01-15", "night", "04"])),
        timestamp_us=draw(st.integers(0, 2**62)),
        position_m=position_m,
        T_world_body=pose(rotation, position_m) if draw(st.booleans()) else None,
        zone=draw(st.none() | st.text(st.characters(exclude_categories=["Cs"]), max_size=5)),
    )


@settings(max_examples=15, deadline=None)
@given(written=st.lists(frames(), min_size=1, max_size=6, unique_by=lambda f: f.key))
def test_frames_come_back_bit_for_bit_in_order(written: list[Frame]) -> None:
    with TemporaryDirectory() as folder:
        with DatasetWriter(Path(folder) / "any", INFO) as writer:
            for frame in written:
                writer.add(frame, Observation(None, None))
        read = open_dataset(Path(folder) / "any").frames
    for here, there in zip(
        read, sorted(written, key=lambda f: (f.run, f.timestamp_us)), strict=True
    ):
        assert (here.key, here.position_m, here.zone) == (there.key, there.position_m, there.zone)
        np.testing.assert_array_equal(here.T_world_body, there.T_world_body)
