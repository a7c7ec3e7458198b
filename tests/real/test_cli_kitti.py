# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The commands on a real drive: mapped, found again, and refused where a file is damaged.

The weights are random and a straight drive never comes back: this says that real files go all the
way through, and nothing about how well places are recognised.
"""

from __future__ import annotations

import hashlib
import io
import re
import shutil
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch

from adafusion.cli import main
from adafusion.datasets import open_dataset
from adafusion.mapping import PlaceMap
from adafusion.models import AdaFusion, ModelConfig, save_model
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid

ADDED = ("000002", "000006")  # frames that the map leaves out


class Said(NamedTuple):
    """What a command returned and printed."""

    code: int
    out: str
    err: str


def type_in(*words: object) -> Said:
    """Run a command line in this process."""
    before, sys.argv = sys.argv, ["adafusion", *map(str, words)]
    try:
        with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
            try:
                main()
                code = 0
            except SystemExit as stop:
                code = int(stop.code or 0)
    finally:
        sys.argv = before
    return Said(code, out.getvalue(), err.getvalue())


@pytest.fixture(scope="module")
def src(real_data: Path) -> Path:
    return real_data / "kitti_odometry"


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    settings = Preprocess(image=ImageSettings(size=(48, 64)), voxels=VoxelGrid(shape=(16, 16, 8)))
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_model(AdaFusion(ModelConfig(width=0.125, dim=16, preprocess=settings)), path)
    return path


@pytest.fixture(scope="module")
def prepared(src: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("kitti") / "drive"
    said = type_in("prepare", "kitti-odometry", src, out)
    assert said.code == 0, said.err
    assert "21 frames in 1 run\n" in said.out
    return out


@pytest.fixture(scope="module")
def mapped(prepared: Path, weights: Path) -> Path:
    path = prepared.parent / "drive.map"
    said = type_in("map", "build", prepared, path, "--frames", "::2", "--model", weights)
    assert said.code == 0, said.err
    assert "11 places" in said.out
    return path


def test_a_drive_is_mapped_and_each_query_told_how_far_off_it_is(
    prepared: Path, mapped: Path, weights: Path
) -> None:
    before = state_of(mapped)
    said = type_in("locate", mapped, "--dataset", prepared, "--frames", "1::2", "--model", weights)
    assert said.code == 0, said.err
    found = re.findall(r"^(04/\d+) -> (04/\d+) .* ([\d.]+) m off", said.out, re.MULTILINE)
    frames = {frame.key: frame for frame in open_dataset(prepared).frames}
    assert [query for query, _, _ in found] == list(frames)[1::2]
    for query, place, off_m in found:
        apart = np.subtract(frames[query].position_m, frames[place].position_m)[:2]
        assert float(off_m) == pytest.approx(np.hypot(*apart), abs=0.06)
    assert "of 10 queries within 20 m" in said.out
    assert state_of(mapped) == before


@dataclass(frozen=True)
class Fault:
    """One way in which a recording can be damaged."""

    file: str
    damage: Callable[[bytes], bytes | None]  # None: the file is gone
    told: str


FAULTS = {
    "cloud cut within a point": Fault(
        "velodyne", lambda data: data[: len(data) // 32 * 16 + 5], "is cut short"
    ),
    "image cut in half": Fault("image_2", lambda data: data[: len(data) // 2], "cut short"),
    "empty cloud": Fault("velodyne", lambda data: b"", "holds no points"),
    "cloud with NaN": Fault("velodyne", lambda data: b"\xff" * 16 + data[16:], "holds NaN"),
    "no poses": Fault("poses", lambda data: None, "is missing"),
}
SENSOR_FAULTS = [name for name, fault in FAULTS.items() if fault.file != "poses"]


@pytest.mark.parametrize("name", FAULTS)
def test_a_damaged_recording_becomes_no_dataset_and_joins_no_map(
    src: Path, mapped: Path, weights: Path, tmp_path: Path, name: str
) -> None:
    fault, before, out = FAULTS[name], state_of(mapped), tmp_path / "out"
    broken = damaged_copy(src, tmp_path / "kitti", fault)
    said = type_in("prepare", "kitti-odometry", tmp_path / "kitti", out)
    refused(said, broken, fault.told, "replace it|fetch it")
    assert not out.exists()
    for rest in (out, tmp_path / "out.partial"):
        said = type_in("map", "add", rest, mapped, "--model", weights)
        refused(said, rest, "is missing|is not finished", "give the folder|repeat the command")
    assert state_of(mapped) == before


@pytest.mark.parametrize("name", SENSOR_FAULTS)
def test_a_damaged_query_is_refused(
    src: Path, mapped: Path, weights: Path, tmp_path: Path, name: str
) -> None:
    fault, before = FAULTS[name], state_of(mapped)
    broken = damaged_copy(src, tmp_path / "kitti", fault)
    given = (
        ["--image", broken]
        if fault.file == "image_2"
        else ["--cloud", broken, "--lidar-height-m", 1.73]
    )
    refused(type_in("locate", mapped, *given, "--model", weights), broken, fault.told, "replace it")
    assert state_of(mapped) == before


@pytest.mark.parametrize("name", SENSOR_FAULTS)
def test_a_dataset_damaged_since_it_was_prepared_joins_no_map(
    src: Path, mapped: Path, weights: Path, tmp_path: Path, name: str
) -> None:
    fault, before, out = FAULTS[name], state_of(mapped), tmp_path / "out"
    damaged_copy(src, tmp_path / "kitti", Fault(fault.file, lambda data: data, ""))
    assert type_in("prepare", "kitti-odometry", tmp_path / "kitti", out).code == 0
    frame = open_dataset(out).frames[1]
    broken = out / str(frame.image if fault.file == "image_2" else frame.cloud)
    if name == "empty cloud":
        np.save(broken, np.zeros((0, 3), np.float32))
    elif name == "cloud with NaN":
        points = np.load(broken)
        points[3] = np.nan
        np.save(broken, points)
    else:
        broken.write_bytes(broken.read_bytes()[: broken.stat().st_size // 2])
    said = type_in("map", "add", out, mapped, "--model", weights)
    refused(said, broken, fault.told if "cut" not in name else "damaged", "replace it")
    assert state_of(mapped) == before


def refused(said: Said, path: Path, told: str, remedy: str) -> None:
    assert said.code == 2, said.err
    assert re.search(rf"{re.escape(str(path))}.*({told}).*({remedy})", said.err), said.err
    assert "Traceback" not in said.err
    assert said.out == ""


def damaged_copy(src: Path, copy: Path, fault: Fault) -> Path:
    """Copy two frames of the drive, damage the second; give the file that is damaged."""
    for path in (src / "poses/04.txt", *(src / "sequences/04").rglob("*.*")):
        if path.suffix == ".txt" or path.stem in ADDED:
            target = copy / path.relative_to(src)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
    broken = copy / "poses/04.txt"
    if fault.file != "poses":
        (broken,) = (copy / "sequences/04" / fault.file).glob(f"{ADDED[1]}.*")
    data = fault.damage(broken.read_bytes())
    broken.unlink()
    if data is not None:
        broken.write_bytes(data)
    return broken


def state_of(path: Path) -> tuple[str, dict[str, str]]:
    """Fingerprint of a map's content, and a hash of each of its files."""
    files = sorted(file for file in path.rglob("*") if file.is_file())
    hashes = {str(f.relative_to(path)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}
    return PlaceMap.open(path).fingerprint, hashes
