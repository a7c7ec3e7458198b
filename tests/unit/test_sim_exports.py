# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The bytes of each layout, from arrays made by hand and decoded by the published description."""

from __future__ import annotations

import errno
import json
import math
import struct
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from adafusion.geometry import pose_from_xyz_yaw, rotation_from_rpy
from adafusion.sim.exports import nclt, pointnetvlad, robotcar
from adafusion.sim.exports.frames import geodetic, ins_along, pose_of, six_numbers
from adafusion.sim.exports.layout import Layout, Piece, write_layout
from adafusion.sim.exports.pictures import undistortion
from adafusion.sim.exports.pushbroom import INS, LMS, LMS_FRONT, fan, mounting
from adafusion.sim.numeric import keyed_rng
from adafusion.sim.run.route import Drive
from adafusion.sim.sensing.camera import Camera
from adafusion.types import UserError

# ------------------------------------------------------------------------------------------ layout


def layout(calls: list[str], *, seed: int = 1, fail: OSError | None = None) -> Layout:
    def encode(name: str) -> bytes:
        if fail is not None and name == "b":
            raise fail
        calls.append(name)
        return name.encode()

    pieces = [Piece("x/a.txt", lambda: encode("a")), Piece("x/b.txt", lambda: encode("b"))]
    return Layout({"synthetic": True, "seed": seed}, pieces)


def test_it_goes_on_after_a_cut_and_keeps_what_is_there(tmp_path: Path) -> None:
    out, calls = tmp_path / "out", []
    full = OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(UserError, match=r"No space left.*whole files are kept"):
        write_layout(layout(calls, fail=full), out)
    assert calls == ["a"]
    assert not out.exists()
    assert not (tmp_path / "out.partial" / "manifest.json").exists()
    litter = tmp_path / "out.partial" / "x" / ".b.tmp-0123456789abcdef.txt"
    litter.write_text("half")
    write_layout(layout(calls), out)
    assert calls == ["a", "b"]
    there = sorted(path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file())
    assert there == ["manifest.json", "x/a.txt", "x/b.txt"]
    assert json.loads((out / "manifest.json").read_text()) == {"synthetic": True, "seed": 1}


def test_it_does_not_go_on_under_other_settings(tmp_path: Path) -> None:
    out, calls = tmp_path / "out", []
    with pytest.raises(UserError):
        write_layout(layout(calls, fail=OSError(errno.EROFS, "Read-only file system")), out)
    with pytest.raises(UserError, match=r"other settings.*manifest\.begun\.json"):
        write_layout(layout(calls, seed=2), out)


def test_it_finishes_what_only_lacked_its_name(tmp_path: Path) -> None:
    out, calls = tmp_path / "out", []
    write_layout(layout(calls), out)
    out.rename(tmp_path / "out.partial")
    write_layout(layout(calls), out)
    assert calls == ["a", "b"]
    assert (out / "manifest.json").exists()


def test_it_leaves_an_existing_folder_alone(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="exists"):
        write_layout(layout([]), tmp_path)


def test_it_names_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        write_layout(layout([]), tmp_path / "file" / "out")


# ------------------------------------------------------------------------------------------- poses


def test_six_numbers_are_those_that_a_pose_was_made_from() -> None:
    numbers = [(1.0, -2.0, 3.0, 0.1, -0.2, 3.0), (0.0, 0.0, 0.0, -1.0, 1.2, -2.0)]
    T = np.stack([pose_of(row) for row in numbers])
    np.testing.assert_allclose(six_numbers(T), numbers, atol=1e-12)
    np.testing.assert_allclose(T[0, :3, :3], rotation_from_rpy(0.1, -0.2, 3.0), atol=1e-12)


def a_drive(off_m: np.ndarray, turned_rad: np.ndarray) -> Drive:
    """East at 5 m/s, a frame every 10 m; the INS is off to the north and turned."""
    n = len(off_m)
    true = np.stack([pose_from_xyz_yaw(10.0 * k, 0.0, 0.0, 0.0) for k in range(n)])
    said = np.stack(
        [
            pose_from_xyz_yaw(10.0 * k, off, 0.0, turned)
            for k, (off, turned) in enumerate(zip(off_m.tolist(), turned_rad.tolist(), strict=True))
        ]
    )
    time, nothing = 2_000_000 * np.arange(n), np.zeros(n)
    return Drive(
        T_world_body=true,
        T_world_ins=said,
        timestamp_us=time,
        zone=("street",) * n,
        speed_m_s=nothing,
        yaw_rate_rad_s=nothing,
        path=true[:, :2, 3],
        path_heading_rad=nothing,
        path_tilt_rad=np.zeros((n, 2)),
        path_time_us=time,
    )


def test_a_steady_error_of_the_ins_is_kept() -> None:
    way = a_drive(np.full(6, 2.0), np.full(6, 0.1))
    time = np.array([-1_000_000, 0, 3_000_000, 12_000_000])
    true = np.stack([pose_from_xyz_yaw(5e-6 * t, 0.0, 0.0, 0.0) for t in time.tolist()])
    said = six_numbers(ins_along(way, true, time))
    np.testing.assert_allclose(said[:, 0], true[:, 0, 3])
    np.testing.assert_allclose(said[:, 1], 2.0)
    np.testing.assert_allclose(said[:, 5], 0.1)


def test_the_track_of_the_ins_is_off_but_hardly_bent() -> None:
    way = a_drive(1.0 + 0.6 * np.sin(np.arange(60) / 6.0), np.zeros(60))
    time = np.arange(0, 118_000_000, 100_000)
    true = np.stack([pose_from_xyz_yaw(5e-6 * t, 0.0, 0.0, 0.0) for t in time.tolist()])
    off = ins_along(way, true, time)[:, 1, 3]
    assert off.mean() == pytest.approx(1.0, abs=0.2)
    slope = np.diff(off) / 0.5
    assert 0.0 < np.abs(np.diff(slope)).max() < np.radians(0.5)


def test_one_degree_of_latitude_is_111_kilometres() -> None:
    north, east = np.array([111_319.49, 0.0]), np.array([0.0, 0.5 * 111_319.49])
    latitude, longitude = (np.degrees(a) for a in geodetic(north, east, (60.0, 20.0)))
    np.testing.assert_allclose(latitude, [61.0, 60.0], atol=1e-6)
    np.testing.assert_allclose(longitude, [20.0, 21.0], atol=1e-6)


# -------------------------------------------------------------------------------------------- NCLT


def test_a_point_of_nclt_is_eight_bytes() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, -2.0, 0.005], [-100.0, 227.675, 0.0024]])
    data = nclt.encode_scan(points, np.uint8([0, 7, 31]), np.uint8([0, 255, 20]))
    assert list(struct.iter_unpack("<HHHBB", data)) == [
        (20000, 20000, 20000, 0, 0),
        (20200, 19600, 20001, 255, 7),
        (0, 65535, 20000, 20, 31),
    ]


def test_a_point_of_nclt_that_is_too_far_is_refused() -> None:
    with pytest.raises(ValueError, match=r"227\.675"):
        nclt.encode_scan(np.array([[-100.1, 0.0, 0.0]]), np.uint8([0]), np.uint8([0]))


def test_the_laser_of_nclt_sees_no_farther_than_a_point_can_be() -> None:
    """So that no run meets the refusal: its farthest return is well within 100 m of the body."""
    assert nclt.velodyne(512).range_m + abs(nclt.BODY_VELODYNE_M[2]) < 95.0


def test_lasers_of_nclt_are_numbered_from_the_top() -> None:
    """The sensor hangs upside down: its lowest laser, number 0, looks up by 30.67 degrees."""
    elevation = np.degrees(nclt.velodyne(512).elevations_rad)
    by_laser = elevation[np.argsort(nclt.laser_ids())]
    np.testing.assert_allclose(
        by_laser[[0, 1, 2, 15, 31]], [30.67, 9.33, 29.33, 0, -10.67], atol=0.02
    )
    assert nclt.velodyne(512).T_body_lidar[2, 3] == pytest.approx(0.957)


def test_the_camera_of_nclt_sits_about_where_the_real_one_does() -> None:
    numbers = nclt.lb3_camera(nclt.ladybug(4))
    published = (0.041862, -0.001905, -0.000212, 160.868615, 89.914152, 160.619894)
    np.testing.assert_allclose(numbers[:3], published[:3], atol=0.01)
    ours, real = (rotation_from_rpy(*np.radians(angles)) for angles in (numbers[3:], published[3:]))
    turn = math.degrees(math.acos((np.trace(ours.T @ real) - 1.0) / 2.0))
    assert turn < 1.0


def test_a_point_meets_its_pixel_of_the_undistorted_picture_of_nclt() -> None:
    """Through K, camera and Ladybug as NCLT's sample does it; then turned upright, clockwise."""
    camera = nclt.ladybug(4)
    h, w = camera.size
    body = np.array([[8.0, 1.5, -2.0, 1.0]])  # ahead, to the right, above
    T_body_lb3 = pose_of((0.035, 0.002, -1.23, *np.radians((-179.93, -0.23, 0.50))))
    numbers = nclt.lb3_camera(camera)
    T_lb3_camera = pose_of((*numbers[:3], *np.radians(numbers[3:])))
    seen = np.linalg.inv(T_lb3_camera) @ np.linalg.inv(T_body_lb3) @ body[0]
    x, y, depth = nclt.raw_intrinsics(camera) @ seen[:3]
    column, row = x / depth, y / depth
    upright = (w - 1 - row, column)  # column and row after a quarter turn clockwise

    ahead = np.linalg.inv(camera.T_body_camera) @ (8.0, -1.5, 2.0, 1.0)
    u, v, d = camera.K @ ahead[:3]
    np.testing.assert_allclose(upright, (u / d, v / d), atol=1e-6)
    assert upright[0] > w / 2
    assert upright[1] < h / 2


def test_the_map_of_nclt_leads_from_undistorted_to_raw_pixels() -> None:
    camera = nclt.ladybug(16)
    h, w = camera.size
    ray = np.array([[0.5, -0.3, 1.0]])
    u, v, _ = camera.K @ ray[0]
    still = np.zeros(3)
    raw = cv2.projectPoints(ray, still, still, camera.K, np.array(camera.distortion))[0].ravel()
    row_column = nclt.u2d(camera).astype(np.float32)
    assert row_column.shape == (w, h, 2)
    # on its side: the column is the upright row, the row counts from the right
    at = np.float32([[v]]), np.float32([[w - 1 - u]])
    found = [float(cv2.remap(row_column[..., c], *at, cv2.INTER_LINEAR)[0, 0]) for c in (0, 1)]
    np.testing.assert_allclose(found, (w - 1 - raw[0], raw[1]), atol=0.02)


def test_the_map_of_nclt_has_the_published_form() -> None:
    text = nclt.encode_u2d(np.arange(12.0).reshape(2, 3, 2)).decode().splitlines()
    assert "".join(c for c in text[0] if c.isdigit() or c == ",") == "3,2"
    assert len(text) == 7
    assert [float(x) for x in text[5].split(" ")] == [1, 1, 8, 9]  # row, column, row, column


def test_pictures_of_nclt_are_upright_after_a_quarter_turn_clockwise() -> None:
    upright = np.random.default_rng(1).integers(0, 256, (12, 9, 3), np.uint8)
    raw = cv2.imdecode(np.frombuffer(nclt.encode_picture(upright), np.uint8), cv2.IMREAD_COLOR)
    assert raw.shape == (9, 12, 3)
    turned = cv2.rotate(raw, cv2.ROTATE_90_CLOCKWISE)
    np.testing.assert_array_equal(cv2.cvtColor(turned, cv2.COLOR_BGR2RGB), upright)


def test_a_track_of_nclt_is_a_line_a_pose() -> None:
    poses = np.array([[np.nan] * 6, [1.5, -2.0, 0.25, 0.1, -0.2, 3.0]])
    text = nclt.encode_track(np.array([1_326_652_795_280_148, 1_326_652_795_290_148]), poses)
    first, second = text.decode().splitlines()
    assert first == "1326652795280148,nan,nan,nan,nan,nan,nan"
    assert [float(x) for x in second.split(",")] == [
        *(1_326_652_795_290_148, 1.5, -2.0, 0.25, 0.1, -0.2, 3.0)
    ]


# ---------------------------------------------------------------------------------------- RobotCar


def test_a_scan_of_robotcar_is_three_doubles_a_point() -> None:
    data = robotcar.encode_scan(np.array([[1.5, -2.0], [0.25, 3.0]]), np.array([7.0, 9.0]))
    assert struct.unpack("<6d", data) == (1.5, -2.0, 7.0, 0.25, 3.0, 9.0)


def test_the_fan_of_robotcar_is_upright_and_open_above() -> None:
    directions = fan()
    angle = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    np.testing.assert_allclose(angle[[0, 270, 540]], [-135.0, 0.0, 135.0], atol=1e-9)
    T = mounting(LMS_FRONT)
    assert T[2, 0] < -0.99  # its middle ray goes down ...
    assert 0.5 < T[2, 3] < 0.6  # ... from low on the front
    assert abs(T[0, 1]) < 0.15  # and the fan is across the way
    assert LMS.steps == 541


def test_mountings_of_robotcar_are_told_from_the_camera() -> None:
    """In z-down axes: the INS is behind and below the camera, a little to its right."""
    x, y, z = mounting(INS)[:3, 3]
    assert (x, y, z) == pytest.approx((0.4 - 1.7132, -0.1181, 1.6 - 1.1948))
    assert mounting((0.0,) * 6)[:3, :3].diagonal().tolist() == [1.0, -1.0, -1.0]


def test_timestamps_of_robotcar_come_with_their_chunk() -> None:
    assert robotcar.encode_timestamps(np.array([12, 345])) == b"12 1\n345 1\n"


def test_pictures_of_robotcar_are_green_blue_red_green() -> None:
    rgb = np.zeros((4, 6, 3), np.uint8) + np.array([200, 100, 50], np.uint8)
    data = np.frombuffer(robotcar.encode_picture(rgb), np.uint8)
    raw = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    assert raw.shape == (4, 6)
    assert raw[:2, :2].tolist() == [[100, 50], [200, 100]]


def test_the_table_of_robotcar_gives_columns_first() -> None:
    column_row = np.stack(np.meshgrid([0.0, 1.0, 2.0], [10.0, 20.0]), axis=-1)
    data = robotcar.encode_lut(column_row)
    assert struct.unpack("<12d", data) == (0, 1, 2, 0, 1, 2, 10, 10, 10, 20, 20, 20)


def test_an_undistorted_pixel_of_robotcar_is_where_the_lens_puts_it() -> None:
    camera = robotcar.bumblebee(8)
    h, w = camera.size
    column_row = undistortion(camera)
    np.testing.assert_allclose(column_row[h // 2, w // 2], (w / 2, h / 2), atol=0.01)
    edge = column_row[h // 2, w - 1, 0]
    x = (w / 2 - 0.5) / (0.753773 * w)
    assert edge == pytest.approx(
        w / 2 - 0.5 + 0.753773 * w * x * (1 - 0.2 * x**2 + 0.06 * x**4), abs=0.01
    )
    straight = replace(camera, distortion=(0.0,) * 5)
    np.testing.assert_allclose(undistortion(straight)[3, 5], (5.0, 3.0), atol=1e-9)


def test_the_model_of_robotcar_has_intrinsics_and_axes() -> None:
    lines = robotcar.encode_model(Camera(size=(96, 128)).K).decode().splitlines()
    assert [float(x) for x in lines[0].split()] == pytest.approx([92.16, 92.16, 63.5, 47.5])
    T_camera_image = np.array([[float(x) for x in line.split()] for line in lines[1:]])
    ahead = T_camera_image @ (0.0, 0.0, 1.0, 1.0)  # along the optical axis
    assert ahead.tolist() == [1.0, 0.0, 0.0, 1.0]
    assert (
        robotcar.encode_extrinsics((1.7589, 0.0, 0.0, 0.0, -1.4572, 0.0356)).split()[4]
        == b"-1.4572"
    )


def test_poses_of_robotcar_are_north_east_down() -> None:
    """A vehicle at x = 3 m east, y = 4 m north, 5 m up that drives east at 2 m/s."""
    T_down_up = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    T = np.stack([T_down_up @ pose_from_xyz_yaw(x, 4.0, 5.0, 0.0) @ flip for x in (3.0, 5.0)])
    for status in (True, False):
        text = robotcar.encode_poses(np.array([0, 1_000_000]), T, status=status)
        head, first, _ = text.decode().splitlines()
        row = dict(zip(head.split(","), first.split(","), strict=True))
        assert ("ins_status" in row) is status
        names = ("northing", "easting", "down", "velocity_north", "velocity_east", "yaw", "roll")
        assert [float(row[name]) for name in names] == pytest.approx(
            [4.0, 3.0, -5.0, 0.0, 2.0, math.pi / 2, 0.0], abs=1e-6
        )
    # readers of ins.csv take columns 5 to 7 and the last three
    assert head.split(",")[4:7] == ["northing", "easting", "down"]
    assert head.split(",")[-3:] == ["roll", "pitch", "yaw"]


# ------------------------------------------------------------------------------------ PointNetVLAD


def street(n: int = 20_000) -> np.ndarray:
    """A road with a slope and two walls of 6 m, z down, metres."""
    rng = np.random.default_rng(3)
    x, y, u = rng.uniform(0, 20, n), rng.uniform(-8, 8, n), rng.uniform(0, 6, n)
    road = np.column_stack([x, y, 1.0 + 0.03 * x + 0.02 * rng.standard_normal(n)])
    walls = np.column_stack([x, np.where(rng.random(n) < 0.5, -8.0, 8.0), 1.0 + 0.03 * x - u])
    return np.concatenate([road, walls])


def test_the_road_is_cut_and_walls_stay() -> None:
    points = street()
    road = pointnetvlad.on_road(points, keyed_rng(1, "t"))
    assert road[:20_000].mean() > 0.999
    high = points[20_000:, 2] < 1.0 + 0.03 * points[20_000:, 0] - 0.7
    assert not road[20_000:][high].any()


def test_a_cloud_without_level_ground_stays_whole() -> None:
    wall = np.random.default_rng(1).uniform(0, 5, (500, 3)) * (1.0, 0.0, 1.0)
    assert not pointnetvlad.on_road(wall, keyed_rng(1, "t")).any()


def test_a_submap_is_normalised_and_negated() -> None:
    points = street()
    submap = pointnetvlad.make_submap(points, keyed_rng(1, "t"))
    assert submap.points.shape == (4096, 3)
    assert np.abs(submap.points).max() <= 1.0
    assert np.linalg.norm(submap.points, axis=1).mean() == pytest.approx(0.5, abs=0.05)
    assert np.abs(submap.points.mean(axis=0)).max() < 0.05
    metres = submap.centroid - submap.points / submap.scale
    assert (np.abs(np.abs(metres[:, 1]) - 8.0) < 0.01).mean() > 0.98  # the walls
    assert (metres[:, 2] < 1.2).all()
    assert submap.points[metres[:, 2].argmin(), 2] == submap.points[:, 2].max()  # high is large


def test_a_cloud_is_thinned_out_evenly() -> None:
    points = np.concatenate(
        [np.random.default_rng(1).uniform(0, 1, (30_000, 3)), np.full((30_000, 3), 0.5)]
    )
    thin = pointnetvlad.thin_out(points, keyed_rng(1, "t"))
    assert thin.shape == (4096, 3)
    assert (thin == 0.5).all(axis=1).sum() < 200  # half of all points are one place
    few = pointnetvlad.thin_out(points[:100], keyed_rng(1, "t"))
    assert len(np.unique(few.round(9), axis=0)) == 100


def test_the_road_alone_is_no_submap_nor_is_nothing() -> None:
    flat = np.random.default_rng(1).uniform(0, 5, (500, 3)) * (1.0, 1.0, 0.0)
    with pytest.raises(ValueError, match="road alone"):
        pointnetvlad.make_submap(flat, keyed_rng(1, "t"))
    with pytest.raises(ValueError, match="no scan had an echo"):
        pointnetvlad.make_submap(flat[:0], keyed_rng(1, "t"))


def test_a_submap_is_points_one_after_the_other() -> None:
    points = np.linspace(-1.0, 1.0, 4096 * 3).reshape(4096, 3)
    data = pointnetvlad.encode_points(points)
    assert len(data) == 98_304
    assert struct.unpack_from("<3d", data, 24) == tuple(points[1])
