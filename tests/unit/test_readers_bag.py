# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of all forms, written with the library's own writers."""

from __future__ import annotations

import pickle
import shutil
import struct
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from adafusion.cli.data import prepare
from adafusion.datasets.recording import Recording, Shot, write_recording
from adafusion.readers.bag import limits
from adafusion.readers.bag.files import Topic, find_bags
from adafusion.readers.bag.reader import describe_topics, list_topics, read, recognises
from adafusion.types import UserError

pytest.importorskip("rosbags", reason="adafusion[data]")

import lz4.frame
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, storage_mcap
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

FORMS = ("bag", "mcap", "db3")
T0_NS = 1_700_000_000_000_000_000
MS = 1_000_000
HALF = 0.5**0.5

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CLOUD, INFO = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CameraInfo"
ODOMETRY, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
FIX, TF = "sensor_msgs/msg/NavSatFix", "tf2_msgs/msg/TFMessage"

STORES = {
    ros1: get_typestore(s) for ros1, s in ((True, Stores.ROS1_NOETIC), (False, Stores.LATEST))
}
STORES[True].register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))


@dataclass
class Log:
    """Messages as (received, topic, kind, message), in the terms of ROS 1 or ROS 2."""

    ros1: bool = False
    rows: list[tuple[int, str, str, Any]] = field(default_factory=list)

    def make(self, kind: str, **fields: Any) -> Any:
        return STORES[self.ros1].types[kind](**fields)

    def header(self, ns: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
        fields = {"stamp": stamp, "frame_id": frame} | ({"seq": 0} if self.ros1 else {})
        return self.make("std_msgs/msg/Header", **fields)

    def add(self, topic: str, kind: str, ns: int, late_ms: int = 0, **fields: Any) -> None:
        self.rows.append((ns + late_ms * MS, topic, kind, self.make(kind, **fields)))

    def image(
        self, ns: int, value: int = 7, topic: str = "/cam/image_raw", late_ms: int = 0
    ) -> None:
        header = self.header(ns, "cam_optical")
        data = np.full(4 * 6 * 3, value, np.uint8)
        shape = {"height": 4, "width": 6, "encoding": "rgb8", "is_bigendian": 0, "step": 18}
        received = ns or T0_NS + 50 * MS
        self.add(topic, IMAGE, received, late_ms, header=header, data=data, **shape)

    def jpeg(self, ns: int, data: bytes, topic: str = "/cam/image_raw/compressed") -> None:
        header = self.header(ns, "cam_optical")
        self.add(
            topic, COMPRESSED, ns, header=header, format="jpeg", data=np.frombuffer(data, "u1")
        )

    def cloud(
        self, ns: int, points: Any = ((1, 2, 3),), topic: str = "/points", late_ms: int = 0
    ) -> None:
        fields = [
            self.make("sensor_msgs/msg/PointField", name=name, offset=4 * i, datatype=7, count=1)
            for i, name in enumerate("xyz")
        ]
        data = np.asarray(points, "<f4")
        self.add(
            topic,
            CLOUD,
            ns,
            late_ms,
            header=self.header(ns, "velodyne"),
            height=1,
            width=len(data),
            fields=fields,
            is_bigendian=False,
            point_step=12,
            row_step=12 * len(data),
            data=np.frombuffer(data.tobytes(), "u1"),
            is_dense=True,
        )

    def pose(self, xyz: Any, q: Any = (0, 0, 0, 1)) -> Any:
        point = self.make(
            "geometry_msgs/msg/Point", **dict(zip("xyz", map(float, xyz), strict=True))
        )
        turn = dict(zip("xyzw", map(float, q), strict=True))
        turn = self.make("geometry_msgs/msg/Quaternion", **turn)
        return self.make("geometry_msgs/msg/Pose", position=point, orientation=turn)

    def odometry(
        self,
        ns: int,
        xyz: Any,
        q: Any = (0, 0, 0, 1),
        child: str = "base_link",
        topic: str = "/odom",
    ) -> None:
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        pose = self.make(
            "geometry_msgs/msg/PoseWithCovariance", pose=self.pose(xyz, q), covariance=np.zeros(36)
        )
        twist = self.make(
            "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)
        )
        header = self.header(ns, "odom")
        self.add(topic, ODOMETRY, ns, header=header, child_frame_id=child, pose=pose, twist=twist)

    def transform(
        self,
        ns: int,
        parent: str,
        child: str,
        xyz: Any,
        q: Any = (0, 0, 0, 1),
        static: bool = False,
    ) -> None:
        move = dict(zip("xyz", map(float, xyz), strict=True))
        turn = dict(zip("xyzw", map(float, q), strict=True))
        one = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(ns, parent),
            child_frame_id=child,
            transform=self.make(
                "geometry_msgs/msg/Transform",
                translation=self.make("geometry_msgs/msg/Vector3", **move),
                rotation=self.make("geometry_msgs/msg/Quaternion", **turn),
            ),
        )
        self.add("/tf_static" if static else "/tf", TF, ns or T0_NS, transforms=[one])

    def fix(self, ns: int, latitude: float, longitude: float) -> None:
        status = self.make("sensor_msgs/msg/NavSatStatus", status=0, service=1)
        self.add(
            "/fix",
            FIX,
            ns,
            header=self.header(ns, "gps"),
            status=status,
            latitude=latitude,
            longitude=longitude,
            altitude=100.0,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )

    def camera_info(self, distortion: list[float], topic: str = "/cam/camera_info") -> None:
        K = np.array([5.0, 0, 2.5, 0, 5.0, 1.5, 0, 0, 1])
        P = np.array([4.0, 0, 2, 0, 0, 4, 1, 0, 0, 0, 1, 0])
        lens = {"d": np.array(distortion), "k": K, "r": np.eye(3).ravel(), "p": P}
        if self.ros1:
            lens = {name.upper(): value for name, value in lens.items()}
        roi = self.make(
            "sensor_msgs/msg/RegionOfInterest",
            **dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0),
            do_rectify=False,
        )
        shape = {"height": 4, "width": 6, "binning_x": 0, "binning_y": 0, "roi": roi}
        header = self.header(T0_NS, "cam_optical")
        self.add(topic, INFO, T0_NS, header=header, distortion_model="plumb_bob", **lens, **shape)

    def drive(self, speed_m: float = 1.0, num: int = 31, y: float = 0.0) -> None:
        """Odometry at 10 Hz, `speed_m` along x from one to the next."""
        for k in range(num):
            self.odometry(T0_NS + 100 * MS * k, (speed_m * k, y, 0.0))

    def mount(self) -> None:
        """LiDAR 1 m ahead and 2 m up, turned to the left; camera 0.5 m above it."""
        self.transform(0, "base_link", "velodyne", (1, 0, 2), (0, 0, HALF, HALF), static=True)
        self.transform(0, "velodyne", "cam_optical", (0, 0, 0.5), static=True)

    def write(self, path: Path, form: str, pack: Callable[[Any], None] | None = None) -> Path:
        """A bag of `form`, its writer set by `pack`; a message of bytes is written as it is."""
        store = STORES[self.ros1]
        writer: Any
        if form == "bag":
            path, write = path.with_suffix(".bag"), store.serialize_ros1
            writer = Writer1(path)
        else:
            plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
            writer, write = Writer2(path, version=9, storage_plugin=plugin), store.serialize_cdr
        if pack is not None:
            pack(writer)
        with writer:
            connections: dict[str, Any] = {}
            for received, topic, kind, message in sorted(self.rows, key=lambda row: row[0]):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                raw = message if isinstance(message, bytes) else write(message, kind)
                writer.write(connections[topic], received, raw)
        return path


def simple(form: str = "mcap") -> Log:
    """Clouds at 5 Hz, 50 ms after a pose, each with an image 20 ms later that arrives first."""
    log = Log(ros1=form == "bag")
    log.drive()
    log.mount()
    for k in range(15):
        at = T0_NS + (200 * k + 50) * MS
        log.cloud(at, late_ms=90)
        log.image(at + 20 * MS, value=k, late_ms=5)
    return log


def shots_of(recording: Recording) -> list[Shot]:
    return list(recording.shots)


def times_ms(shots: list[Shot]) -> list[int]:
    return [(shot.frame.timestamp_us - T0_NS // 1000) // 1000 for shot in shots]


@pytest.mark.parametrize("form", FORMS)
def test_bag_becomes_frames_a_few_metres_apart(tmp_path: Path, form: str) -> None:
    recording = read(simple(form).write(tmp_path / "drive", form))
    shots = shots_of(recording)
    # x = 10 m/s t: clouds at 0.5, 2.5, 4.5, 6.5 ... m
    assert times_ms(shots) == [50, 650, 1250, 1850, 2450]
    assert [shot.frame.run for shot in shots] == ["drive"] * 5
    np.testing.assert_allclose(
        [shot.frame.position_m for shot in shots], [(x, 0, 0) for x in (0.5, 6.5, 12.5, 18.5, 24.5)]
    )
    assert [shot.frame.image_time_us - shot.frame.timestamp_us for shot in shots] == [20_000] * 5
    np.testing.assert_allclose(shots[0].cloud(), [(-1, 1, 5)], atol=1e-6)
    assert [int(shot.image()[0, 0, 0]) for shot in shots] == [0, 3, 6, 9, 12]
    assert not recording.notes
    assert recording.total == pytest.approx(5, abs=1)


@pytest.mark.parametrize("form", FORMS)
def test_prepared_bag_can_be_opened(tmp_path: Path, form: str) -> None:
    path = simple(form).write(tmp_path / "drive", form)
    written = write_recording(read(path, every_m=10.0), tmp_path / "out")
    info = written.dataset.info
    assert len(written.dataset.frames) == 3
    assert (info.name, info.synthetic, info.world) == ("bag", False, "")
    assert "images of /cam/image_raw, clouds of /points, poses of /odom in odom" in info.source
    assert "every 10 m, image within 50 ms" in info.source
    np.testing.assert_allclose(
        info.calibration["T_body_lidar"],
        [(0, -1, 0, 1), (1, 0, 0, 0), (0, 0, 1, 2), (0, 0, 0, 1)],
        atol=1e-9,
    )
    assert info.calibration["T_body_camera"][2][3] == 2.5


def test_shots_travel_to_other_processes(tmp_path: Path) -> None:
    shot = next(iter(read(simple().write(tmp_path / "drive", "mcap")).shots))
    copy = pickle.loads(pickle.dumps(shot))
    np.testing.assert_array_equal(copy.cloud(), shot.cloud())
    np.testing.assert_array_equal(copy.image(), shot.image())


def test_every_cloud_is_a_frame_where_that_is_asked_for(tmp_path: Path) -> None:
    assert len(shots_of(read(simple().write(tmp_path / "drive", "mcap"), every_m=0.0))) == 15


def test_vehicle_that_stands_still_gives_one_frame(tmp_path: Path) -> None:
    log = simple()
    log.rows = [row for row in log.rows if row[2] != ODOMETRY]
    log.drive(speed_m=0.0)
    assert len(shots_of(read(log.write(tmp_path / "drive", "mcap")))) == 1


def test_clouds_without_an_image_in_time_are_left_out(tmp_path: Path) -> None:
    path = simple().write(tmp_path / "drive", "mcap")
    recording = read(path, slop_ms=19.0)
    assert shots_of(recording) == []
    assert recording.notes == ["drive: 15 of 15 clouds have no image within 19 ms: left out"]


def test_next_cloud_takes_the_place_of_one_without_an_image(tmp_path: Path) -> None:
    log = simple()
    log.rows = [r for r in log.rows if r[2] != IMAGE or r[3].data[0] != 3]
    shots = shots_of(read(log.write(tmp_path / "drive", "mcap")))
    assert times_ms(shots)[:2] == [50, 850]


def test_images_that_stop_do_not_hold_clouds_back(tmp_path: Path) -> None:
    log = Log()
    log.drive(num=100)
    for k in range(45):
        log.cloud(T0_NS + 200 * MS * k)
    log.image(T0_NS)
    recording = read(log.write(tmp_path / "drive", "mcap"), every_m=0.0, lidar_height_m=0.0)
    assert times_ms(shots_of(recording)) == [0]
    assert "44 of 45 clouds have no image" in recording.notes[0]


def test_clouds_outside_the_poses_are_left_out(tmp_path: Path) -> None:
    log = Log()
    log.drive(num=11)
    for second in (4, 5):
        log.odometry(T0_NS + second * 1000 * MS, (100, 0, 0))
    for at_ms in (-100, 500, 2500, 4500, 9000):
        log.cloud(T0_NS + at_ms * MS)
    recording = read(log.write(tmp_path / "drive", "mcap"), every_m=0.0, lidar_height_m=0.0)
    assert times_ms(shots_of(recording)) == [500, 4500]
    assert "3 of 5 clouds lie outside the poses" in recording.notes[0]
    assert "different clocks" in recording.notes[0]
    assert "clouds alone" in recording.notes[1]


def test_messages_without_a_stamp_have_the_time_of_recording(tmp_path: Path) -> None:
    log = Log()
    log.drive()
    log.image(0)
    recording = read(log.write(tmp_path / "drive", "mcap"))
    assert times_ms(shots_of(recording)) == [50]
    assert "1 messages have no stamp: recording times" in recording.notes[0]


def test_messages_that_go_back_in_time_are_left_out(tmp_path: Path) -> None:
    log = Log()
    log.drive()
    log.cloud(T0_NS + 500 * MS)
    log.cloud(T0_NS + 500 * MS, late_ms=10)
    log.cloud(T0_NS + 400 * MS, late_ms=300)
    recording = read(log.write(tmp_path / "drive", "mcap"), every_m=0.0, lidar_height_m=0.0)
    assert times_ms(shots_of(recording)) == [500]
    assert "2 messages go back in time" in recording.notes[0]


WILD_NS = 2_130_000_000 * 10**9  # in the year 2037


@pytest.mark.parametrize("which", [0, 7, 14])
def test_single_wild_stamp_loses_its_own_message_alone(tmp_path: Path, which: int) -> None:
    log = Log(ros1=True)
    log.drive()
    for k in range(15):
        at = T0_NS + 200 * MS * k
        if k == which:
            log.cloud(WILD_NS, late_ms=(at - WILD_NS) // MS)
        else:
            log.cloud(at)
    recording = read(log.write(tmp_path / "drive", "bag"), every_m=0.0, lidar_height_m=0.0)
    assert times_ms(shots_of(recording)) == [200 * k for k in range(15) if k != which]
    assert "1 messages have a stamp that is off by more than 60 s" in recording.notes[0]


def test_clock_of_its_own_is_not_wild(tmp_path: Path) -> None:
    log = Log()
    since_power_on = 5_000 * MS
    for k in range(31):
        log.odometry(since_power_on + 100 * MS * k, (k, 0, 0))
        log.cloud(since_power_on + 100 * MS * k)
    log.rows = [(at + T0_NS, *row) for at, *row in log.rows]
    recording = read(log.write(tmp_path / "drive", "mcap"), every_m=0.0, lidar_height_m=0.0)
    assert len(shots_of(recording)) == 31


def test_clock_that_is_set_anew_is_followed(tmp_path: Path) -> None:
    log = Log()
    hour_ms = 3_600_000
    for k in range(40):  # an hour ahead from the tenth message on
        at = T0_NS + (100 * k + hour_ms * (k >= 10)) * MS
        log.odometry(at, (k, 0, 0))
        log.cloud(at, late_ms=-hour_ms * (k >= 10))
    recording = read(log.write(tmp_path / "drive", "mcap"), every_m=0.0, lidar_height_m=0.0)
    times = times_ms(shots_of(recording))
    assert times[:10] == [100 * k for k in range(10)]
    assert times[-1] == 3900 + hour_ms
    assert len(times) >= 35


def test_messages_that_wait_for_each_other_are_bounded_by_number(tmp_path: Path) -> None:
    log = Log()
    log.drive()

    def add(sensor: Callable[..., None], at_ms: int) -> None:  # all recorded at one time
        sensor(T0_NS + at_ms * MS, late_ms=3000 - at_ms)

    for k in range(150):
        add(log.image, 10 * k)
    for at_ms in (0, 1490):
        add(log.cloud, at_ms)
    for k in range(150):
        add(log.cloud, 1501 + 2 * k)
    for at_ms in (1501, 1799):
        add(log.image, at_ms)
    path = log.write(tmp_path / "drive", "mcap")
    recording = read(path, every_m=0.0, lidar_height_m=0.0, slop_ms=0.0)
    assert times_ms(shots_of(recording)) == [1490, 1799]


# ---------------------------------------------------------------------------- poses


def test_hole_in_the_slower_edge_is_not_bridged(tmp_path: Path) -> None:
    log = Log()
    log.mount()
    for k in range(201):
        at = T0_NS + 100 * MS * k
        log.transform(at, "odom", "base_link", (k, 0, 0))
        if k % 5 == 0 and not 50 < k < 150:
            log.transform(at, "map", "odom", (0, k, 0))
    for at_s in (4, 10, 16):
        log.cloud(T0_NS + at_s * 1000 * MS)
    recording = read(log.write(tmp_path / "drive", "mcap"))
    assert times_ms(shots_of(recording)) == [4000, 16000]
    assert "1 of 3 clouds lie outside the poses" in recording.notes[0]


def test_tree_gives_poses_of_the_base_in_the_map(tmp_path: Path) -> None:
    log = Log(ros1=True)
    log.mount()
    log.transform(0, "base_footprint", "base_link", (0, 0, 0.25), static=True)
    for k in range(31):
        at = T0_NS + 100 * MS * k
        log.transform(at, "odom", "base_footprint", (k, 0, 0))
        if k % 5 == 0:  # the map turns odometry to the left, and drifts up
            log.transform(at, "map", "odom", (100, 0, k / 10), (0, 0, HALF, HALF))
    log.cloud(T0_NS + 250 * MS)
    recording = read(log.write(tmp_path / "drive", "bag"))
    (shot,) = shots_of(recording)
    np.testing.assert_allclose(shot.frame.position_m, (100, 2.5, 0.25), atol=1e-9)
    np.testing.assert_allclose(shot.frame.T_world_body[:3, 0], (0, 1, 0), atol=1e-9)
    np.testing.assert_allclose(shot.cloud(), [(-1, 1, 5.25)], atol=1e-6)
    assert "poses of /tf in map" in recording.info.source


def test_height_of_the_lidar_says_where_the_ground_is(tmp_path: Path) -> None:
    path = simple().write(tmp_path / "drive", "mcap")
    shot = shots_of(read(path, lidar_height_m=2.5))[0]
    np.testing.assert_allclose(shot.cloud(), [(-1, 1, 5.5)], atol=1e-6)
    np.testing.assert_allclose(shot.frame.position_m, (0.5, 0, -0.5))


def test_odometry_of_the_lidar_is_moved_to_the_ground_below(tmp_path: Path) -> None:
    log = Log()
    for k in range(11):
        log.odometry(T0_NS + 100 * MS * k, (k, 0, 10), child="velodyne")
    log.cloud(T0_NS)
    shot = shots_of(read(log.write(tmp_path / "drive", "mcap"), lidar_height_m=1.5))[0]
    np.testing.assert_allclose(shot.frame.position_m, (0, 0, 8.5))
    np.testing.assert_allclose(shot.cloud(), [(1, 2, 4.5)])


def test_odometry_of_another_frame_of_the_robot_is_moved_to_the_base(tmp_path: Path) -> None:
    log = Log()
    log.mount()
    for k in range(11):
        log.odometry(T0_NS + 100 * MS * k, (k, 0, 2), (0, 0, HALF, HALF), child="velodyne")
    log.cloud(T0_NS)
    shot = shots_of(read(log.write(tmp_path / "drive", "mcap")))[0]
    # the LiDAR looks to the base's left, and along the world's y: the base looks along x
    np.testing.assert_allclose(shot.frame.position_m, (-1, 0, 0), atol=1e-9)
    np.testing.assert_allclose(shot.frame.T_world_body[:3, :3], np.eye(3), atol=1e-9)


def test_odometry_of_an_unknown_frame_is_taken_as_the_bases(tmp_path: Path) -> None:
    log = Log()
    log.mount()
    for k in range(11):
        log.odometry(T0_NS + 100 * MS * k, (k, 0, 0), child="imu")
    log.cloud(T0_NS)
    recording = read(log.write(tmp_path / "drive", "mcap"))
    assert shots_of(recording)[0].frame.position_m == (0, 0, 0)
    assert "no transform leads from base_link to imu" in recording.notes[0]


def test_cloud_that_nothing_joins_to_the_ground_asks_for_its_height(tmp_path: Path) -> None:
    log = Log()
    log.drive()
    log.cloud(T0_NS)
    path = log.write(tmp_path / "drive", "mcap")
    with pytest.raises(UserError, match="--lidar-height-m"):
        read(path)


def test_fixes_give_positions_of_utm(tmp_path: Path) -> None:
    log = Log()
    for k in range(11):
        log.fix(T0_NS + 1000 * MS * k, k * 1e-4, 9.0)
    log.fix(T0_NS + 11_000 * MS, 0.001, 9.001)
    for at_s in (0, 10, 11):
        log.cloud(T0_NS + at_s * 1000 * MS)
    recording = read(log.write(tmp_path / "drive", "mcap"), lidar_height_m=0.0)
    frames = [shot.frame for shot in shots_of(recording)]
    assert all(frame.T_world_body is None for frame in frames)
    # on the equator a degree of latitude is 110.574 km, one of longitude 111.319 km; grid 0.9996
    np.testing.assert_allclose(
        [frame.position_m for frame in frames],
        [(5e5, 0, 100), (5e5, 110.53, 100), (5e5 + 111.27, 110.53, 100)],
        atol=0.01,
    )
    assert recording.info.world == "UTM zone 32N"


def test_fixes_are_left_alone_where_there_is_odometry(tmp_path: Path) -> None:
    log = simple()
    log.fix(T0_NS, 48.0, 11.0)
    recording = read(log.write(tmp_path / "drive", "mcap"))
    assert recording.info.world == ""
    assert shots_of(recording)[0].frame.T_world_body is not None


def test_poses_may_come_from_a_file(tmp_path: Path) -> None:
    log = simple()
    log.rows = [row for row in log.rows if row[2] != ODOMETRY]
    path = log.write(tmp_path / "drive", "mcap")
    rows = "# t x y z qx qy qz qw\n1700000000.0 0 0 0 0 0 0 1\n1700000002.0 0 20 0 0 0 0 1\n"
    (tmp_path / "trajectory.txt").write_text(rows)
    shots = shots_of(read(path, poses=tmp_path / "trajectory.txt"))
    assert times_ms(shots) == [50, 650, 1250, 1850]
    np.testing.assert_allclose(shots[1].frame.position_m, (0, 6.5, 0))
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "drive.txt").write_text(rows)
    assert len(shots_of(read(path, poses=tmp_path / "folder"))) == 4
    with pytest.raises(UserError, match="missing"):
        read(path, poses=tmp_path / "nothing.txt")


def test_poses_of_several_bags_come_from_a_folder(tmp_path: Path) -> None:
    src = tmp_path / "src"
    src.mkdir()
    for name in "ab":
        simple().write(src / name, "mcap")
        rows = "timestamp_s,latitude,longitude\n1700000000.0,0,9\n1700000002.0,0,9.001\n"
        (src / f"{name}.csv").write_text(rows)
    recording = read(src, poses=src, every_m=0.0)
    frames = [shot.frame for shot in shots_of(recording)]
    assert [frame.run for frame in frames] == ["a"] * 10 + ["b"] * 10
    assert frames[0].T_world_body is None
    assert recording.info.world == "UTM zone 32N"
    assert "poses of a file" in recording.info.source
    with pytest.raises(UserError, match="one file for 2 bags"):
        read(src, poses=src / "a.csv")


def test_bag_without_poses_says_what_to_do(tmp_path: Path) -> None:
    log = simple()
    log.rows = [row for row in log.rows if row[2] != ODOMETRY]
    path = log.write(tmp_path / "drive", "mcap")
    with pytest.raises(UserError, match=r"(?s)/tf gives no poses.*/points.*--poses FILE"):
        read(path)


def test_poses_without_a_direction_are_refused(tmp_path: Path) -> None:
    log = simple()
    log.rows = [row for row in log.rows if row[2] != ODOMETRY]
    for k in range(5):
        log.odometry(T0_NS + 100 * MS * k, (k, 0, 0), (0, 0, 0, 0))
    path = log.write(tmp_path / "drive", "mcap")
    with pytest.raises(UserError, match="/odom gives no poses"):
        read(path)


# ---------------------------------------------------------------------------- topics


def test_topics_are_listed_with_type_and_count(tmp_path: Path) -> None:
    path = simple().write(tmp_path / "drive", "mcap")
    assert list_topics(path) == [
        Topic("/cam/image_raw", IMAGE, 15),
        Topic("/odom", ODOMETRY, 31),
        Topic("/points", CLOUD, 15),
        Topic("/tf_static", TF, 2),
    ]
    assert "/points         sensor_msgs/PointCloud2  15" in describe_topics(path)


def test_listing_takes_the_words_of_preparing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    src = str(simple().write(tmp_path / "drive", "mcap"))
    for paths in ([src], ["bag", src], [src, "data/out"], ["bag", src, "data/out"]):
        prepare(paths, list_topics=True)
        assert "sensor_msgs/PointCloud2  15" in capsys.readouterr().out


def test_several_candidates_ask_for_a_choice(tmp_path: Path) -> None:
    log = simple()
    log.image(T0_NS + 60 * MS, topic="/rear/image_raw")
    log.cloud(T0_NS + 55 * MS, topic="/rear/points")
    log.odometry(T0_NS, (0, 0, 0), topic="/wheel_odom")
    path = log.write(tmp_path / "drive", "mcap")
    given: dict[str, str] = {}
    for option, choice in (
        ("image_topic", "/rear/image_raw"),
        ("cloud_topic", "rear/points"),
        ("pose_topic", "/odom"),
    ):
        with pytest.raises(UserError, match=f"choose with --{option.replace('_', '-')}"):
            read(path, **given)
        given[option] = choice
    assert times_ms(shots_of(read(path, **given))) == [55]


def test_unknown_topic_lists_those_there_are(tmp_path: Path) -> None:
    path = simple().write(tmp_path / "drive", "mcap")
    with pytest.raises(
        UserError, match=r"(?s)no /points of .*Image.*/cam/image_raw.*--image-topic"
    ):
        read(path, image_topic="/points")


def test_compressed_copy_and_depth_are_no_candidates(tmp_path: Path) -> None:
    log = simple()
    log.jpeg(T0_NS, b"\xff\xd8")
    log.image(T0_NS, topic="/cam/depth/image_raw")
    log.cloud(T0_NS, topic="/cam/depth/points")
    assert len(shots_of(read(log.write(tmp_path / "drive", "mcap")))) == 5


def test_bag_with_one_sensor_gives_frames_of_it(tmp_path: Path) -> None:
    log = simple()
    log.rows = [row for row in log.rows if row[2] != CLOUD]
    recording = read(log.write(tmp_path / "drive", "mcap"))
    shots = shots_of(recording)
    assert times_ms(shots) == [70, 670, 1270, 1870, 2470]
    assert all(shot.cloud is None for shot in shots)
    assert "images alone" in recording.notes[0]
    np.testing.assert_allclose(recording.info.calibration["T_body_camera"][2][3], 2.5)


def test_bag_without_sensors_is_refused(tmp_path: Path) -> None:
    log = Log()
    log.drive()
    path = log.write(tmp_path / "drive", "mcap")
    with pytest.raises(UserError, match="neither images nor clouds"):
        read(path)


# ---------------------------------------------------------------------------- lenses


def test_camera_info_beside_the_images_is_used(tmp_path: Path) -> None:
    log = simple("bag")
    log.camera_info([-0.2, 0.0, 0.0, 0.0, 0.0])
    log.camera_info([], topic="/rear/camera_info")
    recording = read(log.write(tmp_path / "drive", "bag"))
    assert recording.info.calibration["K"] == [[5, 0, 2.5], [0, 5, 1.5], [0, 0, 1]]
    image = shots_of(recording)[1].image()
    assert (image[2, 3] == 3).all()


def test_fisheye_images_are_undistorted(tmp_path: Path) -> None:
    log = simple()
    log.camera_info([0.0, 0.0, 0.0, 0.0])
    log.rows[-1][3].distortion_model = "equidistant"
    recording = read(log.write(tmp_path / "drive", "mcap"))
    assert recording.info.calibration["K"] == [[5, 0, 2.5], [0, 5, 1.5], [0, 0, 1]]
    assert "fisheye distortion [0.0, 0.0, 0.0, 0.0] undone" in recording.info.source
    assert shots_of(recording)[1].image().shape == (4, 6, 3)


def test_images_that_stay_bent_have_no_k(tmp_path: Path) -> None:
    log = simple()
    log.camera_info([0.1])
    log.rows[-1][3].distortion_model = "fov"
    recording = read(log.write(tmp_path / "drive", "mcap"))
    assert "K" not in recording.info.calibration
    assert "distortion 'fov' of 1 numbers in /cam/camera_info is not undone" in recording.notes[0]


def test_rectified_images_have_the_k_of_the_projection(tmp_path: Path) -> None:
    log = simple()
    log.rows = [r if r[2] != IMAGE else (r[0], "/cam/image_rect", *r[2:]) for r in log.rows]
    log.camera_info([-0.2, 0.0, 0.0, 0.0, 0.0])
    recording = read(log.write(tmp_path / "drive", "mcap"))
    assert recording.info.calibration["K"] == [[4, 0, 2], [0, 4, 1], [0, 0, 1]]


def test_jpeg_is_kept_as_it_is(tmp_path: Path) -> None:
    jpeg = cv2.imencode(".jpg", np.full((4, 6, 3), 99, np.uint8))[1].tobytes()
    log = Log()
    log.drive()
    log.jpeg(T0_NS, jpeg)
    written = write_recording(read(log.write(tmp_path / "drive", "mcap")), tmp_path / "out")
    (frame,) = written.dataset.frames
    assert (tmp_path / "out" / frame.image).read_bytes() == jpeg
    assert frame.image.endswith(".jpg")


def test_calibration_file_goes_before_what_the_bag_says(tmp_path: Path) -> None:
    log = simple()
    log.camera_info([])
    T = np.eye(4)
    T[:3, 3] = 0, 0, 1.75
    (tmp_path / "rig.yaml").write_text(
        yaml.safe_dump({"K": np.diag([9.0, 9.0, 1.0]).tolist(), "T_body_lidar": T.tolist()})
    )
    recording = read(log.write(tmp_path / "drive", "mcap"), calibration=tmp_path / "rig.yaml")
    np.testing.assert_allclose(shots_of(recording)[0].cloud(), [(1, 2, 4.75)])
    assert recording.info.calibration["K"][0][0] == 9
    assert recording.info.calibration["T_body_camera"][2][3] == pytest.approx(2.25)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no entries"),
        ("[1, 2", "no YAML"),
        ("k: 3", "unknown entries k"),
        ("K: [[1, 0], [0, 1]]", "K is not 3x3"),
        ("K: [[0, 0, 1], [0, 1, 1], [0, 0, 1]]", "K is not"),
        ("distortion: [1, 2, 3]", "4, 5, 8, 12 or 14"),
        ("distortion: [1, 2, 3, x]", "finite numbers"),
        ("distortion: [0.1, 0, 0, 0]", "without K"),
        ("T_body_lidar: [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "no rigid motion"),
    ],
)
def test_calibration_file_that_is_wrong_is_refused(tmp_path: Path, text: str, says: str) -> None:
    path = simple().write(tmp_path / "drive", "mcap")
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(UserError, match=says):
        read(path, calibration=tmp_path / "rig.yaml")


# ---------------------------------------------------------------------------- several, in parts


def test_folder_of_bags_has_a_run_for_each(tmp_path: Path) -> None:
    src = tmp_path / "src"
    src.mkdir()
    for name, form in (("a", "bag"), ("b", "mcap"), ("c", "db3")):
        simple(form).write(src / name, form)
    assert recognises(src)
    recording = read(src, every_m=10.0)
    assert [shot.frame.run for shot in shots_of(recording)] == ["a"] * 3 + ["b"] * 3 + ["c"] * 3
    assert "share one world" in recording.notes[0]
    assert "K" not in recording.info.calibration
    assert len(shots_of(read(src, runs=["b"], every_m=10.0))) == 3
    with pytest.raises(UserError, match=r"no bag d: choose from a, b, c"):
        read(src, runs=["d"])


def test_parts_of_one_recording_are_one_run(tmp_path: Path) -> None:
    log = simple("bag")
    cut = T0_NS + 1_500 * MS
    src = tmp_path / "src"
    src.mkdir()
    for k, rows in enumerate(
        (
            [r for r in log.rows if r[0] < cut],
            [r for r in log.rows if r[0] >= cut],
        )
    ):
        Log(True, rows).write(src / f"drive_{k}", "bag")
    assert [bag.run for bag in find_bags(src)] == ["drive"]
    assert times_ms(shots_of(read(src))) == [50, 650, 1250, 1850, 2450]


def test_numbered_drives_are_runs_of_their_own(tmp_path: Path) -> None:
    for k in (1, 2, 10):
        (tmp_path / f"loop_{k}.bag").touch()
    assert [bag.run for bag in find_bags(tmp_path)] == ["loop_1", "loop_10", "loop_2"]


def test_folder_without_its_metadata_is_read_all_the_same(tmp_path: Path) -> None:
    for form in ("mcap", "db3"):
        path = simple(form).write(tmp_path / form, form)
        (path / "metadata.yaml").unlink()
        assert len(shots_of(read(path))) == 5
        (file,) = path.iterdir()
        assert len(shots_of(read(file))) == 5
        assert recognises(file)


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_folder_is_read(tmp_path: Path, mode: CompressionMode) -> None:
    path = simple().write(
        tmp_path / "drive", "db3", lambda w: w.set_compression(mode, CompressionFormat.ZSTD)
    )
    assert len(shots_of(read(path))) == 5


def test_bags_of_the_world_say_so(tmp_path: Path) -> None:
    simple().write(tmp_path / "drive", "mcap")
    (tmp_path / "manifest.json").write_text('{"synthetic": true}')
    info = read(tmp_path).info
    assert (info.name, info.synthetic) == ("synthetic world in bag layout", True)


# ---------------------------------------------------------------------------- damage


def test_folder_of_other_things_is_no_bag(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("name: something else")
    (tmp_path / "images").mkdir()
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    assert not recognises(tmp_path)
    assert not recognises(tmp_path / "nothing")
    with pytest.raises(UserError, match="holds no bag"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("form", "remedy"), [("bag", "rosbag reindex"), ("mcap", "mcap recover"), ("db3", "recover")]
)
def test_bag_that_is_cut_is_refused_with_a_remedy(tmp_path: Path, form: str, remedy: str) -> None:
    path = simple(form).write(tmp_path / "drive", form)
    file = path if path.is_file() else next(p for p in path.iterdir() if p.suffix == f".{form}")
    whole = file.read_bytes()
    for size in (0, 10, len(whole) // 3):
        file.write_bytes(whole[:size])
        with pytest.raises(UserError, match=remedy) as caught:
            read(file)
        assert file.name in str(caught.value)


def write_broken(path: Path) -> Path:
    """A simple bag that breaks off in its third chunk."""

    def pack(writer: Any) -> None:
        writer.set_compression(Writer1.CompressionFormat.LZ4)
        writer.chunk_threshold = 8_000  # many small chunks

    path = simple("bag").write(path, "bag", pack)
    data = bytearray(path.read_bytes())
    starts = [at for at in range(len(data)) if data.startswith(b"\x04\x22\x4d\x18", at)]
    assert len(starts) > 3
    data[starts[2]] ^= 0xFF  # of the third chunk, with poses, images and clouds
    path.write_bytes(data)
    return path


def test_stream_that_breaks_off_keeps_what_came_before(tmp_path: Path) -> None:
    path = write_broken(tmp_path / "drive")
    with pytest.raises(UserError, match="rosbag reindex"):
        write_recording(read(path), tmp_path / "out")
    written = write_recording(read(path), tmp_path / "kept", skip_bad=True)
    kept = [(f.timestamp_us - T0_NS // 1000) // 1000 for f in written.dataset.frames]
    assert kept == [50, 650, 1250, 1850][: len(kept)]
    assert len(kept) >= 2
    (skipped,) = written.skipped
    assert "drive.bag is damaged or cut short" in skipped.reason


def test_broken_bag_loses_its_own_frames_alone(tmp_path: Path) -> None:
    src = tmp_path / "src"
    src.mkdir()
    write_broken(src / "a")
    simple("bag").write(src / "b", "bag")
    whole = simple("bag").write(src / "c", "bag")
    whole.write_bytes(whole.read_bytes()[:5000])  # not even its index is there
    with pytest.raises(UserError, match=r"c\.bag"):
        write_recording(read(src), tmp_path / "out")
    written = write_recording(read(src), tmp_path / "kept", skip_bad=True)
    runs = [frame.run for frame in written.dataset.frames]
    assert runs.count("b") == 5
    assert 2 <= runs.count("a") < 5
    assert [name for one in written.skipped for name in "ac" if f"{name}.bag" in one.reason] == [
        "c",
        "a",
    ]


def test_folder_of_broken_bags_alone_is_refused(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / f"{name}.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(UserError, match=r"a\.bag is damaged"):
        read(tmp_path)


def test_single_damaged_messages_are_left_out(tmp_path: Path) -> None:
    log = simple()
    for topic, kind in (("/points", CLOUD), ("/cam/image_raw", IMAGE), ("/odom", ODOMETRY)):
        log.rows.append((T0_NS, topic, kind, b"\0\1\0\0cut"))
        log.rows.append((T0_NS + 1000 * MS, topic, kind, b"\0\1\0\0cut"))
    recording = read(log.write(tmp_path / "drive", "mcap"))
    assert times_ms(shots_of(recording)) == [50, 650, 1250, 1850, 2450]
    assert recording.notes == [
        "drive: 2 poses or transforms are damaged: left out",
        "drive: 4 messages are damaged: left out",
    ]


def pack_bag(name: str) -> Callable[[Any], None]:
    return lambda writer: writer.set_compression(Writer1.CompressionFormat[name])


def pack_bag2(name: str) -> Callable[[Any], None]:
    return lambda writer: writer.set_compression(CompressionMode[name], CompressionFormat.ZSTD)


@pytest.mark.parametrize(
    ("form", "pack"),
    [
        ("bag", pack_bag("LZ4")),
        ("bag", pack_bag("BZ2")),
        ("mcap", pack_bag2("STORAGE")),
        ("mcap", pack_bag2("FILE")),
        ("db3", pack_bag2("MESSAGE")),
        ("db3", pack_bag2("FILE")),
        ("mcap", None),
    ],
)
def test_bag_that_unpacks_to_more_than_a_recorder_writes_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str, pack: Callable[[Any], None] | None
) -> None:
    log = simple(form)
    at = T0_NS + 1000 * MS
    log.add(
        "/cam/image_raw",
        IMAGE,
        at,
        header=log.header(at, "cam_optical"),
        data=np.zeros(2**22, np.uint8),
        **{"height": 2**11, "width": 2**11, "encoding": "mono8", "is_bigendian": 0, "step": 2**11},
    )
    path = log.write(tmp_path / "drive", form, pack)
    assert len(shots_of(read(path))) == 5
    monkeypatch.setattr(limits, "MOST_BYTES", 2**20)
    with pytest.raises(UserError, match=r"drive.* (claims|unpacks to|holds) .*more than 1048576"):
        list(read(path).shots)


def record(kind: int, body: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(body)) + body


@pytest.mark.parametrize("packing", ["zstd", "lz4"])
def test_chunk_that_unpacks_to_more_than_it_claims_is_stopped_there(
    tmp_path: Path, packing: str
) -> None:
    pack: dict[str, Callable[[bytes], bytes]] = {
        "lz4": lz4.frame.compress,
        "zstd": storage_mcap.zstd.compress,
    }
    bomb = pack[packing](bytes(2**26))
    name = struct.pack("<I", len(packing)) + packing.encode()
    chunk = struct.pack("<QQQI", 0, 1, 100, 0) + name + struct.pack("<Q", len(bomb)) + bomb
    magic, ros2 = b"\x89MCAP0\r\n", struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0)
    path = tmp_path / "drive.mcap"
    footer = record(2, struct.pack("<QQI", 0, 0, 0))
    path.write_bytes(magic + record(1, ros2) + record(6, chunk) + footer + magic)
    tracemalloc.start()
    with pytest.raises(UserError, match=r"drive\.mcap .*more than 100 bytes"):
        list_topics(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2**24


def test_record_of_a_file_with_holes_is_not_read_whole(tmp_path: Path) -> None:
    magic, ros2 = b"\x89MCAP0\r\n", struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0)
    path = tmp_path / "drive.mcap"
    with path.open("wb") as file:
        file.write(magic + record(1, ros2) + struct.pack("<BQ", 4, 2**29))
        file.seek(2**29, 1)
        file.write(record(2, struct.pack("<QQI", 0, 0, 0)) + magic)
    tracemalloc.start()
    with pytest.raises(UserError, match=r"drive\.mcap .*claims 536870912 bytes"):
        list_topics(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2**24


def test_damaged_metadata_is_refused(tmp_path: Path) -> None:
    path = simple("db3").write(tmp_path / "drive", "db3")
    for text in (
        "rosbag2_bagfile_information: 3",
        "rosbag2_bagfile_information: [",
        "rosbag2_bagfile_information: {version: 99}",
        "rosbag2_bagfile_information:\n" + "  a: " + "[" * 5000,
    ):
        (path / "metadata.yaml").write_text(text)
        with pytest.raises(UserError, match="ros2 bag reindex"):
            read(path)


def test_database_with_messages_beside_it_is_refused(tmp_path: Path) -> None:
    path = simple("db3").write(tmp_path / "drive", "db3")
    (path / "drive.db3-wal").write_bytes(b"unmerged")
    with pytest.raises(UserError, match="wal_checkpoint"):
        read(path)


def test_options_out_of_range_are_refused(tmp_path: Path) -> None:
    path = simple().write(tmp_path / "drive", "mcap")
    for options in ({"slop_ms": -1.0}, {"slop_ms": 5000.0}, {"every_m": float("nan")}):
        with pytest.raises(UserError, match="mend the option"):
            read(path, **options)


def test_two_bags_of_one_name_are_refused(tmp_path: Path) -> None:
    for path in (
        tmp_path / "a" / "drive.bag",
        tmp_path / "a" / "other.bag",
        tmp_path / "drive.bag",
    ):
        path.parent.mkdir(exist_ok=True)
        path.touch()
    with pytest.raises(UserError, match="several bags named drive"):
        read(tmp_path)
    shutil.rmtree(tmp_path / "a")
    assert [bag.run for bag in find_bags(tmp_path)] == ["drive"]


def test_a_chunk_of_zeros_is_no_empty_chunk(tmp_path: Path) -> None:
    """Records of length zero are skipped without a word, and the bag counts more than it has."""
    path = simple().write(tmp_path / "drive", "mcap")
    file = next(path.glob("*.mcap"))
    whole = file.read_bytes()
    image = whole.index(bytes([9]) * 20)  # pixels of the image of value 9 and what follows them
    file.write_bytes(whole[:image] + bytes(4000) + whole[image + 4000 :])
    with pytest.raises(UserError, match=r"counts 11 messages more than can be read: try"):
        write_recording(read(path), tmp_path / "out")
    written = write_recording(read(path), tmp_path / "kept", skip_bad=True)
    assert 2 <= len(written.dataset.frames) < 5
    assert "messages more than can be read" in written.skipped[-1].reason
