# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A diagnosis as one HTML file that needs nothing else: findings, map, histograms, samples."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module, resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from adafusion.doctor.calibration import CameraModel, camera_of
from adafusion.doctor.examine import Diagnosis
from adafusion.files import write_text
from adafusion.report import plots
from adafusion.report.html import COLORS, RECOLOR
from adafusion.types import UserError

SAMPLES = 8  # frames shown of the whole drive
SUSPECTS = 2  # frames shown of each finding that warns or fails
WIDTH_PX = 800  # of a picture: edges and points on them must be told apart
FAR_M = 40.0  # depth at which the colours of projected points end
BINS = 40


@dataclass(frozen=True, eq=False)
class Sample:
    """A frame as the page shows it; None for what there is not."""

    key: str
    why: str  # it is shown
    image: str | None  # pictures as `data:` addresses
    projected: str | None
    from_above: str | None
    wide: bool  # whether the image is so wide that pictures go below each other
    fault: str  # why files cannot be shown


def write_page(path: str | Path, diagnosis: Diagnosis) -> Path:
    """Write a diagnosis as one HTML page, whole or not at all, and return the path."""
    path = Path(path)
    write_text(path, render(diagnosis))
    return path


def render(diagnosis: Diagnosis) -> str:
    """The page as text."""
    try:
        import jinja2
        from markupsafe import Markup
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("a page needs jinja2: pip install 'adafusion[report]'") from error
    dataset, table = diagnosis.dataset, diagnosis.table

    def chart(figure: Any, label: str) -> Markup:
        return Markup(plots.to_svg(figure, label=label, recolor=RECOLOR))

    ways = {run: table.xyz[table.run == k, :2] for k, run in enumerate(table.runs)}
    route = plots.region_map(ways, dataset.info.regions, title="All frames by region")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = resources.files("adafusion.doctor").joinpath("page.html.j2")
    return environment.from_string(template.read_text(encoding="utf-8")).render(
        info=dataset.info,
        root=dataset.root,
        level=diagnosis.level,
        findings=diagnosis.findings,
        frames=len(table.frames),
        runs=table.runs,
        opened=len(diagnosis.looks),
        radius_m=diagnosis.radius_m,
        far_m=FAR_M,
        palette={name.lower(): getattr(plots, name) for name in COLORS},
        route=chart(route, "Map of all runs, their frames coloured by region"),
        histograms=[chart(_histogram(*of), f"Histogram: {of[0]}") for of in _numbers(diagnosis)],
        samples=[_sample(diagnosis, row, why) for row, why in _chosen(diagnosis)],
    )


def _numbers(diagnosis: Diagnosis) -> list[tuple[str, str, Float[np.ndarray, " n"]]]:
    """Title, axis and values of each histogram that has something to show."""
    clouds = [look.cloud for look in diagnosis.looks if look.cloud]
    images = [look.image for look in diagnosis.looks if look.image]
    ground = np.array([cloud.ground_m for cloud in clouds])
    all_of = [
        ("True matches of a frame", "frames of other runs within the radius", diagnosis.positives),
        ("Size of a cloud", "points", [cloud.points for cloud in clouds]),
        ("Voxel grid", "occupied cells", [cloud.occupied for cloud in clouds]),
        ("Ground", "height of the ground in the body frame (m)", ground[np.isfinite(ground)]),
        ("Brightness", "95th percentile of an image's grey values", [i.bright for i in images]),
    ]
    return [(title, axis, np.array(v, float)) for title, axis, v in all_of if len(v)]


def _histogram(title: str, axis: str, values: Float[np.ndarray, " n"]) -> Any:
    # from the defaults, so that nobody's own matplotlibrc changes a page
    with import_module("matplotlib.style").context(["default", plots.STYLE]):
        figure = import_module("matplotlib.figure").Figure((3.6, 2.3), layout="constrained")
        axes = figure.subplots()
        axes.hist(values, bins=bar_edges(values), color=plots.LIDAR)
        axes.set_title(title)
        axes.set_xlabel(axis)
        axes.set_ylabel("frames")
        axes.xaxis.set_major_locator(import_module("matplotlib.ticker").MaxNLocator(5))
    return figure


def bar_edges(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " e"]:
    """Edges of a histogram's bars; one value alone is a narrow bar in the middle."""
    alone = np.ptp(values) == 0
    reach = max(abs(values[0]) / 10, 0.5)
    return np.histogram_bin_edges(
        values,
        bins=BINS + 1 if alone else min(BINS, len(np.unique(values)) + 1),
        range=(values[0] - reach, values[0] + reach) if alone else None,
    )


def _chosen(diagnosis: Diagnosis) -> list[tuple[int, str]]:
    """Rows to show and why: suspects first, then some spread over all that was opened."""
    row_of = {frame.key: row for row, frame in enumerate(diagnosis.table.frames)}
    chosen: dict[int, str] = {}
    for finding in diagnosis.findings:
        if finding.level in ("warn", "fail"):
            for key in finding.frames[:SUSPECTS]:
                chosen.setdefault(row_of[key], f"{finding.level}: {finding.check}")
    rows = [look.row for look in diagnosis.looks]
    for i in np.unique(np.linspace(0, len(rows) - 1, SAMPLES + 2).astype(int)[1:-1]):
        chosen.setdefault(rows[i], "sample")
    return list(chosen.items())


def _sample(diagnosis: Diagnosis, row: int, why: str) -> Sample:
    dataset, frame = diagnosis.dataset, diagnosis.table.frames[row]
    try:
        seen = dataset.load(frame)
    except UserError as error:
        return Sample(frame.key, why, None, None, None, wide=False, fault=str(error))
    image, points = seen.image, seen.points_body
    camera = camera_of(dataset.info, frame.run)
    over = None
    if image is not None and points is not None and isinstance(camera, CameraModel):
        over = _picture(overlay(image, points, camera))
    return Sample(
        key=frame.key,
        why=why,
        image=None if image is None else _picture(image),
        projected=over,
        from_above=None if points is None else _address("png", plots.birds_eye(points), []),
        wide=image is not None and image.shape[1] > 2 * image.shape[0],
        fault="",
    )


def overlay(
    image: UInt8[np.ndarray, "h w 3"], points_body: Float[np.ndarray, "n 3"], camera: CameraModel
) -> UInt8[np.ndarray, "h2 w2 3"]:
    """The cloud drawn onto the image, red near and blue far, nearer points over farther ones."""
    height, width = image.shape[:2]
    _, pixels, depth = camera.project(points_body, (height, width))
    scale = max(1, -(-WIDTH_PX // width))  # small images are enlarged, so that points stay points
    drawn = cv2.resize(image, (width * scale, height * scale), interpolation=cv2.INTER_LINEAR)
    drawn = (0.6 * drawn).astype(np.uint8)
    shade = 255 * (1 - np.clip(depth / FAR_M, 0, 1))
    colors = cv2.applyColorMap(shade.astype(np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]
    apart_px = (drawn.shape[0] * drawn.shape[1] / max(len(depth), 1)) ** 0.5
    radius = int(np.clip(apart_px / 6, 1, 4))  # dense clouds shall not cover the image
    order = np.argsort(-depth)
    for (x, y), color in zip(
        (scale * pixels[order]).astype(int).tolist(), colors[order].tolist(), strict=True
    ):
        cv2.circle(drawn, (x, y), radius, color, thickness=-1)
    return drawn


def _picture(image: UInt8[np.ndarray, "h w 3"]) -> str:
    height, width = image.shape[:2]
    if width > WIDTH_PX:
        size = WIDTH_PX, max(1, round(height * WIDTH_PX / width))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return _address("jpeg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])


def _address(kind: str, image: UInt8[np.ndarray, "h w 3"], options: Sequence[int]) -> str:
    _, data = cv2.imencode(f".{kind}", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
