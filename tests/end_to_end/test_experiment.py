# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A comparison as one command, on tiny worlds with tiny models."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml

from adafusion.datasets import Dataset
from adafusion.evaluation import dataset_splits, evaluate_splits
from adafusion.experiments import (
    EXPERIMENTS,
    ExamData,
    Job,
    all_jobs,
    build_experiment,
    packaged_recipe,
    plan_jobs,
    train_jobs,
)
from adafusion.experiments.budget import batches_of
from adafusion.experiments.judging import answers, ask, evaluate_model
from adafusion.models import load_model
from adafusion.training import TrainConfig
from adafusion.training.corpus import Corpus
from adafusion.training.sampler import Sampler
from adafusion.training.settings import Mining, Sampling
from adafusion.types import UserError

BUDGET = 160


@pytest.fixture
def corpus(tiny_world: Dataset) -> Corpus:
    return Corpus((tiny_world,))


@pytest.fixture
def branch(corpus: Corpus, tiny_changes: tuple[str, ...], tmp_path: Path):
    """The LiDAR branch of the headline, planned into a folder."""

    def plan(out: str, seed: int = 0, further: tuple[str, ...] = ()) -> Job:
        recipe = partial(packaged_recipe, changes=(*tiny_changes, *further))
        rows = build_experiment("headline", recipe, BUDGET).only(["L"])
        return all_jobs(plan_jobs(rows, [seed], corpus, tmp_path / out))[0]

    return plan


@pytest.mark.slow
def test_the_headline_and_again_and_another_experiment_from_the_same_trainings(
    type_in, tiny_world: Dataset, tiny_words: list[str], tmp_path: Path
) -> None:
    words = ["--train", tiny_world.root, "--test", tiny_world.root, "--out", tmp_path, *tiny_words]
    words += ["--budget", BUDGET, "--seeds", "0,1", "--rows", "L,VL,AdaFusion"]
    said = type_in("experiment", "headline", *words, "--plan")
    assert said.code == 0, said.err
    assert "12 of 12 trainings to do" in said.out
    assert not any(tmp_path.iterdir())  # a plan leaves nothing behind

    said = type_in("experiment", "headline", *words)
    assert said.code == 0, said.err
    results = json.loads((tmp_path / "headline.json").read_text())
    page = (tmp_path / "headline.md").read_text()
    assert page in said.out
    assert "SYNTHETIC data" in page
    assert (results["seeds"], results["budget"]) == ([0, 1], BUDGET)
    rows = {row["label"]: row for row in results["rows"]}
    for row in rows.values():
        assert set(row["recall"]) == {"cross-run", "union", "pointnetvlad"}
        for passes in row["frame_passes"].values():
            assert passes == pytest.approx(BUDGET, rel=0.1)
    assert rows["VL"]["trainings"][0][:-1] == rows["AdaFusion"]["trainings"][0][:-1]
    assert {verdict["against"] for verdict in results["verdicts"]} == {"L", "VL"}
    groups = {verdict["group"] for verdict in results["verdicts"]}
    assert "all pairs" in groups
    assert any(group.startswith("zone ") for group in groups)

    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.safetensors")}
    pages = tmp_path / "kept" / "pages"
    said = type_in("experiment", "figure-recall", *words, "--results", pages)
    assert said.code == 0, said.err
    assert {path: path.stat().st_mtime_ns for path in before} == before
    figure = json.loads((pages / "figure-recall.json").read_text())
    assert (pages / "figure-recall.png").stat().st_size > 10_000
    assert not list(tmp_path.glob("figure-recall.*"))
    assert len(figure["study"]["gains"]["VL"]["at"]) == 25
    again = {row["label"]: row["recall"]["cross-run"]["AR@1"] for row in figure["rows"]}
    assert again == {label: row["recall"]["cross-run"]["AR@1"] for label, row in rows.items()}
    said = type_in("experiment", "headline", *words, "--plan")
    assert "0 of 12 trainings to do: 0 of " in said.out
    words[-1] = "L"
    said = type_in("experiment", "headline", *words)
    file = tmp_path / "headline.json"
    was, now = (f"{BUDGET} passes, seeds 0, 1, rows {rows}" for rows in ("L, VL, AdaFusion", "L"))
    assert f"{file} is written over: it was of {was}, and is of {now}" in said.err


@pytest.mark.slow
def test_the_pilot_does_not_look_at_the_test_set(
    type_in, tiny_world: Dataset, tiny_words: list[str], tmp_path: Path
) -> None:
    words = ["--train", tiny_world.root, "--test", tmp_path / "nowhere", "--out", tmp_path]
    words += ["--budget", 64, "--rows", "L x1", *tiny_words]
    said = type_in("experiment", "pilot", *words)
    assert said.code == 0, said.err
    results = json.loads((tmp_path / "pilot.json").read_text())
    assert results["test_data"] == []
    assert not any("recall" in key for row in results["rows"] for key in row)
    assert "judged on its validation region" in said.out
    assert "SYNTHETIC data" in said.out
    assert not (tmp_path / "evaluations").exists()


def test_a_change_that_the_experiment_makes_otherwise_is_told_with_the_rows(
    type_in, tiny_world: Dataset, tmp_path: Path
) -> None:
    words = ["--train", tiny_world.root, "--test", tiny_world.root, "--out", tmp_path, "--plan"]
    said = type_in("experiment", "ablation-input", *words, "--set", "model.last_norm=true")
    rows = "L no norm, V no norm"
    assert f"--set model.last_norm=true: set otherwise by the experiment in {rows}\n" in said.err
    said = type_in("experiment", "ablation-input", *words, "--set", "augment.hue=0.1")
    assert "set otherwise" not in said.err


def test_the_list_tells_every_experiment_with_its_rows(type_in) -> None:
    said = type_in("experiment", "list")
    assert said.code == 0, said.err
    assert all(f"\n{name}  (seeds" in f"\n{said.out}" for name in EXPERIMENTS)
    assert "rows: V; L; VL; AdaFusion" in said.out


@pytest.mark.parametrize("where", ["a named world", "own data"])
def test_the_budget_is_the_worlds_or_follows_from_the_frames(
    type_in,
    tiny_world: Dataset,
    tiny_words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    where: str,
) -> None:
    opened = []

    def open_data(path: Path, cache: Path | None = None) -> Dataset:
        opened.append(path.as_posix())
        return tiny_world

    monkeypatch.setattr("adafusion.cli.experiment.open_data", open_data)
    named = where == "a named world"
    data = ["--world", "world-v1-tiny"] if named else ["--train", "mine", "--test", "other"]
    said = type_in("experiment", "headline", *data, "--out", tmp_path, "--plan", *tiny_words)
    assert said.code == 0, said.err
    passes = 512 if named else 40 * len(Corpus((tiny_world,)).rows("train"))
    assert f"budget of {passes:,} frame passes" in said.out
    assert opened == ["world-v1-tiny/train" if named else "mine"]


@pytest.mark.slow
def test_a_killed_training_goes_on_and_two_side_by_side_do_as_one(
    branch, corpus: Corpus, cache: Path, cut_off
) -> None:
    killed, whole = branch("killed"), branch("whole")
    corpus.prepare(killed.config.model.preprocess, cache)  # the kill shall meet the training
    with pytest.raises(KeyboardInterrupt):
        list(train_jobs([killed], corpus, cache, progress=cut_off(10)))
    assert killed.state == "begun"
    list(train_jobs([killed], corpus, cache))
    list(train_jobs([whole], corpus, cache))
    assert killed.state == "done"
    assert load_model(killed.model).fingerprint == load_model(whole.model).fingerprint
    both = [
        [{k: v for k, v in line.items() if k != "seconds"} for line in job.record()["curve"]]
        for job in (killed, whole)
    ]
    assert both[0] == both[1]
    assert killed.record()["frame_passes"] == whole.record()["frame_passes"]

    pair = [branch("pair", seed=seed) for seed in (0, 1)]
    names = [job.name for job in train_jobs(pair, corpus, cache, workers=2)]
    assert names == [job.name for job in pair]
    assert {job.record()["threads"] for job in pair} == {1}


def test_a_training_is_known_by_its_content_wherever_it_lies(branch) -> None:
    assert branch("a").key == branch("b").key
    assert branch("a").key != branch("a", seed=1).key
    assert branch("a").key != branch("a", further=("augment.color=0",)).key


def test_rows_that_changes_make_equal_share_one_training(
    corpus: Corpus, tiny_changes: tuple[str, ...], tmp_path: Path
) -> None:
    recipe = partial(packaged_recipe, changes=(*tiny_changes, "augment.color=0"))
    experiment = build_experiment("ablation-input", recipe, BUDGET).only(
        ["V", "V no colour jitter"]
    )
    rows = plan_jobs(experiment, [0], corpus, tmp_path)
    assert rows["V"] == rows["V no colour jitter"]
    assert all_jobs(rows) == list(rows["V"])


@pytest.mark.parametrize(
    "sampling",
    [
        Sampling(mode="batch", places=4),
        Sampling(mode="pairs", items=4, mining=Mining(after=5, candidates=30, hardest=4)),
        Sampling(mode="tuples", positives=1, negatives=4, mining=Mining(after=5, candidates=30)),
    ],
    ids=lambda sampling: sampling.mode,
)
def test_a_budget_is_spent_whatever_a_batch_holds(
    corpus: Corpus, tiny_world: Dataset, sampling: Sampling
) -> None:
    batches = batches_of(corpus, sampling, 900)
    rows = corpus.rows("train")
    sampler = Sampler(sampling, corpus.unread, rows, seed=3)
    rng = np.random.default_rng(1)
    passes = 0
    for number, batch in enumerate(sampler.batches(0, batches), 1):
        passes += len(batch.rows)
        if sampling.mining is not None and sampling.mining.is_due(number):
            sampler.described = rng.standard_normal((len(rows), 8)).astype(np.float32)
    assert passes == pytest.approx(900, rel=0.1)


def test_answers_are_kept_and_are_those_of_the_evaluation(
    branch, corpus: Corpus, tiny_world: Dataset, cache: Path, tmp_path: Path
) -> None:
    job = branch("kept")
    list(train_jobs([job], corpus, cache))
    exam = ExamData.of(tiny_world)
    found = [
        evaluate_model(job.name, job.model, [exam], ["cross-run"], cache, tmp_path)["cross-run"]
        for _ in range(2)
    ]
    assert found[0] == found[1]
    assert len(list((tmp_path / "evaluations").iterdir())) == 1
    said, questions = answers(found[0]), ask([exam], "cross-run")
    assert len(said.first_hit) == len(questions.zone)
    answerable = said.first_hit > 0
    recall = [
        said.hits(1)[answerable & (questions.asked.split == split)].mean()
        for split in range(len(questions.kinds))
    ]
    assert np.mean(recall) == pytest.approx(found[0][0]["recall"]["AR@1"]["value"])
    nothing = np.zeros((len(tiny_world.frames), 1), np.float32)
    splits = dataset_splits(tiny_world, "cross-run")
    same = evaluate_splits(nothing, tiny_world.positions_m, splits)
    assert answerable.sum() == same.answerable.sum()


def test_frames_without_a_sensor_are_left_out_for_all_rows(
    tiny_world: Dataset,
) -> None:
    first, *others = tiny_world.frames
    poor = replace(tiny_world, frames=(replace(first, cloud=None), *others))
    exam = ExamData.of(poor)
    assert (exam.num_left_out, len(exam.dataset.frames)) == (1, len(others))
    assert first.key not in {frame.key for frame in exam.dataset.frames}


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (["nothing"], "choose from headline, "),
        (["headline", "--rows", "V,W"], "headline has no row W: choose from V, L, VL, AdaFusion"),
        (["headline", "--seeds", "a"], "whole numbers"),
        (["headline", "--seeds", "-1"], "none below 0"),
    ],
)
def test_what_is_asked_wrongly_is_answered_with_the_remedy(
    type_in, tiny_world: Dataset, tmp_path: Path, words: list[str], remedy: str
) -> None:
    data = ["--train", tiny_world.root, "--test", tiny_world.root, "--out", tmp_path]
    said = type_in("experiment", *words, *data)
    assert (said.code, remedy in said.err) == (2, True), said.err
    said = type_in("experiment", *words, *data[:2])
    assert "give both --train and --test" in said.err


@pytest.mark.parametrize(
    "words",
    [
        ["nothing"],
        ["headline", "--rows", "W"],
        ["headline", "--seeds", "a"],
        ["headline", "--set", "model.widht=1"],
        ["headline", "--set", "seed=7"],
        ["headline", "--set", "batches=20"],
        ["headline", "--set", "norms=true"],
        ["headline", "--set", "model.system=concat"],
        ["ablation-weights", "--rows", "VL,AdaFusion"],
    ],
)
def test_no_world_is_rendered_for_a_mistake(
    type_in, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    monkeypatch.setattr(
        "adafusion.cli.experiment.open_data", lambda *_: pytest.fail("data were opened")
    )
    said = type_in("experiment", *words)
    assert said.code == 2
    assert "configs" not in said.err, "a file is named that nobody gave"


@pytest.mark.parametrize(
    ("option", "region", "remedy"),
    [
        ("--train", "validation", "adafusion split"),
        ("--test", "test", "have frames in the test region"),
    ],
)
def test_data_without_a_region_are_refused_before_anything_is_trained(
    type_in,
    tiny_world: Dataset,
    tiny_words: list[str],
    tmp_path: Path,
    option: str,
    region: str,
    remedy: str,
) -> None:
    folder = tmp_path / "lacking"
    shutil.copytree(tiny_world.root, folder)
    path = folder / "dataset.yaml"
    info = yaml.safe_load(path.read_text())
    assert info["regions"].pop(region)
    assert info["regions"]
    path.write_text(yaml.safe_dump(info))
    data = {"--train": tiny_world.root, "--test": tiny_world.root, option: folder}
    words = [word for pair in data.items() for word in pair]
    said = type_in("experiment", "headline", *words, "--out", tmp_path / "out", *tiny_words)
    assert (said.code, remedy in said.err) == (2, True), said.err
    assert not (tmp_path / "out" / "trainings").exists()


def test_data_without_a_validation_region_is_sent_to_be_split(
    tiny_world: Dataset, tmp_path: Path
) -> None:
    folder = tmp_path / "whole"
    shutil.copytree(tiny_world.root, folder)
    path = folder / "dataset.yaml"
    info = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump({**info, "regions": {}}))
    with pytest.raises(UserError, match="adafusion split"):
        Corpus.open([folder]).rows("validation")


@pytest.mark.slow
def test_a_world_taken_twice_gives_its_own_recall_from_twice_the_queries(run_experiment) -> None:
    labels = ["L", "VL"]
    once, _ = run_experiment("figure-recall", labels)
    twice, _ = run_experiment("figure-recall", labels, worlds=2)
    for row, again in zip(once["rows"], twice["rows"], strict=True):
        for name, recall in row["recall"]["cross-run"].items():
            assert again["recall"]["cross-run"][name]["value"] == pytest.approx(recall["value"])
    assert len(twice["test_data"]) == 2


@pytest.mark.slow
def test_mining_that_would_begin_after_the_last_batch_begins_after_a_quarter_of_them(
    tiny_world: Dataset, tiny_changes: tuple[str, ...], tmp_path: Path
) -> None:
    corpus = Corpus((tiny_world,))

    def planned(after: int) -> TrainConfig:
        def recipe(name: str) -> TrainConfig:
            config = packaged_recipe(name, tiny_changes)
            if config.sampling.mining is None:
                return config
            mining = replace(config.sampling.mining, after=after)
            return replace(config, sampling=replace(config.sampling, mining=mining))

        experiment = build_experiment("table-systems", recipe, 2000).only(["PointNetVLAD"])
        return plan_jobs(experiment, [0], corpus, tmp_path)["PointNetVLAD"][0].config

    early, late = planned(3), planned(10_000)
    assert early.sampling.mining.after == 3
    assert late.batches is not None
    assert 0 < late.sampling.mining.after <= late.batches // 3


def test_a_training_that_lies_there_by_another_name_is_not_done_again(branch) -> None:
    job = branch("out")
    other = job.folder.with_name(f"another-seed0-{job.key}")
    other.mkdir(parents=True)
    assert branch("out").folder == other


def test_test_data_of_another_camera_are_refused_before_anything_is_trained(
    type_in, tiny_world: Dataset, tiny_words: list[str], tmp_path: Path
) -> None:
    folder = tmp_path / "moved"
    shutil.copytree(tiny_world.root, folder)
    path = folder / "dataset.yaml"
    info = yaml.safe_load(path.read_text())
    for calibration in [info["calibration"], *info["calibration"].values()]:
        if isinstance(calibration, dict) and "K" in calibration:
            calibration["K"][0][0] *= 1.2
    path.write_text(yaml.safe_dump(info))
    words = ["--train", tiny_world.root, "--test", folder, "--out", tmp_path / "out", *tiny_words]
    said = type_in("experiment", "table-systems", *words, "--rows", "CORAL", "--budget", 100)
    assert said.code == 2
    assert f"the cameras of {tiny_world.root} and {folder} differ" in said.err
    assert not (tmp_path / "out" / "trainings").exists()


def test_a_world_that_is_none_is_answered_with_those_there_are(type_in) -> None:
    for words in (["--world", "world-v1-tny"], ["--world", "world-v1-tiny/train", "--plan"]):
        said = type_in("experiment", "headline", *words)
        assert said.code == 2
        assert "no such world; choose from world-v1-tiny, world-v1-small, world-v1" in said.err
