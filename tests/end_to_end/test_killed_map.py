# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Maps whose makers are killed at once, in processes of their own."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from adafusion.mapping import MapHeader, PlaceMap, info
from adafusion.types import Descriptions, Frame

KILLED = """
import os, signal, sys, threading
from dataclasses import replace
from pathlib import Path
from adafusion.mapping import PlaceMap

def die(*_: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)

job, path = sys.argv[1], Path(sys.argv[2])
day = PlaceMap.open(path)
if job == "build":
    Path.rename = die  # all is written, and has no name yet
    day.save(path.with_name("new.map"))
threading.Timer(0.5, die).start()
for i in range(100_000):
    PlaceMap.append(path, replace(day, keys=tuple(f"{i}/{row}" for row in range(len(day)))))
    print(i, flush=True)
"""


def make_run(run: str) -> PlaceMap:
    frames = [Frame(run=run, timestamp_us=i, position_m=(float(i), 0.0, 0.0)) for i in range(3)]
    fused = np.random.default_rng(0).random((3, 4), np.float32)
    header = MapHeader(
        model="a",
        model_fingerprint="aaaa",
        preprocess_fingerprint="pppp",
        synthetic=True,
        world="campus",
    )
    descriptions = Descriptions(fused, None, None, None)
    return PlaceMap.from_descriptions(frames, descriptions, header=header, dataset="campus")


@pytest.mark.skipif(sys.platform == "win32", reason="nothing is killed like this on Windows")
def test_a_killed_process_leaves_no_half_map_and_no_half_run(tmp_path: Path) -> None:
    path = tmp_path / "campus.map"
    make_run("day").save(path)
    jobs = {
        job: subprocess.Popen(
            [sys.executable, "-c", KILLED, job, path], stdout=subprocess.PIPE, text=True
        )
        for job in ("build", "add")
    }
    said = {job: process.communicate()[0] for job, process in jobs.items()}
    assert [process.returncode for process in jobs.values()] == [-signal.SIGKILL] * 2
    assert not (tmp_path / "new.map").exists()
    make_run("day").save(tmp_path / "new.map")  # what was left is in nobody's way

    told = info(path)
    added = len(said["add"].split())
    assert added > 0
    assert set(told.runs.values()) == {3}
    assert len(told.runs) - 1 in (added, added + 1)  # what was reported is kept
    PlaceMap.append(path, make_run("night"))  # and no lock outlives its owner
