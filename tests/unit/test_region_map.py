# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np

from adafusion.report import plots

WAYS = {  # 20 frames each, 10 m apart, in map coordinates
    run: np.column_stack([620000.0 + np.arange(0.0, 200.0, 10.0), np.full(20, 5735000.0 + side)])
    for run, side in (("a", 0.0), ("b", 3.0))
}
LINE = {"test": [[620100.0, -np.inf, np.inf, np.inf]], "extra": [[0.0, 0.0, 620020.0, 6e6]]}


def test_frames_are_counted_by_region() -> None:
    figure = plots.region_map(WAYS, LINE, title="t")
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words == ["train (16 frames)", "test (20 frames)", "extra (4 frames)"]


def test_boxes_without_an_end_are_drawn_to_the_rim() -> None:
    (axes,) = plots.region_map(WAYS, LINE, title="t").axes
    (xmin, xmax), (ymin, ymax) = axes.get_xlim(), axes.get_ylim()
    test = axes.patches[-1].get_bbox()
    assert test.x0 == 100.0  # from the near origin 620000
    assert test.x1 > xmax
    assert test.y0 < ymin
    assert test.y1 > ymax
    assert xmin < 0.0 < 190.0 < xmax
    assert axes.get_aspect() == 1.0
    assert axes.get_xlabel() == "x − 620000 (m)"


def test_a_bar_says_how_long_a_round_length_is() -> None:
    (axes,) = plots.region_map(WAYS, {}, title="t").axes
    x, y = axes.lines[-1].get_data()
    assert axes.texts[-1].get_text() == "50 m"
    assert x[1] - x[0] == 50.0
    assert y[0] == y[1]


def test_a_run_that_breaks_off_is_no_line_across_the_gap() -> None:
    way = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [500.0, 0.0], [510.0, 0.0]])
    (axes,) = plots.region_map({"a": way}, {}, title="t").axes
    assert np.isnan(axes.lines[0].get_xdata()).tolist() == [False] * 3 + [True] + [False] * 2


def test_one_frame_is_enough() -> None:
    plots.region_map({"a": np.zeros((1, 2))}, {}, title="t")
