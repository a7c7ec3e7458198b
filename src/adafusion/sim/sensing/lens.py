# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What happens to light between the world and the sensor: all in linear RGB, size unchanged."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Float32, Float64

from adafusion.sim.numeric import Vector, inlined, kernel, keyed_rng, smooth
from adafusion.sim.sensing.projection import View, undistorted

# A sharp core and two wide skirts, as shares of the light. Linear: a lamp blooms because it is
# a thousand times as bright as its street, and no threshold decides what a lamp is.
_SKIRTS = ((0.030, 0.012), (0.015, 0.070))  # share, sigma over the picture's width
_VEIL = 3e-3  # of Stiles and Holladay's glare formula, with the angle in radians
_SUN_CORE_RAD = 0.035
_LONGEST_PX = 24.0  # a longer trail costs more than it shows


class Motion(NamedTuple):
    """How the vehicle moves while the shutter is open."""

    speed_m_s: float = 0.0  # forwards
    yaw_rate_rad_s: float = 0.0  # to the left


STILL = Motion()


def spread(light: Float32[np.ndarray, "h w 3"], blur_px: float) -> Float32[np.ndarray, "h w 3"]:
    """Blur by `blur_px` (sigma), and bloom: bright things spill light over the picture."""
    h, w = light.shape[:2]
    core = cv2.GaussianBlur(light, (3, 3), blur_px) if blur_px > 0.0 else light
    scale = max(w // 100, 1)  # skirts are smooth: a small picture will do for them
    small = cv2.resize(light, (w // scale, h // scale), interpolation=cv2.INTER_AREA)
    skirts = sum(
        share * cv2.GaussianBlur(small, (0, 0), sigma * w / scale) for share, sigma in _SKIRTS
    )
    core = core * np.float32(1.0 - sum(share for share, _ in _SKIRTS))
    core += cv2.resize(skirts, (w, h), interpolation=cv2.INTER_LINEAR)
    return core


def sun_veil(
    view: View, sun: Vector, sun_rgb: Vector, size: tuple[int, int]
) -> Float32[np.ndarray, "h w 3"]:
    """Light of the sun that the lens scatters, whether the sun is in the picture or beside it."""
    h, w = size
    right, down, ahead = (view.R_world_camera.T @ np.array(sun)).tolist()
    x = ((np.arange(w, dtype=np.float32) - view.cx) / view.fx)[None, :]
    y = ((np.arange(h, dtype=np.float32) - view.cy) / view.fy)[:, None]
    cosine = (x * right + y * down + ahead) / np.sqrt(x * x + y * y + 1.0)
    angle2 = 2.0 * (1.0 - cosine)  # near enough to the square of the angle
    falls_in = smooth(0.0, 0.6, ahead)  # a hood
    veil = (_VEIL * falls_in / (angle2 + _SUN_CORE_RAD**2)).astype(np.float32)
    return veil[:, :, None] * np.array(sun_rgb, np.float32)


def smear(
    light: Float32[np.ndarray, "h w 3"],
    depth: Float32[np.ndarray, "h w"],
    view: View,
    T_body_camera: Float64[np.ndarray, "4 4"],
    motion: Motion,
    exposure_s: float,
) -> Float32[np.ndarray, "h w 3"]:
    """Motion blur: each pixel is a mean along its own image flow during the exposure.

    Flow falls with `depth` (metres along the ray) where the vehicle drives and not where it
    turns. A blur of less than half a pixel, even of what is a metre away, is left out.
    """
    turn = np.array([0.0, 0.0, motion.yaw_rate_rad_s])
    drive = np.array([motion.speed_m_s, 0.0, 0.0]) + np.cross(turn, T_body_camera[:3, 3])
    reach = exposure_s * view.fx * (abs(motion.speed_m_s) + abs(motion.yaw_rate_rad_s))
    if reach < 0.5:
        return light
    R = T_body_camera[:3, :3]
    vx, vy, vz = (R.T @ drive * exposure_s).tolist()
    wx, wy, wz = (R.T @ turn * exposure_s).tolist()
    out = np.empty_like(light)
    _smear(light, depth, view, (vx, vy, vz), (wx, wy, wz), out)
    return out


@kernel
def _smear(
    light: Float32[np.ndarray, "h w 3"],
    depth: Float32[np.ndarray, "h w"],
    view: View,
    shift: Vector,
    turn: Vector,
    out: Float32[np.ndarray, "h w 3"],
) -> None:
    """`shift` (metres) and `turn` (radians) are those of the camera, in its own axes."""
    h, w = depth.shape
    for i in range(h):
        for j in range(w):
            du, dv = _flow(view, i, j, depth[i, j], shift, turn)
            length = math.sqrt(du * du + dv * dv)
            steps = int(min(length, _LONGEST_PX)) + 1
            if length < 0.5:
                for c in range(3):
                    out[i, j, c] = light[i, j, c]
                continue
            r, g, b = 0.0, 0.0, 0.0
            for k in range(steps + 1):
                s = k / steps - 0.5
                y = min(max(i + s * dv, 0.0), h - 1.001)
                x = min(max(j + s * du, 0.0), w - 1.001)
                a, e = int(y), int(x)
                fy, fx = y - a, x - e
                p, q = (1.0 - fy) * (1.0 - fx), (1.0 - fy) * fx
                m, n = fy * (1.0 - fx), fy * fx
                r += p * light[a, e, 0] + q * light[a, e + 1, 0]
                r += m * light[a + 1, e, 0] + n * light[a + 1, e + 1, 0]
                g += p * light[a, e, 1] + q * light[a, e + 1, 1]
                g += m * light[a + 1, e, 1] + n * light[a + 1, e + 1, 1]
                b += p * light[a, e, 2] + q * light[a, e + 1, 2]
                b += m * light[a + 1, e, 2] + n * light[a + 1, e + 1, 2]
            share = 1.0 / (steps + 1)
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = r * share, g * share, b * share


@inlined
def _flow(
    view: View, i: int, j: int, distance: float, shift: Vector, turn: Vector
) -> tuple[float, float]:
    """Columns and rows that a point moves in the picture while the camera moves."""
    x, y = undistorted((j - view.cx) / view.fx, (i - view.cy) / view.fy, view.distortion)
    near = math.sqrt(x * x + y * y + 1.0) / distance  # one over the depth along the axis
    # the point goes the other way than the camera: -shift - turn x point, over its depth
    px = -shift[0] * near - (turn[1] - turn[2] * y)
    py = -shift[1] * near - (turn[2] * x - turn[0])
    pz = -shift[2] * near - (turn[0] * y - turn[1] * x)
    return (px - x * pz) * view.fx, (py - y * pz) * view.fy


def spatter(
    light: Float32[np.ndarray, "h w 3"], rain_mm_h: float, seed: int
) -> Float32[np.ndarray, "h w 3"]:
    """Drops on the lens, out of focus: each shows a wide view of the picture upside down."""
    rng = keyed_rng(seed, "lens", "drops")
    h, w = light.shape[:2]
    out = light.copy()
    wide = cv2.GaussianBlur(light, (0, 0), 0.02 * w)
    count = rng.poisson(6.0 * math.sqrt(rain_mm_h))
    centre = rng.uniform((0.0, 0.0), (w, h), (count, 2))
    radius = w * 0.045 * rng.uniform(0.25, 1.0, count) ** 1.5
    _refract(wide, np.column_stack([centre, radius]), out)
    return out


@kernel
def _refract(
    wide: Float32[np.ndarray, "h w 3"],
    drops: Float64[np.ndarray, "n 3"],
    out: Float32[np.ndarray, "h w 3"],
) -> None:
    h, w = out.shape[:2]
    for k in range(len(drops)):
        x, y, radius = drops[k, 0], drops[k, 1], drops[k, 2]
        for i in range(max(int(y - radius), 0), min(int(y + radius) + 1, h)):
            for j in range(max(int(x - radius), 0), min(int(x + radius) + 1, w)):
                dx, dy = (j - x) / radius, (i - y) / radius
                r = math.sqrt(dx * dx + dy * dy)
                share = 0.85 * (1.0 - smooth(0.35, 1.0, r))
                a = int(min(max(y - 0.25 * h * dy, 0.0), h - 1.0))
                b = int(min(max(x - 0.25 * w * dx, 0.0), w - 1.0))
                for c in range(3):
                    out[i, j, c] += share * (wide[a, b, c] - out[i, j, c])


def smudge(size: tuple[int, int], seed: int) -> Float32[np.ndarray, "h w 1"]:
    """Share of light that a dirty lens lets through: a large dark blot, far out of focus."""
    rng = keyed_rng(seed, "lens", "dirt")
    h, w = size
    x = (np.arange(w) / w)[None, :]
    y = (np.arange(h) / h)[:, None]
    heart = rng.uniform(0.3, 0.7, 2)
    clear: Float[np.ndarray, "h w"] = np.ones((h, w))
    for _ in range(4):
        a, b = heart + rng.uniform(-0.2, 0.2, 2)
        wide, tall = rng.uniform(0.15, 0.35, 2)
        clear *= 1.0 - 0.97 * np.exp(-((((x - a) / wide) ** 2 + ((y - b) / tall) ** 2) ** 2))
    return clear.astype(np.float32)[:, :, None]
