# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A report as one HTML file that needs nothing else: charts as SVG, pictures inside, no script."""

from __future__ import annotations

import base64
import logging
from importlib import resources
from itertools import groupby
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from adafusion.files import write_text
from adafusion.report import plots
from adafusion.report.data import AlphaTrace, ProtocolFacts, ReportData
from adafusion.types import Estimate

log = logging.getLogger(__name__)

IMAGE_WIDTH_PX = 400  # a picture in a report is looked at, not measured
# what a dark page turns over or brightens: the style sheet of the template says how
COLORS = ("INK", "FAINT", "IMAGE", "LIDAR", "RIGHT", "WRONG")
RECOLOR = {getattr(plots, name): f"var(--{name.lower()})" for name in COLORS}


def write_report(path: str | Path, data: ReportData) -> Path:
    """Write `data` as one HTML page to `path`, whole or not at all, and return the path."""
    path = Path(path)
    write_text(path, render(data))
    log.info("report written to %s (%.1f MB)", path, path.stat().st_size / 1e6)
    return path


def render(data: ReportData) -> str:
    """The page as text."""
    try:
        import jinja2
        from markupsafe import Markup
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "a report needs jinja2: pip install 'adafusion[report]'"
        ) from error

    def chart(figure: Any, label: str) -> Markup:
        return Markup(plots.to_svg(figure, label=label, recolor=RECOLOR))

    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "percent": percent,
        "interval": interval,
        "points": points,
        "jpeg": jpeg,
        "birds_eye": lambda cloud: png(plots.birds_eye(cloud)),
        "breadth": lambda image: min(image.shape[1] / image.shape[0], 2.2),  # of a cloud's square
        "arrow": lambda text: text.replace("->", " → "),
        "count": lambda number: f"{number:,}".replace(",", "\u202f"),
    }
    template = resources.files("adafusion.report").joinpath("report.html.j2")
    headline = next(s for s in data.systems if s.name == (data.headline or data.systems[-1].name))
    return environment.from_string(template.read_text(encoding="utf-8")).render(
        data=data,
        headline=headline,
        colors=plots.system_colors(s.name for s in data.systems),
        recolor=RECOLOR,
        palette={name.lower(): getattr(plots, name) for name in COLORS},
        who_may_answer=who_may_answer(data.protocol),
        recall_chart=chart(
            plots.recall_curve(data.systems),
            "Recall at N in percent, one curve a system: "
            + ", ".join(f"{s.name} {percent(s.recall[1].value)} at 1" for s in data.systems),
        ),
        routes=[
            (
                view,
                chart(
                    plots.route(view),
                    f"Map of the route, {view.system}, {view.split}: where queries hit and missed",
                ),
            )
            for view in data.routes
        ],
        alpha_charts=[
            (
                system,
                chart(
                    plots.alpha_along_route(traces),
                    f"Weights of image and LiDAR along the route, {system}, runs "
                    + ", ".join(trace.run for trace in traces),
                ),
            )
            for system, traces in _by_system(data.alpha)
        ],
        histograms=[
            (
                pairs,
                chart(
                    plots.distance_histogram(pairs, unit=data.protocol.distance),
                    f"Histogram of descriptor distances, {pairs.system}: same place against apart",
                ),
            )
            for pairs in data.distances
        ],
    )


def percent(fraction: float) -> str:
    """0.8333 as `83.3 %`, its space unbreakable."""
    return f"{100 * fraction:.1f}\u00a0%"


def interval(estimate: Estimate) -> str:
    """The 95 % interval of a fraction, in percent: `78.1-86.0`; empty where none is known."""
    if estimate.interval is None:
        return ""
    low, high = estimate.interval
    return f"{100 * low:.1f}\u2013{100 * high:.1f}"


def points(difference: float) -> str:
    """A difference of fractions in percentage points, with its sign: `+3.1`."""
    return f"{100 * difference:+.1f}".replace("-", "\u2212")


def who_may_answer(protocol: ProtocolFacts) -> str:
    """Which frames of the database a query may be answered with."""
    if protocol.exclude_query_run:
        return "every frame of the database except those of the query's own run"
    if protocol.exclude_self:
        return (
            "every frame of the database except the query itself; its neighbours in its own run may"
        )
    return "every frame of the database"


def jpeg(image: UInt8[np.ndarray, "h w 3"]) -> str:
    """An RGB image as a `data:` address, made smaller for a page."""
    height, width = image.shape[:2]
    if width > IMAGE_WIDTH_PX:
        size = (IMAGE_WIDTH_PX, round(height * IMAGE_WIDTH_PX / width))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return _address("jpeg", image, [cv2.IMWRITE_JPEG_QUALITY, 82])


def png(image: UInt8[np.ndarray, "h w 3"]) -> str:
    """An RGB image as a `data:` address, every pixel as it is."""
    return _address("png", image, [])


def _address(kind: str, image: UInt8[np.ndarray, "h w 3"], options: list[int]) -> str:
    _, data = cv2.imencode(f".{kind}", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"


def _by_system(traces: tuple[AlphaTrace, ...]) -> list[tuple[str, list[AlphaTrace]]]:
    return [(system, list(group)) for system, group in groupby(traces, lambda t: t.system)]
