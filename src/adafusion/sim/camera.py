# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A camera: rays to radiance in one fused kernel, then lens, exposure, noise and tone curve.

Sun with shadows, a sky with clouds, one ambient-occlusion ray, the nearest lamps, headlights and
fog. Pixels on edges get three more rays. The sensor counts electrons (after EMVA 1288), so that a
night is noisy because it is dark.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt8

from adafusion.sim.bvh import Stack, new_stack
from adafusion.sim.conditions import Conditions
from adafusion.sim.numeric import (
    Vector,
    blend,
    dot,
    inlined,
    kernel,
    normal,
    smooth,
    step,
    unit,
    value_noise,
)
from adafusion.sim.scene import (
    Scene,
    blocked,
    outdoor_length,
    texture_uv,
    trace_scene,
    zone_of,
)
from adafusion.sim.shapes import Material
from adafusion.sim.textures import surface

_LEAF, _CAR_BODY = int(Material.LEAF), int(Material.CAR_BODY)
_LAMP, _CAR_LIGHT = int(Material.LAMP), int(Material.CAR_LIGHT)
_LAMP_RADIANCE = 0.12
LAMPS = 16  # the lamps nearest to the camera light the picture


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole camera that looks forward; size as (height, width) in pixels."""

    size: tuple[int, int] = (150, 200)
    focal: float = 0.72  # focal length over image width
    height_m: float = 1.6
    forward_m: float = 0.4
    pitch_down_rad: float = -0.03  # the road needs less of the picture than the houses
    full_well: float = 9000.0  # electrons at white, at gain 1
    sensitivity: float = 7.2e6  # electrons a second and unit of radiance
    longest_s: float = 0.02
    shortest_s: float = 2e-5
    largest_gain: float = 20.0
    read_noise: float = 4.0  # electrons
    key: float = 0.25  # where the meter wants the picture's mean

    def __post_init__(self) -> None:
        if min(self.size) < 8:
            raise ValueError(f"an image of {self.size} pixels shows nothing")

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


def photograph(
    scene: Scene,
    lamps: Float64[np.ndarray, "m 8"],
    camera: Camera,
    conditions: Conditions,
    T_world_body: Float[np.ndarray, "4 4"],
    seed: int,
    run_seed: int,
) -> UInt8[np.ndarray, "h w 3"]:
    """Take one picture. `seed` is the frame's noise, `run_seed` the run's clouds and windows."""
    light = radiance(scene, lamps, camera, conditions, T_world_body, run_seed)
    return develop(light, camera, seed)


def radiance(
    scene: Scene,
    lamps: Float64[np.ndarray, "m 8"],
    camera: Camera,
    conditions: Conditions,
    T_world_body: Float[np.ndarray, "4 4"],
    run_seed: int,
) -> Float32[np.ndarray, "h w 3"]:
    """Linear RGB that reaches the lens."""
    T = T_world_body @ camera.T_body_camera
    h, w = camera.size
    K = camera.K
    x, y, z = T[:3, 3].tolist()
    view = _View((x, y, z), T[:3, :3].copy(), K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    out = np.empty((h, w, 3), np.float32)
    light = light_of(conditions)
    _render(scene, _nearest(scene, lamps, conditions, T), light, view, run_seed, out)
    return out


class Light(NamedTuple):
    """What shines on a scene, linear RGB, in a form that numba takes."""

    sun: Vector  # unit vector towards it
    sun_rgb: Vector  # irradiance at right angles
    zenith: Vector  # radiance of the sky
    horizon: Vector
    cloud: Vector
    cloud_cover: float
    above: Vector  # irradiance from the whole sky on level ground ...
    below: Vector  # ... and from the ground on what faces down
    fog: float  # extinction, per metre
    foliage: float
    lit_windows: float
    window: Vector
    headlights: float


class _View(NamedTuple):
    """Where a camera is and how it projects."""

    eye: Vector
    R_world_camera: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float


def light_of(c: Conditions) -> Light:
    """Sum up the light of the conditions."""
    level = math.cos(c.sun_elevation_rad)
    sun = (
        level * math.cos(c.sun_azimuth_rad),
        level * math.sin(c.sun_azimuth_rad),
        math.sin(c.sun_elevation_rad),
    )
    zenith, horizon, cloud = map(np.array, (c.zenith_rgb, c.horizon_rgb, c.cloud_rgb))
    clear = 0.6 * zenith + 0.4 * horizon
    above = np.pi * ((1 - 0.6 * c.cloud_cover) * clear + 0.6 * c.cloud_cover * cloud)
    # what a street throws back
    below = 0.16 * (above + np.array(c.sun_rgb) * max(sun[2], 0.0)) * (1.0, 0.97, 0.9)
    return Light(
        sun=sun,
        sun_rgb=c.sun_rgb,
        zenith=c.zenith_rgb,
        horizon=c.horizon_rgb,
        cloud=c.cloud_rgb,
        cloud_cover=float(c.cloud_cover),
        above=(float(above[0]), float(above[1]), float(above[2])),
        below=(float(below[0]), float(below[1]), float(below[2])),
        fog=float(c.fog_per_m),
        foliage=float(c.foliage),
        lit_windows=float(c.lit_windows),
        window=c.window_rgb,
        headlights=float(c.headlights),
    )


def _nearest(
    scene: Scene,
    lamps: Float64[np.ndarray, "m 8"],
    conditions: Conditions,
    T_world_camera: Float[np.ndarray, "4 4"],
) -> Float64[np.ndarray, "k 7"]:
    """The lamps that matter: xyz, RGB power, zone; most of them of the camera's own zone."""
    power = np.where(lamps[:, 7:8] > 0, 1.0, conditions.street_lamps)
    lit = np.concatenate([lamps[:, :3], lamps[:, 3:6] * power, lamps[:, 6:7]], axis=1)
    lit = lit[power[:, 0] > 0.0]
    x, y, z = T_world_camera[:3, 3].tolist()
    centre = T_world_camera[:3, 3] + 12.0 * T_world_camera[:3, 2]
    distance = np.linalg.norm(lit[:, :3] - centre, axis=1)
    own = lit[:, 6] == zone_of(scene.zones, (x, y, z))
    order = np.argsort(distance, kind="stable")
    rest = LAMPS // 4
    return np.concatenate([lit[order][own[order]][: LAMPS - rest], lit[order][~own[order]][:rest]])


# ------------------------------------------------------------------------------------ the kernel

# layers of a picture before its ambient light is added: direct RGB, ambient RGB, then
_VISIBLE, _DEPTH, _SURFACE, _LAYERS = 6, 7, 8, 9
_FAR_M = 400.0


@kernel
def _render(
    scene: Scene,
    lamps: Float64[np.ndarray, "k 7"],
    light: Light,
    view: _View,
    seed: int,
    image: Float32[np.ndarray, "h w 3"],
) -> None:
    h, w = image.shape[:2]
    layers = np.empty((h, w, _LAYERS), np.float32)
    extra = np.empty(_LAYERS, np.float32)
    stack = new_stack()
    for i in range(h):
        for j in range(w):
            d = _direction(view, float(i), float(j))
            # every block of 5 x 5 pixels asks all 25 directions for occlusion
            pick = (i % 5) * 5 + j % 5
            _look(scene, stack, lamps, light, view, d, seed, pick, layers[i, j])
    for i in range(h):
        for j in range(w):
            visible, edge = _look_around(layers, i, j)
            own = layers[i, j]
            r, g, b = (
                own[0] + visible * own[3],
                own[1] + visible * own[4],
                own[2] + visible * own[5],
            )
            if edge:
                for k in range(3):
                    di, dj = (0.33, 0.0) if k == 2 else (-0.25, -0.33 + 0.66 * k)
                    d = _direction(view, i + di, j + dj)
                    _look(scene, stack, lamps, light, view, d, seed, -1, extra)
                    seen = visible if extra[_VISIBLE] < 0.0 else 1.0
                    r += extra[0] + seen * extra[3]
                    g += extra[1] + seen * extra[4]
                    b += extra[2] + seen * extra[5]
                r, g, b = 0.25 * r, 0.25 * g, 0.25 * b
            image[i, j, 0], image[i, j, 1], image[i, j, 2] = r, g, b


@inlined
def _direction(view: _View, i: float, j: float) -> Vector:
    """Unit vector in the world through row i and column j."""
    R = view.R_world_camera
    x, y = (j - view.cx) / view.fx, (i - view.cy) / view.fy
    size = 1.0 / math.sqrt(x * x + y * y + 1.0)
    return (
        (R[0, 0] * x + R[0, 1] * y + R[0, 2]) * size,
        (R[1, 0] * x + R[1, 1] * y + R[1, 2]) * size,
        (R[2, 0] * x + R[2, 1] * y + R[2, 2]) * size,
    )


@inlined
def _look_around(layers: Float32[np.ndarray, "h w 9"], i: int, j: int) -> tuple[float, bool]:
    """Mean visibility of the sky over neighbours on the same surface, and whether it ends here."""
    h, w = layers.shape[:2]
    own = layers[i, j]
    total, visible, edge = 0.0, 0.0, False
    for di in range(-2, 3):
        for dj in range(-2, 3):
            a, b = i + di, j + dj
            if a < 0 or b < 0 or a >= h or b >= w:
                continue
            other = layers[a, b]
            near = abs(other[_DEPTH] - own[_DEPTH]) < 0.06 * own[_DEPTH]
            if near and other[_SURFACE] == own[_SURFACE]:
                total += 1.0
                visible += other[_VISIBLE]
            elif abs(di) + abs(dj) == 1 and di + dj > 0:
                edge = True
    return visible / total, edge


@inlined
def _look(
    scene: Scene,
    stack: Stack,
    lamps: Float64[np.ndarray, "k 7"],
    light: Light,
    view: _View,
    d: Vector,
    seed: int,
    pick: int,
    out: Float32[np.ndarray, " 9"],
) -> None:
    """Look along one ray and fill the layers of its pixel.

    Ambient light is kept apart because one occlusion ray says little: `pick` is which of 25
    directions it takes, and neighbours average. With `pick` < 0 none is cast and the visibility
    is -1.
    """
    eye = view.eye
    t, face, b1, b2 = trace_scene(scene, stack, eye, d, _FAR_M, light.foliage)
    if face < 0:
        _look_at_sky(scene, light, eye, d, seed, out)
        return
    n = scene.normal[face, 0], scene.normal[face, 1], scene.normal[face, 2]
    cosine = dot(d, n)
    if cosine > 0.0:
        n = -n[0], -n[1], -n[2]
    cosine = abs(cosine)
    p = step(eye, d, t)
    q = step(p, n, 2e-3)  # off the surface, lest it shades itself
    material, zone = scene.material[face], zone_of(scene.zones, q)
    u, v = texture_uv(scene, face, b1, b2)
    # a slanted pixel is long one way only: the root keeps textures readable along a street
    footprint = t / (view.fx * math.sqrt(max(cosine, 0.02)))
    wu, wv = footprint * scene.uv_per_m[face, 0], footprint * scene.uv_per_m[face, 1]
    row = scene.objects[scene.object_id[face]]
    albedo, glass, glow = surface(material, row, face, u, v, wu, wv, light.lit_windows, seed + 5)
    leaf = material == _LEAF
    sun = _sun_on(scene, stack, light, q, n, leaf)
    direct = step((0.0, 0.0, 0.0), light.sun_rgb, sun)
    direct = _add_lamps(direct, lamps, zone, q, n, leaf)
    direct = _add_headlights(direct, light, view, d, t, cosine, p[2] - eye[2])
    ambient = _ambient(scene, light, zone, n)
    diffuse = (1.0 - 0.9 * glass) / math.pi
    for c in range(3):
        out[c] = albedo[c] * direct[c] * diffuse
        out[3 + c] = albedo[c] * ambient[c] / math.pi
    if zone < 0 and (glass > 0.0 or material == _CAR_BODY):
        _add_mirror(light, d, n, cosine, glass, sun > 0.0, seed, out)
    if material == _LAMP:
        power = _LAMP_RADIANCE if _is_on(lamps, p) else 0.0
        for c in range(3):
            out[c] += glow[c] * power
    elif material == _CAR_LIGHT:  # a lens that throws some daylight back
        for c in range(3):
            out[3 + c] += 0.3 * glow[c] * ambient[c]
    else:
        for c in range(3):
            out[c] += glow[c] * light.window[c]
    near = 1.2 if zone >= 0 else 7.0
    open_sky = _open_sky(scene, stack, q, n, pick, near, light.foliage)
    shaded = 0.4 if leaf else 0.15
    out[_VISIBLE] = -1.0 if pick < 0 else (1.0 if open_sky else shaded)
    out[_DEPTH] = t
    # objects, and faces of one object that look another way, are surfaces of their own
    way = math.floor(n[0] * 1.9 + 2.0) + 0.3 * math.floor(n[1] * 1.9 + 2.0)
    out[_SURFACE] = scene.object_id[face] * 8.0 + way
    _add_fog(scene, light, eye, d, t, out)


@inlined
def _look_at_sky(
    scene: Scene, light: Light, eye: Vector, d: Vector, seed: int, out: Float32[np.ndarray, " 9"]
) -> None:
    """Fill the layers of a pixel that sees no surface."""
    sky = _sky(light, (d[0], d[1], max(d[2], 0.0)), seed, True)
    land = 1.0 - 0.55 * smooth(0.0, 0.05, -d[2])  # open land beyond the town
    for c in range(3):
        out[c], out[3 + c] = sky[c] * land, 0.0
    out[_VISIBLE], out[_DEPTH], out[_SURFACE] = 1.0, _FAR_M, -1.0
    # fog lies 40 m deep
    _add_fog(scene, light, eye, d, _FAR_M if d[2] < 0.02 else min(_FAR_M, 40.0 / d[2]), out)


@inlined
def _sky(light: Light, d: Vector, seed: int, clouds: bool) -> Vector:
    """Radiance of the sky in a direction; the sun's disc is a glow that no lens resolves."""
    rgb = blend(light.horizon, light.zenith, 1.0 - (1.0 - max(d[2], 0.0)) ** 4)
    facing = max(dot(d, light.sun), 0.0)
    glow = 0.10 * facing**6 + 0.25 * facing**40 + 6.0 * smooth(0.9990, 0.9997, facing)
    cover = light.cloud_cover
    if clouds and cover > 0.0 and d[2] > 0.015:
        scale = 1.1 / (d[2] + 0.10)
        x, y = d[0] * scale, d[1] * scale
        n = 0.52 * value_noise(x, y, seed) + 0.28 * value_noise(2.3 * x, 2.1 * y, seed + 1)
        n += 0.20 * value_noise(5.1 * x, 4.7 * y, seed + 2)
        dense = smooth(0.80 - 0.75 * cover, 1.10 - 0.75 * cover, n) * smooth(0.015, 0.12, d[2])
        rgb = blend(rgb, step((0.0, 0.0, 0.0), light.cloud, 1.12 - 0.35 * n), dense)
        glow *= 1.0 - 0.8 * dense
    return step(rgb, light.sun_rgb, glow)


@inlined
def _sun_on(scene: Scene, stack: Stack, light: Light, q: Vector, n: Vector, leaf: bool) -> float:
    """Cosine of the sun on a surface, 0 in the shade."""
    if light.sun_rgb[0] <= 0.0 or light.sun[2] <= 0.0:
        return 0.0
    sun = dot(n, light.sun)
    if leaf:  # light also comes through
        sun = 0.25 + 0.75 * (sun if sun > 0.0 else -0.45 * sun)
    if sun <= 0.0 or blocked(scene, stack, q, light.sun, 250.0, light.foliage):
        return 0.0
    return sun


@inlined
def _add_lamps(
    rgb: Vector, lamps: Float64[np.ndarray, "k 7"], zone: int, q: Vector, n: Vector, leaf: bool
) -> Vector:
    """Add the irradiance of the lamps of the point's own zone; they shine down, without shadows."""
    for k in range(len(lamps)):
        if lamps[k, 6] != zone:
            continue
        x, y, z = lamps[k, 0] - q[0], lamps[k, 1] - q[1], lamps[k, 2] - q[2]
        d2 = x * x + y * y + z * z + 0.05
        inverse = 1.0 / math.sqrt(d2)
        lit = (n[0] * x + n[1] * y + n[2] * z) * inverse
        if leaf:
            lit = 0.4 + 0.6 * abs(lit)
        elif zone >= 0:
            lit = 0.2 + 0.8 * max(lit, 0.0)  # walls light each other
        if lit > 0.0:
            power = lit * (0.10 + 0.90 * smooth(0.10, 0.55, z * inverse)) / d2
            rgb = step(rgb, (lamps[k, 3], lamps[k, 4], lamps[k, 5]), power)
    return rgb


@inlined
def _add_headlights(
    rgb: Vector, light: Light, view: _View, d: Vector, t: float, cosine: float, above: float
) -> Vector:
    """Add the vehicle's own light: it comes from the camera's place, so it needs no shadow ray."""
    if light.headlights <= 0.0:
        return rgb
    R = view.R_world_camera
    axis = d[0] * R[0, 2] + d[1] * R[1, 2] + d[2] * R[2, 2]
    power = 1.3 * light.headlights * cosine * smooth(0.72, 0.99, axis) / (t * t + 30.0)
    power *= 1.0 - 0.85 * smooth(0.4, 2.2, above + 1.0)  # dipped
    return step(rgb, (1.0, 0.95, 0.85), power)


@inlined
def _ambient(scene: Scene, light: Light, zone: int, n: Vector) -> Vector:
    """Irradiance from all around, before occlusion."""
    if zone >= 0:
        bounce = math.pi * scene.zones[zone, 6]
        return bounce, 0.97 * bounce, 0.88 * bounce
    return blend(light.below, light.above, 0.5 + 0.5 * n[2])


@inlined
def _open_sky(
    scene: Scene, stack: Stack, q: Vector, n: Vector, pick: int, near: float, foliage: float
) -> bool:
    """Whether nothing is `near` in one of 25 directions, spread by the cosine over the normal."""
    if pick < 0:
        return True
    # the normal plus a point of a spiral on the unit sphere
    h, a = 1.0 - (2.0 * pick + 1.0) / 25.0, 2.39996323 * pick
    ring = math.sqrt(max(1.0 - h * h, 0.0))
    way = n[0] + ring * math.cos(a), n[1] + ring * math.sin(a), n[2] + h
    if dot(way, way) < 1e-6:
        return True
    return not blocked(scene, stack, q, unit(way), near, foliage)


@inlined
def _add_mirror(
    light: Light,
    d: Vector,
    n: Vector,
    cosine: float,
    glass: float,
    sunlit: bool,
    seed: int,
    out: Float32[np.ndarray, " 9"],
) -> None:
    """Add what panes and the lacquer of cars mirror: sky, street, and the sun on lacquer."""
    fresnel = 0.05 + 0.75 * (1.0 - cosine) ** 4
    strength = (fresnel + 0.06) * glass if glass > 0.0 else 0.5 * fresnel
    way = step(d, n, 2.0 * cosine)
    if way[2] > 0.0:
        seen = _sky(light, way, seed, False)
        strength *= 0.3 + 0.7 * smooth(0.05, 0.45, way[2])  # houses opposite hide the lower sky
    else:
        seen = step((0.0, 0.0, 0.0), light.below, 1.0 / math.pi)
    shine = 0.0
    if sunlit and glass == 0.0:
        shine = 0.35 * max(dot(unit(step(light.sun, d, -1.0)), n), 0.0) ** 60
    for c in range(3):
        out[c] += strength * seen[c] + shine * light.sun_rgb[c]


@inlined
def _is_on(lamps: Float64[np.ndarray, "k 7"], p: Vector) -> bool:
    """Whether one of the lamps that shine is at p; one that is off is a white cover."""
    nearest = math.inf
    for k in range(len(lamps)):
        nearest = min(nearest, abs(lamps[k, 0] - p[0]) + abs(lamps[k, 1] - p[1]))
    return nearest < 1.5


@inlined
def _add_fog(
    scene: Scene, light: Light, eye: Vector, d: Vector, t: float, out: Float32[np.ndarray, " 9"]
) -> None:
    """Dim what lies behind the air and add the light that the air scatters."""
    if light.fog <= 0.0:
        return
    clear = math.exp(-light.fog * outdoor_length(scene.zones, eye, d, t))
    glow = 0.06 * max(dot(d, light.sun), 0.0) ** 8
    for c in range(3):
        veil = 0.85 * light.horizon[c] + 0.15 * light.zenith[c] + glow * light.sun_rgb[c]
        out[c] = out[c] * clear + veil * (1.0 - clear)
        out[3 + c] *= clear


# ------------------------------------------------------------------------------------ the sensor


def develop(
    light: Float32[np.ndarray, "h w 3"], camera: Camera, seed: int
) -> UInt8[np.ndarray, "h w 3"]:
    """Expose, add the sensor's noise, balance the white, bend the tone, quantise."""
    sensor = _Sensor(
        camera.full_well,
        camera.sensitivity,
        camera.shortest_s,
        camera.longest_s,
        camera.largest_gain,
        camera.read_noise,
        camera.key,
    )
    out = np.empty(light.shape, np.uint8)
    _develop(light, sensor, seed, out)
    return out


class _Sensor(NamedTuple):
    """The part of a `Camera` that counts electrons."""

    full_well: float
    sensitivity: float
    shortest_s: float
    longest_s: float
    largest_gain: float
    read_noise: float
    key: float


@kernel
def _develop(
    light: Float32[np.ndarray, "h w 3"],
    sensor: _Sensor,
    seed: int,
    out: UInt8[np.ndarray, "h w 3"],
) -> None:
    h, w = light.shape[:2]
    # the meter: a mean of roots, so that one lamp does not turn the night black
    mean, red, green, blue = 0.0, 0.0, 0.0, 0.0
    for i in range(h):
        for j in range(w):
            r, g, b = light[i, j, 0], light[i, j, 1], light[i, j, 2]
            mean += math.sqrt(max(0.25 * r + 0.6 * g + 0.15 * b, 0.0))
            top = max(max(r, g), max(b, 1e-12))
            # each pixel votes for the colour of the light, however bright it is
            red, green, blue = red + r / top, green + g / top, blue + b / top
    mean = (mean / (h * w)) ** 2
    wanted = sensor.key * sensor.full_well / (sensor.sensitivity * max(mean, 1e-9))  # s times gain
    exposure = min(max(wanted, sensor.shortest_s), sensor.longest_s)
    gain = min(max(wanted / exposure, 1.0), sensor.largest_gain)
    # most of the way to grey: an evening stays warm but is not pink
    balance = (green / max(red, 1e-9)) ** 0.65, 1.0, (green / max(blue, 1e-9)) ** 0.65
    scale = sensor.sensitivity * exposure
    inverse_size = 1.0 / (0.25 * (w * w + h * h))
    for i in range(h):
        for j in range(w):
            away = ((j - 0.5 * w) ** 2 + (i - 0.5 * h) ** 2) * inverse_size
            vignette = 1.0 - 0.28 * away
            for c in range(3):
                electrons = light[i, j, c] * scale * vignette
                noise = math.sqrt(max(electrons, 0.0) + sensor.read_noise**2)
                electrons += noise * normal(seed, i * w + j, c)
                x = max(electrons * gain / sensor.full_well, 0.0) * balance[c]
                # shoulder: white is reached at four times the scale
                x = x * (1.0 + x / 16.0) / (1.0 + 0.75 * x) * 1.15
                x = 12.92 * x if x < 0.0031308 else 1.055 * x ** (1.0 / 2.4) - 0.055
                out[i, j, c] = np.uint8(min(max(x * 255.0 + 0.5, 0.0), 255.0))
