# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from adafusion.evaluation import contribution_shares, summarize_alpha
from adafusion.types import AlphaSummary

ALPHA = np.array([[0.25, 1.0], [0.75, 1.0], [0.5, 0.0]], np.float32)


def test_it_summarises_alpha_by_label() -> None:
    assert summarize_alpha(ALPHA, ["night", "night", "day"]) == {
        "day": AlphaSummary(1, (0.5, 0.0), (0.0, 0.0)),
        "night": AlphaSummary(2, (0.5, 1.0), (0.25, 0.0)),
    }
    assert summarize_alpha(ALPHA)["all"].num_frames == 3


def test_it_leaves_out_frames_of_no_zone() -> None:
    assert list(summarize_alpha(ALPHA, [None, "tunnel", None])) == ["tunnel"]
    with pytest.raises(ValueError, match="1 labels for 3 frames"):
        summarize_alpha(ALPHA, ["tunnel"])


def test_shares_are_parts_of_the_distance() -> None:
    query = np.array([[1.0, 0.0, 5.0, 5.0], [2.0, 2.0, 2.0, 2.0]], np.float32)
    match = np.array([[0.0, 0.0, 5.0, 2.0], [2.0, 2.0, 2.0, 2.0]], np.float32)
    shares = contribution_shares(query, match)
    assert shares[0].tolist() == [0.25, 0.75]
    assert np.isnan(shares[1]).all()  # no distance, no shares


def test_shares_need_two_halves() -> None:
    with pytest.raises(ValueError, match="two halves"):
        contribution_shares(np.zeros((1, 3), np.float32), np.zeros((1, 3), np.float32))
