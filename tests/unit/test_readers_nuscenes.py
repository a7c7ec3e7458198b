# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The nuScenes reader on two scenes made by hand."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from adafusion.datasets import Dataset
from adafusion.datasets.recording import write_recording
from adafusion.readers.nuscenes.reader import read, recognises
from adafusion.readers.nuscenes.tables import read_table
from adafusion.types import UserError

START_US = 1_532_402_927_647_951
HALF = 0.5**0.5
SENSORS = {
    # right, forward, up of the LiDAR: turned right by a quarter against the body
    "LIDAR_TOP": ((0.9, 0.0, 1.84), (HALF, 0.0, 0.0, -HALF), []),
    # z ahead, x right, y down
    "CAM_FRONT": (
        (1.7, 0.0, 1.5),
        (0.5, -0.5, 0.5, -0.5),
        [[1266, 0, 816], [0, 1266, 491], [0, 0, 1]],
    ),
    "RADAR_FRONT": ((3.4, 0.0, 0.5), (1, 0, 0, 0), []),
}
SCENES = {"scene-0061": "singapore-onenorth", "scene-0103": "boston-seaport"}


def jpg(level: int) -> bytes:
    return cv2.imencode(".jpg", np.full((8, 12, 3), level, np.uint8))[1].tobytes()


def tables() -> dict[str, list[dict[str, Any]]]:
    """Three samples a scene, half a second and 5 m apart; images 12 ms before the scans."""
    made: dict[str, list[dict[str, Any]]] = {
        "log": [{"token": f"log-{place}", "location": place} for place in SCENES.values()],
        "scene": [
            {"token": f"s-{name}", "name": name, "log_token": f"log-{place}"}
            for name, place in SCENES.items()
        ],
        "sensor": [{"token": f"t-{name}", "channel": name} for name in SENSORS],
        "calibrated_sensor": [
            {
                "token": f"c-{name}",
                "sensor_token": f"t-{name}",
                "translation": list(t),
                "rotation": list(q),
                "camera_intrinsic": K,
            }
            for name, (t, q, K) in SENSORS.items()
        ],
        "sample": [],
        "sample_data": [],
        "ego_pose": [],
    }
    for scene in SCENES:
        for k in range(3):
            sample = f"{scene}-{k}"
            made["sample"].append({"token": sample, "scene_token": f"s-{scene}"})
            for sensor, early_us in (("LIDAR_TOP", 0), ("CAM_FRONT", 12_000), ("RADAR_FRONT", 0)):
                suffix = "jpg" if sensor == "CAM_FRONT" else "pcd.bin"
                for is_key_frame in (True, False):
                    token = f"{sample}-{sensor}-{is_key_frame}"
                    folder = "samples" if is_key_frame else "sweeps"
                    made["sample_data"].append(
                        {
                            "token": token,
                            "sample_token": sample,
                            "ego_pose_token": token,
                            "calibrated_sensor_token": f"c-{sensor}",
                            "filename": f"{folder}/{sensor}/{sample}.{suffix}",
                            "timestamp": START_US + 500_000 * k - early_us,
                            "is_key_frame": is_key_frame,
                        }
                    )
                    made["ego_pose"].append(
                        {
                            "token": token,
                            "translation": [400.0 + 5.0 * k - 1e-5 * early_us, 1100.0, 0.0],
                            "rotation": [1.0, 0.0, 0.0, 0.0],
                        }
                    )
    return made


def write_tables(src: Path, made: dict[str, list[dict[str, Any]]], **style: Any) -> None:
    (src / "v1.0-mini").mkdir(parents=True, exist_ok=True)
    for name, rows in made.items():
        (src / f"v1.0-mini/{name}.json").write_text(json.dumps(rows, **style))


@pytest.fixture
def src(tmp_path: Path) -> Path:
    src = tmp_path / "nuscenes"
    write_tables(src, tables(), indent=0)
    for row in tables()["sample_data"]:
        if row["is_key_frame"]:
            path = src / row["filename"]
            path.parent.mkdir(parents=True, exist_ok=True)
            # 10 m ahead, 3 m to the right, on the ground
            cloud = struct.pack("<5f", 3.0, 10.0 - 0.9, -1.84, 7.0, 3.0)
            path.write_bytes(jpg(50) if path.suffix == ".jpg" else cloud)
    return src


def prepare(src: Path, out: Path, **options: Any) -> Dataset:
    return write_recording(read(src, **options), out).dataset


def test_frames_have_the_time_and_pose_of_their_scans(src: Path, tmp_path: Path) -> None:
    dataset = prepare(src, tmp_path / "out")
    assert dataset.runs == ("scene-0061", "scene-0103")
    frames = [frame for frame in dataset.frames if frame.run == "scene-0103"]
    assert [f.timestamp_us - START_US for f in frames] == [0, 500_000, 1_000_000]
    assert [f.image_time_us for f in frames] == [f.timestamp_us - 12_000 for f in frames]
    np.testing.assert_allclose(
        [f.position_m for f in frames], [[400.0 + 5 * k, 1100.0, 0.0] for k in range(3)]
    )


def test_locations_are_put_apart_in_one_order_whatever_is_chosen(src: Path) -> None:
    for runs in (None, ["scene-0061"]):
        shot = next(shot for shot in read(src, runs=runs).shots if shot.frame.run == "scene-0061")
        assert shot.frame.position_m[0] == pytest.approx(200_400.0)  # the third of the locations
    assert read(src).info.world == read(src, runs=["scene-0061"]).info.world
    made = tables()
    made["log"][0]["location"] = "elsewhere"
    write_tables(src, made)
    (shot, *_) = read(src, runs=["scene-0061"]).shots
    assert shot.frame.position_m[0] == pytest.approx(400_400.0)
    assert read(src).info.world.endswith("singapore-queenstown, elsewhere")


def test_points_and_sensors_are_in_the_body_frame(src: Path, tmp_path: Path) -> None:
    dataset = prepare(src, tmp_path / "out")
    seen = dataset.load(dataset.frames[0])
    np.testing.assert_allclose(seen.points_body, [[10.0, -3.0, 0.0]], atol=1e-5)
    calibration = dataset.info.calibration["scene-0061"]
    T_body_camera = np.array(calibration["T_body_camera"])
    np.testing.assert_allclose(
        T_body_camera,
        [[0, 0, 1, 1.7], [-1, 0, 0, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]],
        atol=1e-12,
    )
    assert calibration["K"] == [[1266.0, 0.0, 816.0], [0.0, 1266.0, 491.0], [0.0, 0.0, 1.0]]
    name = dataset.frames[0].image
    assert name is not None
    assert name.endswith(".jpg")
    assert (dataset.root / name).read_bytes() == jpg(50)


def test_missing_files_are_borne_and_scenes_without_any_told(src: Path, tmp_path: Path) -> None:
    for path in src.glob("samples/*/scene-0103*"):
        path.unlink()
    (src / "samples/LIDAR_TOP/scene-0061-1.pcd.bin").unlink()
    (src / "samples/CAM_FRONT/scene-0061-2.jpg").unlink()
    recording = read(src)
    assert recording.notes == ["1 of 2 scenes have no files: left out"]
    frames = write_recording(recording, tmp_path / "out").dataset.frames
    assert [(f.image is None, f.cloud is None) for f in frames] == [
        (False, False),
        (False, True),
        (True, False),
    ]
    assert frames[1].timestamp_us == START_US + 500_000 - 12_000  # of the image, and its pose
    assert frames[1].position_m[0] == pytest.approx(200_404.88)
    with pytest.raises(UserError, match=r"no scene of .* has files"):
        read(src, runs=["scene-0103"])


def test_frames_are_thinned_by_travel(src: Path) -> None:
    assert read(src, every_m=8.0).total == 4


def test_the_layout_is_recognised_and_scenes_and_cameras_can_be_chosen(src: Path) -> None:
    assert recognises(src)
    assert not recognises(src / "v1.0-mini")
    with pytest.raises(UserError, match="no run 'x': choose from scene-0061, scene-0103"):
        read(src, runs=["x"])
    with pytest.raises(UserError, match="no camera LIDAR_TOP: choose from CAM_FRONT"):
        read(src, camera="LIDAR_TOP")
    (src / "v1.0-trainval").mkdir()
    (src / "v1.0-trainval/sample_data.json").write_text("[]")
    with pytest.raises(UserError, match=r"one folder v1\.0-\* .*v1\.0-mini, v1\.0-trainval"):
        read(src)


def test_a_table_is_read_a_record_at_a_time_however_it_is_laid_out(tmp_path: Path) -> None:
    rows = [{"token": str(i), "text": "]},{[" * 40, "list": [i, [i]]} for i in range(9000)]
    for style in ({}, {"indent": 2}, {"separators": (",", ":")}):
        path = tmp_path / "table.json"
        path.write_text(json.dumps(rows, **style))
        assert path.stat().st_size > 1 << 20  # more than one chunk
        assert list(read_table(path)) == rows
    path.write_text(" [ ] ")
    assert list(read_table(path)) == []


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "no list of records"),
        ("{}", "no list of records"),
        ("[1, 2]", "no list of records"),
        ('[{"token": "a"}, {"tok', "cut short or damaged after 1 records"),
        ('[{"token": "a"}', "cut short or damaged after 1 records"),
        ("[" + '{"a":' * 5000, "no list of records|cut short"),
        ('[{"token": ' + "1" * 5000 + "}]", "cut short or damaged"),
    ],
)
def test_a_damaged_table_is_named(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "scene.json"
    path.write_text(text)
    with pytest.raises(UserError, match=rf"scene\.json .*({told})"):
        list(read_table(path))


def change(table: str, row: int, **values: Any) -> Callable[[Path], None]:
    def damage(src: Path) -> None:
        made = tables()
        made[table][row] |= values
        write_tables(src, made)

    return damage


def test_an_image_of_another_kind_costs_its_frame_alone(src: Path) -> None:
    (src / "samples/CAM_FRONT/image.gif").write_bytes(b"GIF89a")
    rows = tables()["sample_data"]
    row = next(i for i, r in enumerate(rows) if "CAM_FRONT" in r["filename"] and r["is_key_frame"])
    change("sample_data", row, filename="samples/CAM_FRONT/image.gif")(src)
    told = []
    for shot in read(src).shots:
        try:
            assert shot.image is None or shot.image()
        except UserError as error:
            told.append(str(error))
    assert len(told) == 1
    assert "image.gif is no .png or .jpg" in told[0]


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (change("log", 0, token=None), r"log\.json: a record has no token"),
        (change("scene", 0, log_token="x"), r"scene\.json: the log of scene-0061 is not in"),
        (change("calibrated_sensor", 0, rotation=[1, 1, 0, 0]), "no unit quaternion"),
        (change("calibrated_sensor", 0, rotation=[1, 0, 0]), r"no rotation of \(4,\) numbers"),
        (change("calibrated_sensor", 0, translation=["x"] * 3), "no translation of"),
        (change("calibrated_sensor", 1, camera_intrinsic=[]), "no camera_intrinsic of"),
        (change("calibrated_sensor", 1, camera_intrinsic=[[0] * 3] * 3), "no projection"),
        (change("sample_data", 0, timestamp="now"), "no timestamp in microseconds"),
        (change("sample_data", 0, filename="../../etc/passwd"), "is no file below"),
        (change("sample_data", 0, filename="/etc/passwd"), "is no file below"),
        (change("sample_data", 0, ego_pose_token="x"), r"ego_pose\.json lacks 1 poses"),
        (change("ego_pose", 0, translation=[1e300, 0, 0]), "no rigid motion"),
        (lambda src: (src / "v1.0-mini/log.json").unlink(), r"log\.json is missing: fetch"),
    ],
)
def test_damaged_records_are_named(src: Path, damage: Callable[[Path], None], told: str) -> None:
    damage(src)
    with pytest.raises(UserError, match=told):
        read(src)
