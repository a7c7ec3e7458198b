# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""`adafusion prepare` as a person uses it: guesses, is killed, meets damage, says what to do."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from adafusion.datasets import open_dataset
from adafusion.datasets.recording import SKIPPED_FILE

FRAMES = 150


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of one drive: a picture, a cloud and a pose every metre."""
    src = tmp_path_factory.mktemp("site")
    for name in ("images", "clouds"):
        (src / name).mkdir()
    rng = np.random.default_rng(0)
    rows = ["timestamp_us,x,y,z,qx,qy,qz,qw"]
    for k in range(FRAMES):
        time_us = 1_700_000_000_000_000 + 100_000 * k
        picture = rng.integers(0, 255, (48, 64, 3), np.uint8)
        cv2.imwrite(str(src / "images" / f"{time_us}.png"), picture)
        cloud = np.column_stack([rng.uniform(-20, 20, (200, 3)), rng.uniform(0, 1, 200)])
        cloud.astype("<f4").tofile(src / "clouds" / f"{time_us}.bin")
        rows.append(f"{time_us},{k},0,0,0,0,0,1")
    (src / "poses.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return src


@pytest.fixture
def damaged(site: Path, tmp_path: Path) -> Path:
    """The same drive with one cloud cut within a point."""
    src = tmp_path / "damaged"
    for path in site.rglob("*.*"):
        target = src / path.relative_to(site)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(path.read_bytes())
    cloud = sorted((src / "clouds").iterdir())[7]
    cloud.write_bytes(cloud.read_bytes()[:-5])
    return src


def test_it_guesses_the_format_and_says_what_it_did(type_in, site: Path, tmp_path: Path) -> None:
    said = type_in("prepare", str(site), str(tmp_path / "out"), "--every-m", "10")
    assert said.code == 0
    assert f"{tmp_path / 'out'}: 15 frames in 1 run\n" in said.out
    assert "frames/s; of the work " in said.err
    assert len(open_dataset(tmp_path / "out").frames) == 15


def test_a_damaged_cloud_stops_it_by_name(type_in, damaged: Path, tmp_path: Path) -> None:
    cloud = sorted((damaged / "clouds").iterdir())[7]
    said = type_in("prepare", "folder", str(damaged), str(tmp_path / "out"), "--workers", "1")
    assert said.code == 2
    assert str(cloud) in said.err
    assert not (tmp_path / "out").exists()


def test_it_leaves_damage_out_and_lists_it(type_in, damaged: Path, tmp_path: Path) -> None:
    cloud = sorted((damaged / "clouds").iterdir())[7]
    out = tmp_path / "out"
    said = type_in("prepare", "folder", str(damaged), str(out), "--skip-bad", "--workers", "1")
    assert said.code == 0
    assert "left out, 1 damaged" in said.err
    assert str(cloud) in (out / SKIPPED_FILE).read_text(encoding="utf-8")
    assert len(open_dataset(out).frames) == FRAMES - 1


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["nclt", "{site}", "{out}", "--image-topic", "/camera"], "nclt knows no --image-topic"),
        (["noon", "{site}", "{out}"], "unknown format 'noon': choose from robotcar"),
        (["{out}/nothing", "{out}"], "nothing is missing"),
        (["{site}/images", "{out}"], "is laid out like no format known here"),
        (["{site}"], r"give [KIND] SRC OUT"),
    ],
)
def test_wrong_usage_is_told_with_the_choices(
    type_in, site: Path, tmp_path: Path, words: list[str], told: str
) -> None:
    said = type_in("prepare", *(word.format(site=site, out=tmp_path / "out") for word in words))
    assert said.code == 2
    assert told in said.err


@pytest.mark.slow
def test_a_killed_job_goes_on_to_the_same_bytes(contents, site: Path, tmp_path: Path) -> None:
    """kill -9 takes parent and workers in the middle; the same command then finishes."""
    program = "from adafusion.cli import main; main()"
    command = [sys.executable, "-c", program, "prepare", "folder", str(site)]
    subprocess.run([*command, str(tmp_path / "whole")], check=True, capture_output=True)
    out, partial = tmp_path / "killed", tmp_path / "killed.partial"
    job = subprocess.Popen([*command, str(out)], stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 100.0
    while len(list(partial.rglob("*.npy"))) < 10:
        assert time.monotonic() < deadline, "nothing was prepared"
        assert job.poll() is None, "the job ended before it could be killed"
        time.sleep(0.005)
    job.kill()
    job.wait()
    assert not out.exists()
    subprocess.run([*command, str(out)], check=True, capture_output=True)
    assert contents(out) == contents(tmp_path / "whole")
