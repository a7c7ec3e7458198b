# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Which runs are read, and files that are named by their time."""

from __future__ import annotations

from pathlib import Path

import pytest

from adafusion.readers.runs import choose_runs, file_times, files_by_stamp
from adafusion.types import UserError


def touch(folder: Path, *names: str) -> None:
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).touch()


def test_it_takes_files_by_their_numbers_rising(tmp_path: Path) -> None:
    touch(tmp_path, "10.png", "000002.jpg", "x.png", "3.txt", "-4.png", "٣.png", "9" * 30 + ".png")
    found = files_by_stamp(tmp_path, ".png", ".jpg")
    assert list(found.items()) == [(2, tmp_path / "000002.jpg"), (10, tmp_path / "10.png")]
    assert files_by_stamp(tmp_path / "none", ".png") == {}
    assert files_by_stamp(tmp_path / "10.png", ".png") == {}


@pytest.mark.parametrize("other", ["01.png", "000001.jpg"])
def test_it_refuses_two_files_of_one_number_by_name(tmp_path: Path, other: str) -> None:
    touch(tmp_path, "1.png", other)
    with pytest.raises(UserError, match=rf"({other}|1\.png) and ({other}|1\.png) .*: remove one"):
        files_by_stamp(tmp_path, ".png", ".jpg")


def test_times_are_those_that_make_the_names(tmp_path: Path) -> None:
    touch(tmp_path, "10.bin", "2.bin", "007.bin", "0.bin", "5.txt", "12a.bin")
    assert file_times(tmp_path, ".bin").tolist() == [0, 2, 10]
    assert file_times(tmp_path / "none", ".bin").tolist() == []


def test_runs_are_those_named_or_those_preferred_or_all(tmp_path: Path) -> None:
    there = ["c", "a", "b"]
    assert choose_runs(tmp_path, there, None) == ["a", "b", "c"]
    assert choose_runs(tmp_path, there, ["c", "a", "c"]) == ["c", "a"]
    assert choose_runs(tmp_path, there, None, preferred=("d", "b")) == ["b"]
    assert choose_runs(tmp_path, there, None, preferred=("d",)) == ["a", "b", "c"]
    assert choose_runs(tmp_path, there, ["a"], preferred=("b",)) == ["a"]
    with pytest.raises(UserError, match="has no run 'd': choose from a, b, c"):
        choose_runs(tmp_path, there, ["a", "d"])
    for names, runs in ((there, []), ([], None)):
        with pytest.raises(UserError, match=r"no run of .* is chosen"):
            choose_runs(tmp_path, names, runs)
