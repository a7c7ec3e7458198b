# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Splits as a person types them, on datasets of positions alone."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from adafusion.datasets import Dataset, DatasetInfo, DatasetWriter, open_dataset
from adafusion.datasets.splits import load_split, region_of
from adafusion.types import Frame

# three runs on one way: through P1 of Oxford from west to east, and back 400 m further south
WEST, NORTH, SOUTH = 619700.0, 5735712.0, 5735300.0


def ring() -> list[tuple[float, float]]:
    along = np.arange(0.0, 800.0, 10.0)
    down = np.arange(NORTH, SOUTH, -10.0)
    sides = (
        [(WEST + x, NORTH) for x in along],
        [(WEST + 800.0, y) for y in down],
        [(WEST + 800.0 - x, SOUTH) for x in along],
        [(WEST, y) for y in down[::-1]],
    )
    return [xy for side in sides for xy in side]


@pytest.fixture
def oxford(tmp_path: Path) -> Dataset:
    info = DatasetInfo(
        name="robotcar",
        version="1",
        source="a test",
        licence="none",
        synthetic=True,
        world="UTM zone 30N",
    )
    with DatasetWriter(tmp_path / "oxford", info) as writer:
        for k, run in enumerate(("may", "june", "july")):
            for t, (x, y) in enumerate(ring()):
                writer.add_written(
                    Frame(run=run, timestamp_us=1_000_000 * t, position_m=(x + k, y + k, 0.0))
                )
    return open_dataset(tmp_path / "oxford")


def regions_of(dataset: Dataset) -> dict[str, list[list[float]]]:
    """As the file has them now."""
    return open_dataset(dataset.root).info.regions


def test_a_check_counts_every_split_of_the_world_and_writes_nothing(
    type_in, oxford: Dataset
) -> None:
    before = (oxford.root / "dataset.yaml").read_bytes()
    said = type_in("split", oxford.root, "--check")
    assert said.code == 0, said.err
    assert "robotcar-boxes: Tests in four boxes" in said.out
    assert "robotcar-line: Tests east of a line" in said.out
    assert "nclt" not in said.out
    assert "10.0 m apart on the median; world UTM zone 30N" in said.out
    assert "A guess: that AdaFusion used it" in said.out
    assert said.out.count("5,155 frames make 13,284,435 pairs in all") == 2
    assert "Nearest to its paper's train and test frames: robotcar-" in said.out
    assert (oxford.root / "dataset.yaml").read_bytes() == before


def test_a_named_split_is_written_and_what_was_there_is_told(type_in, oxford: Dataset) -> None:
    said = type_in("split", oxford.root, "robotcar-boxes")
    assert said.code == 0, said.err
    assert regions_of(oxford) == load_split("robotcar-boxes").boxes()
    assert "before: {}" in said.err
    said = type_in("split", oxford.root, "robotcar-line")
    assert said.code == 0, said.err
    _, _, before = said.err.partition("before: ")
    assert yaml.safe_load(before) == load_split("robotcar-boxes").boxes()
    assert open_dataset(oxford.root).info.conventions["regions"] == "robotcar-line"
    assert type_in("split", oxford.root).out.splitlines()[2] == "robotcar-line"


def test_a_named_split_gives_part_of_its_training_to_validation(type_in, oxford: Dataset) -> None:
    said = type_in("split", oxford.root, "robotcar-boxes", "--validation", "0.2")
    assert said.code == 0, said.err
    regions = regions_of(oxford)
    assert regions["test"] == load_split("robotcar-boxes").boxes()["test"]
    xy = oxford.positions_m[:, :2]
    names, plain = region_of(xy, regions), region_of(xy, {"test": regions["test"]})
    assert (names[plain == "test"] == "test").all()
    assert 0.1 < (names == "validation").mean() < 0.3
    again = type_in("split", oxford.root, "robotcar-line", "--validation", "0.2")
    assert again.code == 2
    assert "there is a validation region already" in again.err


def test_own_data_are_cut_by_themselves_the_same_way_for_the_same_seed(
    type_in, oxford: Dataset
) -> None:
    words = ["split", oxford.root, "--auto", "--test", "0.3", "--validation", "0.1", "--seed"]
    said = type_in(*words, 4)
    assert said.code == 0, said.err
    assert "blocks that two runs or more visit" in said.err
    first = regions_of(oxford)
    names = region_of(oxford.positions_m[:, :2], first)
    assert 0.2 < (names == "test").mean() < 0.4
    assert 0.03 < (names == "validation").mean() < 0.2
    assert (names == "train").mean() > 0.2
    type_in(*words, 5)
    assert regions_of(oxford) != first
    type_in(*words, 4)
    assert regions_of(oxford) == first


def test_boxes_by_hand_are_drawn_before_anything_is_written(
    type_in, oxford: Dataset, tmp_path: Path
) -> None:
    box = f"test={WEST},{SOUTH - 50},{WEST + 400},{SOUTH + 50}"
    words = ["split", oxford.root, "--box", box, "--buffer-m", "30"]
    said = type_in(*words, "--check", "--plot", tmp_path / "map.png")
    assert said.code == 0, said.err
    assert regions_of(oxford) == {}
    picture = cv2.imread(str(tmp_path / "map.png"))
    assert picture is not None
    assert min(picture.shape[:2]) > 600
    assert picture.std() > 5.0
    assert type_in(*words).code == 0
    assert list(regions_of(oxford)) == ["test", "guard"]


def test_a_split_of_ones_own_is_a_file(type_in, oxford: Dataset, tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    box = [WEST, SOUTH - 50.0, WEST + 400.0, SOUTH + 50.0]
    own.write_text(f"name: own\nwords: w\nsource: s\nregions: {{test: [{box}]}}\nguard_m: 5\n")
    said = type_in("split", oxford.root, own)
    assert said.code == 0, said.err
    assert "paper" not in said.out
    assert list(regions_of(oxford)) == ["test", "guard"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nclt-opr"], "is for coordinates of NCLT local ENU, and those of .* are of UTM zone 30N"),
        (["oxford"], "unknown split 'oxford'"),
        (["robotcar-boxes", "--auto"], "NAME and --auto both make regions"),
        (["robotcar-line", "--buffer-m", "10"], "0 m apart, less than the 10 m"),
        (["robotcar-boxes", "--test", "0.2"], "--test is the share that --auto cuts"),
        (["--validation", "0.2"], "need a split"),
        (["--box", "test=0,0,1,1"], "no frame of .* lies in the test boxes"),
        (["--auto", "--test", "1.5"], "share of 1.5"),
        (["--auto", "--block-m", "0"], "blocks of 0 m"),
        (["--auto", "--buffer-m", "2000"], "validation: none of .* blocks.* --validation 0"),
        (["--box", "test=20,0,0,30"], "XMIN must be below XMAX"),
        (["--auto", "--plot", "map.txt"], "ends in .png, .svg, .pdf"),
    ],
)
def test_what_cannot_be_split_is_told_why_and_stays_as_it_was(
    type_in, oxford: Dataset, words: list[str], message: str
) -> None:
    said = type_in("split", oxford.root, *words)
    assert said.code == 2
    assert said.err.startswith("adafusion: ") or "blocks" in said.err
    lines = " ".join(said.err.split())
    assert re.search(message, lines), lines
    assert regions_of(oxford) == {}


def test_regions_without_a_frame_are_warned_of(type_in, oxford: Dataset) -> None:
    boxes = [f"--box=test={WEST - 10},{SOUTH - 10},{WEST + 900},{NORTH + 10}"]
    said = type_in("split", oxford.root, *boxes, "--box", "validation=0,0,1,1", "--check")
    assert said.code == 0
    assert "no frame lies in the train region" in said.err
    assert "no frame lies in the validation region" in said.err


def test_a_world_that_no_split_is_for_is_told_so(type_in, tmp_path: Path) -> None:
    info = DatasetInfo(name="mine", version="1", source="s", licence="l", synthetic=True)
    with DatasetWriter(tmp_path / "mine", info) as writer:
        writer.add_written(Frame(run="a", timestamp_us=1, position_m=(0.0, 0.0, 0.0)))
    said = type_in("split", tmp_path / "mine", "--check")
    assert said.code == 0
    assert "cut others by --auto or --box" in said.err
    assert "train frames" in said.out
    assert re.search(r"nearest train to test frame +none", said.out)
    picture = tmp_path / "map.png"
    said = type_in("split", tmp_path / "mine", "--check", "--plot", picture)
    assert said.code == 0, said.err
    assert "no split that comes with the package is for" in " ".join(said.err.split())
    assert cv2.imread(str(picture)) is not None
