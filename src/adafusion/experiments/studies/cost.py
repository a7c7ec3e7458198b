# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Recall against what a row costs: parameters, and the time of describing a frame."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from adafusion.experiments.picture import picture
from adafusion.experiments.study import Study, Trained
from adafusion.models import PlaceModel, describe, load_model, use_channels_last
from adafusion.report import plots

ROUNDS = 20
PANELS = {"size": "parameters (millions)", "time": "describing a frame (ms)"}


def measure_cost(trained: Trained) -> dict[str, Any]:
    """Milliseconds in which each row's model of the first seed describes one frame.

    The models take turns, so that what else the machine does hits all alike; the median of
    `ROUNDS` is told. Inputs are in memory: only the network is timed.
    """
    models = [load_model(jobs[0].model) for jobs in trained.rows.values()]
    ms = time_in_turns(models, ROUNDS)
    return {
        "ms": dict(zip(trained.rows, ms, strict=True)),
        "threads": torch.get_num_threads(),
        "rounds": ROUNDS,
    }


def time_in_turns(models: Sequence[PlaceModel], rounds: int) -> list[float]:
    """Median milliseconds of describing one frame by each model."""
    runs = [(use_channels_last(model.eval()), _frame(model)) for model in models]
    taken = np.empty((rounds + 1, len(models)))
    for i in range(rounds + 1):
        for j, (model, frame) in enumerate(runs):
            start = time.perf_counter()
            describe(model, [frame])
            taken[i, j] = time.perf_counter() - start
    return [float(ms) for ms in 1e3 * np.median(taken[1:], axis=0)]  # the first warms up


def cost_section(study: Mapping[str, Any]) -> list[str]:
    """A table of the times, and the ratio to the fastest."""
    fastest = min(study["ms"].values())
    lines = [
        "",
        "## What it costs",
        "",
        f"Describing one frame on a CPU, threads: {study['threads']}, the network alone; the "
        f"median of {study['rounds']} rounds in which the rows take turns. Read the ratio: "
        "milliseconds drift with the machine.",
        "",
        "| system | ms a frame | ratio to the fastest |",
        "|---|---|---|",
    ]
    lines += [f"| {label} | {ms:.1f} | {ms / fastest:.2f} |" for label, ms in study["ms"].items()]
    lines += [
        "",
        "The paper's mean weights, image / LiDAR, on NCLT: 0.40 / 0.60 at 256, 0.32 / 0.68 at 128; "
        "those of these rows stand above. What weighing gains at each length: see the verdicts.",
    ]
    return lines


def draw_cost(results: Mapping[str, Any], path: Path) -> None:
    """Recall@1 with its interval over parameters and time, a mark a row, joined by system."""
    protocol = next(iter(results["protocols"]))
    colors = plots.system_colors(row["system"] for row in results["rows"])
    with picture(path, results, 3.6) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        for axes, (cost, words) in zip(panels, PANELS.items(), strict=True):
            for system, color in colors.items():
                rows = [row for row in results["rows"] if row["system"] == system]
                x = [_cost(row, results)[cost] for row in rows]
                recall = [100 * row["recall"][protocol]["AR@1"]["value"] for row in rows]
                name = rows[0]["label"].rpartition(" ")[0] or system
                axes.plot(x, recall, "-", color=color, label=name)
                for row, *at in zip(rows, x, recall, strict=True):
                    inside = color if row["converged"] else "white"
                    axes.plot(*at, "o", color=color, markerfacecolor=inside)
                    if ends := row["recall"][protocol]["AR@1"]["interval"]:
                        between = [100 * end for end in ends]
                        axes.plot([at[0]] * 2, between, color=color, linewidth=1.0, alpha=0.6)
                    length = row["label"].split(" ")[-1]
                    axes.annotate(
                        length, at, xytext=(6, -11), textcoords="offset points", fontsize=8
                    )
            axes.set_xlabel(words)
            axes.margins(0.2)
        panels[0].set_ylabel(f"recall@1 (%), {protocol}")
        if not all(row["converged"] for row in results["rows"]):
            panels[0].plot([], [], "o", color=plots.FAINT, mfc="white", label="not ranked")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper")


def _cost(row: Mapping[str, Any], results: Mapping[str, Any]) -> dict[str, float]:
    return {"size": row["parameters"] / 1e6, "time": results["study"]["ms"][row["label"]]}


def _frame(model: PlaceModel) -> tuple[Tensor | None, Tensor | None]:
    """Random input of the model's size: its speed does not depend on what it sees."""
    generator = torch.Generator().manual_seed(0)
    preprocess = model.config.preprocess
    image = lidar = None
    if "image" in model.sensors:
        image = torch.rand(1, 3, *preprocess.image.size, generator=generator) * 2 - 1
    if "lidar" in model.sensors:
        lidar = torch.rand(1, *preprocess.lidar_shape, generator=generator)
    return image, lidar


COST = Study(measure=measure_cost, section=cost_section, draw=draw_cost)
