# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where the weights are looked at, and what is said of them there."""

from __future__ import annotations

import base64
import inspect
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from adafusion.datasets.native import Dataset, DatasetInfo
from adafusion.experiments.judging import ExamData, ask
from adafusion.experiments.plan import Experiment
from adafusion.experiments.studies.stretches import (
    CLAIMS,
    SHOWN,
    Claim,
    choose_stretch,
    is_outdoors,
    stays,
)
from adafusion.experiments.studies.weights import (
    TestFrames,
    claim_word,
    judge_claim,
    thumbnail,
    weights_section,
)
from adafusion.experiments.studies.weights_picture import draw_weights
from adafusion.experiments.study import Trained
from adafusion.experiments.verdict import Asked, Verdict
from adafusion.training.corpus import Corpus
from adafusion.types import Estimate, Frame

CLAIM = {claim.name: claim for claim in CLAIMS}


def drive(run: str, *pieces: tuple[str | None, int], start_m: float = 0.0) -> list[Frame]:
    """Frames 10 m apart through zones, each so many frames long."""
    zones = [zone for zone, count in pieces for _ in range(count)]
    return [
        Frame(run=run, timestamp_us=k, position_m=(start_m + 10.0 * k, 0.0, 0.0), zone=zone)
        for k, zone in enumerate(zones)
    ]


def frames_of(frames: list[Frame]) -> TestFrames:
    """The frames of one world, in blocks of 50 m."""
    runs = np.unique([frame.run for frame in frames], return_inverse=True)[1]
    block = np.array([int(frame.position_m[0] // 50) for frame in frames], np.int64)
    asked = Asked(runs, block, np.zeros(len(frames), np.int64))
    return TestFrames(tuple(frames), asked, (np.arange(len(frames)),))


def pieces(claim: Claim, frames: list[Frame]) -> list[tuple[list[int], list[int]]]:
    return [(stay.before.tolist(), stay.inside.tolist()) for stay in stays(claim, frames)]


def test_a_corridor_is_entered_from_outdoors_with_enough_frames_on_both_sides() -> None:
    frames = drive(
        "day", ("path", 4), ("corridor", 5), ("path", 2), ("corridor", 3), ("hall", 3),
        ("corridor", 4), ("street", 1), ("path", 2), ("corridor", 2),
    )  # fmt: skip
    assert pieces(CLAIM["into a corridor"], frames) == [([0, 1, 2, 3], [4, 5, 6, 7, 8])]


def test_a_stay_ends_with_its_run_and_where_the_frames_leave_a_gap() -> None:
    first, second = drive("a", ("corridor", 3)), drive("b", ("corridor", 2))
    third = drive("b", ("corridor", 4), start_m=100.0)
    assert pieces(CLAIM["indoor"], [*first, *second, *third]) == [
        ([], [0, 1, 2]),
        ([], [3, 4]),
        ([], [5, 6, 7, 8]),
    ]


def test_dark_is_the_night_alone_and_bright_a_lit_passage() -> None:
    way = (("street", 4), ("tunnel", 4))
    frames = [*drive("day", *way), *drive("night-2", *way), *drive("dusk", *way)]
    assert pieces(CLAIM["dark to bright"], frames) == [([8, 9, 10, 11], [12, 13, 14, 15])]
    assert len(stays(CLAIM["the same without dark"], frames)) == 2
    assert not stays(CLAIM["dark to bright"], drive("night", ("street", 4), ("corridor", 4)))


def test_the_stretch_has_the_most_frames_and_the_first_of_equals_wins() -> None:
    way = (("path", 20), ("corridor", 20))
    frames = [*drive("a", ("path", 5), ("corridor", 9)), *drive("b", *way), *drive("c", *way)]
    chosen = choose_stretch(CLAIM["into a corridor"], frames)
    assert chosen is not None
    rows, door = chosen
    assert rows.tolist() == list(range(14 + 20 - SHOWN, 14 + 20 + SHOWN))
    assert door == SHOWN


def test_a_stay_is_shown_from_its_middle() -> None:
    frames = drive("a", ("corridor", 2), ("park", 1), ("corridor", 40))
    chosen = choose_stretch(CLAIM["indoor"], frames)
    assert chosen is not None
    assert chosen[0].tolist() == list(range(3 + 20 - SHOWN, 3 + 20 + SHOWN))
    assert chosen[1] is None


def test_frames_without_zones_have_no_stretch() -> None:
    frames = drive("night", (None, 30))
    assert [choose_stretch(claim, frames) for claim in CLAIMS] == [None] * len(CLAIMS)


def test_no_stretch_can_be_chosen_by_what_the_weights_are() -> None:
    for choose in (stays, choose_stretch):
        assert list(inspect.signature(choose).parameters) == ["claim", "frames"]


def test_the_whole_test_set_is_measured_and_not_the_stretch() -> None:
    way = (("path", 5), ("corridor", 5))
    test = frames_of([*drive("a", *way), *drive("b", *way), *drive("b", *way, start_m=500.0)])
    ratio = np.ones((2, 30, 2))
    for first, step in ((5, -0.3), (15, -0.3), (25, -0.1)):  # run b: -0.2 on the mean of two
        ratio[:, first : first + 5, 1] += step
    verdict = judge_claim(CLAIM["into a corridor"], test, ratio)
    assert verdict is not None
    assert verdict.difference.value == pytest.approx((-0.3 - 0.2) / 2)
    assert verdict.num_queries == 3
    assert claim_word(CLAIM["into a corridor"], verdict) == "holds"


def test_only_frames_near_the_door_are_compared() -> None:
    test = frames_of(drive("a", ("path", 9), ("corridor", 9)))
    ratio = np.ones((2, 18, 2))
    ratio[:, :5, 1] = ratio[:, 13:, 1] = 7.0
    verdict = judge_claim(CLAIM["into a corridor"], test, ratio)
    assert verdict is not None
    assert verdict.difference.value == pytest.approx(0.0)


def test_who_leads_is_the_mean_over_all_frames_inside() -> None:
    test = frames_of(drive("a", ("corridor", 4), ("street", 6)))
    rng = np.random.default_rng(0)
    ratio = rng.random((2, 10, 2))
    verdict = judge_claim(CLAIM["outdoor"], test, ratio)
    assert verdict is not None
    assert verdict.difference.value == pytest.approx((ratio[:, 4:, 0] - ratio[:, 4:, 1]).mean())


def test_what_light_adds_is_over_the_steps_at_the_same_doors() -> None:
    way = (("path", 4), ("hall", 4))
    frames = [
        *drive("day", *way), *drive("snow", *way, start_m=3.0), *drive("night", *way),
        *drive("night", *way, start_m=900.0),
    ]  # fmt: skip
    ratio = np.ones((2, 32, 2))
    for first, step in ((4, 0.1), (12, 0.2), (20, 0.5), (28, 9.0)):  # no other run at the last
        ratio[:, first : first + 4, 0] += step
    verdict = judge_claim(CLAIM["what light adds"], frames_of(frames), ratio)
    assert verdict is not None
    assert verdict.num_queries == 1
    assert verdict.difference.value == pytest.approx(0.5 - 0.15)
    assert judge_claim(CLAIM["what light adds"], frames_of(frames[16:]), ratio[:, 16:]) is None


@pytest.mark.parametrize(
    ("name", "interval", "word"),
    [
        ("into a corridor", (-0.3, -0.1), "holds"),
        ("into a corridor", (0.1, 0.3), "fails"),
        ("into a corridor", (-0.1, 0.3), "undecided"),
        ("into a corridor", None, "undecided"),
        ("both poor", (-0.05, 0.09), "holds"),
        ("both poor", (0.02, 0.2), "undecided"),
        ("both poor", (-0.3, -0.11), "fails"),
        ("the same without dark", (0.1, 0.2), ""),
    ],
)
def test_a_word_says_what_the_interval_says(
    name: str, interval: tuple[float, float] | None, word: str
) -> None:
    low, high = interval or (-1.0, 1.0)
    side = "above" if low > 0 else "below" if high < 0 else "undecided"
    verdict = Verdict(side, Estimate((low + high) / 2, interval), (0.0, 0.0), 9)
    assert claim_word(CLAIM[name], verdict) == word


def test_one_seed_decides_nothing() -> None:
    verdict = Verdict("undecided", Estimate(0.01, (0.0, 0.02)), (0.01,), 9)
    assert claim_word(CLAIM["both poor"], verdict) == "undecided"


def test_outdoors_is_a_zone_that_is_known() -> None:
    frames = drive("a", ("street", 1), ("tunnel", 1), (None, 1))
    assert [is_outdoors(frame) for frame in frames] == [True, False, False]


def test_page_and_picture_show_what_is_there_and_say_what_is_not(
    tmp_path: Path, heading: dict[str, Any]
) -> None:
    image = np.full((30, 40, 3), (200, 100, 0), np.uint8)
    stretch = {
        "frames": [f"day/{k}" for k in range(6)],
        "zones": ["path"] * 3 + ["corridor"] * 3,
        "door": 3,
        "brightness": [0.5] * 3 + [0.25] * 3,
        "ratio": {"image": [[1.0] * 6, [1.1] * 6], "lidar": [[0.9] * 6, [0.8] * 6]},
        "pictures": {str(at): thumbnail(image) for at in (0, 3, 5)},
    }
    there = {
        "name": "into a corridor", "words": "the LiDAR's weight falls", "shown": True,
        "difference": {"value": -0.2, "interval": [-0.3, -0.1]}, "counted": 9,
        "verdict": "holds", "stretch": stretch,
    }  # fmt: skip
    absent = {"name": "both poor", "words": "about equal", "shown": True, "stretch": None}
    study = {"frames": 6, "claims": [there, absent]}
    lines = weights_section(study)
    row = "| into a corridor | the LiDAR's weight falls | 50 % to 25 % | -20.0 [-30.0, -10.0] | 9 |"
    assert f"{row} holds |" in lines
    assert lines[-1].startswith("| both poor | about equal | | no such stretch")
    path = tmp_path / "weights.png"
    draw_weights(
        {
            "study": study,
            **heading,
        },
        path,
    )
    drawn = cv2.imread(str(path))
    assert drawn is not None
    assert (np.abs(drawn.astype(int) - (0, 100, 200)).max(axis=2) < 12).sum() > 1000  # thumbnails


def test_a_thumbnail_keeps_colours_and_shape() -> None:
    image = np.full((300, 400, 3), (200, 100, 0), np.uint8)
    data = np.frombuffer(base64.b64decode(thumbnail(image)), np.uint8)
    small = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert small is not None
    assert small.shape == (90, 120, 3)
    assert np.abs(small[45, 60].astype(int) - (0, 100, 200)).max() < 6


def test_frames_of_two_worlds_share_no_run_and_no_place(tmp_path: Path) -> None:
    info = DatasetInfo(name="made", version="1", source="by hand", licence="none", synthetic=True)
    way = (("street", 10),)  # two blocks long
    frames = tuple(
        replace(frame, image="i.png", cloud="c.npy")
        for frame in [*drive("a", *way), *drive("b", *way)]
    )
    world = ExamData(Dataset(tmp_path, info, frames), 0)
    test = TestFrames.of(
        Trained(
            experiment=Experiment(name="", words="", rows=(), protocols=("cross-run",), seeds=()),
            rows={},
            corpus=Corpus((world.dataset,)),
            exams=(world, world),
            questions=ask([world], "cross-run"),
            said={},
            converged=frozenset(),
            num_answers=0,
            cache=tmp_path,
            out=tmp_path,
        )
    )
    assert len(test.frames) == 40
    assert [rows.tolist() for rows in test.rows] == [list(range(20))] * 2
    assert test.asked.split.tolist() == [0] * 10 + [1] * 10 + [2] * 10 + [3] * 10
    assert test.asked.block.tolist() == ([0] * 5 + [1] * 5) * 2 + ([2] * 5 + [3] * 5) * 2
    assert test.asked.world.tolist() == [0] * 20 + [1] * 20
