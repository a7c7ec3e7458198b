# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A contact sheet: places down, conditions across, what camera and LiDAR saw in every cell."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from adafusion.files import atomic_path, write_text
from adafusion.sim.sensing.lidar import Lidar
from adafusion.types import Observation, UserError

SUFFIXES = (".png", ".html")
CELL_PX = 320  # width of a cell
REACH_M = 60.0  # the last colour of the range image
VIEW_M = 30.0  # of the bird's eye view to each side, two thirds of it ahead and behind
_GAP_PX, _MARGIN_PX = 4, 14
_PAPER, _INK, _FAINT = (250, 250, 248), (30, 32, 36), (120, 124, 130)  # RGB
_EMPTY = (22, 24, 28)  # where nothing came back
NOTE = "synthetic world"

Picture = UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True, eq=False)
class Cell:
    """What a cell shows, from the top; a part that is None is left out."""

    image: Picture | None  # RGB
    ranges: Float32[np.ndarray, "beams steps"] | None = None  # metres, lowest beam first, 0: none
    points_body: Float[np.ndarray, "n 3"] | None = None  # metres, for a bird's eye view


def cell_of(seen: Observation, lidar: Lidar, *, from_above: bool = False) -> Cell:
    """The cell of one observation; `from_above` adds the bird's eye view."""
    points = np.zeros((0, 3)) if seen.points_body is None else seen.points_body
    return Cell(seen.image, range_image(points, lidar), points if from_above else None)


def range_image(
    points_body: Float[np.ndarray, "n 3"], lidar: Lidar
) -> Float32[np.ndarray, "beams steps"]:
    """Put a cloud back on the beams and steps of its sensor: metres, 0 where nothing came back.

    Lowest beam first; the first step looks backwards and the middle one ahead. Of several points
    on one ray the nearest counts.
    """
    points = np.asarray(points_body, float) - lidar.T_body_lidar[:3, 3]
    distance = np.linalg.norm(points, axis=1)
    points, distance = points[distance > 0.0], distance[distance > 0.0]
    elevation = np.arcsin(np.clip(points[:, 2] / distance, -1.0, 1.0))
    beam = np.interp(elevation, lidar.elevations_rad, np.arange(lidar.beams))
    turn = (np.pi - np.arctan2(points[:, 1], points[:, 0])) / (2.0 * np.pi)
    step = np.round(turn * lidar.steps).astype(int) % lidar.steps
    ranges = np.full((lidar.beams, lidar.steps), np.inf, np.float32)
    np.minimum.at(ranges, (np.round(beam).astype(int), step), distance.astype(np.float32))
    return np.where(np.isfinite(ranges), ranges, np.float32(0.0))


def draw_sheet(
    cells: Sequence[Sequence[Cell]],
    rows: Sequence[str],
    columns: Sequence[str],
    *,
    title: str = "Contact sheet",
) -> Picture:
    """One picture of all cells, with the kind of place before each row and conditions on top.

    ValueError where the labels do not count the cells.
    """
    _check(cells, rows, columns)
    drawn = [[_draw_cell(cell) for cell in row] for row in cells]
    heights = [max(part.shape[0] for part in row) for row in drawn]
    left = 2 * _MARGIN_PX + max(_text_width(label) for label in rows)
    top = _MARGIN_PX + 72
    h = top + sum(heights) + _GAP_PX * (len(rows) - 1) + _MARGIN_PX
    w = left + len(columns) * (CELL_PX + _GAP_PX) - _GAP_PX + _MARGIN_PX
    sheet = np.full((h, w, 3), _PAPER, np.uint8)
    _write(sheet, title, (_MARGIN_PX, _MARGIN_PX + 14), _INK, 0.62)
    _write(sheet, f"{NOTE}: rendered, not recorded", (_MARGIN_PX, _MARGIN_PX + 34), _FAINT, 0.42)
    for j, label in enumerate(columns):
        _write(sheet, label, (left + j * (CELL_PX + _GAP_PX), top - 10), _INK)
    y = top
    for label, row, height in zip(rows, drawn, heights, strict=True):
        _write(sheet, label, (_MARGIN_PX, y + 18), _FAINT)
        for j, part in enumerate(row):
            x = left + j * (CELL_PX + _GAP_PX)
            sheet[y : y + part.shape[0], x : x + CELL_PX] = part
        y += height + _GAP_PX
    return sheet


def check_suffix(path: Path) -> None:
    """UserError where a sheet cannot be written by such a name."""
    if path.suffix not in SUFFIXES:
        raise UserError(f"{path}: a contact sheet ends in {' or '.join(SUFFIXES)}")


def write_sheet(
    path: str | Path,
    cells: Sequence[Sequence[Cell]],
    rows: Sequence[str],
    columns: Sequence[str],
    *,
    title: str = "Contact sheet",
) -> None:
    """Write a sheet as a picture (.png) or as a page that needs no other file (.html).

    The file is whole or not there. UserError for another suffix.
    """
    path = Path(path)
    check_suffix(path)
    if path.suffix == ".html":
        write_text(path, _page(cells, rows, columns, title))
        return
    data = _png(draw_sheet(cells, rows, columns, title=title))
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def _check(cells: Sequence[Sequence[Cell]], rows: Sequence[str], columns: Sequence[str]) -> None:
    if not rows or not columns:
        raise ValueError("a sheet needs a place and a condition at least")
    if len(cells) != len(rows) or any(len(row) != len(columns) for row in cells):
        raise ValueError(
            f"{len(rows)} rows x {len(columns)} columns are named, "
            f"the cells are {[len(row) for row in cells]}"
        )


def _draw_cell(cell: Cell) -> Picture:
    """Camera image, range image and bird's eye view, one below the other."""
    parts = []
    if cell.image is not None:
        parts.append(_fit(cell.image))
    if cell.ranges is not None:
        parts.append(_colour_ranges(cell.ranges))
    if cell.points_body is not None:
        parts.append(_from_above(cell.points_body))
    if not parts:
        return np.full((CELL_PX // 4, CELL_PX, 3), _EMPTY, np.uint8)
    return np.concatenate(parts)


def _fit(image: Picture) -> UInt8[np.ndarray, "rows columns 3"]:
    """An image at the width of a cell."""
    height = round(image.shape[0] * CELL_PX / image.shape[1])
    smaller = image.shape[1] > CELL_PX
    how = cv2.INTER_AREA if smaller else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, (CELL_PX, height), interpolation=how))


def _colour_ranges(ranges: Float32[np.ndarray, "beams steps"]) -> Picture:
    """Range as colour, near ones warm; the horizon above, straight ahead in the middle."""
    near = 1.0 - np.sqrt(np.clip(ranges / REACH_M, 0.0, 1.0))  # most of a street is near
    rgb = _turbo(near)
    rgb[ranges <= 0.0] = _EMPTY
    height = max(2 * round(0.5 * CELL_PX * 0.22), ranges.shape[0])
    # nearest: a mean of two colours would be a range that nobody measured
    picture = cv2.resize(rgb[::-1], (CELL_PX, height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(picture)


def _from_above(points: Float[np.ndarray, "n 3"]) -> Picture:
    """Points from above by height, heading upwards, the vehicle in the middle."""
    w, h = CELL_PX, CELL_PX * 2 // 3
    scale = 0.5 * w / VIEW_M
    column = np.floor(0.5 * w - scale * points[:, 1]).astype(int)
    row = np.floor(0.5 * h - scale * points[:, 0]).astype(int)
    inside = (column >= 0) & (column < w) & (row >= 0) & (row < h)
    row, column, z = row[inside], column[inside], points[inside, 2]
    order = np.argsort(z, kind="stable")  # what is higher hides what is lower
    picture = np.full((h, w, 3), _EMPTY, np.uint8)
    picture[row[order], column[order]] = _turbo(0.1 + 0.8 * np.clip(z[order] / 6.0, 0.0, 1.0))
    cv2.drawMarker(picture, (w // 2, h // 2), (255, 255, 255), cv2.MARKER_TRIANGLE_UP, 9, 1)
    return picture


def _turbo(share: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape 3"]:
    """Colours of shares from 0 (blue) to 1 (red), RGB."""
    table = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)
    return np.asarray(table)[:, 0, ::-1][np.round(share * 255.0).astype(np.uint8)]


def _write(
    sheet: Picture, text: str, at: tuple[int, int], rgb: tuple[int, int, int], size: float = 0.5
) -> None:
    cv2.putText(sheet, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, rgb, 1, cv2.LINE_AA)


def _text_width(text: str) -> int:
    return int(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)[0][0])


def _png(picture: Picture) -> bytes:
    _, data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))
    return bytes(data)


_STYLE = """
body { margin: 2rem; background: #fafaf8; color: #1e2024; font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.3rem; margin: 0; }
p { color: #6b7078; margin: .2rem 0 1.2rem; }
.wide { overflow-x: auto; }
table { border-spacing: 4px; }
th { font-weight: 600; text-align: left; vertical-align: top; padding: 0 .6rem 0 0; }
tbody th { font-weight: 400; color: #6b7078; position: sticky; left: 0; background: #fafaf8; }
td { padding: 0; vertical-align: top; }
img { display: block; width: 20rem; }
"""


def _page(
    cells: Sequence[Sequence[Cell]], rows: Sequence[str], columns: Sequence[str], title: str
) -> str:
    """The sheet as HTML, every picture inside it."""
    _check(cells, rows, columns)
    head = "".join(f"<th scope=col>{html.escape(label)}</th>" for label in columns)
    body = []
    for label, row in zip(rows, cells, strict=True):
        pictures = []
        for cell, column in zip(row, columns, strict=True):
            data = base64.b64encode(_png(_draw_cell(cell))).decode()
            name = html.escape(f"{label}, {column}", quote=True)
            pictures.append(f'<td><img alt="{name}" src="data:image/png;base64,{data}"></td>')
        body.append(f"<tr><th scope=row>{html.escape(label)}</th>{''.join(pictures)}</tr>\n")
    return (
        f'<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n'
        f"<title>{html.escape(title)}</title>\n<style>{_STYLE}</style>\n"
        f"<h1>{html.escape(title)}</h1>\n"
        f"<p>{NOTE}: rendered, not recorded. Below each picture the LiDAR ranges, "
        f"red near and blue at {REACH_M:g} m, straight ahead in the middle.</p>\n"
        f"<div class=wide><table>\n<thead><tr><th></th>{head}</tr></thead>\n"
        f"<tbody>\n{''.join(body)}</tbody>\n</table></div>\n</html>\n"
    )
