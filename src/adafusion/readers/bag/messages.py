# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""ROS messages as they lie in bags, and the small ones decoded: poses, fixes, transforms, lenses.

Definitions: the common_interfaces of ROS 1 and 2 (sensor_msgs, nav_msgs, geometry_msgs, tf2_msgs;
REP 103 to 105 for axes and frames), which all releases of ROS 2 share for the messages read here.
The bytes of a message travel as they lie in the bag; the process that needs it decodes it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from adafusion.readers.calibration import Calibration, is_camera_matrix, is_distortion
from adafusion.types import UserError

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
CLOUD = "sensor_msgs/msg/PointCloud2"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
FIX = "sensor_msgs/msg/NavSatFix"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
# how each kind of pose keeps it
POSES: dict[str, Callable[[Any], Any]] = {
    "nav_msgs/msg/Odometry": lambda message: message.pose.pose,
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose,
}

NO_ROSBAGS = "bags are read with rosbags: pip install 'adafusion[data]'"


@dataclass(frozen=True, slots=True)
class Message:
    """One message as it lies in a bag."""

    file: str
    topic: str
    kind: str  # "sensor_msgs/msg/Image", in ROS 1 bags too
    ros1: bool  # in the wire format of ROS 1, else CDR
    received_ns: int
    raw: bytes

    def __str__(self) -> str:
        s, ns = divmod(self.received_ns, 10**9)
        return f"{self.file}: the message of {self.topic} received at {s}.{ns:09d} s"


class Header(NamedTuple):
    """When and in which frame a message was seen."""

    stamp_us: int  # 0 where the driver set none
    frame: str  # without a leading slash


class Transform(NamedTuple):
    """One edge of the tree of frames."""

    parent: str
    child: str
    stamp_us: int
    position_m: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]  # x y z w


class CameraInfo(NamedTuple):
    """What a camera says of its lens."""

    calibration: Calibration
    size: tuple[int, int] | None  # (width, height) of the images, where it says so
    note: str  # what a person should know, "" for nothing


class Damaged(UserError):
    """A bag or a message that cannot be read, whatever the options."""


@contextmanager
def refused(where: object, remedy: str) -> Iterator[None]:
    """The one place where whatever a damaged bag or message provokes becomes `Damaged`.

    The library and its decompressors answer damage with exceptions of every kind: asserts, struct,
    zstd, lz4, SQLite and YAML errors, MemoryError where a length is a lie.
    """
    try:
        yield
    except (UserError, ModuleNotFoundError):
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise Damaged(f"{where} is damaged or cut short ({reason[:300]}): {remedy}") from error


def decode(message: Message) -> Any:
    """All fields of a message; Damaged where its bytes are not what its type says."""
    store = _typestore(message.ros1)
    with refused(message, "leave the bag out, or record it again"):
        read = store.deserialize_ros1 if message.ros1 else store.deserialize_cdr
        return read(message.raw, message.kind)


def header(message: Message) -> Header:
    """The header that a stamped message begins with; what follows it is not looked at."""
    raw = message.raw
    with refused(message, "leave the bag out, or record it again"):
        if message.ros1:  # sequence number, seconds, nanoseconds, frame
            order, start = "little", 4
        else:  # two bytes of encoding and two of options come first
            order, start = ("little" if raw[1] & 1 else "big"), 4
        s, ns, length = (
            int.from_bytes(raw[at : at + 4], order)  # type: ignore[arg-type]
            for at in range(start, start + 12, 4)
        )
        if len(raw) < start + 12 + length:
            raise ValueError(f"{len(raw)} bytes")
        frame = raw[start + 12 : start + 12 + length].rstrip(b"\0").decode()
    return Header(s * 10**6 + ns // 1000, frame.lstrip("/"))


def decode_transforms(message: Message) -> list[Transform]:
    """Every edge of a message of /tf or /tf_static."""
    return [
        Transform(
            one.header.frame_id.lstrip("/"),
            one.child_frame_id.lstrip("/"),
            _stamp_us(one.header.stamp),
            _xyz(one.transform.translation),
            _xyzw(one.transform.rotation),
        )
        for one in decode(message).transforms
    ]


def decode_pose(message: Message) -> Transform:
    """A stamped pose or odometry; the child's name is "" where the message does not say it."""
    value = decode(message)
    pose = POSES[message.kind](value)
    return Transform(
        value.header.frame_id.lstrip("/"),
        getattr(value, "child_frame_id", "").lstrip("/"),
        _stamp_us(value.header.stamp),
        _xyz(pose.position),
        _xyzw(pose.orientation),
    )


def decode_fix(message: Message) -> tuple[float, float, float] | None:
    """Latitude and longitude in degrees and height in metres (0 if unknown); None without a fix."""
    value = decode(message)
    place = (float(value.latitude), float(value.longitude), float(value.altitude))
    known = abs(place[0]) <= 90 and abs(place[1]) <= 180
    if value.status.status < 0 or not known or place[:2] == (0.0, 0.0):
        return None
    return place if np.isfinite(place[2]) else (*place[:2], 0.0)


def decode_camera_info(message: Message, rectified: bool) -> CameraInfo:
    """The lens of images; `rectified`: of those rectified already, K is in the projection then.

    A camera that reads out every n-th pixel, or a part of them, has the K of what it reads out.
    """
    value = decode(message)
    K = np.array(_either(value, "p"), dtype=np.float64).reshape(3, 4)[:, :3]
    if not rectified:
        K = np.array(_either(value, "k"), dtype=np.float64).reshape(3, 3)
    part, skip = value.roi, (max(int(value.binning_x), 1), max(int(value.binning_y), 1))
    K[0, 2] -= part.x_offset
    K[1, 2] -= part.y_offset
    K[0] /= skip[0]
    K[1] /= skip[1]
    width, height = int(part.width or value.width), int(part.height or value.height)
    size = (width // skip[0], height // skip[1]) if width and height else None
    if not is_camera_matrix(K):
        note = f"{message.topic} is of a camera that nobody calibrated: no K is kept"
        return CameraInfo(Calibration(), size, note)
    distortion = tuple(float(k) for k in _either(value, "d"))
    model = value.distortion_model
    fisheye = model in ("equidistant", "fisheye")  # bends even where all numbers are 0
    if rectified or not (fisheye or any(distortion)):
        return CameraInfo(Calibration(K=K), size, "")
    plain = model in ("plumb_bob", "rational_polynomial") and is_distortion(distortion)
    if not (plain or (fisheye and len(distortion) == 4)) or not np.isfinite(distortion).all():
        note = (
            f"distortion {model!r} of {len(distortion)} numbers in {message.topic} is not undone: "
            "images are left bent, and no K is kept"
        )
        return CameraInfo(Calibration(), size, note)
    return CameraInfo(Calibration(K=K, distortion=distortion, fisheye=fisheye), size, "")


def _either(value: Any, name: str) -> Any:
    """A field that ROS 2 writes small and ROS 1 large."""
    return getattr(value, name) if hasattr(value, name) else getattr(value, name.upper())


@cache
def _typestore(ros1: bool) -> Any:
    """The definitions of all messages; once a process."""
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(NO_ROSBAGS) from error
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for kind in TRANSFORMS:
        if kind not in store.fielddefs:
            text = "geometry_msgs/TransformStamped[] transforms"
            store.register(get_types_from_msg(text, kind))
    return store


def _stamp_us(stamp: Any) -> int:
    return int(stamp.sec) * 10**6 + int(stamp.nanosec) // 1000


def _xyz(vector: Any) -> tuple[float, float, float]:
    return float(vector.x), float(vector.y), float(vector.z)


def _xyzw(quaternion: Any) -> tuple[float, float, float, float]:
    return float(quaternion.x), float(quaternion.y), float(quaternion.z), float(quaternion.w)
