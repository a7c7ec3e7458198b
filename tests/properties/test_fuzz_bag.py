# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever is done to a bag, it is read or refused in words; so is every message by itself."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from adafusion.readers.bag.messages import (
    CAMERA_INFO,
    CLOUD,
    COMPRESSED,
    FIX,
    IMAGE,
    POSES,
    TRANSFORMS,
    Message,
    decode_camera_info,
    decode_fix,
    decode_pose,
    decode_transforms,
    header,
)
from adafusion.readers.bag.reader import list_topics, read, recognises
from adafusion.readers.bag.sensors import decode_cloud, decode_picture, encoded_suffix
from adafusion.readers.calibration import Calibration, read_calibration
from adafusion.types import UserError

pytest.importorskip("rosbags", reason="adafusion[data]")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

T0_NS = 1_700_000_000_000_000_000
FORMS = ("bag", "lz4.bag", "mcap", "zstd.mcap", "db3")
POSE = "geometry_msgs/msg/PoseStamped"
MANY = settings(
    max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)

# what is done to the bytes of a file: cut it, or write over a place with what liars write
LIES = [b"\x00", b"\xff", b"\x01", b"\xff" * 4, b"\xff" * 8, b"\x00" * 4, b"\x7f\xff\xff\xff"]
places = st.floats(0, 1, exclude_max=True)
edits = st.lists(st.tuples(places, st.sampled_from(LIES) | st.binary(max_size=8)), max_size=6)


def damaged(data: bytes, length: float, changes: list[tuple[float, bytes]]) -> bytes:
    out = bytearray(data[: len(data) - int(length * len(data))])
    for place, new in changes:
        at = int(place * len(out))
        out[at : at + len(new)] = new
    return bytes(out)


@cache
def message_bytes(ros1: bool) -> dict[str, bytes]:
    """One serialized message of every kind that the bags hold."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.LATEST)
    types: dict[str, Any] = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=T0_NS // 10**9, nanosec=0)
    seq = {"seq": 0} if ros1 else {}
    head = types["std_msgs/msg/Header"](stamp=stamp, frame_id="lidar", **seq)
    point = types["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=3.0)
    turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    fields = [
        types["sensor_msgs/msg/PointField"](name=name, offset=4 * i, datatype=7, count=1)
        for i, name in enumerate("xyz")
    ]
    made = {
        POSE: types[POSE](
            header=head, pose=types["geometry_msgs/msg/Pose"](position=point, orientation=turn)
        ),
        CLOUD: types[CLOUD](
            header=head,
            height=1,
            width=4,
            fields=fields,
            is_bigendian=False,
            point_step=12,
            row_step=48,
            data=np.arange(48, dtype=np.uint8),
            is_dense=True,
        ),
        IMAGE: types[IMAGE](
            header=head,
            height=2,
            width=2,
            encoding="bgr8",
            is_bigendian=0,
            step=6,
            data=np.arange(12, dtype=np.uint8),
        ),
    }
    write = store.serialize_ros1 if ros1 else store.serialize_cdr
    return {kind: bytes(write(message, kind)) for kind, message in made.items()}


def write_bag(folder: Path, form: str) -> Path:
    """A bag of 8 poses, clouds and images; the file, in a folder of its own."""
    ros1 = form.endswith("bag")
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.LATEST)
    writer: Any
    if ros1:
        folder.mkdir()
        writer = Writer1(folder / "drive.bag")
        if form == "lz4.bag":
            writer.set_compression(Writer1.CompressionFormat.LZ4)
    else:
        plugin = StoragePlugin.SQLITE3 if form == "db3" else StoragePlugin.MCAP
        writer = Writer2(folder, version=9, storage_plugin=plugin)
        if form == "zstd.mcap":
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        topics = {POSE: "/pose", CLOUD: "/points", IMAGE: "/image"}
        raw = message_bytes(ros1)
        known = {k: writer.add_connection(t, k, typestore=store) for k, t in topics.items()}
        for k in range(8):
            for kind, connection in known.items():
                seconds = (T0_NS // 10**9 + k).to_bytes(4, "little")
                old = (T0_NS // 10**9).to_bytes(4, "little")
                writer.write(connection, T0_NS + k * 10**9, raw[kind].replace(old, seconds))
    (file,) = folder.glob(f"*.{form.split('.')[-1]}")
    return file


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("bags")
    return {form: write_bag(root / form, form) for form in FORMS}


def read_all(path: Path) -> int:
    """Read every frame; how many there are."""
    recognises(path)
    shots = list(read(path, every_m=0.0, lidar_height_m=1.0).shots)
    for shot in shots:
        for decode in (shot.image, shot.cloud):
            if decode is not None:
                decode()
    return len(shots)


@pytest.mark.parametrize("form", FORMS)
def test_whole_bag_is_read(bags: dict[str, Path], form: str) -> None:
    assert read_all(bags[form]) == 8


@pytest.mark.parametrize("form", FORMS)
@MANY
@given(length=st.just(0.0) | places, changes=edits)
def test_damaged_bag_is_read_or_refused(
    bags: dict[str, Path],
    tmp_path: Path,
    form: str,
    length: float,
    changes: list[tuple[float, bytes]],
) -> None:
    path = tmp_path / bags[form].name
    path.write_bytes(damaged(bags[form].read_bytes(), length, changes))
    with suppress(UserError):
        read_all(path)


@pytest.mark.parametrize("form", FORMS)
@MANY
@given(length=st.just(0.0) | places, changes=edits)
def test_damaged_bag_leaves_others_of_its_folder_alone(
    bags: dict[str, Path],
    tmp_path: Path,
    form: str,
    length: float,
    changes: list[tuple[float, bytes]],
) -> None:
    suffix = bags[form].suffix
    (tmp_path / f"a{suffix}").write_bytes(damaged(bags[form].read_bytes(), length, changes))
    shutil.copy(bags[form], tmp_path / f"b{suffix}")
    try:
        shots = read(tmp_path, every_m=0.0, lidar_height_m=1.0).shots
    except UserError:  # the damage may ask for an option
        return
    assert isinstance(shots, Iterator)
    runs = []
    while True:
        with suppress(UserError):
            if (shot := next(shots, None)) is None:
                break
            runs.append(shot.frame.run)
    assert runs.count("b") == 8


@pytest.mark.parametrize("form", ["mcap", "db3"])
@MANY
@given(length=st.just(0.0) | places, changes=edits)
def test_damaged_metadata_is_read_or_refused(
    bags: dict[str, Path],
    tmp_path: Path,
    form: str,
    length: float,
    changes: list[tuple[float, bytes]],
) -> None:
    folder = tmp_path / "drive"
    folder.mkdir(exist_ok=True)
    shutil.copy(bags[form], folder / bags[form].name)
    whole = (bags[form].parent / "metadata.yaml").read_bytes()
    (folder / "metadata.yaml").write_bytes(damaged(whole, length, changes))
    with suppress(UserError):
        list_topics(folder)
        read_all(folder)


def decode_any(message: Message) -> None:
    lens = Calibration(K=np.diag([2.0, 2.0, 1.0]), distortion=(0.1, 0.0, 0.0, 0.0))
    header(message)
    if message.kind in (IMAGE, COMPRESSED):
        encoded_suffix(message, Calibration())
        decode_picture(message, lens, None)
    elif message.kind == CLOUD:
        decode_cloud(message, np.eye(4))
    elif message.kind in TRANSFORMS:
        decode_transforms(message)
    elif message.kind in POSES:
        decode_pose(message)
    elif message.kind == FIX:
        decode_fix(message)
    else:
        decode_camera_info(message, rectified=False)


@pytest.mark.parametrize("ros1", [True, False])
@MANY
@given(
    kind=st.sampled_from([IMAGE, COMPRESSED, CLOUD, CAMERA_INFO, FIX, *TRANSFORMS, *POSES]),
    raw=st.binary(max_size=200),
)
def test_arbitrary_bytes_are_a_message_or_refused(ros1: bool, kind: str, raw: bytes) -> None:
    with suppress(UserError):
        decode_any(Message("a.bag", "/topic", kind, ros1, T0_NS, raw))


@pytest.mark.parametrize("ros1", [True, False])
@MANY
@given(
    kind=st.sampled_from([IMAGE, CLOUD, POSE]),
    length=st.just(0.0) | places,
    changes=edits,
)
def test_damaged_message_is_read_or_refused(
    ros1: bool, kind: str, length: float, changes: list[tuple[float, bytes]]
) -> None:
    raw = damaged(message_bytes(ros1)[kind], length, changes)
    with suppress(UserError):
        decode_any(Message("a.bag", "/topic", kind, ros1, T0_NS, raw))


CALIBRATION = b"""K: [[525.0, 0.0, 319.5], [0.0, 525.0, 239.5], [0.0, 0.0, 1.0]]
distortion: [-0.28, 0.07, 0.0002, 0.0001, 0.0]
T_body_lidar: [[1, 0, 0, 0.9], [0, 1, 0, 0.0], [0, 0, 1, 1.7], [0, 0, 0, 1]]
"""


@MANY
@given(length=st.just(0.0) | places, changes=edits)
def test_damaged_calibration_is_read_or_refused(
    tmp_path: Path, length: float, changes: list[tuple[float, bytes]]
) -> None:
    path = tmp_path / "rig.yaml"
    path.write_bytes(damaged(CALIBRATION, length, changes))
    with suppress(UserError):
        read_calibration(path)
