# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Each fault is planted in a clean synthetic set, and the checks meant for it speak, alone."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from adafusion.datasets import Dataset, DatasetInfo, DatasetWriter, open_dataset, read_image
from adafusion.doctor import Diagnosis, examine
from adafusion.doctor.page import render
from adafusion.geometry import invert, pose, rotation_from_rpy
from adafusion.sim.simulate import simulate
from adafusion.types import Frame

SAMPLES = 24
FLIP = np.diag([1.0, -1.0, -1.0])  # half a turn about x: z up becomes z down


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    out = tmp_path_factory.mktemp("doctor") / "clean"
    return simulate(out, seed=5, runs=["day", "overcast"], profile="tiny", places=60)


@dataclass(frozen=True, kw_only=True)
class Fault:
    """How a set is spoilt, and the level of each check that must speak of it."""

    told: dict[str, str]
    frames: Callable[[int, Frame], list[Frame]] = lambda row, frame: [frame]
    info: Callable[[DatasetInfo], DatasetInfo] = lambda info: info
    image: Callable[[int, np.ndarray], np.ndarray | None] | None = None  # None: leave it
    cloud: Callable[[int, np.ndarray], np.ndarray | None] | None = None
    files: Callable[[Dataset], None] = lambda dataset: None
    every_frame: bool = False


def planted(clean: Dataset, out: Path, fault: Fault) -> Dataset:
    with DatasetWriter(out, fault.info(clean.info)) as writer:
        for run in clean.runs:
            shutil.copytree(clean.root / run, writer.folder / run)
        for row, frame in enumerate(clean.frames):
            for changed in fault.frames(row, frame):
                writer.add_written(changed)
    for row, frame in enumerate(clean.frames):
        if fault.image is not None:
            path = out / str(frame.image)
            if (image := fault.image(row, read_image(path))) is not None:
                write(path, image)
        if fault.cloud is not None:
            path = out / str(frame.cloud)
            if (points := fault.cloud(row, np.load(path))) is not None:
                np.save(path, points.astype(np.float32))
    dataset = open_dataset(out)
    fault.files(dataset)
    return dataset


def write(path: Path, image: np.ndarray) -> None:
    cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))


def told(diagnosis: Diagnosis) -> dict[str, str]:
    return {f.check: f.level for f in diagnosis.findings if f.level in ("warn", "fail")}


# ------------------------------------------------------------------------------ ways to spoil


def placed(frame: Frame, T: np.ndarray, T_ins: np.ndarray | None) -> Frame:
    x, y, z = T[:3, 3].tolist()
    return replace(frame, T_world_body=T, T_world_ins=T_ins, position_m=(x, y, z))


def moved(frame: Frame, x: float, y: float, z: float = 0.0) -> list[Frame]:
    """The frame elsewhere in the world."""
    shift = pose(np.eye(3), (x, y, z))
    return [placed(frame, shift @ frame.T_world_body, shift @ frame.T_world_ins)]


def turned(frame: Frame, R_body_new: np.ndarray) -> list[Frame]:
    """The frame with other axes of the body."""
    R, t = frame.T_world_body[:3, :3], frame.T_world_body[:3, 3]
    return [placed(frame, pose(R @ R_body_new, t), frame.T_world_ins)]


def inverted(row: int, frame: Frame) -> list[Frame]:
    R, t = frame.T_world_body[:3, :3], frame.T_world_body[:3, 3]
    return [placed(frame, pose(R.T, t), frame.T_world_ins)]


def strayed_ins(frame: Frame, metres: float) -> list[Frame]:
    shift = pose(np.eye(3), (metres, 0.0, 0.0))
    return [placed(frame, frame.T_world_body, shift @ frame.T_world_ins)]


def late(frame: Frame, *, image_ms: int = 0, cloud_ms: int = 0) -> list[Frame]:
    return [
        replace(
            frame,
            image_time_us=frame.timestamp_us + 1000 * image_ms,
            cloud_time_us=frame.timestamp_us + 1000 * cloud_ms,
        )
    ]


def waiting(row: int, frame: Frame) -> list[Frame]:
    """Half of the frames are taken twice, a second apart, at one place."""
    again = replace(frame, timestamp_us=frame.timestamp_us + 1_000_000)
    return [frame, again] if row % 2 else [frame]


def yaw(degrees: float) -> np.ndarray:
    return rotation_from_rpy(0.0, 0.0, float(np.deg2rad(degrees)))


def some(row: int) -> bool:
    return 10 <= row < 20


def noise(image: np.ndarray, high: int) -> np.ndarray:
    rng = np.random.default_rng(int(image[:9].sum()))  # another one for each image
    return rng.integers(0, high, image.shape, dtype=np.uint8)


def freeze(dataset: Dataset) -> None:
    for row in range(20, 30):
        shutil.copyfile(*(dataset.root / str(dataset.frames[k].image) for k in (19, row)))


def freeze_clouds(dataset: Dataset) -> None:
    for row in range(20, 30):
        shutil.copyfile(*(dataset.root / str(dataset.frames[k].cloud) for k in (19, row)))


def nearly_freeze(dataset: Dataset) -> None:
    """One scene, encoded anew each time with its own sensor noise."""
    stuck = read_image(dataset.root / str(dataset.frames[19].image)).clip(0, 250)
    for row in range(20, 30):
        path = dataset.root / str(dataset.frames[row].image)
        write(path, stuck + noise(read_image(path), 3))


def copy_run(dataset: Dataset) -> None:
    day, overcast = ([f for f in dataset.frames if f.run == run] for run in dataset.runs)
    for one, other in zip(day, overcast, strict=True):
        shutil.copyfile(dataset.root / str(one.image), dataset.root / str(other.image))


def cut(sensor: str) -> Callable[[Dataset], None]:
    def damage(dataset: Dataset) -> None:
        path = dataset.root / str(getattr(dataset.frames[7], sensor))
        path.write_bytes(path.read_bytes()[:-100])

    return damage


def regions(**boxes: list[float]) -> Callable[[DatasetInfo], DatasetInfo]:
    return lambda info: replace(info, regions={name: [box] for name, box in boxes.items()})


def calibrated(**values: object) -> Callable[[DatasetInfo], DatasetInfo]:
    return lambda info: replace(
        info, calibration={k: v for k, v in (info.calibration | values).items() if v is not None}
    )


def camera_inverted(info: DatasetInfo) -> DatasetInfo:
    T = invert(np.array(info.calibration["T_body_camera"]))
    return replace(info, calibration=info.calibration | {"T_body_camera": T.tolist()})


def camera_on_its_side(info: DatasetInfo) -> DatasetInfo:
    T = np.array(info.calibration["T_body_camera"])
    T[:3, :3] = T[:3, :3] @ yaw(90.0)  # about the optical axis
    return replace(info, calibration=info.calibration | {"T_body_camera": T.tolist()})


FAULTS: dict[str, Fault] = {
    # times
    "the camera's clock is 0.3 s late": Fault(
        told={"time sync": "warn"}, frames=lambda row, frame: late(frame, image_ms=300)
    ),
    "the camera's clock is 5 s late": Fault(
        told={"time sync": "fail"}, frames=lambda row, frame: late(frame, image_ms=5000)
    ),
    "both sensors are 5 s after the pose": Fault(
        told={"time sync": "fail"},
        frames=lambda row, frame: late(frame, image_ms=5000, cloud_ms=5000),
    ),
    "times are nanoseconds": Fault(
        told={"speed": "fail"},
        frames=lambda row, f: [replace(f, timestamp_us=f.timestamp_us * 1000)],
    ),
    "half of the frames are taken twice": Fault(told={"standing still": "warn"}, frames=waiting),
    # poses
    "a position is far off": Fault(
        told={"pose jumps": "warn"},
        frames=lambda row, frame: moved(frame, -60.0 * (row == 5), 0.0),
    ),
    "positions jump again and again": Fault(
        told={"pose jumps": "fail"},
        frames=lambda row, frame: moved(frame, 0.0, 0.0, 60.0 * (row % 12 == 5)),
    ),
    "rotations are inverted": Fault(
        told={"heading": "fail", "clouds and poses": "fail"}, frames=inverted
    ),
    "the body drives sideways": Fault(
        told={"heading": "fail", "clouds and poses": "fail"},
        frames=lambda row, frame: turned(frame, yaw(-90.0)),
    ),
    "the body drives backwards": Fault(
        told={"heading": "fail", "clouds and poses": "fail"},
        frames=lambda row, frame: turned(frame, yaw(180.0)),
    ),
    "the body looks 25 degrees aside": Fault(
        told={"heading": "warn", "clouds and poses": "fail"},
        frames=lambda row, frame: turned(frame, yaw(25.0)),
    ),
    "the body's z is down": Fault(
        told={"tilt": "fail", "clouds and poses": "warn"},
        frames=lambda row, frame: turned(frame, FLIP),
    ),
    "the INS is in another frame": Fault(
        told={"GPS/INS": "fail"}, frames=lambda row, frame: strayed_ins(frame, 500.0)
    ),
    "the INS is bad": Fault(
        told={"GPS/INS": "warn"}, frames=lambda row, frame: strayed_ins(frame, 15.0)
    ),
    # places
    "runs are in two frames": Fault(
        told={"overlap of runs": "warn"},
        frames=lambda row, frame: moved(frame, 0.0, 5000.0 * (frame.run == "day")),
    ),
    "there is one run": Fault(
        told={"overlap of runs": "warn"},
        frames=lambda row, frame: [frame] * (frame.run == "day"),
    ),
    "regions touch": Fault(
        told={"train/test leakage": "fail"},
        info=regions(test=[-200.0, -200.0, 200.0, 0.0]),
    ),
    "a region is empty": Fault(
        told={"regions": "warn"}, info=regions(test=[9000.0, 9000.0, 9001.0, 9001.0])
    ),
    # files
    "images are lost": Fault(
        told={"sensors": "warn"},
        frames=lambda row, frame: [replace(frame, image=None)] if some(row) else [frame],
    ),
    "orientations are lost": Fault(
        told={"sensors": "warn"},
        frames=lambda row, frame: [replace(frame, T_world_body=None)] if some(row) else [frame],
    ),
    "a run is a copy": Fault(told={"duplicates": "fail"}, files=copy_run),
    "the camera freezes": Fault(told={"frozen sensors": "warn"}, files=freeze),
    "the LiDAR freezes": Fault(told={"frozen sensors": "warn"}, files=freeze_clouds),
    "the camera freezes under noise": Fault(
        told={"frozen sensors": "warn"}, files=nearly_freeze, every_frame=True
    ),
    "an image is cut short": Fault(
        told={"readable files": "fail"}, files=cut("image"), every_frame=True
    ),
    "a cloud is cut short": Fault(
        told={"readable files": "fail"}, files=cut("cloud"), every_frame=True
    ),
    "a cloud has NaN": Fault(
        told={"readable files": "fail"},
        cloud=lambda row, points: points * np.nan if row == 3 else None,
        every_frame=True,
    ),
    "a cloud is empty": Fault(
        told={"readable files": "fail"},
        cloud=lambda row, points: points[:0] if row == 3 else None,
        every_frame=True,
    ),
    # images
    "images are of two sizes": Fault(
        told={"image size": "warn"},
        image=lambda row, image: cv2.resize(image, (110, 75)) if row < 8 else None,
    ),
    "images are halved and K is not": Fault(
        told={"intrinsics": "fail"}, image=lambda row, image: cv2.resize(image, (50, 37))
    ),
    "some images are black": Fault(
        told={"exposure": "warn"},
        image=lambda row, image: noise(image, 4) if some(row) else None,
        every_frame=True,
    ),
    "images are white": Fault(
        told={"exposure": "fail"}, image=lambda row, image: 255 - noise(image, 4)
    ),
    "images are blank": Fault(
        told={"exposure": "fail"}, image=lambda row, image: 90 + noise(image, 3)
    ),
    # clouds
    "some clouds are tiny": Fault(
        told={"cloud size": "warn"},
        cloud=lambda row, points: points[:50] if some(row) else None,
        every_frame=True,
    ),
    "clouds are scaled into [-1, 1]": Fault(
        told={"cloud scale": "fail"}, cloud=lambda row, points: points / 80
    ),
    "clouds are millimetres": Fault(
        told={"cloud scale": "fail"}, cloud=lambda row, points: points * 1000
    ),
    "clouds are in the world": Fault(
        told={"cloud scale": "fail"}, cloud=lambda row, points: points + 5e5
    ),
    "clouds are in the sensor's frame": Fault(
        told={"ground": "fail"}, cloud=lambda row, points: points - (0, 0, 1.8)
    ),
    "the LiDAR's height is 0.6 m too small": Fault(
        told={"ground": "warn"}, cloud=lambda row, points: points - (0, 0, 0.6)
    ),
    "the LiDAR's height is 0.6 m too large": Fault(
        told={"ground": "warn"}, cloud=lambda row, points: points - (0, 0, -0.6)
    ),
    "the LiDAR's height is 0.15 m too small": Fault(  # nearly as much as slopes do
        told={}, cloud=lambda row, points: points - (0, 0, 0.15)
    ),
    "clouds are upside down": Fault(
        told={"ground": "fail"}, cloud=lambda row, points: points @ FLIP
    ),
    "clouds look back": Fault(
        told={"clouds and poses": "fail"}, cloud=lambda row, points: points @ yaw(180.0).T
    ),
    "clouds are mirrored": Fault(
        told={"clouds and poses": "warn"}, cloud=lambda row, points: points * (1, -1, 1)
    ),
    "clouds lie outside the box": Fault(
        told={"voxel grid": "fail"}, cloud=lambda row, points: points - (-100, 0, 0)
    ),
    # calibration
    "the camera's pose is inverted": Fault(told={"camera pose": "warn"}, info=camera_inverted),
    "the camera has the axes of the body": Fault(
        told={"camera pose": "warn", "projection": "fail"},
        info=calibrated(T_body_camera=pose(np.eye(3), (0.4, 0.0, 1.6)).tolist()),
    ),
    "the camera lies on its side": Fault(told={"camera pose": "warn"}, info=camera_on_its_side),
}


def test_a_clean_set_is_clean(clean: Dataset) -> None:
    diagnosis = examine(clean, samples=SAMPLES)
    assert told(diagnosis) == {}
    assert diagnosis.level == "ok"
    assert len(diagnosis.looks) < len(clean.frames)


@pytest.mark.parametrize("name", FAULTS)
def test_a_planted_fault_is_found_and_nothing_else(
    clean: Dataset, tmp_path: Path, name: str
) -> None:
    fault = FAULTS[name]
    dataset = planted(clean, tmp_path / "spoilt", fault)
    diagnosis = examine(dataset, samples=None if fault.every_frame else SAMPLES)
    assert told(diagnosis) == fault.told
    for finding in diagnosis.findings:
        if finding.check in fault.told:
            assert finding.why
            assert finding.remedy


def test_what_the_data_do_not_say_is_skipped_and_not_called_right(
    clean: Dataset, tmp_path: Path
) -> None:
    bare = Fault(
        told={},
        info=lambda info: replace(
            calibrated(K=None)(info), regions={}, sensors={"cloud_unit": "normalised: no metre"}
        ),
        frames=lambda row, f: [replace(f, T_world_body=None, T_world_ins=None)],
        cloud=lambda row, points: points / 80,
    )
    diagnosis = examine(planted(clean, tmp_path / "bare", bare), samples=SAMPLES)
    assert told(diagnosis) == {}
    skipped = {f.check for f in diagnosis.findings if f.level == "skip"}
    assert skipped == {
        *("time sync", "heading", "tilt", "GPS/INS", "clouds and poses"),
        *("regions", "train/test leakage", "cloud scale", "ground", "voxel grid"),
        *("intrinsics", "camera pose", "projection"),
    }


def test_a_set_without_a_camera_is_not_told_to_look_for_images(
    clean: Dataset, tmp_path: Path
) -> None:
    blind = Fault(told={}, frames=lambda row, frame: [replace(frame, image=None)])
    finding = examine(planted(clean, tmp_path / "blind", blind), samples=2).findings[0]
    assert (finding.check, finding.level) == ("sensors", "warn")
    assert "--slop-ms" not in finding.remedy
    assert "--model lidar-s" in finding.remedy


def test_the_same_seed_opens_the_same_frames_and_every_frame_can_be_asked_for(
    clean: Dataset,
) -> None:
    rows = [[k.row for k in examine(clean, samples=10, seed=s).looks] for s in (1, 1, 2)]
    assert rows[0] == rows[1] != rows[2]
    assert len(examine(clean, samples=None).looks) == len(clean.frames)


def test_the_page_shows_suspects_and_tells_what_cannot_be_shown(
    clean: Dataset, tmp_path: Path
) -> None:
    dataset = planted(clean, tmp_path / "spoilt", FAULTS["an image is cut short"])
    page = render(examine(dataset, samples=None))
    assert f"{dataset.frames[7].image} is damaged or cut short" in page
    assert "fail: readable files" in page
    assert "SYNTHETIC" in page
    assert page.count("The cloud projected onto the image") >= 5
    assert "--html" not in page
    assert "http" not in page.replace("http://www.w3.org/", "").replace("https://www.w3.org/", "")
