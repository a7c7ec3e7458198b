# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Models compared on a tiny world: from files to tables, results and reports."""

from __future__ import annotations

import json
import logging
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from adafusion.cli import main
from adafusion.cli.evaluation import EvaluateConfig
from adafusion.cli.reporting import WRONG_M, report_data
from adafusion.config import dump_config, load_config
from adafusion.datasets import Dataset
from adafusion.evaluation import Judged, dataset_splits, judge
from adafusion.models import AdaFusion, ModelConfig, load_model, save_model
from adafusion.report.html import render
from adafusion.types import Frame, UserError


def trained(config: ModelConfig, out: Path, seed: int = 0, **card: object) -> str:
    """A model file as a training writes it."""
    torch.manual_seed(seed)
    save_model(AdaFusion(config), out / "model.safetensors", card)
    return str(out / "model.safetensors")


@pytest.fixture(scope="module")
def models(tiny_model: ModelConfig, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """An AdaFusion and a LiDAR model."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "fused").mkdir()
    (folder / "scan").mkdir()
    return (
        trained(tiny_model, folder / "fused"),
        trained(replace(tiny_model, system="lidar"), folder / "scan"),
    )


def moved(dataset: Dataset, east_m: float, north_m: float) -> Dataset:
    """The same world at other coordinates."""
    x, y = (east_m, north_m)
    frames = [
        replace(f, position_m=(f.position_m[0] + x, f.position_m[1] + y, f.position_m[2]))
        for f in dataset.frames
    ]
    regions = {
        name: [[x0 + x, y0 + y, x1 + x, y1 + y] for x0, y0, x1, y1 in boxes]
        for name, boxes in dataset.info.regions.items()
    }
    return replace(dataset, frames=tuple(frames), info=replace(dataset.info, regions=regions))


def judged_and_config(
    models: tuple[str, ...], dataset: Dataset, cache: Path, protocol: str, radius_m: float, p: int
) -> tuple[list[Judged], EvaluateConfig]:
    splits = dataset_splits(dataset, protocol, radius_m=radius_m)
    config = EvaluateConfig(
        dataset="tiny", models=models, protocol=protocol, region="test", runs=dataset.runs,
        radius_m=radius_m, distance="l1" if p == 1 else "l2", seed=3,
    )  # fmt: skip
    return judge([load_model(m) for m in models], dataset, splits, cache, p=p), config


def test_a_report_counts_each_query_once(
    tiny_world: Dataset, models: tuple[str, str], cache: Path
) -> None:
    judged, config = judged_and_config(models, tiny_world, cache, "cross-run", 3.0, 1)
    data = report_data(judged, tiny_world, config, "adafusion evaluate")
    e = judged[0].evaluation
    assert 0 < e.num_unanswerable < e.num_queries
    assert sum(split.queries for split in data.protocol.splits) == e.num_queries
    assert sum(split.left_out for split in data.protocol.splits) == e.num_unanswerable
    page = render(data)
    assert f"asked {e.num_queries - e.num_unanswerable} queries" in page
    assert data.config == dump_config(config)
    assert [means.system for means in data.mean_alpha] == ["fused"]
    (means,) = data.mean_alpha
    assert set(means.by_run) == {"day", "night"}
    frames = sum(summary.num_frames for summary in means.by_run.values())
    assert frames == sum(summary.num_frames for summary in means.by_zone.values()) > 0
    assert data.systems[1].gap is not None


@pytest.mark.parametrize("protocol", ["cross-run", "union", "union-strict"])
def test_the_histogram_holds_pairs_that_may_answer_alone(
    tiny_world: Dataset, models: tuple[str, str], cache: Path, protocol: str
) -> None:
    # metres of a UTM zone: half of one is lost where float32 holds them
    far = moved(tiny_world, 450_000.0, 5_400_000.0)
    judged, config = judged_and_config(models[:1], far, cache, protocol, 10.0, 1)
    (pairs,) = report_data(judged, far, config, "").distances
    count = {"true": 0, "wrong": 0}
    for result in judged[0].evaluation.results:
        for q in result.split.query_rows:
            for n in result.split.database_rows:
                own = far.frames[q].run == far.frames[n].run
                if own and (protocol != "union" or q == n):
                    continue
                away = np.hypot(*(far.positions_m[q] - far.positions_m[n])[:2])
                count["true"] += bool(away <= 10.0)
                count["wrong"] += bool(away > WRONG_M)
    assert (len(pairs.true), len(pairs.wrong)) == (count["true"], count["wrong"])


def test_under_l2_a_report_shows_l2_distances_and_divides_none(
    tiny_world: Dataset, models: tuple[str, str], cache: Path
) -> None:
    judged, config = judged_and_config(models[:1], tiny_world, cache, "cross-run", 20.0, 2)
    data = report_data(judged, tiny_world, config, "")
    assert data.protocol.distance == "L2"
    fused = judged[0].descriptions.fused
    row = {frame.key: i for i, frame in enumerate(tiny_world.frames)}
    for shown in data.retrievals:
        query, top = fused[row[shown.query.key]], fused[row[shown.top1.place.key]]
        assert shown.top1.distance == pytest.approx(np.linalg.norm(query - top), rel=1e-5)
        assert shown.top1.image_share is None


def test_two_models_of_one_name_are_refused_before_any_work(
    tiny_world: Dataset, models: tuple[str, str], tmp_path: Path
) -> None:
    splits = dataset_splits(tiny_world, "cross-run")
    with pytest.raises(UserError, match="two models are called fused"):
        judge([load_model(models[0])] * 2, tiny_world, splits, tmp_path / "cache")
    assert not (tmp_path / "cache").exists()


def test_a_frame_without_a_sensor_is_left_out_for_every_model(
    tiny_world: Dataset, models: tuple[str, str], cache: Path
) -> None:
    splits = dataset_splits(tiny_world, "cross-run")
    blind = {int(splits[0].query_rows[0]), int(splits[0].database_rows[1])}
    holed = without(tiny_world, "image", blind)
    judged = judge([load_model(m) for m in models], holed, splits, cache)
    assert [j.num_lacking for j in judged] == [2, 2]
    for j in judged:
        for result in j.evaluation.results:
            assert not blind & {*result.split.query_rows, *result.split.database_rows}
    (scan,) = judge([load_model(models[1])], holed, splits, cache)  # it needs no image
    assert scan.num_lacking == 0


def test_a_run_without_a_sensor_leaves_nothing_to_compare(
    tiny_world: Dataset, models: tuple[str, str], cache: Path
) -> None:
    nights = {i for i, frame in enumerate(tiny_world.frames) if frame.run == "night"}
    dark = without(tiny_world, "image", nights)
    for protocol in ("cross-run", "union"):  # a pool of one run would be another question
        with pytest.raises(UserError, match="no two runs have frames with all sensors"):
            judge([load_model(models[0])], dark, dataset_splits(dark, protocol), cache)


def without(dataset: Dataset, sensor: str, rows: set[int]) -> Dataset:
    def blinded(i: int, frame: Frame) -> Frame:
        return replace(frame, **{sensor: None}) if i in rows else frame

    return replace(dataset, frames=tuple(blinded(i, f) for i, f in enumerate(dataset.frames)))


def test_a_dataset_without_regions_is_evaluated_whole_and_that_is_said(
    tiny_world: Dataset, caplog: pytest.LogCaptureFixture
) -> None:
    plain = replace(tiny_world, info=replace(tiny_world.info, regions={}))
    with caplog.at_level(logging.WARNING):
        splits = dataset_splits(plain, "cross-run")
    assert "names no regions: every frame counts as test" in caplog.text
    assert sum(len(split.query_rows) for split in splits) == len(plain.frames)


def test_the_command_keeps_its_effective_settings_beside_the_result(
    tiny_world: Dataset,
    tiny_model: ModelConfig,
    models: tuple[str, str],
    cache: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "home").mkdir()
    data = [{"fingerprint": tiny_world.fingerprint}]
    home = trained(tiny_model, tmp_path / "home", 1, data=data)
    out = tmp_path / "out"
    words = [
        "adafusion", "evaluate", str(tiny_world.root), str(out), "--cache", str(cache),
        "--model", models[0], "--model", home, "--runs", "night,day", "--distance", "l2",
        "--seed", "5", "--protocol", "union",
    ]  # fmt: skip
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as stop:
        main()
    said = capfd.readouterr()
    assert not stop.value.code, said.err
    assert f"warning: {home} was trained on this dataset" in said.err
    assert "fused minus home: recall@1" in said.out
    assert said.out.splitlines()[-1] == str(out / "report.html")
    assert load_config(EvaluateConfig, out / "evaluate.yaml") == EvaluateConfig(
        dataset=str(tiny_world.root), models=(models[0], home), protocol="union", region="test",
        runs=("night", "day"), radius_m=20.0, distance="l2", seed=5,
    )  # fmt: skip
    first, second = json.loads((out / "result.json").read_text())["results"]
    assert first["data"]["runs"] == ["night", "day"]
    assert first["data"]["left_out_for_lack_of_a_sensor"] == 0
    assert first["protocol"]["descriptor_distance"] == "L2"
    assert first["intervals"]["seed"] == 5
    assert [r["model"]["trained_on_this_dataset"] for r in (first, second)] == [False, True]
    assert "trained on this dataset" in (out / "report.html").read_text()


@pytest.mark.parametrize("words", [["--radius-m", "0"], ["--distance", "l3"], ["--seed", "-1"]])
def test_settings_that_make_no_sense_are_refused(
    tiny_world: Dataset,
    models: tuple[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    words: list[str],
) -> None:
    given = ["adafusion", "evaluate", str(tiny_world.root), str(tmp_path), "--model", models[0]]
    monkeypatch.setattr(sys, "argv", [*given, *words])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert "Traceback" not in capfd.readouterr().err
    assert not list(tmp_path.iterdir())
