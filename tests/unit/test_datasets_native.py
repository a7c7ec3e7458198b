# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from adafusion.datasets import sensor_files
from adafusion.datasets.native import Dataset, DatasetInfo, open_dataset
from adafusion.datasets.sensor_files import read_cloud, read_image, write_image, write_observation
from adafusion.datasets.writer import DatasetWriter
from adafusion.geometry import pose_from_xyz_yaw
from adafusion.types import Frame, Observation, UserError

INFO = DatasetInfo(
    name="toy",
    version="1",
    source="made by hand",
    licence="CC0-1.0",
    synthetic=True,
    calibration={"K": [[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]]},
    regions={"test": [[0.0, 0.0, 10.0, 10.0]]},
)


def frame_at(run: str, timestamp_us: int) -> Frame:
    x = float(timestamp_us)
    return Frame(
        run=run,
        timestamp_us=timestamp_us,
        position_m=(x, 2.0, 0.0),
        T_world_body=pose_from_xyz_yaw(x, 2.0, 0.0, 0.1 * x),
        zone="street",
    )


def seen(seed: int) -> Observation:
    rng = np.random.default_rng(seed)
    return Observation(
        image=rng.integers(0, 256, (6, 8, 3), dtype=np.uint8),
        points_body=rng.normal(size=(5, 3)).astype(np.float32),
    )


def write_toy(out: Path) -> Dataset:
    """Two runs of three frames; the last frame of `day` has no image, that of `night` no cloud."""
    with DatasetWriter(out, INFO) as writer:
        for run in ("night", "day"):
            for t in (2, 0, 1):
                writer.add(frame_at(run, t), without(run if t == 2 else "", seen(t)))
    return open_dataset(out)


def without(run: str, observation: Observation) -> Observation:
    return {
        "day": replace(observation, image=None),
        "night": replace(observation, points_body=None),
    }.get(run, observation)


@pytest.fixture
def toy(tmp_path: Path) -> Dataset:
    return write_toy(tmp_path / "toy")


# ------------------------------------------------------------------------------- written and read


def test_what_was_written_is_read(toy: Dataset) -> None:
    assert toy.info == INFO
    assert toy.runs == ("day", "night")
    assert [f.key for f in toy.frames] == [f"{run}/{t}" for run in toy.runs for t in (0, 1, 2)]
    for frame in toy.frames:
        expected = frame_at(frame.run, frame.timestamp_us)
        assert (frame.position_m, frame.zone) == (expected.position_m, "street")
        np.testing.assert_array_equal(frame.T_world_body, expected.T_world_body)
        here, there = toy.load(frame), seen(frame.timestamp_us)
        if here.image is not None:
            np.testing.assert_array_equal(here.image, there.image)
        if here.points_body is not None:
            np.testing.assert_array_equal(here.points_body, there.points_body)
    missing = [(f.image is None, f.cloud is None) for f in toy.frames]
    assert missing == [(False, False)] * 2 + [(True, False)] + [(False, False)] * 2 + [
        (False, True)
    ]


def test_positions_lie_row_by_row(toy: Dataset) -> None:
    assert toy.positions_m.tolist() == [[x, 2.0, 0.0] for x in (0.0, 1.0, 2.0) * 2]


def test_a_frame_may_know_its_position_only(tmp_path: Path) -> None:
    with DatasetWriter(tmp_path / "toy", INFO) as writer:
        writer.add(Frame(run="a", timestamp_us=0, position_m=(1.0, 2.0, 3.0)), seen(0))
        writer.add(frame_at("a", 1), seen(1))
    first, second = open_dataset(tmp_path / "toy").frames
    assert (first.position_m, first.T_world_body, first.zone) == ((1.0, 2.0, 3.0), None, None)
    assert second.T_world_body is not None


def test_an_encoded_image_is_kept_byte_for_byte(tmp_path: Path) -> None:
    jpeg = cv2.imencode(".jpg", np.full((6, 8, 3), 200, np.uint8))[1].tobytes()
    with DatasetWriter(tmp_path / "toy", INFO) as writer:
        name = write_image(writer.folder, "a", 7, jpeg, ".jpg")
        writer.add_written(replace(frame_at("a", 7), image=name))
    assert name == "a/images/7.jpg"
    assert (tmp_path / "toy" / name).read_bytes() == jpeg


def test_images_are_rgb_on_both_sides(tmp_path: Path) -> None:
    red = np.zeros((4, 4, 3), np.uint8)
    red[..., 0] = 255
    name = write_image(tmp_path, "a", 0, red)
    assert cv2.imread(str(tmp_path / name))[0, 0].tolist() == [0, 0, 255]  # OpenCV reads BGR
    assert read_image(tmp_path / name)[0, 0].tolist() == [255, 0, 0]


def test_the_same_data_gives_the_same_bytes_and_fingerprint(tmp_path: Path) -> None:
    one, two = write_toy(tmp_path / "one"), write_toy(tmp_path / "two")
    assert one.fingerprint == two.fingerprint
    for path in sorted(p for p in one.root.rglob("*") if p.is_file()):
        assert path.read_bytes() == (two.root / path.relative_to(one.root)).read_bytes()


def test_the_fingerprint_sees_a_file_that_grew_and_a_changed_manifest(toy: Dataset) -> None:
    image, manifest = toy.root / "day/images/0.png", toy.root / "dataset.yaml"
    before = toy.fingerprint
    image.write_bytes(image.read_bytes() + b"\0")
    grown = open_dataset(toy.root).fingerprint
    manifest.write_text(manifest.read_text().replace("made by hand", "made by Hand"))
    assert len({before, grown, open_dataset(toy.root).fingerprint}) == 3


# --------------------------------------------------------------------------- whole or not at all


def test_a_dataset_takes_its_name_only_when_whole(tmp_path: Path) -> None:
    out = tmp_path / "toy"
    with DatasetWriter(out, INFO) as writer:
        writer.add(frame_at("a", 0), seen(0))
        assert not out.exists()
        for path in (out, writer.folder):
            with pytest.raises(UserError, match="not finished"):
                open_dataset(path)
    assert [path.name for path in tmp_path.iterdir()] == ["toy"]


def test_a_failure_keeps_what_was_written_and_the_next_run_resumes(tmp_path: Path) -> None:
    out = tmp_path / "toy"

    def write(until: int) -> list[int]:
        written = []
        with DatasetWriter(out, INFO) as writer:
            for t in range(until):
                if writer.has("a", t):
                    frame = replace(frame_at("a", t), image=f"a/images/{t}.png")
                    writer.add_written(replace(frame, cloud=f"a/clouds/{t}.npy"))
                else:
                    writer.add(frame_at("a", t), seen(t))
                    written.append(t)
            if until < 4:
                (writer.folder / "a/images/.9.rest-of-a-killed-process.png").write_bytes(b"half")
                raise RuntimeError("power cut")
        return written

    with pytest.raises(RuntimeError):
        write(2)
    assert not out.exists()
    assert write(4) == [2, 3]
    assert len(open_dataset(out).frames) == 4
    assert not list(out.rglob(".*"))


def test_a_frame_is_there_only_with_all_that_is_asked_for(tmp_path: Path) -> None:
    with DatasetWriter(tmp_path / "toy", INFO) as writer:
        writer.add(frame_at("a", 0), without("night", seen(0)))
        assert writer.has("a", 0, cloud=False)
        assert not writer.has("a", 0)
        assert not writer.has("a", 1, cloud=False)


def test_an_existing_dataset_is_never_written_over(toy: Dataset) -> None:
    before = toy.fingerprint
    with pytest.raises(UserError, match=r"toy exists: choose another folder"):
        write_toy(toy.root)
    assert open_dataset(toy.root).fingerprint == before


def test_an_unfinished_dataset_of_other_settings_is_refused(tmp_path: Path) -> None:
    def fail(info: DatasetInfo) -> None:
        with DatasetWriter(tmp_path / "toy", info):
            raise RuntimeError("power cut")

    for _ in range(2):  # the same settings go on
        with pytest.raises(RuntimeError):
            fail(INFO)
    with pytest.raises(UserError, match=r"toy\.partial was begun with other settings: remove it"):
        fail(replace(INFO, source="made by another hand"))


def test_an_end_before_the_last_step_is_mended(toy: Dataset) -> None:
    before = toy.fingerprint
    toy.root.rename(f"{toy.root}.partial")  # all is written, only the name is not taken
    assert write_toy(toy.root).fingerprint == before


@pytest.mark.parametrize("place", ["blocked", "blocked/below"])
def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path, place: str) -> None:
    (tmp_path / "blocked").write_text("a file")
    with (
        pytest.raises(UserError, match="blocked"),
        DatasetWriter(tmp_path / place, INFO),
    ):
        pass


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux lends a full disk")
@pytest.mark.parametrize(
    "observation", [without("day", seen(0)), without("night", seen(0))], ids=["cloud", "image"]
)
def test_a_full_disk_is_told_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, observation: Observation
) -> None:
    @contextmanager
    def on_a_full_disk(path: Path) -> Iterator[Path]:
        yield Path("/dev/full")

    monkeypatch.setattr(sensor_files, "atomic_path", on_a_full_disk)
    with (
        pytest.raises(UserError, match=r"toy\.partial cannot be written \(No space.*free space"),
        DatasetWriter(tmp_path / "toy", INFO) as writer,
    ):
        writer.add(frame_at("a", 0), observation)


def test_a_dataset_without_frames_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no frame"), DatasetWriter(tmp_path / "toy", INFO):
        pass
    assert not (tmp_path / "toy").exists()


def test_mistakes_of_the_caller_are_refused_at_once(tmp_path: Path) -> None:
    with DatasetWriter(tmp_path / "toy", INFO) as writer:
        written = writer.add(frame_at("a", 0), seen(0))
        with pytest.raises(ValueError, match="a/0 is written twice"):
            writer.add_written(written)
        with pytest.raises(ValueError, match=r"a/images/1\.png, which nobody wrote"):
            writer.add_written(replace(frame_at("a", 1), image="a/images/1.png"))
        bad = ("", "..", ".hidden", "a/b", "a\\b", "a\nb", "a\udcff", "ü" * 101)
        for run in (*bad, "dataset.yaml", "Dataset.YAML", "skipped.txt"):
            with pytest.raises(UserError, match="cannot name a folder"):
                writer.add(frame_at(run, 2), seen(2))
        for points in (np.empty((0, 3), np.float32), np.full((1, 3), np.nan, np.float32)):
            with pytest.raises(ValueError, match="a/3 is empty or not finite"):
                write_observation(writer.folder, "a", 3, Observation(None, points))
        with pytest.raises(ValueError, match=r"suffix '\.gif'"):
            write_image(writer.folder, "a", 3, np.zeros((2, 2, 3), np.uint8), ".gif")


@pytest.mark.parametrize("box", [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, np.nan]])
def test_a_region_that_is_no_box_is_refused(box: list[float]) -> None:
    with pytest.raises(ValueError, match="region 'test'"):
        replace(INFO, regions={"test": [box]})


# ------------------------------------------------------------------------------- damage on disk


def edit_manifest(change: Callable[[dict], None]) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        path = root / "dataset.yaml"
        values = yaml.safe_load(path.read_text())
        change(values)
        path.write_text(yaml.safe_dump(values))

    return damage


def edit_table(**columns: list) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        path = root / "day/frames.parquet"
        table = pq.read_table(path)
        for name, values in columns.items():
            at, kind = table.schema.get_field_index(name), table.schema.field(name)
            table = table.set_column(at, kind, pa.array(values, kind.type))
        pq.write_table(table, path)

    return damage


def cut(name: str, keep: float = 0.5) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        data = (root / name).read_bytes()
        (root / name).write_bytes(data[: int(len(data) * keep)])

    return damage


MIRROR = np.diag([1.0, 1.0, -1.0, 1.0]).ravel().tolist()


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda root: (root / "dataset.yaml").unlink(), r"dataset\.yaml is missing"),
        (lambda root: (root / "dataset.yaml").write_text("a: ["), r"dataset\.yaml is no YAML"),
        (lambda root: (root / "dataset.yaml").write_text("7"), r"dataset\.yaml has no schema_ver"),
        (
            edit_manifest(lambda v: v.update(schema_version=2)),
            r"schema version 2.*update adafusion",
        ),
        (edit_manifest(lambda v: v.update(sensor={})), r"dataset\.yaml .*keys: sensor$"),
        (edit_manifest(lambda v: v.pop("licence")), r"dataset\.yaml .*keys: licence$"),
        (edit_manifest(lambda v: v.update(synthetic="no")), r"dataset\.yaml: synthetic is no bool"),
        (edit_manifest(lambda v: v.update(regions={"t": [[1]]})), r"dataset\.yaml: region 't'"),
        (edit_manifest(lambda v: v.update(regions={"t": [["a"]]})), r"dataset\.yaml: could not"),
        (edit_manifest(lambda v: v["runs"].update(day=None)), r"yaml: run day has None for a num"),
        (edit_manifest(lambda v: v["runs"].update(day=2)), r"day/frames\.parquet holds 3 .*says 2"),
        (edit_manifest(lambda v: v["runs"].update(dusk=3)), r"dusk/frames\.parquet is missing"),
        (lambda root: (root / "day/frames.parquet").unlink(), r"day/frames\.parquet is missing"),
        (cut("day/frames.parquet"), r"day/frames\.parquet is damaged"),
        (edit_table(timestamp_us=[0, 1, 1]), r"day/frames\.parquet: timestamps repeat"),
        (edit_table(x=[0.0, np.inf, 2.0]), r"day/frames\.parquet: a position is not finite"),
        (edit_table(x=[0.0, 5.0, 2.0]), r"day/frames\.parquet: positions and poses disagree"),
        (edit_table(T_world_body=[None, None, MIRROR]), r"T_world_body of frame 2 is no rigid"),
        (edit_table(image=["../a.png", None, None]), r"frames\.parquet: \.\./a\.png lies outside"),
        (lambda root: (root / "day/images/1.png").unlink(), r"day/images/1\.png is missing"),
        (lambda root: (root / "night/clouds/0.npy").unlink(), r"night/clouds/0\.npy is missing"),
    ],
)
def test_opening_names_the_file_at_fault(
    toy: Dataset, damage: Callable[[Path], None], told: str
) -> None:
    damage(toy.root)
    with pytest.raises(UserError, match=told):
        open_dataset(toy.root)


def test_a_dataset_shares_a_world_only_where_it_names_the_same(tmp_path: Path) -> None:
    def write(name: str, world: str) -> Dataset:
        with DatasetWriter(tmp_path / name, replace(INFO, world=world)) as writer:
            writer.add(frame_at("day", len(name)), seen(0))
        return open_dataset(tmp_path / name)

    assert write("a", "campus").world == write("bb", "campus").world == "campus"
    assert write("ccc", "").world != write("dddd", "").world
    assert open_dataset(tmp_path / "ccc").world == open_dataset(tmp_path / "ccc").world


def test_a_dataset_from_before_worlds_had_names_opens(toy: Dataset) -> None:
    edit_manifest(lambda v: v.pop("world"))(toy.root)
    opened = open_dataset(toy.root)
    assert opened.info == toy.info
    assert opened.world == f"{toy.info.name} {opened.fingerprint}"


def test_opening_what_is_not_there_makes_nothing(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"typo/dataset\.yaml is missing: give the folder"):
        open_dataset(tmp_path / "typo")
    assert not list(tmp_path.iterdir())


def save(points: np.ndarray) -> Callable[[Path], None]:
    return lambda root: np.save(root / "day/clouds/0.npy", points)


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (cut("day/images/0.png"), r"day/images/0\.png is damaged or cut short: replace"),
        (cut("day/images/0.png", 0), r"day/images/0\.png is damaged or cut short: replace"),
        (cut("day/clouds/0.npy", 0.9), r"day/clouds/0\.npy is damaged .*: replace"),
        (cut("day/clouds/0.npy", 0), r"day/clouds/0\.npy is damaged .*: replace"),
        (save(np.empty((0, 3), np.float32)), r"day/clouds/0\.npy holds no points: replace"),
        (save(np.full((2, 3), np.nan, np.float32)), r"0\.npy holds NaN or infinite points \(2\)"),
        (
            save(np.zeros((2, 4), np.float32)),
            r"float32 \(2, 4\), not float32 \(N, 3\): .* points\[:, :3\]\.astype\(np\.float32\)",
        ),
        (save(np.zeros((2, 3))), r"0\.npy holds float64 \(2, 3\), not float32 \(N, 3\)"),
        (save(np.array([{}])), r"0\.npy is damaged .*pickle"),
    ],
)
def test_loading_names_the_damaged_file(
    toy: Dataset, damage: Callable[[Path], None], told: str
) -> None:
    damage(toy.root)
    with pytest.raises(UserError, match=told):
        toy.load(toy.frames[0])


def test_an_image_cut_anywhere_is_refused(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (24, 24, 3), dtype=np.uint8)
    for suffix in (".png", ".jpg"):
        path = tmp_path / f"a{suffix}"
        data = cv2.imencode(suffix, picture)[1].tobytes()
        for length in range(0, len(data), 7):
            path.write_bytes(data[:length])
            with pytest.raises(UserError, match="damaged or cut short"):
                read_image(path)


def test_a_png_with_any_byte_changed_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    data = cv2.imencode(".png", np.arange(48, dtype=np.uint8).reshape(4, 4, 3))[1].tobytes()
    for at in range(len(data)):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :])
        with pytest.raises(UserError, match=r"is (damaged or cut short|no PNG)"):
            read_image(path)


def test_a_jpeg_may_be_padded(tmp_path: Path) -> None:
    jpeg = cv2.imencode(".jpg", np.full((6, 8, 3), 200, np.uint8))[1].tobytes()
    (tmp_path / "a.jpg").write_bytes(jpeg + b"\0" * 9)
    assert read_image(tmp_path / "a.jpg").shape == (6, 8, 3)


@pytest.mark.parametrize("read", [read_image, read_cloud])
def test_a_file_that_is_not_there_is_named(tmp_path: Path, read: Callable[[Path], object]) -> None:
    with pytest.raises(UserError, match=r"gone.* is missing"):
        read(tmp_path / "gone")


@pytest.fixture(params=["pipe", "device", "large"])
def no_file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """What blocks, never ends or fills the memory where it is read as a file."""
    path = tmp_path / "odd"
    if request.param == "large":
        with path.open("wb") as file:
            file.truncate(2**30 + 1)  # of which nothing is on disk
    elif not hasattr(os, "mkfifo"):
        pytest.skip("Windows has neither pipes nor devices among its files")
    elif request.param == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    return path


@pytest.mark.timeout(20)
@pytest.mark.parametrize("read", [read_image, read_cloud])
def test_only_a_regular_file_of_bounded_size_is_read(
    no_file: Path, read: Callable[[Path], object]
) -> None:
    with pytest.raises(UserError, match=r"odd .*(no regular file|larger than 1024 MB)"):
        read(no_file)


@pytest.mark.timeout(20)
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no pipes among its files")
def test_a_pipe_is_no_table_of_frames(toy: Dataset) -> None:
    table = toy.root / "day/frames.parquet"
    table.unlink()
    os.mkfifo(table)
    with pytest.raises(UserError, match=r"day/frames\.parquet is missing"):
        open_dataset(toy.root)
