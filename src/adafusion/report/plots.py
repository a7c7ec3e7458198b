# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The charts of a report, each a function from plain values to a matplotlib `Figure`.

They can be used alone: `recall_curve(systems).savefig("recall.pdf")`. A colour means one thing all
over: a system, a sensor, right or wrong. Colours are those of Okabe and Ito (2008), told apart by
people who see fewer of them; right and wrong differ in shape as well.
"""

from __future__ import annotations

import importlib
import io
import re
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from itertools import cycle, groupby
from typing import TYPE_CHECKING, Any, TypeAlias

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from adafusion.datasets.splits import GUARD, Regions, region_of
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
REGIONS = {"train": "#6b7280", "validation": "#8a6d1f", "guard": "#c3c8d2", "test": "#a3333d"}
SPARE = ("#8a6d1f", "#7b5ea7", "#a3333d", "#6b7280", "#56b4e9")

WIDE, HALF = 9.4, 4.6  # inches: the width of a page, and of a chart with a neighbour
MANY = 3000  # marks from which a picture is smaller than their outlines
STYLE = {
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib, so the layout is the same anywhere
    "font.size": 9.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
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
    "text.parse_math": False,  # a dollar in a name is a dollar
}


def system_colors(names: Iterable[str]) -> dict[str, str]:
    """The colour of each system; a small one (`adafusion-s`) has that of its large kin if free."""
    spare, colors = cycle(SPARE), dict[str, str]()
    for name in dict.fromkeys(names):
        own = SYSTEMS.get(name.removesuffix("-s"))
        colors[name] = own if own and own not in colors.values() else next(spare)
    return colors


def recall_curve(systems: Sequence[SystemResult]) -> Figure:
    """Recall@N of each system, in percent over N, its interval as a band."""
    with _style():
        figure, (axes,) = _figure(WIDE, 3.7)
        colors = system_colors(system.name for system in systems)
        for system in sorted(systems, key=lambda system: -system.recall[1].value):
            n, color = sorted(system.recall), colors[system.name]
            known = [k for k in n if system.recall[k].interval is not None]
            if known:
                low, high = 100 * np.transpose([system.recall[k].interval for k in known])
                axes.fill_between(known, low, high, color=color, alpha=0.13, linewidth=0)
            percent = [100 * system.recall[k].value for k in n]
            marks: dict[str, Any] = {"marker": "o", "markersize": 3.5} if len(n) <= 30 else {}
            label = f"{system.name}  {percent[0]:.1f} %"
            axes.plot(n, percent, color=color, linewidth=1.9, label=label, **marks)
        longest = max(max(system.recall) for system in systems)
        axes.set_xticks([n for n in (1, 5, 10, 15, 20, 25, 50, 100) if n <= longest])
        axes.set_xlim(1 - 0.02 * longest, 1.02 * longest)
        axes.set_ylim(0, 101)  # lines at 100 % keep their width
        axes.set_xlabel("N, number of candidates looked at")
        axes.set_ylabel("recall@N (%)")
        figure.legend(title="recall@1", alignment="left", loc="outside right upper")
        return figure


def route(view: RouteView) -> Figure:
    """The database's route, the queries on it (right, wrong, left out), wrong answers as lines.

    x and y are those of the dataset's world, metres; from a near origin where they are large.
    """
    with _style():
        origin = _near_origin(view.database_xy_m)
        database, query = view.database_xy_m - origin, view.query_xy_m - origin
        wide, high = np.ptp(np.concatenate([database, query]), axis=0) + 10.0
        figure, (axes,) = _figure(HALF, 0.9 + float(np.clip(4.4 * high / wide, 2.0, 5.5)))
        asked = np.ones(len(query), bool) if view.is_answerable is None else view.is_answerable
        right, wrong = asked & view.is_hit, asked & ~view.is_hit

        # thousands of marks must not run into one blot
        size = float(np.clip((400 / (len(query) + 1)) ** 0.5, 0.3, 1.0))
        draw: dict[str, Any] = {"rasterized": len(database) + len(query) > MANY}

        def mark(where: Float[np.ndarray, "n 2"], marker: str, label: str, **look: Any) -> None:
            look["markersize"] *= size
            axes.plot(*where.T, marker, label=label, **look, **draw)

        mark(database, "o", "database", color=FAINT, alpha=0.3, markersize=6, markeredgewidth=0)
        if view.top1_xy_m is not None and wrong.any():
            ways = np.stack([query[wrong], view.top1_xy_m[wrong] - origin])  # (2, misses, 2)
            strength = float(np.clip(10 / wrong.sum(), 0.03, 0.5))  # many lines hide the map
            axes.plot(*ways.transpose(2, 0, 1), color=WRONG, linewidth=0.8, alpha=strength, **draw)
        if not asked.all():
            label = f"left out ({(~asked).sum()})"
            mark(query[~asked], "o", label, color=FAINT, markerfacecolor="none", markersize=5)
        mark(query[right], "o", f"hit ({right.sum()})", color=RIGHT, markersize=4)
        mark(query[wrong], "x", f"miss ({wrong.sum()})", color=WRONG, markersize=5, mew=1.6 * size)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(f"{view.system}, {view.split}".replace("->", " → "))
        _label_plane(axes, origin)
        figure.legend(
            loc="outside lower center",
            ncols=4,
            markerscale=1 / size,
            handletextpad=0.3,
            columnspacing=1.2,
        )
        return figure


def region_map(
    ways_xy_m: Mapping[str, Float[np.ndarray, "n 2"]], regions: Regions, *, title: str
) -> Figure:
    """The way of every run, its frames coloured by region, and the boxes that make the regions.

    x and y are those of the dataset's world, metres; from a near origin where they are large.
    """
    with _style():
        xy = np.concatenate(list(ways_xy_m.values()))
        origin = _near_origin(xy)
        names = region_of(xy, regions)
        low, high = xy.min(axis=0) - origin, xy.max(axis=0) - origin
        margin = 0.04 * float((high - low).max()) + 10.0
        low, high = _with_boxes(low, high, regions, origin)
        low, high = low - margin, high + margin
        low[1] -= margin  # room for the scale bar
        wide, tall = high - low
        figure, (axes,) = _figure(WIDE, 1.0 + float(np.clip(8.0 * tall / wide, 3.0, 10.0)))
        draw: dict[str, Any] = {"rasterized": len(xy) > MANY}

        for way in ways_xy_m.values():
            gaps = _gaps(np.r_[0.0, np.hypot(*np.diff(way, axis=0).T).cumsum()])
            line = np.insert(way - origin, gaps, np.nan, axis=0)
            axes.plot(*line.T, color=FAINT, linewidth=0.6, alpha=0.6, **draw)
        shown = [*REGIONS, *sorted(set(regions) - REGIONS.keys())]
        colors = REGIONS | dict(zip(shown[len(REGIONS) :], cycle(SPARE), strict=False))
        size = float(np.clip(4.0 * (2000 / len(xy)) ** 0.5, 1.2, 4.0))
        for name in shown:
            here = xy[names == name] - origin
            if len(here):
                look: dict[str, Any] = {"color": colors[name], "markersize": size, **draw}
                label = f"{name} ({len(here):,} frames)"
                axes.plot(*here.T, "o", label=label, markeredgewidth=0, **look)
        rectangle = _matplotlib("patches").Rectangle
        for name in reversed([name for name in shown if name in regions]):
            # guards overlap each other and lie below the rest: no tint that would add up
            guard = name == GUARD
            tint = {"color": "#eef0f3", "zorder": 0.4} if guard else {"alpha": 0.13}
            tint = {"color": colors[name], "linewidth": 0, "zorder": 0.5, **tint}
            for box in regions[name]:
                # what reaches beyond the picture, to infinity even, ends outside of it
                corners = np.reshape(box, (2, 2)) - origin
                corner, end = np.clip(corners, low - margin, high + margin)
                axes.add_patch(rectangle(corner, *(end - corner), **tint))
                if not guard:
                    edge = {"fill": False, "edgecolor": colors[name], "linewidth": 1.2}
                    axes.add_patch(rectangle(corner, *(end - corner), **edge))
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_aspect("equal", adjustable="box")
        _scale_bar(axes, low, high)
        # over the whole picture: the axes of a straight route are narrower than any title
        figure.suptitle(title, x=0.01, ha="left", fontsize=9.5, fontweight="bold", wrap=True)
        _label_plane(axes, origin)
        figure.legend(loc="outside lower center", ncols=4, markerscale=5 / size, handletextpad=0.3)
        return figure


def alpha_along_route(traces: Sequence[AlphaTrace]) -> Figure:
    """Both weights over the metres driven, one panel a run, the kinds of place shaded.

    The commonest kind stays white.
    """
    with _style():
        figure, panels = _figure(WIDE, 0.9 + 1.6 * len(traces), rows=len(traces))
        common, tints = _zone_tints(traces)
        for axes, trace in zip(panels, traces, strict=True):
            for zone, first, last in zone_bands(trace):
                if zone in tints:
                    axes.axvspan(first, last, color=tints[zone], alpha=0.18, linewidth=0)
            gaps = _gaps(trace.along_m)  # a line must not pretend to have seen what lies between
            along = np.insert(trace.along_m, gaps, np.nan)
            width = 1.5 if len(along) < 600 else 0.7
            for label, color, weight in zip(
                ("image", "LiDAR"), (IMAGE, LIDAR), trace.alpha.T, strict=True
            ):
                weight = np.insert(weight, gaps, np.nan)
                axes.plot(along, weight, color=color, linewidth=width, label=label)
            axes.set_ylim(0, 1)
            axes.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0", "", "0.5", "", "1"])
            axes.set_ylabel("weight α")
            axes.set_title(trace.run)
            axes.margins(x=0.01)
        panels[-1].set_xlabel("distance driven (m)")
        marks, labels = panels[0].get_legend_handles_labels()
        patch = _matplotlib("patches").Patch
        marks += [patch(color=tint, alpha=0.25, linewidth=0) for tint in tints.values()]
        labels += list(tints)
        if common:
            marks.append(patch(facecolor="none", edgecolor=FAINT, linewidth=0.7))
            labels.append(common)
        figure.legend(marks, labels, loc="outside lower center", ncols=8)
        return figure


def distance_histogram(pairs: PairDistances, *, unit: str = "L1") -> Figure:
    """Descriptor distances of pairs at the same place and of pairs apart, each summing to 100 %."""
    with _style():
        figure, (axes,) = _figure(HALF, 3.2)
        edges = np.histogram_bin_edges(np.concatenate([pairs.true, pairs.wrong]), bins=40)
        for name, values, color in (
            ("apart", pairs.wrong, WRONG),
            ("same place", pairs.true, RIGHT),
        ):
            share = 100 * np.histogram(values, edges)[0] / max(len(values), 1)
            label = f"{name} ({len(values)} pairs)"
            axes.stairs(share, edges, color=color, alpha=0.25, fill=True)
            axes.stairs(share, edges, color=color, linewidth=1.6, label=label)
        axes.set_title(pairs.system)
        axes.set_xlabel(f"descriptor distance ({unit})")
        axes.set_ylabel("share of the pairs (%)")
        axes.set_ylim(bottom=0)
        figure.legend(loc="outside lower center", ncols=2)
        return figure


def birds_eye(
    points_body: Float[np.ndarray, "n 3"], *, reach_m: float = 20.0, size_px: int = 160
) -> UInt8[np.ndarray, "size size 3"]:
    """The highest point of each cell seen from above, RGB: forward is up, left is left.

    The vehicle stands in the middle, a side is `2 * reach_m`; points outside are not shown. Blue is
    the ground, yellow is 4 m and more above it, black is where nothing was seen.
    """
    finite = points_body[np.isfinite(points_body).all(axis=1)]
    cell = np.floor((reach_m - finite[:, :2]) / (2 * reach_m) * size_px)
    inside = ((cell >= 0) & (cell < size_px)).all(axis=1)
    row, column = cell[inside].astype(np.int64).T
    height_m = np.full((size_px, size_px), -np.inf)
    np.maximum.at(height_m, (row, column), finite[inside, 2])
    seen = np.isfinite(height_m)
    shade = 0.3 + 0.7 * np.clip(height_m / 4.0, 0.0, 1.0)  # lower shades drown in the black
    bgr = cv2.applyColorMap((255 * shade).astype(np.uint8), cv2.COLORMAP_CIVIDIS)
    return np.where(seen[..., None], bgr[..., ::-1], np.uint8(16))


def zone_bands(trace: AlphaTrace) -> list[tuple[str, float, float]]:
    """(zone, first metre, last metre) of each stretch of equal zone; frames without one have none.

    A band reaches half way to the neighbouring frames, so that bands meet, but not over a gap.
    """
    if not trace.zones:
        return []
    middle = (trace.along_m[1:] + trace.along_m[:-1]) / 2
    gaps = _gaps(trace.along_m)
    first = np.concatenate([trace.along_m[:1], middle])
    first[gaps] = trace.along_m[gaps]
    last = np.concatenate([middle, trace.along_m[-1:]])
    last[gaps - 1] = trace.along_m[gaps - 1]
    piece = np.zeros(len(first), int)
    piece[gaps] = 1
    key = list(zip(np.cumsum(piece).tolist(), trace.zones, strict=True))
    stretches = [list(rows) for _, rows in groupby(range(len(key)), lambda row: key[row])]
    return [
        (zone, float(first[rows[0]]), float(last[rows[-1]]))
        for rows in stretches
        if (zone := trace.zones[rows[0]]) is not None
    ]


def to_svg(figure: Figure, *, label: str, recolor: Mapping[str, str] | None = None) -> str:
    """The figure as an `<svg>` element to stand in a page, `label` its text for screen readers.

    `recolor` replaces colours by what CSS shall decide (`{INK: "var(--ink)"}`).
    """
    buffer = io.StringIO()
    # ids must differ between figures of one page, and be the same when the same page is made again
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with _style({"svg.hashsalt": label}), warnings.catch_warnings():
        # words stay words, so the reader's browser finds the letters that our font has not
        warnings.filterwarnings("ignore", message="Glyph")
        figure.savefig(buffer, format="svg", metadata=nothing, dpi=160)
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*" height="[^"]*"|(<svg)', r"\1\2", svg, count=1)
    for color, name in (recolor or {}).items():
        svg = svg.replace(color, name)
    return svg.replace("<svg", f'<svg role="img" aria-label="{escape(label)}"', 1)


def _matplotlib(module: str) -> Any:
    try:
        return importlib.import_module(f"matplotlib.{module}")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "charts need matplotlib: pip install 'adafusion[report]'"
        ) from error


@contextmanager
def _style(more: Mapping[str, object] | None = None) -> Iterator[None]:
    # from the defaults, so that nobody's own matplotlibrc changes a report
    with _matplotlib("style").context(["default", {**STYLE, **(more or {})}]):
        yield


def _figure(width: float, height: float, *, rows: int = 1) -> tuple[Figure, list[Axes]]:
    figure = _matplotlib("figure").Figure((width, height), layout="constrained")
    return figure, list(figure.subplots(rows, 1, sharex=True, sharey=True, squeeze=False)[:, 0])


def _near_origin(xy_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " 2"]:
    """What to take off map coordinates to read them at all: UTM northings have seven digits."""
    lowest = xy_m.min(axis=0) if len(xy_m) else np.zeros(2)
    return np.where(np.abs(lowest) > 1e4, np.floor(lowest / 1000) * 1000, 0.0)


def _label_plane(axes: Axes, origin: Float[np.ndarray, " 2"]) -> None:
    for axis, name, value in zip((axes.xaxis, axes.yaxis), "xy", origin, strict=True):
        axis.set_label_text(f"{name} − {value:.0f} (m)" if value else f"{name} (m)")


def _with_boxes(
    low: Float[np.ndarray, " 2"],
    high: Float[np.ndarray, " 2"],
    regions: Regions,
    origin: Float[np.ndarray, " 2"],
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]:
    """Bounds that take in the corners of boxes, those no farther off than the ways are long."""
    boxes = [box for boxes in regions.values() for box in boxes]
    corners = np.reshape(boxes, (-1, 2)) - origin
    reach = (high - low).max()
    near = corners[((corners >= low - reach) & (corners <= high + reach)).all(axis=1)]
    shown = np.concatenate([near, low[None], high[None]])
    return shown.min(axis=0), shown.max(axis=0)


def _scale_bar(axes: Axes, low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"]) -> None:
    """A bar of a round length, at most a quarter of the width, in the lower left corner."""
    wide, tall = high - low
    power = 10.0 ** np.floor(np.log10(wide / 4))
    length = power * max(step for step in (1, 2, 5) if step * power <= wide / 4)
    x, y = low[0] + 0.02 * wide, low[1] + 0.015 * tall
    axes.plot([x, x + length], [y, y], color=INK, linewidth=2.5, solid_capstyle="butt")
    axes.annotate(f"{length:g} m", (x, y), (0, 4), textcoords="offset points", color=INK)


def _zone_tints(traces: Sequence[AlphaTrace]) -> tuple[str | None, dict[str, str]]:
    """The commonest kind of place, and a tint for each other one."""
    count = Counter(zone for trace in traces for zone in trace.zones if zone is not None)
    common = max(sorted(count), key=lambda zone: count[zone], default=None)
    return common, dict(zip(sorted(count.keys() - {common}), cycle(SPARE), strict=False))


def _gaps(along_m: Float[np.ndarray, " n"]) -> Int[np.ndarray, " g"]:
    """Rows before which frames are missing: steps of five usual ones, standstill not counted."""
    step = np.diff(along_m)
    usual = np.median(step[step > 0]) if (step > 0).any() else 0.0
    return np.flatnonzero(step > 5 * usual) + 1
