# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from datetime import timedelta
from pathlib import Path

import lancedb
import numpy as np
import pyarrow as pa
import pytest

from adafusion.geometry import pose_from_xyz_yaw
from adafusion.mapping import MapHeader, PlaceMap, compact, info
from adafusion.types import Descriptions, Frame, UserError

HEADER = MapHeader(
    model="a",
    model_fingerprint="aaaa",
    preprocess_fingerprint="pppp",
    synthetic=True,
    world="campus 1",
)


def make_run(run: str = "day", n: int = 3, *, dim: int = 4, seed: int = 0) -> PlaceMap:
    """A run along x, 10 m a frame; of its first frame the position alone is known."""
    rng = np.random.default_rng(seed)
    frames = [
        Frame(
            run=run,
            timestamp_us=i,
            position_m=(10.0 * i, 1.0, 0.0),
            T_world_body=pose_from_xyz_yaw(10.0 * i, 1.0, 0.0, 0.1 * i) if i else None,
            zone="street" if i % 2 else None,
        )
        for i in range(n)
    ]
    fused, image, lidar, alpha = (
        rng.random((n, d), np.float32) for d in (dim, dim // 2, dim // 2, 2)
    )
    return PlaceMap.from_descriptions(
        frames,
        Descriptions(fused, image, lidar, alpha),
        header=HEADER,
        dataset="campus",
    )


def without_alpha(place_map: PlaceMap) -> PlaceMap:
    return replace(place_map, descriptions=place_map.descriptions._replace(alpha=None))


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_it_opens_what_was_saved(tmp_path: Path) -> None:
    saved = make_run()
    saved.save(tmp_path / "campus.map")
    opened = PlaceMap.open(tmp_path / "campus.map")

    assert opened.header == saved.header
    assert opened.keys == ("day/0", "day/1", "day/2")
    assert opened.datasets == ("campus",) * 3
    assert opened.zones == (None, "street", None)
    np.testing.assert_array_equal(opened.positions_m, saved.positions_m)
    np.testing.assert_array_equal(opened.T_map_body, saved.T_map_body)
    for ours, theirs in zip(opened.descriptions, saved.descriptions, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert opened.fingerprint == saved.fingerprint


def test_it_remembers_which_poses_are_unknown(tmp_path: Path) -> None:
    make_run().save(tmp_path / "campus.map")
    T_map_body = PlaceMap.open(tmp_path / "campus.map").T_map_body
    assert np.isnan(T_map_body[0]).all()
    np.testing.assert_array_equal(T_map_body[2], pose_from_xyz_yaw(20.0, 1.0, 0.0, 0.2))


def test_it_keeps_the_parts_a_system_does_not_have_as_none(tmp_path: Path) -> None:
    without_alpha(make_run()).save(tmp_path / "campus.map")
    opened = PlaceMap.open(tmp_path / "campus.map")
    assert opened.descriptions.alpha is None
    assert list(opened.parts) == ["fused", "image_half", "lidar_half"]


def test_it_appends_a_run_behind_the_others(tmp_path: Path) -> None:
    day, night = make_run("day"), make_run("night", seed=1)
    day.save(tmp_path / "campus.map")
    PlaceMap.append(tmp_path / "campus.map", night)
    both = PlaceMap.open(tmp_path / "campus.map")
    assert both.keys == day.keys + night.keys
    np.testing.assert_array_equal(both.descriptions.fused[3:], night.descriptions.fused)
    assert both.fingerprint not in (day.fingerprint, night.fingerprint)


def test_it_compacts_without_touching_the_content(tmp_path: Path) -> None:
    path = tmp_path / "campus.map"
    make_run("day").save(path)
    for i in range(4):
        PlaceMap.append(path, make_run(f"night{i}"))
    before = info(path)
    compact(path, keep=timedelta(milliseconds=1))
    after = info(path)
    assert (before.versions, after.versions) == (5, 1)
    assert after.bytes_on_disk < before.bytes_on_disk
    assert after.fingerprint == before.fingerprint
    assert len(list((path / "places.lance" / "data").iterdir())) == 1


def test_it_says_what_a_map_holds(tmp_path: Path) -> None:
    path = tmp_path / "campus.map"
    make_run("day", 3).save(path)
    PlaceMap.append(path, make_run("north/night", 2))
    told = info(path)
    assert told.places == 5
    assert told.runs == {"day": 3, "north/night": 2}
    assert told.datasets == ("campus",)
    assert told.dims == {"fused": 4, "image_half": 2, "lidar_half": 2, "alpha": 2}
    assert (told.lower_m, told.upper_m) == ((0.0, 1.0, 0.0), (20.0, 1.0, 0.0))
    assert told.versions == 2
    assert told.bytes_on_disk == sum(map(len, bytes_of(path).values()))
    assert json.loads(json.dumps(told.to_dict()))["header"]["model"] == "a"


@pytest.mark.parametrize(
    "use",
    [
        PlaceMap.open,
        info,
        compact,
        lambda path: PlaceMap.append(path, make_run()),
    ],
)
def test_it_creates_nothing_where_no_map_is(tmp_path: Path, use: Callable[[Path], object]) -> None:
    with pytest.raises(UserError, match=r"typo\.map: there is no such map"):
        use(tmp_path / "typo.map")
    assert list(tmp_path.iterdir()) == []


def test_it_refuses_what_is_no_map(tmp_path: Path) -> None:
    file, folder, table = tmp_path / "file.map", tmp_path / "folder.map", tmp_path / "table.map"
    file.write_text("hello")
    folder.mkdir()
    lancedb.connect(table).create_table("places", pa.table({"key": ["a"]}))
    before = bytes_of(table)
    for path in (file, folder, table):
        for use in (PlaceMap.open, info, compact):
            with pytest.raises(UserError, match=rf"{path.name} is not a map"):
                use(path)
    assert list(folder.iterdir()) == []
    assert bytes_of(table) == before


@pytest.mark.parametrize("lost", ["_versions", "data"])
def test_it_names_a_damaged_map(tmp_path: Path, lost: str) -> None:
    path = tmp_path / "campus.map"
    make_run().save(path)
    shutil.rmtree(path / "places.lance" / lost)
    with pytest.raises(UserError, match=r"campus\.map cannot be read .* restore it"):
        PlaceMap.open(path)


def test_it_names_a_map_cut_short(tmp_path: Path) -> None:
    make_run().save(tmp_path / "campus.map")
    (data,) = (tmp_path / "campus.map" / "places.lance" / "data").iterdir()
    data.write_bytes(data.read_bytes()[: data.stat().st_size // 2])
    with pytest.raises(UserError, match=r"campus\.map cannot be read .* restore it"):
        PlaceMap.open(tmp_path / "campus.map")


def test_it_refuses_a_format_it_does_not_know(tmp_path: Path) -> None:
    header = json.dumps({"format": 99, **asdict(make_run().header)})
    table = pa.table({"key": ["a"]}).replace_schema_metadata({"adafusion": header})
    lancedb.connect(tmp_path / "new.map").create_table("places", table)
    with pytest.raises(UserError, match=r"new\.map is a map of format 99"):
        PlaceMap.open(tmp_path / "new.map")


def test_it_saves_over_nothing(tmp_path: Path) -> None:
    path = tmp_path / "campus.map"
    make_run("day").save(path)
    before = bytes_of(path)
    with pytest.raises(UserError, match=r"campus\.map exists"):
        make_run("night").save(path)
    assert bytes_of(path) == before


def test_it_says_where_it_cannot_write(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(UserError, match=r"campus\.map cannot be written .*check free space"):
        make_run().save(tmp_path / "file" / "campus.map")


def test_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "lancedb", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'adafusion\[map\]'"):
        make_run().save(tmp_path / "campus.map")
    assert list(tmp_path.iterdir()) == []


def test_it_leaves_nothing_behind_when_saving_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def disk_full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "rename", disk_full)  # the last step, all is written
    with pytest.raises(UserError, match=r"campus\.map cannot be written .*No space left"):
        make_run().save(tmp_path / "campus.map")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (
            {"model": "b", "model_fingerprint": "bbbb"},
            "'b' do not fit: model fingerprint 'bbbb' instead of 'aaaa'",
        ),
        ({"preprocess_fingerprint": "qqqq"}, "preprocess fingerprint 'qqqq' instead of 'pppp'"),
        ({"synthetic": False}, "synthetic False instead of True"),
        ({"world": "campus 2"}, "world 'campus 2' instead of 'campus 1'"),
        ({"p": 2}, "p 2 instead of 1"),
    ],
)
def test_it_refuses_places_made_another_way(
    tmp_path: Path, changes: dict[str, object], reason: str
) -> None:
    path = tmp_path / "campus.map"
    make_run("day").save(path)
    before = bytes_of(path)
    night = make_run("night")
    with pytest.raises(UserError, match=rf"campus\.map is a map of model 'a', .*{reason}"):
        PlaceMap.append(path, replace(night, header=replace(night.header, **changes)))
    assert bytes_of(path) == before


def test_it_cares_about_what_a_model_computes_and_not_about_its_name(tmp_path: Path) -> None:
    path = tmp_path / "campus.map"
    make_run("day").save(path)
    night = make_run("night")
    PlaceMap.append(path, replace(night, header=replace(night.header, model="copy of a")))
    assert PlaceMap.open(path).header.model == "a"


@pytest.mark.parametrize("other", [without_alpha(make_run("night")), make_run("night", dim=8)])
def test_it_refuses_places_with_other_columns(tmp_path: Path, other: PlaceMap) -> None:
    path = tmp_path / "campus.map"
    make_run("day").save(path)
    before = bytes_of(path)
    with pytest.raises(UserError, match=r"do not fit: columns"):
        PlaceMap.append(path, other)
    assert bytes_of(path) == before


def test_it_refuses_a_place_it_has(tmp_path: Path) -> None:
    path = tmp_path / "campus.map"
    make_run("day", 3).save(path)
    before = bytes_of(path)
    with pytest.raises(UserError, match=r"3 places would be there twice, the first 'day/0'"):
        PlaceMap.append(path, make_run("day", 5))
    assert bytes_of(path) == before


def test_it_takes_one_writer_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "campus.map"
    make_run("day").save(path)

    def append(run: str) -> bool:
        try:
            PlaceMap.append(path, make_run(run, 50))
        except UserError:
            return False
        return True

    runs = ["dusk", "dusk", "dusk", "night"]
    with ThreadPoolExecutor(len(runs)) as pool:
        added = list(pool.map(append, runs))
    assert sum(added[:3]) == 1
    assert added[3]
    assert info(path).runs == {"day": 3, "dusk": 50, "night": 50}


def test_it_is_read_only_and_leaves_the_arrays_of_its_maker_alone() -> None:
    fused = np.ones((1, 2), np.float32)
    place_map = PlaceMap.from_descriptions(
        [Frame(run="day", timestamp_us=0, position_m=(0.0, 0.0, 0.0))],
        Descriptions(fused, None, None, None),
        header=HEADER,
        dataset="campus",
    )
    for array in (place_map.positions_m, place_map.T_map_body, *place_map.parts.values()):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0
    fused[:] = 7
    assert place_map.descriptions.fused is not None
    assert (place_map.descriptions.fused == 1).all()


def test_it_opens_read_only(tmp_path: Path) -> None:
    make_run().save(tmp_path / "campus.map")
    opened = PlaceMap.open(tmp_path / "campus.map")
    for array in (opened.positions_m, opened.T_map_body, *opened.parts.values()):
        assert not array.flags.writeable


@pytest.mark.parametrize(
    "changes",
    [
        {"zones": ("street",) * 3},
        {"datasets": ("other",) * 3},
        {"keys": ("day/7", "day/8", "day/9")},
        {"positions_m": np.zeros((3, 3))},
        {"T_map_body": np.full((3, 4, 4), np.nan)},
    ],
)
def test_it_fingerprints_everything_it_holds(changes: dict[str, object]) -> None:
    assert replace(make_run(), **changes).fingerprint != make_run().fingerprint


def test_it_refuses_parts_that_do_not_fit_together() -> None:
    good = make_run()
    with pytest.raises(UserError, match="the first 'day/0'"):
        replace(good, keys=("day/0", "day/0", "day/1"))
    with pytest.raises(ValueError, match="at least one place"):
        make_run(n=0)
    with pytest.raises(ValueError, match="3 keys"):
        replace(good, zones=(None,))
    with pytest.raises(ValueError, match="fused"):
        replace(good, descriptions=good.descriptions._replace(fused=None))
    broken = np.array(good.descriptions.lidar_half)
    broken[1, 0] = np.nan
    with pytest.raises(ValueError, match="lidar_half of day/1 is not finite"):
        replace(good, descriptions=good.descriptions._replace(lidar_half=broken))
    half_known = np.array(good.T_map_body)
    half_known[0, 0, 0] = 1.0
    with pytest.raises(ValueError, match="all NaN"):
        replace(good, T_map_body=half_known)
    with pytest.raises(ValueError, match="p 3"):
        replace(good.header, p=3)
