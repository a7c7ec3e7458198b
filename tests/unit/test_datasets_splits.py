# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adafusion.datasets import DatasetInfo, DatasetWriter, open_dataset
from adafusion.datasets.splits import box_gap, load_split, region_of, splits_folder, with_guard
from adafusion.datasets.writer import write_regions
from adafusion.types import Frame, UserError

REGIONS = {
    "test": [[0.0, 0.0, 10.0, 10.0], [50.0, 0.0, 60.0, 10.0]],
    "validation": [[10.0, 0.0, 20.0, 10.0]],
}
SPLIT = """\
name: own
words: One box.
source: me
regions:
  test:
    - [10.0, 20.0, 30.0, 40.0]
"""


def test_a_place_belongs_to_the_box_that_holds_it() -> None:
    positions = np.array([[5.0, 5.0], [55.0, 5.0], [15.0, 5.0], [30.0, 5.0], [5.0, -5.0]])
    expected = ["test", "test", "validation", "train", "train"]
    assert region_of(positions, REGIONS).tolist() == expected


def test_a_box_owns_its_lower_edges_only() -> None:
    positions = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [5.0, 10.0]])
    assert region_of(positions, REGIONS).tolist() == ["test", "validation", "train", "train"]


def test_the_region_named_first_owns_an_overlap() -> None:
    overlapping = {"a": [[0.0, 0.0, 2.0, 2.0]], "b": [[1.0, 1.0, 3.0, 3.0]]}
    positions = np.array([[1.5, 1.5], [2.5, 2.5]])
    assert region_of(positions, overlapping).tolist() == ["a", "b"]


def test_without_regions_all_is_for_training() -> None:
    assert region_of(np.zeros((3, 2)), {}).tolist() == ["train"] * 3
    assert region_of(np.zeros((0, 2)), REGIONS).tolist() == []


def test_a_gap_is_the_wider_of_the_two_axes() -> None:
    a = [0.0, 0.0, 10.0, 10.0]
    assert box_gap(a, [13.0, 14.0, 20.0, 20.0]) == 4.0
    assert box_gap([13.0, 0.0, 20.0, 5.0], a) == 3.0
    assert box_gap(a, [10.0, 0.0, 20.0, 10.0]) == 0.0  # they touch
    assert box_gap(a, [8.0, -5.0, 20.0, 20.0]) == -2.0
    assert box_gap([-np.inf, 0.0, 0.0, np.inf], [5.0, -np.inf, np.inf, np.inf]) == 5.0


def test_a_guard_takes_the_strip_around_a_box_and_nothing_of_the_box() -> None:
    guarded = with_guard({"test": [[0.0, 0.0, 10.0, 10.0]]}, 5.0)
    assert guarded["guard"] == [[-5.0, -5.0, 15.0, 15.0]]
    x = np.array([-5.1, -5.0, -0.1, 0.0, 9.9, 10.0, 14.9, 15.0])
    names = region_of(np.column_stack([x, np.full_like(x, 5.0)]), guarded)
    between = ["guard", "guard", "test", "test", "guard", "guard"]
    assert names.tolist() == ["train", *between, "train"]
    assert with_guard(REGIONS, 0.0) == REGIONS


@pytest.mark.parametrize(
    ("guard_m", "message"), [(5.0, "validation box .* 0 m apart, less than the 5 m"), (-1.0, "-1")]
)
def test_a_guard_that_has_no_room_is_refused(guard_m: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        with_guard(REGIONS, guard_m)


@pytest.mark.parametrize("path", sorted(splits_folder().glob("*.yaml")), ids=lambda path: path.stem)
def test_every_split_that_is_shipped_is_one(path: Path) -> None:
    split = load_split(path.stem)
    assert split == load_split(path)
    assert split.name == path.stem
    assert split.worlds
    assert split.boxes()["test"]


def test_the_splits_have_the_places_that_their_sources_name() -> None:
    at = {  # worked by hand from the published centres: x east, y north
        "robotcar-boxes": [
            ((620084.402381, 5735712.768124), "test"),  # P1
            ((620084.402381 + 149.9, 5735712.768124 - 149.9), "test"),
            ((620084.402381 + 150.1, 5735712.768124), "train"),
            ((619932.693364, 5734749.303802), "test"),  # P4
            ((620084.402381, 5735000.0), "train"),
        ],
        "robotcar-line": [
            ((620105.1, 5734000.0), "test"),
            ((620104.9, 5735800.1), "validation"),
            ((620104.9, 5735799.9), "train"),
        ],
        "nclt-100m": [  # NCLT writes (north, east): P1 is (-260, -680), P3 (20, -550)
            ((-680.0, -260.0), "test"),
            ((-550.0, 20.0), "test"),
            ((-260.0, -680.0), "train"),
            ((-680.0 + 51.0, -260.0), "train"),
        ],
        "nclt-100m-buffer": [((-680.0 + 51.0, -260.0), "guard"), ((-680.0, -260.0), "test")],
        "nclt-opr": [
            ((-680.0 + 99.0, -260.0), "test"),
            ((-680.0 + 105.0, -260.0), "guard"),
            ((-680.0, -260.0 - 111.0), "train"),
        ],
        "pointnetvlad-inhouse": [
            ((142864.19756, 363621.292362), "test"),  # P5
            ((145209.663042, 361368.907155), "test"),  # P10
        ],
    }
    for name, places in at.items():
        found = region_of(np.array([xy for xy, _ in places]), load_split(name).boxes())
        assert found.tolist() == [region for _, region in places], name


def test_a_split_is_for_its_world_and_one_that_names_none_for_all(tmp_path: Path) -> None:
    assert load_split("nclt-opr").fits("NCLT local ENU")
    assert not load_split("nclt-opr").fits("UTM zone 30N")
    own = tmp_path / "own.yaml"
    own.write_text(SPLIT)
    assert load_split(own).fits("anywhere")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{SPLIT}gaurd_m: 3\n", "unknown key gaurd_m; did you mean guard_m"),
        (SPLIT.replace("test:", "tset:"), "regions are test"),
        (SPLIT.replace("30.0", "-30.0"), r"region 'test': .* is no \[xmin"),
        (SPLIT.replace("30.0", ".nan"), r"region 'test': .* is no \[xmin"),
        (SPLIT.replace(", 40.0", ""), "own.yaml"),
        (SPLIT.replace("10.0", "far"), "far"),
        (f"{SPLIT}guard_m: -3\n", "-3"),
        (SPLIT.replace("source: me\n", ""), "source"),
        ("- a list", "must hold"),
        ("{", "not readable"),
    ],
)
def test_a_file_that_is_no_split_is_refused_by_name(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(text)
    with pytest.raises(UserError, match=message) as caught:
        load_split(path)
    assert str(path) in str(caught.value)


def test_an_unknown_split_is_told_which_there_are(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"unknown split 'robotcar': choose from .*robotcar-boxes"):
        load_split("robotcar")
    with pytest.raises(UserError, match="no such"):
        load_split(tmp_path / "none.yaml")


def test_new_regions_take_the_place_of_the_old_ones_and_of_nothing_else(tmp_path: Path) -> None:
    info = DatasetInfo(
        name="n", version="1", source="s", licence="l", synthetic=True, regions=REGIONS
    )
    with DatasetWriter(tmp_path / "set", info) as writer:
        for run, t in (("b", 1), ("a", 2), ("a", 3)):
            writer.add_written(Frame(run=run, timestamp_us=t, position_m=(float(t), 0.0, 0.0)))
    before = open_dataset(tmp_path / "set")
    fingerprint = before.fingerprint
    line = {"test": [[620105.0, -np.inf, np.inf, np.inf]], "guard": [[0.0, 0.0, 1.0, 1.0]]}
    after = write_regions(before, line, "a line")
    assert after.info.regions == line
    assert list(after.info.regions) == ["test", "guard"]  # the first owns what both hold
    assert after.info.conventions.pop("regions") == "a line"
    assert replace(after.info, regions=REGIONS) == before.info
    assert [frame.key for frame in after.frames] == [frame.key for frame in before.frames]
    assert after.fingerprint != fingerprint
    names = sorted(path.name for path in (tmp_path / "set").iterdir())
    assert names == ["a", "b", "dataset.yaml"]
