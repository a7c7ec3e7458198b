# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The order of batches is a function of the seed and, where they grow, of what was told of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from adafusion.preprocess import Preprocess
from adafusion.preprocess.cache import PreparedFrames, PreparedSet
from adafusion.training import TrainConfig
from adafusion.training.pairs import Batch, epoch_rng, place_batches
from adafusion.training.sampler import Course, Sampler
from adafusion.training.settings import Growth, Sampling
from adafusion.types import Frame

GROWING = Sampling(places=4, growth=Growth(factor=1.4, below=0.7, limit=160))


def street(stops: int = 40, runs: int = 2, spacing_m: float = 30.0) -> PreparedSet:
    """Some runs past the same stops, 1 m apart."""
    frames = tuple(
        Frame(run=f"run-{run}", timestamp_us=stop, position_m=(stop * spacing_m, float(run), 0.0))
        for run in range(runs)
        for stop in range(stops)
    )
    return PreparedSet((PreparedFrames(Path(), frames, Preprocess(), {}, np.zeros(0), {}),))


def sampler(sampling: Sampling = GROWING, data: PreparedSet | None = None) -> Sampler:
    data = data or street()
    return Sampler(sampling, data, np.arange(len(data)), seed=3)


def told(one: Sampler, first: int, active: Sequence[float]) -> list[list[int]]:
    """The rows of batches, each drawn after the one before was told of."""
    drawn = []
    for batch, share in zip(one.batches(first), active, strict=False):
        drawn.append(batch.rows.tolist())
        one.tell(share)
    return drawn


def sizes(drawn: list[list[int]]) -> list[int]:
    return [len(rows) for rows in drawn]


def test_sizes_are_those_of_the_original() -> None:
    growth, frames = Growth(), [8]
    while frames[-1] < 160:
        frames.append(growth.after(frames[-1], room=10**6))
    assert frames == [8, 11, 15, 21, 29, 40, 56, 78, 109, 152, 160]
    assert growth.after(160, room=10**6) == 160
    assert growth.after(29, room=34) == 34
    assert growth.after(64, room=34) == 64  # nothing shrinks


def test_a_batch_grows_after_an_easy_epoch_and_after_no_other() -> None:
    one = sampler()
    epoch = one.batches_per_epoch
    assert epoch == 10  # 80 frames, 8 in a batch
    hard, easy = [0.9] * 5 + [0.5] * 5, [0.9] * 5 + [0.49] * 5  # 0.7 on average, and less
    drawn = told(one, 0, [*hard, *easy, *hard])
    assert sizes(drawn) == [8] * 20 + [12] * 7 + [12] * 3  # 11 frames asked, two of each place
    assert one.batches_per_epoch == 7
    assert (one.course.epoch, one.course.first, one.course.frames) == (3, 27, 11)
    assert len(one.course.active) == 3


def test_a_batch_grows_to_what_the_world_has_room_for() -> None:
    one = sampler(data=street(stops=12))  # 330 m: no more than 6 places 50 m apart
    assert 8 < one.room <= 12
    told(one, 0, [0.0] * 100)
    assert one.course.frames == one.room


def test_batches_that_are_all_hard_are_those_of_a_sampling_without_growth() -> None:
    plain = [batch.rows.tolist() for batch in sampler(Sampling(places=4)).batches(0, 35)]
    assert told(sampler(), 0, [1.0] * 35) == plain
    assert [batch.rows.tolist() for batch in sampler().batches(0, 35)] == plain  # told of none


def test_it_is_entered_at_any_batch_as_if_it_had_drawn_all_before() -> None:
    active = np.random.default_rng(0).uniform(0.4, 0.9, 40).tolist()
    whole = told(sampler(), 0, active)
    assert len(set(sizes(whole))) > 2
    for stop in range(0, len(active), 3):
        first, second = sampler(), sampler()
        told(first, 0, active[:stop])
        second.go_on(replace(first.course))
        assert told(second, stop, active[stop:]) == whole[stop:]


def test_a_sampling_without_growth_keeps_its_course() -> None:
    one = sampler(Sampling(places=4))
    told(one, 0, [0.0] * 30)
    assert one.course == Course(epoch=0, first=0, frames=8)


@pytest.mark.parametrize("first", [0, 3, 10, 47])
def test_batches_of_one_size_are_their_epochs_one_after_the_other(first: int) -> None:
    data = street()
    one = sampler(Sampling(places=4), data)

    def epochs() -> list[Batch]:
        return [
            batch
            for epoch in range(6)
            for batch in place_batches(one.pairs, 4, 2, epoch_rng(3, epoch), run=data.runs)
        ]

    expected = [batch.rows.tolist() for batch in epochs()[first : first + 12]]
    assert [batch.rows.tolist() for batch in one.batches(first, 12)] == expected
    assert [batch.rows.tolist() for batch in islice(one.batches(first), 12)] == expected
    assert not list(one.batches(first, 0))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"factor": 1.0}, "factor > 1"),
        ({"below": 0.0}, "below"),
        ({"below": 1.5}, "below"),
    ],
)
def test_growth_that_could_not_be_is_refused(settings: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Growth(**settings)


def test_growth_needs_whole_batches_and_a_length_that_it_does_not_change() -> None:
    with pytest.raises(ValueError, match="mode pairs"):
        Sampling(mode="pairs", growth=Growth())
    with pytest.raises(ValueError, match="passes or batches"):
        TrainConfig(sampling=GROWING)
    assert TrainConfig(sampling=GROWING, passes=100).counts_passes
    assert not TrainConfig(sampling=GROWING, passes=100, batches=10).counts_passes
    with pytest.raises(ValueError, match="passes"):
        TrainConfig(passes=0)
