# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A benchmark made by hand: two runs, a few submaps, raw and prepared images."""

from __future__ import annotations

import pickle
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from adafusion.config import load_config
from adafusion.datasets.recording import Recording, write_recording
from adafusion.datasets.splits import region_of
from adafusion.preprocess.voxels import voxelize
from adafusion.readers.pointnetvlad import LAYOUTS, read, read_picture, read_submap, recognises
from adafusion.training.settings import TrainConfig
from adafusion.types import UserError

A, B = "2014-05-19-13-20-57", "2015-08-13-16-02-58"
START = 1400505894395159


def encode_submap(points: list[tuple[float, float, float]]) -> bytes:
    """4096 points, those given over and over."""
    rows = [points[k % len(points)] for k in range(4096)]
    return b"".join(struct.pack("<3d", *row) for row in rows)


def add_run(
    folder: Path, layout: str = "20m_10overlap", *, times: tuple[int, ...], north: float = 5735000.0
) -> None:
    """A run whose k-th submap lies 10 m further north than the last one."""
    where = LAYOUTS[layout]
    (folder / where.folder).mkdir(parents=True, exist_ok=True)
    lines = ["timestamp,northing,easting"]
    for k, time_us in enumerate(times):
        (folder / where.folder / f"{time_us}.bin").write_bytes(encode_submap([(0.5, 0.25, -0.125)]))
        lines.append(f"{time_us},{north + 10 * k:.6f},{620000.5:.6f}")
    (folder / where.table).write_text("\n".join(lines) + "\n")


def add_picture(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


GBRG = np.tile(np.array([[100, 50], [200, 100]], np.uint8), (4, 6))  # of one colour: 200, 100, 50
PREPARED = np.full((6, 8, 3), (50, 100, 200), np.uint8)  # the same, as OpenCV orders it


@pytest.fixture
def benchmark(tmp_path: Path) -> Path:
    root = tmp_path / "benchmark_datasets"
    add_run(root / "oxford" / A, times=(START, START + 2_000_000, START + 4_000_000))
    add_run(root / "oxford" / B, times=(START + 10**12,), north=5736000.0)
    return root


def keys(recording: Recording) -> list[str]:
    return [shot.frame.key for shot in recording.shots]


# ---------------------------------------------------------------------------------------- submaps


def test_a_submap_is_turned_forward_left_up(tmp_path: Path) -> None:
    path = tmp_path / "1.bin"
    path.write_bytes(encode_submap([(0.5, 0.25, -0.125), (-1.0, 0.0, 1.0)]))
    points = read_submap(path)
    assert (points.shape, points.dtype) == ((4096, 3), np.float32)
    # stored is back, left, up: 0.5 back is -0.5 forward
    np.testing.assert_array_equal(points[:2], [[-0.5, 0.25, -0.125], [1.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (encode_submap([(0, 0, 0)])[:-1], "98303 bytes, a submap 98304"),
        (encode_submap([(0, 0, 0)]) + b"\0" * 24, "98328 bytes"),
        (b"", "0 bytes"),
        (encode_submap([(0, 0, float("nan"))]), r"outside of \[-1, 1\]"),
        (encode_submap([(0, 1e300, 0)]), r"outside of \[-1, 1\]"),
        (encode_submap([(0, -float("inf"), 0)]), r"outside of \[-1, 1\]"),
    ],
)
def test_a_damaged_submap_is_refused_by_name(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "1400505894395159.bin"
    path.write_bytes(data)
    with pytest.raises(UserError, match=rf"1400505894395159\.bin .*{message}"):
        read_submap(path)


# ----------------------------------------------------------------------------------- the benchmark


def test_frames_have_the_submaps_time_and_place(benchmark: Path, tmp_path: Path) -> None:
    recording = read(benchmark)
    assert recording.total == 4
    dataset = write_recording(recording, tmp_path / "out").dataset
    assert dataset.runs == (A, B)
    second = dataset.frames[1]
    assert second.key == f"{A}/{START + 2_000_000}"
    assert second.position_m == (620000.5, 5735010.0, 0.0)  # x is east, y north
    assert (second.T_world_body, second.image, second.image_time_us) == (None, None, None)
    np.testing.assert_array_equal(dataset.load(second).points_body[0], (-0.5, 0.25, -0.125))
    assert dataset.world == "UTM zone 30N"
    assert dataset.info.synthetic is False
    assert dataset.info.sensors["cloud_unit"].startswith("normalised: 1 is not a metre")
    assert dataset.info.conventions["image"] == "RGB, not undistorted"
    assert "no images" in dataset.info.source


def test_the_folder_above_and_the_part_itself_will_do(benchmark: Path) -> None:
    for src in (benchmark, benchmark.parent, benchmark / "oxford"):
        assert recognises(src)
        assert read(src).total == 4
    assert not recognises(benchmark / "oxford" / A)
    assert not recognises(benchmark / "none")


@pytest.mark.parametrize("layout", ["20m", "25m_10", "25m_25"])
def test_other_submaps_are_read_when_asked_for(benchmark: Path, layout: str) -> None:
    part = LAYOUTS[layout].part
    add_run(benchmark / part / "business_run1", layout, times=(7, 8))
    recording = read(benchmark, lidar=layout)
    assert keys(recording) == ["business_run1/7", "business_run1/8"]
    assert layout in recording.info.source
    assert (recording.info.world == "UTM zone 30N") == (part == "oxford")


def test_only_in_house_submaps_are_found_without_asking(tmp_path: Path) -> None:
    add_run(tmp_path / "inhouse_datasets" / "run1", "25m_25", times=(7,))
    assert keys(read(tmp_path)) == ["run1/7"]


def test_runs_can_be_chosen(benchmark: Path) -> None:
    assert keys(read(benchmark, runs=[B])) == [f"{B}/{START + 10**12}"]
    with pytest.raises(UserError, match=rf"no run 'noon': choose from {A}, {B}"):
        read(benchmark, runs=["noon"])


def test_rows_without_a_file_and_rows_twice_are_left_out_and_noted(benchmark: Path) -> None:
    run = benchmark / "oxford" / A
    (run / "pointcloud_20m_10overlap" / f"{START}.bin").unlink()
    table = run / "pointcloud_locations_20m_10overlap.csv"
    table.write_text(table.read_text() + f"{START + 2_000_000},1,1\n")
    recording = read(benchmark, runs=[A])
    assert keys(recording) == [f"{A}/{START + 2_000_000}", f"{A}/{START + 4_000_000}"]
    (note,) = recording.notes
    assert note.startswith("2 of 4 rows")
    assert str(table) in note


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("../../etc/passwd,1,1", "line 2 has '../../etc/passwd' for a time"),
        ("1400505894395159.0,1,1", "line 2 has '1400505894395159.0' for a time"),
        ("-5,1,1", "line 2 has '-5'"),
        ("99999999999999999999,1,1", "line 2"),
        ("5,north,1", "line 2 has 'north' for a number"),
        ("5,1,nan", "line 2 has 'nan'"),
        ("5,1", "line 2 has 2 fields"),
    ],
)
def test_a_bad_table_is_refused_by_line(benchmark: Path, row: str, message: str) -> None:
    table = benchmark / "oxford" / A / "pointcloud_locations_20m_10overlap.csv"
    table.write_text(f"timestamp,northing,easting\n{row}\n")
    with pytest.raises(UserError, match=rf"20m_10overlap\.csv: {message}"):
        read(benchmark)


def test_what_is_not_there_is_said(benchmark: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"has no oxford/<run>/.* give the folder"):
        read(tmp_path / "none")
    with pytest.raises(UserError, match=r"has no inhouse_datasets/<run>/pointcloud_centroids_25"):
        read(benchmark, lidar="25m_25")
    with pytest.raises(UserError, match="unknown lidar '30m': choose from 20m_10overlap"):
        read(benchmark, lidar="30m")


def test_the_synthetic_world_is_never_called_real(benchmark: Path) -> None:
    source = read(benchmark).info.source
    (benchmark / "manifest.json").write_text('{"synthetic": true}')
    for src in (benchmark, benchmark.parent, benchmark / "oxford"):
        info = read(src).info
        assert (info.name, info.synthetic) == ("synthetic world in pointnetvlad layout", True)
        assert info.world == ""
        assert info.source.endswith(source)


def test_submaps_that_its_lists_name_and_that_lack_are_noted(benchmark: Path) -> None:
    there = f"oxford/{A}/pointcloud_20m_10overlap/{START}.bin"
    query = {"query": there, "northing": 1.0, "easting": 1.0}
    sets = [{0: query, 1: {**query, "query": f"oxford/{A}/pointcloud_20m/1.bin"}}]
    path = benchmark / "oxford_evaluation_database.pickle"
    path.write_bytes(pickle.dumps(sets))
    train = {0: {"query": there, "positives": [], "negatives": []}}
    (benchmark / "training_queries_baseline.pickle").write_bytes(pickle.dumps(train))
    assert read(benchmark).notes == [f"1 of the 2 submaps that {path} names are not here"]
    path.write_bytes(b"no pickle")
    (note,) = read(benchmark).notes
    assert f"{path} is damaged" in note


# ----------------------------------------------------------------------------------------- images


def test_a_raw_image_is_demosaiced_and_a_prepared_one_kept(tmp_path: Path) -> None:
    add_picture(tmp_path / "raw.png", GBRG)
    add_picture(tmp_path / "prepared.png", PREPARED)
    raw = read_picture(tmp_path / "raw.png", cv2.COLOR_BayerGBRG2RGB)
    assert (raw.shape, raw.dtype) == ((8, 12, 3), np.uint8)
    assert (raw == (200, 100, 50)).all()  # red, green, blue
    kept = read_picture(tmp_path / "prepared.png", cv2.COLOR_BayerGBRG2RGB)
    assert kept == (tmp_path / "prepared.png").read_bytes()


@pytest.mark.parametrize("prepared", [True, False])
def test_the_image_nearest_in_time_is_joined(
    benchmark: Path, tmp_path: Path, prepared: bool
) -> None:
    images = tmp_path / "images"
    folder = images / A if prepared else images / A / "stereo" / "centre"
    for late_us in (-400_000, 300_000, 2_000_000, 5_100_000):
        add_picture(folder / f"{START + late_us}.png", PREPARED if prepared else GBRG)
    recording = read(benchmark, images=images)
    frames = [shot.frame for shot in recording.shots]
    assert [frame.timestamp_us - START for frame in frames] == [0, 2_000_000]
    assert [frame.image_time_us for frame in frames] == [START + 300_000, None]  # None: the same
    assert recording.notes == [
        f"{A}: 1 of 3 submaps have no image within 1000 ms: left out",
        f"{B}: 1 of 1 submaps have no image within 1000 ms: left out",
    ]
    written = write_recording(read(benchmark, images=images, slop_ms=1100.0), tmp_path / "out")
    dataset = written.dataset
    assert len(dataset.frames) == 3
    assert (dataset.load(dataset.frames[2]).image == (200, 100, 50)).all()
    assert f"stereo/centre within 1100 ms, images {images}" in dataset.info.source


@pytest.mark.parametrize("beside_images", [True, False])
def test_minklocs_list_says_which_image_is_nearest(
    benchmark: Path, tmp_path: Path, beside_images: bool
) -> None:
    images = tmp_path / "images"
    for late_us in (0, 60_000, -70_000):
        add_picture(images / A / f"{START + late_us}.png", PREPARED)
    # the list passes over an image of the very time of the submap; the first it names is not there
    listed = {START: [START + 50_000, START + 60_000, START - 70_000]}
    where = (images if beside_images else benchmark) / "lidar2image_ndx.pickle"
    where.write_bytes(pickle.dumps(listed))
    shot = next(iter(read(benchmark, runs=[A], images=images).shots))
    assert shot.frame.image_time_us == START + 60_000


def test_missing_images_are_said(benchmark: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=rf"stereo/centre/<time>\.png and no .* of {A}"):
        read(benchmark, images=tmp_path / "none")
    with pytest.raises(UserError, match="unknown camera 'front'"):
        read(benchmark, images=tmp_path, camera="front")
    with pytest.raises(UserError, match=r"unknown camera 'stereo/../..'"):
        read(benchmark, images=tmp_path, camera="stereo/../..")
    add_picture(tmp_path / "images" / A / f"{START + 10**9}.png", PREPARED)
    with pytest.raises(UserError, match="no image lies within 1000 ms of any submap"):
        read(benchmark, images=tmp_path / "images")


def test_a_cut_image_is_refused_by_name(tmp_path: Path) -> None:
    add_picture(tmp_path / "raw.png", GBRG)
    (tmp_path / "raw.png").write_bytes((tmp_path / "raw.png").read_bytes()[:-20])
    with pytest.raises(UserError, match=r"raw\.png"):
        read_picture(tmp_path / "raw.png", cv2.COLOR_BayerGBRG2RGB)


# ------------------------------------------------------------------------- the paper's settings


def test_the_papers_grid_has_the_cells_of_the_released_code() -> None:
    path = Path(__file__).parents[2] / "configs" / "paper-oxford.yaml"
    grid = load_config(TrainConfig, path).model.preprocess.voxels
    stored = np.random.default_rng(0).uniform(-1, 1, (4096, 3)).astype(np.float32)
    ours = voxelize(stored * np.array((-1, 1, 1), np.float32), grid)
    # released: axes (-y, -x, z) of what is stored, right, forward, up, in a box of 72 x 72 x 48
    right_forward_up = np.column_stack([-stored[:, 1], -stored[:, 0], stored[:, 2]])
    lower, upper = np.array([(-0.8, -0.4, -0.2), (0.8, 0.4, 0.4)])
    shape = np.array([72, 72, 48])
    cell = np.floor((right_forward_up - lower) * shape / (upper - lower)).astype(int)
    inside = cell[((cell >= 0) & (cell < shape)).all(axis=1)]
    theirs = np.zeros(shape, bool)
    theirs[tuple(inside.T)] = True
    assert theirs.sum() > 300
    np.testing.assert_array_equal(ours, theirs[::-1].transpose(1, 0, 2))  # right is minus left


def test_the_published_boxes_hold_the_queries_of_the_evaluation(benchmark: Path) -> None:
    north, east = 5735712.768124, 620084.402381  # P1, squares of half-width 150 m
    box = [east - 150, north - 150, east + 150, north + 150]
    positions = np.array([shot.frame.position_m for shot in read(benchmark).shots])
    positions[:, 1] += 570.0  # the first run begins 142.8 m south of P1
    assert region_of(positions[:, :2], {"test": [box]}).tolist() == ["test"] * 3 + ["train"]
