# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the weights tell wrong matches from true ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from adafusion.datasets.native import Dataset, DatasetInfo
from adafusion.experiments.jobs import Job
from adafusion.experiments.judging import ExamData, ask
from adafusion.experiments.plan import Experiment
from adafusion.experiments.studies import idea
from adafusion.experiments.studies.idea import (
    choose_matches,
    draw_idea,
    idea_section,
    measure_idea,
    weight_distances,
)
from adafusion.experiments.study import Trained
from adafusion.training import TrainConfig
from adafusion.training.corpus import Corpus
from adafusion.types import Descriptions, Frame, Split, UserError

PLACES = 12  # 30 m apart
INFO = DatasetInfo(name="made", version="1", source="by hand", licence="none", synthetic=True)


def described(alpha: np.ndarray, fused: np.ndarray) -> Descriptions:
    return Descriptions(fused.astype(np.float32), None, None, alpha.astype(np.float32))


def test_matches_are_as_a_slow_search_finds_them() -> None:
    rng = np.random.default_rng(0)
    distance = rng.random((6, 40)).astype(np.float32)
    apart = rng.uniform(0.0, 100.0, (6, 40))
    matches = choose_matches(distance, apart, 20.0, rng)
    for q in range(6):
        order = sorted(range(40), key=lambda n: distance[q, n])
        assert matches["nearest true"][q] == next(n for n in order if apart[q, n] <= 20)
        assert matches["nearest wrong"][q] == next(n for n in order if apart[q, n] > 20)
        assert matches["nearest elsewhere"][q] == next(n for n in order if apart[q, n] > 50)
        assert apart[q, matches["random true"][q]] <= 20 < apart[q, matches["random wrong"][q]]


def test_every_match_is_drawn_as_often_as_any_other() -> None:
    apart = np.tile([0.0, 10.0, 60.0, 70.0, 80.0], (9000, 1))
    distance = np.tile(np.arange(5, dtype=np.float32), (9000, 1))
    matches = choose_matches(distance, apart, 20.0, np.random.default_rng(0))
    assert np.bincount(matches["random true"]) == pytest.approx([4500] * 2, rel=0.05)
    assert np.bincount(matches["random wrong"])[2:] == pytest.approx([3000] * 3, rel=0.05)


def test_a_query_without_a_match_of_one_kind_is_refused() -> None:
    distance = np.zeros((1, 2), np.float32)
    for apart in ([30.0, 60.0], [10.0, 40.0]):
        with pytest.raises(ValueError, match="no true match"):
            choose_matches(distance, np.array([apart]), 20.0, np.random.default_rng(0))


def test_the_weights_of_each_match_are_set_against_the_querys() -> None:
    xy = np.array([[0.0, 0.0], [500.0, 0.0], [5.0, 0.0], [90.0, 0.0], [900.0, 0.0]])
    fused = np.array([[0.0], [9.0], [1.0], [2.0], [9.0]])
    alpha = np.array([[0.5, 0.4], [0.1, 0.1], [0.6, 0.4], [0.2, 0.9], [0.0, 0.0]])
    split = Split(
        name="a->b",
        protocol="cross-run",
        radius_m=20.0,
        query_rows=np.array([0, 1]),
        database_rows=np.array([2, 3, 4]),
    )
    asked, found = weight_distances(described(alpha, fused), xy, split, np.random.default_rng(0))
    assert asked.tolist() == [True, False]  # nothing lies near the second
    assert found["nearest true"] == pytest.approx(np.array([[0.1, 0.0, 0.1]]))
    assert found["nearest wrong"] == pytest.approx(np.array([[0.3, 0.5, 0.8]]))


def exam(root: Path) -> ExamData:
    """Two runs past the same places, half of them in a park."""
    frames = tuple(
        Frame(
            run=run,
            timestamp_us=k,
            position_m=(30.0 * k, 0.0, 0.0),
            image="i.png",
            cloud="c.npy",
            zone="park" if k % 2 else "street",
        )
        for run in ("a", "b")
        for k in range(PLACES)
    )
    return ExamData(Dataset(root, INFO, frames), 0)


def trained(root: Path, monkeypatch: pytest.MonkeyPatch, alphas: list[np.ndarray]) -> Trained:
    """What a study is given, with these weights of each seed on the frames of `exam`."""
    test = exam(root)
    x = test.dataset.positions_m[:, :1]

    def say(_: object, label: str):
        assert label == "AdaFusion"
        yield from ((described(alpha, x),) for alpha in alphas)

    monkeypatch.setattr(idea, "described_by_seed", say)
    job = Job(name="", key="", config=TrainConfig(), passes=1, sources=(), folder=root)
    return Trained(
        experiment=Experiment(name="", words="", rows=(), protocols=("cross-run",), seeds=()),
        rows={"AdaFusion": (job,)},
        corpus=Corpus((test.dataset,)),
        exams=(test,),
        questions=ask([test], "cross-run"),
        said={},
        converged=frozenset({"AdaFusion"}),
        num_answers=0,
        cache=root,
        out=root,
    )


def test_weights_of_the_place_tell_it_from_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = np.tile(np.arange(PLACES), 2) / PLACES
    alphas = [np.column_stack([place, np.full(2 * PLACES, c)]) for c in (0.3, 0.4, 0.5)]
    study = measure_idea(trained(tmp_path, monkeypatch, alphas))
    assert study["queries"] == 2 * PLACES
    nearest = study["comparisons"]["nearest"]
    found = nearest["readings"]["image"]
    assert found["true"]["value"] == pytest.approx(0.0, abs=1e-6)
    assert found["wrong"]["value"] == pytest.approx(1 / PLACES, abs=1e-6)  # the neighbour
    assert found["share"]["value"] == 1.0
    assert found["wrong_minus_true"]["verdict"] == "above"
    assert nearest["readings"]["lidar"]["wrong_minus_true"]["verdict"] == "undecided"
    assert set(nearest["zones"]) == {"park", "street"}
    far = study["comparisons"]["nearest, elsewhere"]["readings"]["both"]
    assert far["wrong"]["value"] == pytest.approx(2 / PLACES, abs=1e-6)


def test_weights_that_know_nothing_of_the_place_are_undecided(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(3)
    alphas = [rng.random((2 * PLACES, 2)) for _ in range(3)]
    study = measure_idea(trained(tmp_path, monkeypatch, alphas))
    for comparison in study["comparisons"].values():
        assert comparison["readings"]["both"]["wrong_minus_true"]["verdict"] == "undecided"


def test_a_share_of_queries_stays_one_where_seeds_disagree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = np.tile(np.arange(PLACES), 2) / PLACES
    flat = np.full(2 * PLACES, 0.3)
    alphas = [np.column_stack([image, flat]) for image in (place, place, flat)]
    study = measure_idea(trained(tmp_path, monkeypatch, alphas))
    share = study["comparisons"]["nearest"]["readings"]["image"]["share"]
    assert share["value"] == pytest.approx(2 / 3)
    assert share["interval"] == (0.0, 1.0)


def test_a_row_that_had_not_converged_gets_no_word(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = trained(tmp_path, monkeypatch, [np.random.default_rng(0).random((2 * PLACES, 2))])
    study = measure_idea(replace(given, converged=frozenset()))
    found = study["comparisons"]["nearest"]["readings"]["both"]
    assert found["wrong_minus_true"]["verdict"] == "not ranked"


def test_places_that_all_lie_near_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = trained(tmp_path, monkeypatch, [np.zeros((2 * PLACES, 2))])
    frames = tuple(
        replace(frame, position_m=(0.0, 0.0, 0.0)) for frame in given.exams[0].dataset.frames
    )
    near = ExamData(replace(given.exams[0].dataset, frames=frames), 0)
    with pytest.raises(UserError, match="no query has a true match, and a wrong one 50 m away"):
        measure_idea(replace(given, exams=(near,)))


def test_page_and_picture_say_all_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, heading: dict[str, Any]
) -> None:
    rng = np.random.default_rng(0)
    study = measure_idea(
        trained(tmp_path, monkeypatch, [rng.random((2 * PLACES, 2)) for _ in range(2)])
    )
    lines = idea_section(study)
    assert sum(line.startswith("| nearest true, random wrong |") for line in lines) == 3
    assert sum("| park |" in line for line in lines) == 2
    path = tmp_path / "idea.png"
    draw_idea(
        {
            "study": study,
            **heading,
        },
        path,
    )
    drawn = cv2.imread(str(path))
    assert drawn is not None
    assert drawn.std() > 5
