# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest

from adafusion.cli.common import cache_folder, choose_frames
from adafusion.datasets import Dataset, DatasetInfo
from adafusion.types import Frame, UserError


@pytest.fixture
def dataset() -> Dataset:
    frames = tuple(
        Frame(run=run, timestamp_us=i, position_m=(float(i), 0.0, 0.0))
        for run in ("day", "night")
        for i in range(5)
    )
    info = DatasetInfo(
        name="five", version="1", source="made by hand", licence="CC0-1.0", synthetic=True
    )
    return Dataset(root=Path("five"), info=info, frames=frames)


@pytest.mark.parametrize(
    ("runs", "frames", "expected"),
    [
        (
            None,
            "::",
            ["day/0", "day/1", "day/2", "day/3", "day/4"] + [f"night/{i}" for i in range(5)],
        ),
        ("night", "::2", ["night/0", "night/2", "night/4"]),
        ("night,day", "1::3", ["night/1", "night/4", "day/1", "day/4"]),
        ("day", ":2", ["day/0", "day/1"]),
        ("day", "-1:", ["day/4"]),
    ],
)
def test_a_slice_counts_within_each_run(
    dataset: Dataset, runs: str | None, frames: str, expected: list[str]
) -> None:
    assert [frame.key for frame in choose_frames(dataset, runs, frames)] == expected


@pytest.mark.parametrize("frames", ["a", "2", "1:2:3:4", "::0", "9:", ""])
def test_a_slice_that_is_none_or_keeps_nothing_is_refused(dataset: Dataset, frames: str) -> None:
    with pytest.raises(UserError, match="--frames"):
        choose_frames(dataset, None, frames)


def test_an_empty_variable_names_no_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    monkeypatch.delenv("ADAFUSION_CACHE", raising=False)
    usual = cache_folder(None)
    assert usual == tmp_path / ".cache" / "adafusion"
    monkeypatch.setenv("ADAFUSION_CACHE", "")
    assert cache_folder(None) == usual
    monkeypatch.setenv("ADAFUSION_CACHE", "elsewhere")
    assert cache_folder(None) == Path("elsewhere")
    assert cache_folder(Path("given")) == Path("given")


def test_an_unknown_run_lists_the_runs_there_are(dataset: Dataset) -> None:
    with pytest.raises(UserError, match="day, night"):
        choose_frames(dataset, "fog")
