# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Range images out of clouds, and the sheet of places by conditions."""

from __future__ import annotations

import base64
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from adafusion.sim.sensing.lidar import VLP_16, Lidar, ray_directions
from adafusion.sim.sheet import CELL_PX, Cell, cell_of, draw_sheet, range_image, write_sheet
from adafusion.types import Observation, UserError

SENSOR = Lidar(beams=3, steps=8, lowest_deg=-10.0, highest_deg=10.0, height_m=2.0)


def test_a_cloud_goes_back_to_the_rays_it_came_from() -> None:
    ranges = np.random.default_rng(0).uniform(2.0, 70.0, (VLP_16.beams, VLP_16.steps))
    ranges[3, 5] = 0.0
    points = (ray_directions(VLP_16) * ranges[..., None])[ranges > 0.0]
    points[:, 2] += VLP_16.height_m
    back = range_image(points.astype(np.float32), VLP_16)
    np.testing.assert_allclose(back, ranges, rtol=1e-5)


def test_what_is_ahead_is_in_the_middle_and_what_is_high_in_the_last_row() -> None:
    up = np.tan(np.deg2rad(10.0)) * 4.0
    points = np.array([(5.0, 0.0, 2.0), (0.0, 6.0, 2.0), (4.0, 0.0, 2.0 + up), (-7.0, 0.0, 2.0)])
    expected = np.zeros((3, 8))
    expected[1, 4], expected[1, 2], expected[2, 4] = 5.0, 6.0, np.hypot(4.0, up)
    expected[1, 0] = 7.0
    np.testing.assert_allclose(range_image(points, SENSOR), expected, rtol=1e-6)


def test_the_nearest_of_several_points_on_a_ray_counts() -> None:
    points = np.array([(9.0, 0.0, 2.0), (5.0, 0.0, 2.0), (7.0, 0.0, 2.0)])
    assert range_image(points, SENSOR)[1, 4] == 5.0
    assert not range_image(np.zeros((0, 3)), SENSOR).any()


def grey(level: int) -> np.ndarray:
    return np.full((60, 80, 3), level, np.uint8)


def test_cells_stand_in_rows_and_columns_below_their_labels() -> None:
    levels = [[40, 90, 140], [60, 110, 160]]
    cells = [[Cell(grey(level)) for level in row] for row in levels]
    sheet = draw_sheet(cells, ("street", "park"), ("day", "dusk", "night"))
    height = 60 * CELL_PX // 80
    where = {}
    for level in (40, 90, 140, 60, 110, 160):
        rows, columns = np.nonzero((sheet == level).all(axis=2))
        box = np.ptp(rows) + 1, np.ptp(columns) + 1
        # letters are smoothed and may hold any grey, but only a cell is this large
        assert box[0] >= height
        assert box[1] >= CELL_PX
        where[level] = np.median(rows), np.median(columns)
    assert where[40][0] == where[90][0] == where[140][0] < where[60][0]
    assert where[40][1] < where[90][1] < where[140][1]
    assert where[40][1] == where[60][1]
    assert sheet[: int(where[40][0]) - height // 2].min() < 100, "labels are written above"


def test_ranges_are_coloured_by_distance_below_the_image() -> None:
    ranges = np.zeros((4, 8), np.float32)
    ranges[:, :4], ranges[:2, 4:] = 2.0, 55.0
    plain = draw_sheet([[Cell(grey(200))]], ("a",), ("b",))
    sheet = draw_sheet([[Cell(grey(200), ranges)]], ("a",), ("b",))
    assert sheet.shape[0] > plain.shape[0]
    strip = sheet[plain.shape[0] - 14 : sheet.shape[0] - 14, -14 - CELL_PX : -14].astype(int)
    near, far, sky = strip[-3, 20], strip[-3, -20], strip[2, -20]
    assert near[0] > near[2] + 50, "near is red"
    assert far[2] > far[0] + 20, "far is blue"
    assert sky.max() < 40, "nothing came back from above: the lowest beam is at the bottom"


def test_a_view_from_above_has_ahead_at_the_top() -> None:
    points = np.array([(10.0, 0.0, 3.0), (0.0, 10.0, 3.0)])
    alone, seen = (
        draw_sheet([[Cell(grey(200), None, cloud)]], ("a",), ("b",)).astype(int)
        for cloud in (points[:0], points)
    )
    rows, columns = np.nonzero(np.abs(seen - alone).sum(axis=2))
    ahead, left = np.argmin(rows), np.argmin(columns)
    assert rows[ahead] < rows[left]
    assert columns[left] < columns[ahead]


def test_a_sensor_that_gave_nothing_is_a_dark_cell() -> None:
    cell = cell_of(Observation(grey(10), None), VLP_16, from_above=True)
    assert cell.ranges is not None
    assert not cell.ranges.any()
    sheet = draw_sheet([[Cell(None), cell]], ("a",), ("b", "c"))
    left = sheet[90:120, -14 - 2 * CELL_PX : -14 - CELL_PX - 10]
    assert left.max() < 40


def test_labels_that_do_not_count_the_cells_are_refused() -> None:
    for rows, columns in ((("a", "b"), ("c",)), (("a",), ("c", "d")), ((), ())):
        with pytest.raises(ValueError, match=r"rows|place"):
            draw_sheet([[Cell(grey(1))]], rows, columns)


def test_a_page_holds_its_pictures_and_says_that_it_is_synthetic(tmp_path: Path) -> None:
    path = tmp_path / "sheet.html"
    write_sheet(
        path, [[Cell(grey(7)), Cell(grey(9))]], ("<street>",), ("day", "night"), title="A&B"
    )
    page = path.read_text(encoding="utf-8")
    assert "synthetic" in page
    assert "&lt;street&gt;" in page
    assert "A&amp;B" in page
    assert not re.search(r'(src|href)="(?!data:)', page), "it needs no other file"
    pictures = re.findall(r"data:image/png;base64,([^\"]+)", page)
    decoded = [
        cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
        for data in pictures
    ]
    assert [int(np.median(picture)) for picture in decoded] == [7, 9]


def test_a_picture_is_the_sheet_in_rgb(tmp_path: Path) -> None:
    red = grey(0)
    red[..., 0] = 250
    write_sheet(tmp_path / "sheet.png", [[Cell(red)]], ("a",), ("b",))
    bgr = cv2.imread(str(tmp_path / "sheet.png"))
    expected = draw_sheet([[Cell(red)]], ("a",), ("b",))
    np.testing.assert_array_equal(bgr[..., ::-1], expected)
    assert [path.name for path in tmp_path.iterdir()] == ["sheet.png"]


def test_another_suffix_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"\.png or \.html"):
        write_sheet(tmp_path / "sheet.pdf", [[Cell(grey(1))]], ("a",), ("b",))
    assert not list(tmp_path.iterdir())
