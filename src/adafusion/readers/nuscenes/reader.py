# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""nuScenes (Caesar et al., CVPR 2020): keyframes of its scenes, one camera and the roof LiDAR.

    <src>/v1.0-*/{scene,sample,sample_data,ego_pose,calibrated_sensor,sensor,log}.json
    <src>/samples/CAM_FRONT/*.jpg
    <src>/samples/LIDAR_TOP/*.pcd.bin       float32 x y z intensity ring; x right, y forward, z up

After the schema of its development kit. The ego frame is the middle of the rear axle, on the
ground, x forward, y left, z up: it is our body frame. Quaternions are w x y z, times microseconds.
A frame has the time and the pose of its scan, z of which is always 0; the image was taken some
milliseconds before or after. Each location has a map of its own: they are put apart along x, in
one fixed order, so that two locations never seem to be one place.

Tables are read a record at a time, and of the 2.6 million rows of sensor data only those of the
keyframes of two sensors are kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from adafusion.datasets.native import CONVENTIONS, DatasetInfo
from adafusion.datasets.recording import Recording, Shot
from adafusion.datasets.sensor_files import IMAGE_SUFFIXES
from adafusion.readers.calibration import is_camera_matrix
from adafusion.readers.nuscenes.tables import motion, numbers, read_table, word
from adafusion.readers.runs import choose_runs, matches
from adafusion.readers.sensors import encoded_image, read_xyz, to_body
from adafusion.readers.text import path_inside
from adafusion.readers.track import keyframes
from adafusion.types import Frame, UserError

LIDAR = "LIDAR_TOP"
LOCATION_SPACING_M = 100_000.0
LOCATIONS = (
    "boston-seaport",
    "singapore-hollandvillage",
    "singapore-onenorth",
    "singapore-queenstown",
)

_RECORD_BYTES = 20  # float32 x y z intensity ring
_FETCH = "fetch the metadata of nuScenes again"


def recognises(src: Path) -> bool:
    """Whether `src` holds the tables of nuScenes."""
    return matches(src, "v1.0-*/sample_data.json", "v1.0-*/scene.json")


def read(
    src: str | Path,
    *,
    runs: Sequence[str] | None = None,
    every_m: float = 0.0,
    camera: str = "CAM_FRONT",
) -> Recording:
    """Read the tables of nuScenes, one run a scene, as "scene-0061".

    Keyframes come at 2 Hz. A scene whose files are not there (each part of the download has some)
    is left out; a frame is kept if its scan or its image is there.
    """
    src = Path(src)
    folders = sorted(path.parent for path in src.glob("v1.0-*/sample_data.json"))
    if len(folders) != 1:
        found = ", ".join(path.name for path in folders) or "none"
        raise UserError(f"{src} must hold one folder v1.0-* with tables ({found} is there)")
    tables = folders[0]
    sensors = _read_sensors(tables, camera)
    scenes, places = _read_scenes(src, tables, runs)
    _read_keyframes(src, tables, sensors, scenes)
    there = [scene for scene in scenes if scene.clouds or scene.images]
    if not there:
        raise UserError(f"no scene of {src} has files in samples/{LIDAR} or samples/{camera}")
    notes = []
    if len(there) < len(scenes):
        notes.append(f"{len(scenes) - len(there)} of {len(scenes)} scenes have no files: left out")
    poses = _read_poses(tables, {seen.pose for scene in there for seen in scene.frames()})
    frames = {scene.run: _place(scene, poses, places, every_m) for scene in there}
    thinned = f", a frame every {every_m:g} m" if every_m > 0 else ""
    info = DatasetInfo(
        name="nuscenes",
        version=tables.name,
        source=f"nuScenes (Caesar et al., CVPR 2020), keyframes, {camera}{thinned}",
        licence="CC BY-NC-SA 4.0",
        synthetic=False,
        world=f"nuScenes, {LOCATION_SPACING_M:.0f} m apart along x: {', '.join(places)}",
        sensors={"camera": camera, "lidar": f"{LIDAR}: 32 beams, on the roof"},
        calibration={scene.run: _calibration(scene, sensors) for scene in there},
        conventions={
            **CONVENTIONS,
            "world": f"z = 0 everywhere; the maps of locations {LOCATION_SPACING_M:.0f} m apart",
        },
    )
    return Recording(
        info=info,
        shots=(shot for scene in there for shot in _shots(scene, frames[scene.run], sensors)),
        total=sum(map(len, frames.values())),
        notes=notes,
    )


class _Sensor(NamedTuple):
    """One of the two sensors as it was mounted for some drives."""

    channel: str
    T_body_sensor: Float64[np.ndarray, "4 4"]
    K: Float64[np.ndarray, "3 3"] | None


class _Seen(NamedTuple):
    """A file of one of the two sensors at a keyframe."""

    path: Path
    time_us: int
    pose: str  # tokens
    sensor: str


@dataclass(frozen=True)
class _Scene:
    """One scene: what each sensor saw at its keyframes, by their tokens."""

    run: str
    location: str
    clouds: dict[str, _Seen] = field(default_factory=dict)
    images: dict[str, _Seen] = field(default_factory=dict)

    def frames(self) -> list[_Seen]:
        """What gives each frame its time and pose, by time: the scan, else the image."""
        return sorted({**self.images, **self.clouds}.values(), key=lambda seen: seen.time_us)


def _read_sensors(tables: Path, camera: str) -> dict[str, _Sensor]:
    """Mounted sensors of the two channels, by token."""
    path = tables / "sensor.json"
    channels = {word(r, "token", path): word(r, "channel", path) for r in read_table(path)}
    cameras = sorted({name for name in channels.values() if name.startswith("CAM")})
    if camera not in cameras:
        raise UserError(f"{path} has no camera {camera}: choose from {', '.join(cameras)}")
    sensors = {}
    path = tables / "calibrated_sensor.json"
    for record in read_table(path):
        channel = channels.get(word(record, "sensor_token", path))
        if channel in (camera, LIDAR):
            K = numbers(record, "camera_intrinsic", path, (3, 3)) if channel == camera else None
            if K is not None and not is_camera_matrix(K):
                raise UserError(f"{path}: camera_intrinsic of {channel} is no projection: {_FETCH}")
            sensors[word(record, "token", path)] = _Sensor(channel, motion(record, path), K)
    return sensors


def _read_scenes(
    src: Path, tables: Path, runs: Sequence[str] | None
) -> tuple[list[_Scene], tuple[str, ...]]:
    """Scenes that are asked for, and all locations in the order in which they are put apart."""
    path = tables / "log.json"
    location = {word(r, "token", path): word(r, "location", path) for r in read_table(path)}
    path = tables / "scene.json"
    named = {word(r, "name", path): word(r, "log_token", path) for r in read_table(path)}
    if lost := sorted(name for name, log in named.items() if log not in location):
        raise UserError(f"{path}: the log of {lost[0]} is not in log.json: {_FETCH}")
    chosen = choose_runs(src, named, runs)
    further = sorted(set(location.values()) - set(LOCATIONS))
    return [_Scene(name, location[named[name]]) for name in chosen], (*LOCATIONS, *further)


def _read_keyframes(
    src: Path, tables: Path, sensors: Mapping[str, _Sensor], scenes: Sequence[_Scene]
) -> None:
    """Fill the scenes with those keyframes whose files are there."""
    path = tables / "scene.json"
    by_name = {scene.run: scene for scene in scenes}
    of_scene = {
        word(r, "token", path): by_name[r["name"]]
        for r in read_table(path)
        if r.get("name") in by_name
    }
    path = tables / "sample.json"
    of_sample = {
        word(r, "token", path): of_scene[r["scene_token"]]
        for r in read_table(path)
        if word(r, "scene_token", path) in of_scene
    }
    path = tables / "sample_data.json"
    for record in read_table(path):
        sensor = word(record, "calibrated_sensor_token", path)
        sample = word(record, "sample_token", path)
        if sensor not in sensors or sample not in of_sample or not record.get("is_key_frame"):
            continue
        time_us = record.get("timestamp")
        if not isinstance(time_us, int) or not 0 <= time_us < 2**62:
            raise UserError(f"{path}: a record has no timestamp in microseconds: {_FETCH}")
        file = path_inside(src, word(record, "filename", path), path)
        if _is_file(file):
            seen = _Seen(file, time_us, word(record, "ego_pose_token", path), sensor)
            scene = of_sample[sample]
            (scene.clouds if sensors[sensor].channel == LIDAR else scene.images)[sample] = seen


def _read_poses(tables: Path, tokens: set[str]) -> dict[str, Float64[np.ndarray, "4 4"]]:
    """T_map_body by token, of those asked for."""
    path = tables / "ego_pose.json"
    poses = {
        token: motion(record, path)
        for record in read_table(path)
        if (token := word(record, "token", path)) in tokens
    }
    if lost := tokens - poses.keys():
        raise UserError(f"{path} lacks {len(lost)} poses of keyframes: {_FETCH}")
    return poses


def _place(
    scene: _Scene,
    poses: Mapping[str, Float64[np.ndarray, "4 4"]],
    places: Sequence[str],
    every_m: float,
) -> list[tuple[str, Float64[np.ndarray, "4 4"]]]:
    """Samples of a scene to write, each with T_world_body."""
    sample_of = {seen: sample for sample, seen in {**scene.images, **scene.clouds}.items()}
    frames = []
    for seen in scene.frames():
        T_world_body = poses[seen.pose].copy()
        T_world_body[0, 3] += LOCATION_SPACING_M * places.index(scene.location)
        frames.append((sample_of[seen], T_world_body))
    kept = keyframes(np.array([T[:3, 3] for _, T in frames]), every_m)
    return [frames[row] for row in kept]


def _shots(
    scene: _Scene,
    frames: Sequence[tuple[str, Float64[np.ndarray, "4 4"]]],
    sensors: Mapping[str, _Sensor],
) -> Iterator[Shot]:
    for sample, T_world_body in frames:
        image, cloud = scene.images.get(sample), scene.clouds.get(sample)
        at_us = (cloud or scene.images[sample]).time_us
        yield Shot(
            frame=Frame(
                run=scene.run,
                timestamp_us=at_us,
                position_m=tuple(T_world_body[:3, 3].tolist()),
                T_world_body=T_world_body,
                image_time_us=image.time_us if image and image.time_us != at_us else None,
            ),
            image=None if image is None else partial(_read_image, image.path),
            cloud=None
            if cloud is None
            else partial(to_body, _read_scan, cloud.path, sensors[cloud.sensor].T_body_sensor),
            image_suffix=".png" if image is None else image.path.suffix,
        )


def _calibration(scene: _Scene, sensors: Mapping[str, _Sensor]) -> dict[str, list[list[float]]]:
    """Of the first keyframe: a scene is twenty seconds of one drive."""
    known: dict[str, list[list[float]]] = {}
    if scene.images:
        camera = sensors[next(iter(scene.images.values())).sensor]
        known["T_body_camera"] = camera.T_body_sensor.tolist()
        if camera.K is not None:
            known["K"] = camera.K.tolist()
    if scene.clouds:
        lidar = sensors[next(iter(scene.clouds.values())).sensor]
        known["T_body_lidar"] = lidar.T_body_sensor.tolist()
    return known


def _read_scan(path: Path) -> Float32[np.ndarray, "n 3"]:
    return read_xyz(path, _RECORD_BYTES)


def _read_image(path: Path) -> bytes:
    if path.suffix not in IMAGE_SUFFIXES:
        raise UserError(f"{path} is no .png or .jpg: fetch the images of nuScenes again")
    return encoded_image(path)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:
        return False
