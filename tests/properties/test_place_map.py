# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from adafusion.mapping import MapHeader, PlaceMap
from adafusion.types import Descriptions

FLOATS = st.floats(width=32, allow_nan=False, allow_infinity=False)  # -0.0 and subnormals too
NAMES = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)  # any Unicode


@st.composite
def contents(draw: st.DrawFn) -> dict[str, Any]:
    keys = draw(st.lists(NAMES, min_size=1, max_size=5, unique=True))
    n = len(keys)

    def part(dims: int) -> np.ndarray:
        return draw(arrays(np.float32, (n, dims), elements=FLOATS))

    half = draw(st.integers(1, 12))
    T_map_body = draw(arrays(np.float64, (n, 4, 4), elements=FLOATS))
    T_map_body[draw(arrays(np.bool_, n))] = np.nan
    # not a PlaceMap yet: checking its types draws random numbers, which a strategy may not
    return {
        "header": {
            "model": draw(NAMES),
            "model_fingerprint": draw(NAMES),
            "preprocess_fingerprint": draw(NAMES),
            "synthetic": draw(st.booleans()),
            "world": draw(NAMES),
            "p": draw(st.sampled_from((1, 2))),
        },
        "keys": tuple(keys),
        "datasets": tuple(draw(NAMES) for _ in range(n)),
        "zones": tuple(draw(st.none() | NAMES) for _ in range(n)),
        "positions_m": draw(arrays(np.float64, (n, 3), elements=FLOATS)),
        "T_map_body": T_map_body,
        "descriptions": (
            part(2 * half),
            part(half) if draw(st.booleans()) else None,
            part(half) if draw(st.booleans()) else None,
            part(2) if draw(st.booleans()) else None,
        ),
    }


@settings(max_examples=25, deadline=None)
@given(contents())
def test_it_comes_back_from_disk_to_the_last_bit(content: dict[str, Any]) -> None:
    content["header"] = MapHeader(**content["header"])
    content["descriptions"] = Descriptions(*content["descriptions"])
    place_map = PlaceMap(**content)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.map"
        place_map.save(path)
        opened = PlaceMap.open(path)
    assert (opened.header, opened.keys) == (place_map.header, place_map.keys)
    assert (opened.datasets, opened.zones) == (place_map.datasets, place_map.zones)
    assert opened.T_map_body.tobytes() == place_map.T_map_body.tobytes()
    assert opened.positions_m.tobytes() == place_map.positions_m.tobytes()
    assert {k: v.tobytes() for k, v in opened.parts.items()} == {
        k: v.tobytes() for k, v in place_map.parts.items()
    }
    assert opened.fingerprint == place_map.fingerprint
