# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from adafusion.datasets.sensor_files import read_bytes
from adafusion.types import JobFailed, UserError
from adafusion.workers import map_in_processes

# spawned processes import what they do by name, and this module has none: it borrows functions


@pytest.mark.parametrize("workers", [1, 2])
def test_it_yields_in_the_order_of_the_items(workers: int) -> None:
    results = map_in_processes(math.factorial, iter(range(20)), workers)
    assert list(results) == [math.factorial(x) for x in range(20)]


def test_it_takes_items_only_a_few_ahead() -> None:
    taken: list[int] = []

    def items() -> Iterator[int]:
        for x in range(1000):
            taken.append(x)
            yield x

    results = iter(map_in_processes(abs, items(), 2))
    next(results)
    assert len(taken) <= 8


@pytest.mark.parametrize("workers", [1, 2])
def test_it_starts_every_process_as_told(
    workers: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(Path.cwd())  # where one worker's start leads, the test leads back from
    results = map_in_processes(
        os.path.abspath, ["x"], workers, start=os.chdir, arguments=(tmp_path,)
    )
    assert list(results) == [str(tmp_path / "x")]


@pytest.mark.parametrize("workers", [1, 2])
def test_it_passes_on_what_the_work_raises(workers: int, tmp_path: Path) -> None:
    (tmp_path / "1.bin").write_bytes(b"whole")
    files = [tmp_path / "1.bin", tmp_path / "2.bin"]
    results = iter(map_in_processes(partial(read_bytes, kind="cloud"), files, workers))
    assert next(results) == b"whole"
    with pytest.raises(UserError, match=r"2\.bin is missing"):
        next(results)


def test_it_says_that_a_process_was_killed() -> None:
    with pytest.raises(JobFailed, match="fewer --workers"):
        list(map_in_processes(os._exit, [9, 9], 2))


def test_it_refuses_to_work_with_nobody() -> None:
    with pytest.raises(UserError, match="workers = 0"):
        list(map_in_processes(abs, range(4), 0))
