# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest

from adafusion.report import AlphaTrace, Estimate, PairDistances, RouteView, SystemResult, plots


def trace(along_m: list[float], zones: tuple[str | None, ...] = ()) -> AlphaTrace:
    return AlphaTrace(
        system="adafusion",
        run="day",
        along_m=np.array(along_m),
        alpha=np.full((len(along_m), 2), 0.5),
        zones=zones,
    )


def view(**changes: object) -> RouteView:
    values: dict[str, object] = {
        "system": "adafusion",
        "split": "day->night",
        "database_xy_m": np.array([[0.0, 0.0], [100.0, 0.0]]),
        "query_xy_m": np.array([[0.0, 1.0], [100.0, 1.0], [50.0, 1.0]]),
        "is_hit": np.array([True, False, False]),
    }
    return RouteView(**{**values, **changes})


def test_a_system_keeps_its_colour_whoever_stands_beside_it() -> None:
    alone = plots.system_colors(["adafusion-s"])["adafusion-s"]
    among = plots.system_colors(["other", "image", "adafusion"])
    assert among["adafusion"] == alone
    assert len(set(among.values())) == 3


def test_two_sizes_of_a_system_side_by_side_differ_in_colour() -> None:
    assert len(set(plots.system_colors(["adafusion", "adafusion-s"]).values())) == 2


def test_recall_is_drawn_in_percent() -> None:
    result = SystemResult(name="lidar", recall={5: Estimate(0.75), 1: Estimate(0.5)})
    (line,) = plots.recall_curve([result]).axes[0].lines
    np.testing.assert_allclose(line.get_xydata(), [[1, 50], [5, 75]])


def test_a_route_counts_hits_misses_and_queries_left_out() -> None:
    figure = plots.route(view(is_answerable=np.array([True, True, False])))
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words == ["database", "left out (1)", "hit (1)", "miss (1)"]


def test_a_line_leads_from_each_miss_to_its_answer() -> None:
    answers = np.array([[0.0, 0.0], [0.0, 0.0], [100.0, 0.0]])
    ways = [
        line.get_xydata().tolist()
        for line in plots.route(view(top1_xy_m=answers)).axes[0].lines
        if line.get_linestyle() == "-"
    ]
    assert ways == [[[100.0, 1.0], [0.0, 0.0]], [[50.0, 1.0], [100.0, 0.0]]]


def test_a_route_without_queries_is_still_a_map() -> None:
    nothing = np.zeros((0, 2))
    plots.route(view(query_xy_m=nothing, is_hit=np.zeros(0, bool)))


def test_map_coordinates_far_away_are_drawn_from_a_near_origin() -> None:
    far = np.array([620_000.0, 5_735_000.0])
    axes = plots.route(
        view(database_xy_m=view().database_xy_m + far, query_xy_m=view().query_xy_m + far)
    ).axes[0]
    assert axes.get_ylabel() == "y − 5735000 (m)"
    assert abs(axes.dataLim.y0) < 1000


def test_zone_bands_meet_half_way_between_frames() -> None:
    bands = plots.zone_bands(
        trace([0.0, 2.0, 4.0, 6.0, 8.0], ("street", "street", "tunnel", None, "street"))
    )
    assert bands == [("street", 0.0, 3.0), ("tunnel", 3.0, 5.0), ("street", 7.0, 8.0)]


def test_weights_are_not_drawn_where_no_frame_was() -> None:
    (line, _) = plots.alpha_along_route([trace([0.0, 1.0, 2.0, 30.0, 31.0])]).axes[0].lines
    np.testing.assert_array_equal(line.get_xdata(), [0, 1, 2, np.nan, 30, 31])


def test_standing_still_opens_no_gap() -> None:
    (line, _) = plots.alpha_along_route([trace([0.0, 0.0, 0.0, 0.0, 1.0, 2.0])]).axes[0].lines
    np.testing.assert_array_equal(line.get_xdata(), [0, 0, 0, 0, 1, 2])


def test_a_histogram_gives_each_kind_of_pair_100_percent() -> None:
    pairs = PairDistances(system="adafusion", true=np.array([1.0, 2.0]), wrong=np.arange(3.0, 9.0))
    for patch in plots.distance_histogram(pairs).axes[0].patches:
        assert patch.get_data().values.sum() == pytest.approx(100)


def test_forward_is_up_and_left_is_left_in_a_birds_eye_view() -> None:
    cloud = np.array([[10.0, 0.0, 1.0], [0.0, 10.0, 1.0], [np.nan, 0.0, 0.0], [99.0, 0.0, 0.0]])
    picture = plots.birds_eye(cloud, reach_m=20.0, size_px=40)
    empty = picture[39, 39]
    assert sorted(zip(*np.nonzero((picture != empty).any(axis=2)), strict=True)) == [
        (10, 20),
        (20, 10),
    ]


def test_the_highest_point_of_a_cell_colours_a_birds_eye_view() -> None:
    def color(*heights: float) -> list[int]:
        return plots.birds_eye(np.array([[1.0, 1.0, z] for z in heights]))[76, 76].tolist()

    assert color(0.0, 3.0, 1.0) == color(3.0)
    assert color(0.0)[2] > color(0.0)[0]  # blue ground
    assert color(9.0)[0] > color(9.0)[2]  # yellow roofs


def test_drawing_leaves_the_settings_of_matplotlib_alone() -> None:
    import matplotlib

    before = {name: matplotlib.rcParams[name] for name in plots.STYLE}
    plots.to_svg(
        plots.recall_curve([SystemResult(name="lidar", recall={1: Estimate(1.0)})]), label="x"
    )
    assert {name: matplotlib.rcParams[name] for name in plots.STYLE} == before


@pytest.mark.parametrize("draw", [lambda: plots.recall_curve([]), lambda: plots.route(view())])
def test_without_matplotlib_it_says_what_to_install(
    draw: Callable[[], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for name in [name for name in sys.modules if name.startswith("matplotlib.")]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(ModuleNotFoundError, match=r"adafusion\[report\]"):
        draw()
