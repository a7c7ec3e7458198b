# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The weights along a stretch of each kind, beside what was seen there."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from adafusion.experiments.page import in_percent
from adafusion.experiments.picture import picture
from adafusion.report import plots


def draw_weights(results: Mapping[str, Any], path: Path) -> None:
    """A row for each claim: alpha over its mean along the stretch, and three of its images."""
    claims = [claim for claim in results["study"]["claims"] if claim["shown"]]
    with picture(path, results, 1.75 * len(claims)) as figure:
        widths = (4.6, 1.0, 1.0, 1.0)
        grid = figure.subplots(len(claims), 4, width_ratios=widths, squeeze=False)
        for claim, (trace, *places) in zip(claims, grid, strict=True):
            trace.set_title(_title(claim), fontsize=8.5)
            for place in places:
                place.axis("off")
            if claim["stretch"] is None:
                trace.axis("off")
                continue
            _trace(trace, claim["stretch"])
            pictures = claim["stretch"]["pictures"].items()
            for place, (at, image) in zip(places, pictures, strict=True):
                place.imshow(_decode(image))
                run = claim["stretch"]["frames"][int(at)].partition("/")[0]
                place.set_title(f"{run}, frame {at}", fontsize=7.5, fontweight="normal")
        shown = [axes for axes in grid[:, 0] if axes.lines]
        ends = [axes.get_ylim() for axes in shown]
        for axes in shown:
            axes.set_ylim(min(low for low, _ in ends), max(high for _, high in ends))
        if shown:
            shown[-1].set_xlabel("frame of the stretch")
            shown[0].legend(loc="upper right", ncols=2)


def _title(claim: Mapping[str, Any]) -> str:
    name = claim["name"].capitalize()
    if claim["stretch"] is None:
        return f"{name}: no such stretch in these data"
    found = in_percent(claim["difference"], "+")
    over_all = f"whole test set, % of the mean: {found}, {claim['verdict']}"
    return f"{name}, the claim: {claim['words']}\n{over_all}"


def _trace(axes: Any, stretch: Mapping[str, Any]) -> None:
    """Both ratios, mean over the seeds with their range as a band, over the zones."""
    x = np.arange(len(stretch["frames"]))
    for sensor, color in (("image", plots.IMAGE), ("lidar", plots.LIDAR)):
        ratio = np.array(stretch["ratio"][sensor])
        label = "image" if sensor == "image" else "LiDAR"
        axes.plot(x, ratio.mean(axis=0), color=color, marker="o", markersize=2.5, label=label)
        axes.fill_between(x, *np.quantile(ratio, [0, 1], axis=0), color=color, alpha=0.18, lw=0)
    axes.axhline(1.0, color=plots.FAINT, linewidth=0.8)
    if stretch["door"] is not None:
        axes.axvline(stretch["door"] - 0.5, color=plots.INK, linewidth=1.0, linestyle=":")
    axes.set_ylabel("alpha / mean")
    begin = 0
    for zone, piece in groupby(stretch["zones"]):
        end = begin + len(list(piece))
        axes.text(
            begin - 0.3, 0.02, zone, fontsize=7, color=plots.FAINT,
            transform=axes.get_xaxis_transform(),
        )  # fmt: skip
        begin = end


def _decode(image: str) -> UInt8[np.ndarray, "h w 3"]:
    data = np.frombuffer(base64.b64decode(image), np.uint8)
    pixels = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert pixels is not None
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB).astype(np.uint8)
