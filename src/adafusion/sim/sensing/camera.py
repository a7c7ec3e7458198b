# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A camera: from the light in a scene to the picture of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt8

from adafusion.sim.numeric import kernel
from adafusion.sim.run.conditions import Conditions
from adafusion.sim.sensing.bvh import new_stack
from adafusion.sim.sensing.lens import STILL, Motion, smear, smudge, spatter, spread, sun_veil
from adafusion.sim.sensing.lighting import Light, light_of, nearest_lamps
from adafusion.sim.sensing.projection import Brown, View, distorted, undistorted
from adafusion.sim.sensing.rendering import render
from adafusion.sim.sensing.scene import Scene, blocked, shelters, zone_of
from adafusion.sim.sensing.sensor import BAYER, Sensor, demosaic, develop, meter, mosaic

_INDOORS_M = 80.0  # a passage farther away is not looked into: the haze before it is all one
_SNOW_BIAS = 2.0  # a meter takes snow for grey; its owner tells it better
_STUCK_BIAS = 12.0


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera that looks forward; size as (height, width) in pixels.

    A pinhole, unless `distortion` gives k1, k2, p1, p2, k3 of Brown's lens (OpenCV's order). With
    a `bayer` pattern ("RGGB", "GBRG") each pixel counts one colour and the others are filled in.
    """

    size: tuple[int, int] = (150, 200)
    focal: float = 0.72  # focal length over image width
    distortion: Brown = (0.0, 0.0, 0.0, 0.0, 0.0)
    bayer: str = ""
    height_m: float = 1.6
    forward_m: float = 0.4
    pitch_down_rad: float = -0.03  # the road needs less of the picture than the houses
    blur_px: float = 0.45  # sigma of the lens
    full_well: float = 9000.0  # electrons at white, at gain 1
    sensitivity: float = 7.2e6  # electrons a second and unit of radiance
    longest_s: float = 0.015  # a moving camera may not expose for longer
    shortest_s: float = 2e-5
    largest_gain: float = 4.5
    read_noise: float = 4.0  # electrons
    key: float = 0.25  # where the meter wants the picture's mean

    def __post_init__(self) -> None:
        if min(self.size) < 8:
            raise ValueError(f"an image of {self.size} pixels shows nothing")
        if self.bayer not in BAYER:
            raise ValueError(f"bayer = {self.bayer!r} is none of {', '.join(BAYER[1:])}")
        if any(self.distortion) and not self._is_one_to_one():
            raise ValueError(f"distortion {self.distortion} folds the picture over itself")

    @property
    def K(self) -> Float64[np.ndarray, "3 3"]:
        """Intrinsic matrix in pixels."""
        h, w = self.size
        f = self.focal * w
        return np.array([[f, 0.0, w / 2 - 0.5], [0.0, f, h / 2 - 0.5], [0.0, 0.0, 1.0]])

    @property
    def T_body_camera(self) -> Float64[np.ndarray, "4 4"]:
        """Pose of the camera (x right, y down, z forward) on the vehicle."""
        c, s = math.cos(self.pitch_down_rad), math.sin(self.pitch_down_rad)
        T = np.eye(4)
        T[:3, :3] = np.array([[0.0, -s, c], [-1.0, 0.0, 0.0], [0.0, -c, -s]])
        T[:3, 3] = (self.forward_m, 0.0, self.height_m)
        return T

    @property
    def sensor(self) -> Sensor:
        """What its sensor counts with."""
        return Sensor(
            full_well=self.full_well,
            sensitivity=self.sensitivity,
            shortest_s=self.shortest_s,
            longest_s=self.longest_s,
            largest_gain=self.largest_gain,
            read_noise=self.read_noise,
            key=self.key,
        )

    def view(self, T_world_body: Float[np.ndarray, "4 4"]) -> View:
        """Where the camera of a vehicle is and how it projects."""
        T, K = T_world_body @ self.T_body_camera, self.K
        x, y, z = T[:3, 3].tolist()
        return View(
            eye=(x, y, z),
            R_world_camera=T[:3, :3].copy(),
            fx=K[0, 0],
            fy=K[1, 1],
            cx=K[0, 2],
            cy=K[1, 2],
            distortion=self.distortion,
        )

    def _is_one_to_one(self) -> bool:
        """Whether every pixel of the rim comes back to itself through lens and inverse."""
        h, w = self.size
        K = self.K
        for i in np.linspace(0.0, h - 1.0, 9).tolist():
            for j in np.linspace(0.0, w - 1.0, 9).tolist():
                x, y = (j - K[0, 2]) / K[0, 0], (i - K[1, 2]) / K[1, 1]
                u, v = undistorted(x, y, self.distortion)
                back_x, back_y = distorted(u, v, self.distortion)
                if not math.hypot(back_x - x, back_y - y) * K[0, 0] < 0.05:  # NaN too
                    return False
        return True


def photograph(
    scene: Scene,
    lamps: Float64[np.ndarray, "m 8"],
    camera: Camera,
    conditions: Conditions,
    T_world_body: Float[np.ndarray, "4 4"],
    seed: int,
    run_seed: int,
    motion: Motion = STILL,
) -> UInt8[np.ndarray, "h w 3"]:
    """Take one picture, RGB.

    `seed` is the frame's noise and drops, `run_seed` the run's clouds, lit windows and dirt.
    A camera fault of the conditions is applied, except "frozen": that is an earlier picture.
    """
    fault = conditions.camera_fault
    view = camera.view(T_world_body)
    outdoors = zone_of(scene.zones, view.eye) < 0
    if fault == "black":  # the cap is on
        light, depth = np.zeros((*camera.size, 3), np.float32), np.ones(camera.size, np.float32)
    else:
        light, depth = radiance(scene, lamps, camera, conditions, T_world_body, run_seed)
        light = spread(light, camera.blur_px)
        sky = light_of(conditions, run_seed)
        if _sees_sun(scene, view, sky):
            light += sun_veil(view, sky.sun, sky.sun_rgb, camera.size)
        if conditions.rain_mm_h > 0.0 and outdoors:
            light = spatter(light, conditions.rain_mm_h, seed)
        if fault == "occluded":
            light *= smudge(camera.size, run_seed)
    bias = 1.0 + _SNOW_BIAS * conditions.snow_cover if outdoors else 1.0
    if fault == "over-exposed":
        bias *= _STUCK_BIAS
    exposure = meter(light, camera.sensor, bias)
    light = smear(light, depth, view, camera.T_body_camera, motion, exposure.seconds)
    image = develop(light, exposure, camera.sensor, seed)
    return demosaic(mosaic(image, camera.bayer), camera.bayer) if camera.bayer else image


def radiance(
    scene: Scene,
    lamps: Float64[np.ndarray, "m 8"],
    camera: Camera,
    conditions: Conditions,
    T_world_body: Float[np.ndarray, "4 4"],
    run_seed: int,
) -> tuple[Float32[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"]]:
    """Linear RGB that reaches the lens, and the distance along each ray in metres."""
    view = camera.view(T_world_body)
    light = np.empty((*camera.size, 3), np.float32)
    depth = np.empty(camera.size, np.float32)
    near = nearest_lamps(scene, lamps, conditions, T_world_body @ camera.T_body_camera)
    indoors = shelters(scene.zones, view.eye, _INDOORS_M)
    render(scene, near, light_of(conditions, run_seed), view, indoors, light, depth)
    return light, depth


@kernel
def _sees_sun(scene: Scene, view: View, light: Light) -> bool:
    """Whether the sun shines on the lens."""
    if light.sun_rgb[0] <= 0.0 or light.sun[2] <= 0.0:
        return False
    return not blocked(scene, new_stack(), view.eye, light.sun, 250.0, light.foliage)
