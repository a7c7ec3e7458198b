# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The cache of preprocessed frames gives what the direct path gives, or says what is wrong."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Literal

import numpy as np
import pytest
import torch

from adafusion.preprocess import Crop, Ground, ImageSettings, Preprocess, VoxelGrid, cache
from adafusion.preprocess.cache import PreparedSet, prepare_cache
from adafusion.types import Frame, Observation, T, UserError


@dataclass
class World:
    """A dataset in memory: frame i shows what seed and i make of it."""

    frames: tuple[Frame, ...]
    seed: int = 0
    root: Path = Path("town")
    loads: list[str] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def fingerprint(self) -> str:
        return f"{self.seed} {self.frames}"

    def load(self, frame: Frame) -> Observation:
        time.sleep(self.seconds)
        self.loads.append(frame.key)
        rng = np.random.default_rng([self.seed, frame.timestamp_us])
        image = rng.integers(0, 256, (12, 18, 3), dtype=np.uint8)
        points = rng.uniform((-6, -6, -1), (6, 6, 4), (200, 3)).astype(np.float32)
        return Observation(
            image=None if frame.image is None else image,
            points_body=None if frame.cloud is None else points,
        )


def world(
    n: int, seed: int = 0, no_image: tuple[int, ...] = (), no_cloud: tuple[int, ...] = ()
) -> World:
    frames = tuple(
        Frame(
            run="day" if i < n // 2 else "night",
            timestamp_us=i,
            position_m=(float(i), 10.0 * seed, 0.0),
            image=None if i in no_image else f"{i}.png",
            cloud=None if i in no_cloud else f"{i}.npy",
        )
        for i in range(n)
    )
    return World(frames, seed)


def settings(occupancy: Literal["binary", "count", "soft", "tdf"] = "binary") -> Preprocess:
    return Preprocess(
        image=ImageSettings(size=(6, 9), crop=Crop(bottom=0.25)),
        ground=Ground(method="height", height_m=0.2),
        voxels=VoxelGrid(
            lower_m=(-5.0, -5.0, 0.0), upper_m=(5.0, 5.0, 3.0), shape=(5, 6, 3), occupancy=occupancy
        ),
    )


@pytest.mark.parametrize("occupancy", ["binary", "count", "soft", "tdf"])
def test_gives_the_tensors_of_the_direct_path_bit_for_bit(
    tmp_path: Path, occupancy: Literal["binary", "count", "soft", "tdf"]
) -> None:
    town = world(7)
    prepared = prepare_cache(town, settings(occupancy), tmp_path)
    rows = np.array([4, 0, 6, 4])
    images, voxels = prepared.tensors(rows)
    for i, row in enumerate(rows):
        seen = town.load(town.frames[row])
        image, grid = settings(occupancy)(seen.image, seen.points_body)
        assert image is not None
        assert grid is not None
        assert torch.equal(images[i], image)
        assert torch.equal(voxels[i], grid)


def test_reads_a_missing_sensor_as_zeros_and_says_so(tmp_path: Path) -> None:
    prepared = prepare_cache(world(4, no_image=(1,), no_cloud=(2,)), settings(), tmp_path)
    assert prepared.has_image.tolist() == [True, False, True, True]
    assert prepared.has_cloud.tolist() == [True, True, False, True]
    assert not prepared.images_u8(np.array([1])).any()
    assert not prepared.lidar(np.array([2])).any()
    assert prepared.lidar(np.array([1])).any()


def test_loads_each_frame_once_and_nothing_the_second_time(tmp_path: Path) -> None:
    town = world(5)
    prepare_cache(town, settings(), tmp_path, workers=3)
    assert sorted(town.loads) == sorted(frame.key for frame in town.frames)
    town.loads.clear()
    prepare_cache(town, settings(), tmp_path)
    assert town.loads == []


def test_keeps_other_settings_and_other_datasets_apart(tmp_path: Path) -> None:
    folders = {
        prepare_cache(town, chosen, tmp_path).folder
        for town in (world(2), world(2, seed=1))
        for chosen in (settings(), settings("count"))
    }
    assert len(folders) == 4


def test_shows_its_progress(tmp_path: Path) -> None:
    seen: list[int | None] = []

    def watch(items: Iterable[T], *, total: int | None = None, desc: str = "") -> Iterable[T]:
        seen.append(total)
        return items

    prepare_cache(world(3), settings(), tmp_path, progress=watch)
    assert seen == [3]


def test_goes_on_after_kill_9_with_what_was_done(tmp_path: Path) -> None:
    script = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
import test_preprocess_cache as t
from adafusion.preprocess import cache
cache.CHECKPOINT = 4
town = t.world(40)
town.seconds = 0.05
cache.prepare_cache(town, t.settings(), {str(tmp_path)!r}, workers=1)
"""
    builder = subprocess.Popen([sys.executable, "-c", script])
    deadline = time.monotonic() + 120
    while not (index := list(tmp_path.glob("*/index.json"))):
        assert builder.poll() is None, "the builder ended too early"
        assert time.monotonic() < deadline, "the builder never came to its first checkpoint"
        time.sleep(0.01)
    os.kill(builder.pid, signal.SIGKILL)
    builder.wait()
    done = json.loads(index[0].read_text())["done"]
    assert 0 < done < 40

    town = world(40)
    resumed = prepare_cache(town, settings(), tmp_path)
    whole = prepare_cache(world(40), settings(), tmp_path / "other")
    assert sorted(town.loads) == sorted(frame.key for frame in town.frames[done:])
    for name in ("images.npy", "lidar.npy", "rows.npy"):
        assert (resumed.folder / name).read_bytes() == (whole.folder / name).read_bytes()


def test_two_builders_of_the_same_cache_take_turns(tmp_path: Path) -> None:
    town = world(12)
    town.seconds = 0.005
    with ThreadPoolExecutor(2) as pool:
        one, two = [pool.submit(prepare_cache, town, settings(), tmp_path) for _ in range(2)]
        rows = np.arange(12)
        assert torch.equal(one.result().lidar(rows), two.result().lidar(rows))
    assert len(town.loads) == 12


def test_a_frame_that_cannot_be_read_stops_it_and_leaves_no_whole_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache, "CHECKPOINT", 2)
    town = world(6)
    good_load = town.load

    def load(frame: Frame) -> Observation:
        if frame.timestamp_us == 4:
            raise UserError("4.png is cut off: restore it")
        return good_load(frame)

    monkeypatch.setattr(town, "load", load)
    with pytest.raises(UserError, match=r"4\.png is cut off"):
        prepare_cache(town, settings(), tmp_path)
    monkeypatch.undo()
    town.loads.clear()
    prepared = prepare_cache(town, settings(), tmp_path)
    assert town.loads[0] == town.frames[4].key  # what came before is kept
    assert prepared.has_image.all()


@pytest.mark.parametrize("name", ["images.npy", "lidar.npy", "rows.npy"])
@pytest.mark.parametrize("harm", ["cut", "flip", "header", "gone"])
def test_refuses_a_damaged_file_by_name_with_the_remedy(
    tmp_path: Path, name: str, harm: str
) -> None:
    town = world(4)
    path = prepare_cache(town, settings(), tmp_path).folder / name
    data = bytearray(path.read_bytes())
    if harm == "cut":
        path.write_bytes(data[:-3])
    elif harm == "gone":
        path.unlink()
    else:
        data[-3 if harm == "flip" else 0] ^= 1
        path.write_bytes(data)
    with pytest.raises(UserError, match=f"{name} is damaged.*delete {path.parent}"):
        prepare_cache(town, settings(), tmp_path).tensors(np.arange(4))


def test_refuses_a_damaged_index(tmp_path: Path) -> None:
    index = prepare_cache(world(2), settings(), tmp_path).folder / "index.json"
    index.write_text("{")
    with pytest.raises(UserError, match=r"index\.json is damaged.*delete"):
        prepare_cache(world(2), settings(), tmp_path)


def test_refuses_a_full_disk_before_it_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache.shutil, "disk_usage", lambda _: SimpleNamespace(free=100))
    with pytest.raises(UserError, match="make room"):
        prepare_cache(world(4), settings(), tmp_path)


def test_refuses_a_dataset_without_frames(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no frames"):
        prepare_cache(World(()), settings(), tmp_path)


def test_several_worlds_read_as_one(tmp_path: Path) -> None:
    towns = [
        prepare_cache(world(4, no_cloud=(3,)), settings(), tmp_path),
        prepare_cache(world(3, seed=1), settings(), tmp_path),
    ]
    together = PreparedSet(tuple(towns))
    assert len(together) == 7
    assert together.worlds.tolist() == [0, 0, 0, 0, 1, 1, 1]
    assert together.runs.tolist() == [0, 0, 1, 1, 2, 3, 3]
    assert together.positions[:, 1].tolist() == [0.0] * 4 + [10.0] * 3
    assert [frame.timestamp_us for frame in together.frames] == [0, 1, 2, 3, 0, 1, 2]
    assert together.has_cloud.tolist() == [True, True, True, False, True, True, True]
    assert together.has_image.all()

    images, voxels = together.tensors(np.array([5, 0, 4, 3, 5, -1]))
    for i, (town, row) in enumerate([(1, 1), (0, 0), (1, 0), (0, 3), (1, 1), (1, 2)]):
        image, grid = towns[town].tensors(np.array([row]))
        assert torch.equal(images[i], image[0])
        assert torch.equal(voxels[i], grid[0])
    assert together.images_u8(np.array([6])).shape == (1, 6, 9, 3)
    assert together.images_u8(np.array([], dtype=np.int64)).shape == (0, 6, 9, 3)
    with pytest.raises(IndexError):
        together.lidar(np.array([7]))


def test_worlds_prepared_in_different_ways_do_not_mix(tmp_path: Path) -> None:
    parts = tuple(prepare_cache(world(2), s, tmp_path) for s in (settings(), settings("soft")))
    with pytest.raises(ValueError, match="share one preprocessing"):
        PreparedSet(parts)
