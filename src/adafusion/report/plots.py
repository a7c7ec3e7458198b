# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The charts of a report, each a function from plain values to a matplotlib `Figure`.

They can be used alone: `recall_curve(systems).savefig("recall.pdf")`. A colour means one thing all
over: a system, a sensor, right or wrong. Colours are those of Okabe and Ito (2008), told apart by
people who see fewer of them; right and wrong differ in shape as well.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import groupby
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from jaxtyping import Float, UInt8

from adafusion.report.data import AlphaTrace, PairDistances, RouteView, SystemResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
else:  # drawing is optional, so its types are not there to be checked while the code runs
    Axes: TypeAlias = Any
    Figure: TypeAlias = Any

INK, FAINT = "#1f2430", "#8b93a3"
IMAGE, LIDAR = "#e69f00", "#0072b2"
RIGHT, WRONG = "#009e73", "#d55e00"
SYSTEMS = {"image": IMAGE, "lidar": LIDAR, "concat": "#cc79a7", "adafusion": INK}
SPARE = ("#56b4e9", "#8a6d1f", "#7b5ea7", "#6b7280", "#a3333d")
ZONES = ("#7b5ea7", "#56b4e9", "#8a6d1f", "#6b7280", "#cc79a7", "#009e73")

MANY = 3000  # marks from which a picture is smaller than their outlines
STYLE = {
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib, so the layout is the same anywhere
    "font.size": 10.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": FAINT,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.7,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "legend.frameon": False,
    "svg.fonttype": "none",  # words stay words: they can be searched, read aloud and recoloured
    "svg.image_inline": True,
}


def system_colors(names: Iterable[str]) -> dict[str, str]:
    """The colour of each system; the size in a name does not matter (`adafusion-s`)."""
    spare = iter(SPARE * 10)
    return {name: SYSTEMS.get(name.removesuffix("-s")) or next(spare) for name in names}


def recall_curve(systems: Sequence[SystemResult]) -> Figure:
    """Recall@N of each system, in percent over N, its interval as a band."""
    with _style():
        figure, (axes,) = _figure(6.2, 4.4)
        colors = system_colors(system.name for system in systems)
        for system in sorted(systems, key=lambda system: -float(system.recall[0])):
            n = np.arange(1, len(system.recall) + 1)
            if system.recall_low is not None and system.recall_high is not None:
                axes.fill_between(
                    n,
                    100 * system.recall_low,
                    100 * system.recall_high,
                    color=colors[system.name],
                    alpha=0.13,
                    linewidth=0,
                )
            axes.plot(
                n,
                100 * system.recall,
                color=colors[system.name],
                linewidth=1.9,
                marker="o" if len(n) <= 30 else None,
                markersize=3,
                label=f"{system.name}  {100 * system.recall[0]:.1f} %",
            )
        longest = max(len(system.recall) for system in systems)
        axes.set_xlim(1 - 0.02 * longest, longest + 0.02 * longest)
        axes.set_ylim(0, 101)
        axes.set_xticks([n for n in (1, 5, 10, 15, 20, 25) if n <= longest])
        axes.set_xlabel("N, candidates looked at")
        axes.set_ylabel("recall@N (%)")
        axes.legend(title="recall@1", alignment="left", loc="lower right")
        return figure


def route(view: RouteView) -> Figure:
    """The database's route, the queries on it (right, wrong, left out), wrong answers as lines."""
    with _style():
        origin = _far_origin(view.database_xy_m)
        database, query = view.database_xy_m - origin, view.query_xy_m - origin
        wide, high = np.ptp(np.concatenate([database, query]), axis=0) + 20.0
        figure, (axes,) = _figure(6.2, float(np.clip(5.4 * high / wide, 2.2, 6.5)) + 0.9)
        asked = np.ones(len(query), bool) if view.is_answerable is None else view.is_answerable
        right, wrong = asked & view.is_hit, asked & ~view.is_hit
        picture = len(database) + len(query) > MANY
        marks: dict[str, Any] = {"linestyle": "none", "rasterized": picture}

        axes.plot(*database.T, ".", color=FAINT, markersize=4, label="database", **marks)
        if view.top1_xy_m is not None:
            for here, there in zip(query[wrong], view.top1_xy_m[wrong] - origin, strict=True):
                axes.plot(*np.stack([here, there]).T, color=WRONG, linewidth=0.7, alpha=0.35)
        if not asked.all():
            axes.plot(
                *query[~asked].T,
                "o",
                markerfacecolor="none",
                markeredgecolor=FAINT,
                markersize=5,
                label=f"left out ({(~asked).sum()})",
                **marks,
            )
        axes.plot(
            *query[right].T, "o", color=RIGHT, markersize=4.5, label=f"hit ({right.sum()})", **marks
        )
        axes.plot(
            *query[wrong].T,
            "X",
            color=WRONG,
            markersize=6,
            markeredgecolor="white",
            markeredgewidth=0.4,
            label=f"miss ({wrong.sum()})",
            **marks,
        )
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(f"{view.system}, {view.split}".replace("->", " → "))
        for axis, name, value in zip((axes.xaxis, axes.yaxis), "xy", origin, strict=True):
            axis.set_label_text(f"{name} − {value:.0f} (m)" if value else f"{name} (m)")
        figure.legend(loc="outside lower center", ncols=4, handletextpad=0.2, columnspacing=1.2)
        return figure


def alpha_along_route(traces: Sequence[AlphaTrace]) -> Figure:
    """Both weights over the metres driven, one panel a run, the kinds of place shaded."""
    with _style():
        figure, panels = _figure(11.0, 0.8 + 1.9 * len(traces), rows=len(traces))
        tints = _zone_tints(traces)
        for axes, trace in zip(panels, traces, strict=True):
            for zone, first, last in zone_bands(trace):
                if zone in tints:
                    axes.axvspan(first, last, color=tints[zone], alpha=0.16, linewidth=0)
            x, alpha = _broken_at_gaps(trace.along_m, trace.alpha)
            for column, (label, color) in enumerate((("image", IMAGE), ("LiDAR", LIDAR))):
                axes.plot(x, alpha[:, column], color=color, linewidth=1.5, label=label)
            axes.set_ylim(0, 1)
            axes.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0", "", "0.5", "", "1"])
            axes.set_ylabel("weight α")
            axes.set_title(trace.run)
            axes.margins(x=0.01)
        panels[-1].set_xlabel("distance driven (m)")
        lines, labels = panels[0].get_legend_handles_labels()
        patch = _matplotlib("patches").Patch
        bands = [patch(color=tint, alpha=0.2, linewidth=0) for tint in tints.values()]
        figure.legend(lines + bands, labels + list(tints), loc="outside lower center", ncols=8)
        return figure


def distance_histogram(pairs: PairDistances, *, unit: str = "L1") -> Figure:
    """Descriptor distances of pairs at the same place against pairs apart, each summing to 1."""
    with _style():
        figure, (axes,) = _figure(6.2, 3.4)
        edges = np.histogram_bin_edges(np.concatenate([pairs.true, pairs.wrong]), bins=40)
        for values, label, color in (
            (pairs.wrong, "apart", WRONG),
            (pairs.true, "same place", RIGHT),
        ):
            counts, _ = np.histogram(values, edges)
            share = 100 * counts / max(len(values), 1)
            axes.stairs(share, edges, color=color, alpha=0.25, fill=True)
            axes.stairs(
                share, edges, color=color, linewidth=1.6, label=f"{label} ({len(values)} pairs)"
            )
        axes.set_title(pairs.system)
        axes.set_xlabel(f"descriptor distance ({unit})")
        axes.set_ylabel("share of the pairs (%)")
        axes.set_ylim(bottom=0)
        axes.legend(loc="upper right")
        return figure


def birds_eye(
    points_body: Float[np.ndarray, "n 3"], *, reach_m: float = 20.0, size_px: int = 240
) -> UInt8[np.ndarray, "size size 3"]:
    """The cloud from above, RGB: forward is up, dark is low, bright is high (0 to 5 m).

    The vehicle stands in the middle, the side is `2 * reach_m`. Points outside are not shown.
    """
    finite = points_body[np.isfinite(points_body).all(axis=1)]
    row, column = np.floor((reach_m - finite[:, :2].T) / (2 * reach_m) * size_px).astype(np.int64)
    inside = (row >= 0) & (row < size_px) & (column >= 0) & (column < size_px)
    row, column, z = row[inside], column[inside], finite[inside, 2]
    height = np.full((size_px, size_px), -np.inf)
    np.maximum.at(height, (row, column), z)
    shade = _matplotlib("cm").ScalarMappable(cmap="cividis")
    shade.set_clim(0.0, 5.0)
    seen = np.isfinite(height)
    picture = np.full((size_px, size_px, 3), (20, 23, 31), np.uint8)
    picture[seen] = shade.to_rgba(height[seen], bytes=True)[:, :3]
    return picture


def zone_bands(trace: AlphaTrace) -> list[tuple[str, float, float]]:
    """(zone, first metre, last metre) of each stretch of equal zone; frames without one have none.

    A band reaches half way to the neighbouring frames, so that bands meet.
    """
    middle = (trace.along_m[1:] + trace.along_m[:-1]) / 2
    edge = np.concatenate([trace.along_m[:1], middle, trace.along_m[-1:]])
    bands, first = [], 0
    for zone, group in groupby(trace.zones):
        end = first + len(list(group))
        if zone is not None:
            bands.append((zone, float(edge[first]), float(edge[end])))
        first = end
    return bands


def to_svg(figure: Figure, *, label: str, recolor: Mapping[str, str] | None = None) -> str:
    """The figure as an `<svg>` element to stand in a page, `label` its text for screen readers.

    `recolor` replaces colours by what CSS shall decide (`{INK: "var(--ink)"}`).
    """
    buffer = io.StringIO()
    # ids must differ between figures of one page, and be the same when the same page is made again
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with _style({"svg.hashsalt": label}):
        figure.savefig(buffer, format="svg", metadata=nothing, dpi=160)
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*" height="[^"]*"|(<svg)', r"\1\2", svg, count=1)
    for color, name in (recolor or {}).items():
        svg = svg.replace(color, name)
    quoted = label.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    return svg.replace("<svg", f'<svg role="img" aria-label="{quoted}"', 1)


def _matplotlib(module: str) -> Any:
    try:
        import importlib

        return importlib.import_module(f"matplotlib.{module}")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "charts need matplotlib: pip install 'adafusion[report]'"
        ) from error


@contextmanager
def _style(more: Mapping[str, object] | None = None) -> Iterator[None]:
    with _matplotlib("style").context({**STYLE, **(more or {})}):
        yield


def _figure(width: float, height: float, *, rows: int = 1) -> tuple[Figure, list[Axes]]:
    figure = _matplotlib("figure").Figure((width, height), layout="constrained")
    return figure, list(figure.subplots(rows, 1, sharex=True, sharey=True, squeeze=False)[:, 0])


def _far_origin(xy_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " 2"]:
    """What to take off map coordinates (UTM northings have seven digits) to read them at all."""
    lowest = xy_m.min(axis=0) if len(xy_m) else np.zeros(2)
    return np.where(np.abs(lowest) > 1e4, np.floor(lowest / 1000) * 1000, 0.0)


def _zone_tints(traces: Sequence[AlphaTrace]) -> dict[str, str]:
    """A tint for each kind of place."""
    zones = sorted({zone for trace in traces for zone in trace.zones if zone is not None})
    return {zone: ZONES[k % len(ZONES)] for k, zone in enumerate(zones)}


def _broken_at_gaps(
    x: Float[np.ndarray, " n"], y: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m 2"]]:
    """Put a NaN where frames are missing, so that a line does not pretend to have seen them."""
    step = np.diff(x)
    gaps = np.flatnonzero(step > 5 * np.median(step)) + 1 if len(step) else np.zeros(0, int)
    return np.insert(x, gaps, np.nan), np.insert(y, gaps, np.nan, axis=0)
