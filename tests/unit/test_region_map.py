# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import io

import numpy as np
import pytest
from matplotlib.text import Text

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


STRAIGHT = {"a": np.column_stack([np.zeros(20), np.arange(0.0, 200.0, 10.0)])}
BLOCK = {"test": [[-5.0, 0.0, 95.0, 100.0]], "guard": [[-30.0, -25.0, 120.0, 125.0]]}


def test_boxes_about_a_straight_route_are_shown_whole() -> None:
    (axes,) = plots.region_map(STRAIGHT, BLOCK, title="t").axes
    (xmin, xmax), (ymin, ymax) = axes.get_xlim(), axes.get_ylim()
    assert xmin < -30.0 < 120.0 < xmax
    assert ymin < -25.0 < 190.0 < ymax


def test_boxes_far_from_the_route_do_not_make_it_small() -> None:
    far = {"test": [[-1e6, -1e6, 0.0, 1e6], [5000.0, 5000.0, 5100.0, 5100.0]]}
    sizes = [
        plots.region_map(STRAIGHT, regions, title="t").axes[0].get_xlim() for regions in ({}, far)
    ]
    assert sizes[0] == sizes[1]


@pytest.mark.parametrize("ways", [STRAIGHT, {"a": STRAIGHT["a"][:, ::-1]}])
def test_a_long_title_stays_in_the_picture(ways: dict[str, np.ndarray]) -> None:
    title = "some-dataset: cut: test 0.3, validation 0.1 in blocks of 100 m, guard 25 m; " * 2
    figure = plots.region_map(ways, {}, title=title)
    figure.savefig(io.BytesIO(), dpi=100)  # lays it out
    (words,) = [text for text in figure.findobj(Text) if text.get_text().startswith("some")]
    box = words.get_window_extent()
    assert 0 <= box.x0 < box.x1 <= figure.bbox.width
    assert box.y1 <= figure.bbox.height


def test_one_frame_is_enough() -> None:
    plots.region_map({"a": np.zeros((1, 2))}, {}, title="t")
