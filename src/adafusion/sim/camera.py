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

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt8

from adafusion.sim.bvh import new_stack
from adafusion.sim.conditions import Conditions
from adafusion.sim.numeric import kernel, normal, smooth, value_noise
from adafusion.sim.scene import Scene, blocked, outdoor_length, trace_scene, zone_of
from adafusion.sim.shapes import Material
from adafusion.sim.textures import surface

_LEAF, _GLASS, _CAR_BODY = int(Material.LEAF), int(Material.GLASS), int(Material.CAR_BODY)
_LAMP, _CAR_LIGHT, _FACADE = int(Material.LAMP), int(Material.CAR_LIGHT), int(Material.FACADE)
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
    out = np.zeros((h, w, 3), np.float32)
    _render(
        scene,
        _nearest(scene, lamps, conditions, T),
        _light_table(conditions),
        T[:3, :3].copy(),
        T[:3, 3].copy(),
        np.array([camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]]),
        run_seed,
        out,
    )
    return out


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
    here = zone_of(scene.zones, *T_world_camera[:3, 3])
    centre = T_world_camera[:3, 3] + 12.0 * T_world_camera[:3, 2]
    distance = np.linalg.norm(lit[:, :3] - centre, axis=1)
    own = lit[:, 6] == here
    order = np.argsort(distance, kind="stable")
    rest = LAMPS // 4
    return np.concatenate([lit[order][own[order]][: LAMPS - rest], lit[order][~own[order]][:rest]])


# slots of the table of light
_SUN, _SUN_RGB, _ZENITH, _HORIZON, _CLOUD, _COVER, _FOG, _LEAVES, _LIT, _WINDOW, _HEAD, _AMBIENT = (
    0, 3, 6, 9, 12, 15, 16, 17, 18, 19, 22, 23,
)  # fmt: skip


def _light_table(c: Conditions) -> Float64[np.ndarray, " 29"]:
    sun = (
        math.cos(c.sun_elevation_rad) * math.cos(c.sun_azimuth_rad),
        math.cos(c.sun_elevation_rad) * math.sin(c.sun_azimuth_rad),
        math.sin(c.sun_elevation_rad),
    )
    zenith, horizon, cloud = map(np.array, (c.zenith_rgb, c.horizon_rgb, c.cloud_rgb))
    clear = 0.6 * zenith + 0.4 * horizon
    sky = np.pi * ((1 - 0.6 * c.cloud_cover) * clear + 0.6 * c.cloud_cover * cloud)
    down = sky + np.array(c.sun_rgb) * max(sun[2], 0.0)
    ground = 0.16 * down * (1.0, 0.97, 0.9)  # what a street throws back
    return np.concatenate(
        [sun, c.sun_rgb, zenith, horizon, cloud, [c.cloud_cover, c.fog_per_m, c.foliage,
         c.lit_windows], c.window_rgb, [c.headlights], sky, ground]
    )  # fmt: skip


@kernel
def _sky(light, dx, dy, dz, seed, clouds):  # type: ignore[no-untyped-def]
    """Radiance of the sky in a direction; the sun's disc is a glow that no lens resolves."""
    up = max(dz, 0.0)
    t = 1.0 - (1.0 - up) ** 4
    r = light[_HORIZON] + (light[_ZENITH] - light[_HORIZON]) * t
    g = light[_HORIZON + 1] + (light[_ZENITH + 1] - light[_HORIZON + 1]) * t
    b = light[_HORIZON + 2] + (light[_ZENITH + 2] - light[_HORIZON + 2]) * t
    facing = max(dx * light[_SUN] + dy * light[_SUN + 1] + dz * light[_SUN + 2], 0.0)
    glow = 0.10 * facing**6 + 0.25 * facing**40 + 6.0 * smooth(0.9990, 0.9997, facing)
    cover = light[_COVER]
    if clouds and cover > 0.0 and dz > 0.015:
        scale = 1.1 / (dz + 0.10)
        x, y = dx * scale, dy * scale
        n = 0.52 * value_noise(x, y, seed) + 0.28 * value_noise(2.3 * x, 2.1 * y, seed + 1)
        n += 0.20 * value_noise(5.1 * x, 4.7 * y, seed + 2)
        dense = smooth(0.80 - 0.75 * cover, 1.10 - 0.75 * cover, n)
        dense *= smooth(0.015, 0.12, dz)
        shade = 1.12 - 0.35 * n
        r += (light[_CLOUD] * shade - r) * dense
        g += (light[_CLOUD + 1] * shade - g) * dense
        b += (light[_CLOUD + 2] * shade - b) * dense
        glow *= 1.0 - 0.8 * dense
    return (
        r + glow * light[_SUN_RGB],
        g + glow * light[_SUN_RGB + 1],
        b + glow * light[_SUN_RGB + 2],
    )


@kernel
def _look(scene, stack, lamps, light, ox, oy, oz, dx, dy, dz, ax, ay, az, spread, seed, pick, out):  # type: ignore[no-untyped-def]
    """Radiance along one ray into `out`: direct RGB, ambient RGB, its visibility, depth, object.

    (ax, ay, az) is the optical axis, `spread` the angle of a pixel. The ambient light is kept
    apart because one occlusion ray says little: `pick` is which of 25 directions it takes, every
    block of 5 x 5 pixels holds them all, and neighbours average. With `pick` < 0 no occlusion ray
    is cast and the visibility comes back as -1.
    """
    foliage, fog = light[_LEAVES], light[_FOG]
    t, face, b1, b2 = trace_scene(scene, stack, ox, oy, oz, dx, dy, dz, 400.0, foliage)
    out[:] = 0.0
    if face < 0:
        out[0], out[1], out[2] = _sky(light, dx, dy, max(dz, 0.0), seed, True)
        if dz < 0.0:  # open land beyond the town
            land = 0.55 * smooth(0.0, 0.05, -dz)
            out[0], out[1], out[2] = out[0] * (1 - land), out[1] * (1 - land), out[2] * (1 - land)
        out[6], out[7], out[8] = 1.0, 400.0, -1.0
        if fog > 0.0:
            _add_fog(
                scene,
                light,
                ox,
                oy,
                oz,
                dx,
                dy,
                dz,
                400.0 if dz < 0.02 else min(400.0, 40.0 / dz),
                out,
            )
        return
    nx, ny, nz = scene.normal[face, 0], scene.normal[face, 1], scene.normal[face, 2]
    cosine = dx * nx + dy * ny + dz * nz
    if cosine > 0.0:
        nx, ny, nz = -nx, -ny, -nz
    cosine = abs(cosine)
    px, py, pz = ox + t * dx, oy + t * dy, oz + t * dz
    qx, qy, qz = px + 2e-3 * nx, py + 2e-3 * ny, pz + 2e-3 * nz
    material = scene.material[face]
    row = scene.objects[scene.object_id[face]]
    w = scene.uv[face]
    u = w[0] + b1 * (w[2] - w[0]) + b2 * (w[4] - w[0])
    v = w[1] + b1 * (w[3] - w[1]) + b2 * (w[5] - w[1])
    # a slanted pixel is long one way only: the root keeps textures readable along a street
    footprint = t * spread / math.sqrt(max(cosine, 0.02))
    wu, wv = footprint * scene.uv_per_m[face, 0], footprint * scene.uv_per_m[face, 1]
    r, g, b, glass, er, eg, eb = surface(material, row, face, u, v, wu, wv, light[_LIT], seed + 5)
    zone = zone_of(scene.zones, qx, qy, qz)
    leaf = material == _LEAF
    # sun
    ir, ig, ib = 0.0, 0.0, 0.0
    sun = nx * light[_SUN] + ny * light[_SUN + 1] + nz * light[_SUN + 2]
    if leaf:  # light also comes through
        sun = 0.25 + 0.75 * (sun if sun > 0.0 else -0.45 * sun)
    shine = 0.0
    if sun > 0.0 and light[_SUN_RGB] > 0.0 and light[_SUN + 2] > 0.0:
        sx, sy, sz = light[_SUN], light[_SUN + 1], light[_SUN + 2]
        if not blocked(scene, stack, qx, qy, qz, sx, sy, sz, 250.0, foliage):
            ir, ig, ib = sun * light[_SUN_RGB], sun * light[_SUN_RGB + 1], sun * light[_SUN_RGB + 2]
            if material == _CAR_BODY:
                hx, hy, hz = sx - dx, sy - dy, sz - dz
                size = math.sqrt(hx * hx + hy * hy + hz * hz)
                shine = 0.35 * max((hx * nx + hy * ny + hz * nz) / size, 0.0) ** 60
    # lamps: a street lamp shines down, a point of one zone is lit by the lamps of that zone
    for k in range(len(lamps)):
        if lamps[k, 6] != zone:
            continue
        lx, ly, lz = lamps[k, 0] - qx, lamps[k, 1] - qy, lamps[k, 2] - qz
        d2 = lx * lx + ly * ly + lz * lz + 0.05
        inverse = 1.0 / math.sqrt(d2)
        lit = (nx * lx + ny * ly + nz * lz) * inverse
        if leaf:
            lit = 0.4 + 0.6 * abs(lit)
        elif zone >= 0:
            lit = 0.2 + 0.8 * max(lit, 0.0)  # walls light each other
        if lit <= 0.0:
            continue
        beam = 0.10 + 0.90 * smooth(0.10, 0.55, lz * inverse)
        power = lit * beam / d2
        ir, ig, ib = ir + power * lamps[k, 3], ig + power * lamps[k, 4], ib + power * lamps[k, 5]
    # headlights sit below the camera, so what the camera sees is lit: no shadow ray
    if light[_HEAD] > 0.0:
        axis = dx * ax + dy * ay + dz * az
        power = 1.3 * light[_HEAD] * cosine * smooth(0.72, 0.99, axis) / (t * t + 30.0)
        power *= 1.0 - 0.85 * smooth(0.4, 2.2, pz - oz + 1.0)
        ir, ig, ib = ir + power, ig + 0.95 * power, ib + 0.85 * power
    # ambient
    sky = 0.5 + 0.5 * nz
    if zone >= 0:
        bounce = math.pi * scene.zones[zone, 6]
        mr, mg, mb = bounce, 0.97 * bounce, 0.88 * bounce
    else:
        mr = light[_AMBIENT] * sky + light[_AMBIENT + 3] * (1.0 - sky)
        mg = light[_AMBIENT + 1] * sky + light[_AMBIENT + 4] * (1.0 - sky)
        mb = light[_AMBIENT + 2] * sky + light[_AMBIENT + 5] * (1.0 - sky)
    visible = -1.0
    if pick >= 0:
        visible = 1.0
        # a direction over the normal, cosine weighted: the normal plus a point on the sphere
        h, a = 1.0 - (2.0 * pick + 1.0) / 25.0, 2.39996323 * pick
        ring = math.sqrt(max(1.0 - h * h, 0.0))
        vx, vy, vz = nx + ring * math.cos(a), ny + ring * math.sin(a), nz + h
        size = math.sqrt(vx * vx + vy * vy + vz * vz)
        if size > 1e-3:
            near = 1.2 if zone >= 0 else 7.0
            if blocked(scene, stack, qx, qy, qz, vx / size, vy / size, vz / size, near, foliage):
                visible = 0.4 if leaf else 0.15
    inv_pi = 1.0 / math.pi
    keep = 1.0 - 0.9 * glass
    out[0], out[1], out[2] = r * ir * inv_pi * keep, g * ig * inv_pi * keep, b * ib * inv_pi * keep
    out[3], out[4], out[5] = r * mr * inv_pi, g * mg * inv_pi, b * mb * inv_pi
    # mirrors: panes, and the lacquer of cars
    if (glass > 0.0 or material == _CAR_BODY) and zone < 0:
        rx, ry, rz = dx + 2.0 * cosine * nx, dy + 2.0 * cosine * ny, dz + 2.0 * cosine * nz
        fresnel = 0.05 + 0.75 * (1.0 - cosine) ** 4
        mirror = (fresnel + 0.06) * glass if glass > 0.0 else 0.5 * fresnel
        if rz > 0.0:
            sr, sg, sb = _sky(light, rx, ry, rz, seed, False)
            # the houses opposite hide the lower sky
            open_sky = smooth(0.05, 0.45, rz)
            mirror *= 0.3 + 0.7 * open_sky
        else:
            sr, sg, sb = (
                inv_pi * light[_AMBIENT + 3],
                inv_pi * light[_AMBIENT + 4],
                inv_pi * light[_AMBIENT + 5],
            )
        out[0] += mirror * sr + shine * light[_SUN_RGB]
        out[1] += mirror * sg + shine * light[_SUN_RGB + 1]
        out[2] += mirror * sb + shine * light[_SUN_RGB + 2]
    if material == _LAMP:
        # a lamp that is off is a white cover
        on = 0.0
        for k in range(len(lamps)):
            if abs(lamps[k, 0] - px) + abs(lamps[k, 1] - py) < 1.5:
                on = 0.12
        out[0], out[1], out[2] = out[0] + er * on, out[1] + eg * on, out[2] + eb * on
    elif material == _CAR_LIGHT:
        out[3], out[4], out[5] = (
            out[3] + 0.3 * er * mr,
            out[4] + 0.3 * eg * mg,
            out[5] + 0.3 * eb * mb,
        )
    else:
        out[0] += er * light[_WINDOW]
        out[1] += eg * light[_WINDOW + 1]
        out[2] += eb * light[_WINDOW + 2]
    out[6], out[7], out[8] = (
        visible,
        t,
        float(scene.object_id[face]) * 8.0
        + math.floor(nx * 1.9 + 2.0)
        + 0.3 * math.floor(ny * 1.9 + 2.0),
    )
    if fog > 0.0:
        _add_fog(scene, light, ox, oy, oz, dx, dy, dz, t, out)


@kernel
def _add_fog(scene, light, ox, oy, oz, dx, dy, dz, t, out):  # type: ignore[no-untyped-def]
    """Dim what lies behind the air and add the light that the air scatters."""
    air = outdoor_length(scene.zones, ox, oy, oz, dx, dy, dz, t)
    clear = math.exp(-light[_FOG] * air)
    facing = max(dx * light[_SUN] + dy * light[_SUN + 1] + dz * light[_SUN + 2], 0.0)
    glow = 0.06 * facing**8
    for c in range(3):
        veil = 0.85 * light[_HORIZON + c] + 0.15 * light[_ZENITH + c] + glow * light[_SUN_RGB + c]
        out[c] = out[c] * clear + veil * (1.0 - clear)
        out[3 + c] *= clear


@kernel
def _render(scene, lamps, light, R, origin, K, seed, image):  # type: ignore[no-untyped-def]
    h, w = image.shape[:2]
    ox, oy, oz = origin
    ax, ay, az = R[0, 2], R[1, 2], R[2, 2]
    spread = 1.0 / K[0]
    layers = np.empty((h, w, 9), np.float32)
    stack = new_stack()
    for i in range(h):
        for j in range(w):
            x, y = (j - K[2]) / K[0], (i - K[3]) / K[1]
            size = 1.0 / math.sqrt(x * x + y * y + 1.0)
            dx = (R[0, 0] * x + R[0, 1] * y + R[0, 2]) * size
            dy = (R[1, 0] * x + R[1, 1] * y + R[1, 2]) * size
            dz = (R[2, 0] * x + R[2, 1] * y + R[2, 2]) * size
            _look(scene, stack, lamps, light, ox, oy, oz, dx, dy, dz, ax, ay, az, spread, seed,
                  (i % 5) * 5 + j % 5, layers[i, j])  # fmt: skip
    extra = np.empty(9, np.float32)
    for i in range(h):
        for j in range(w):
            own = layers[i, j]
            # average the occlusion over neighbours on the same surface
            total, visible, edge = 0.0, 0.0, False
            for di in range(-2, 3):
                for dj in range(-2, 3):
                    a, b = i + di, j + dj
                    if a < 0 or b < 0 or a >= h or b >= w:
                        continue
                    other = layers[a, b]
                    if other[8] == own[8] and abs(other[7] - own[7]) < 0.06 * own[7]:
                        total += 1.0
                        visible += other[6]
                    elif abs(di) + abs(dj) == 1 and di + dj > 0:
                        edge = True
            visible /= total
            r = own[0] + visible * own[3]
            g = own[1] + visible * own[4]
            b_ = own[2] + visible * own[5]
            if edge:
                for k in range(3):
                    x = (j - K[2] + (-0.33 if k == 0 else (0.33 if k == 1 else 0.0))) / K[0]
                    y = (i - K[3] + (-0.25 if k < 2 else 0.33)) / K[1]
                    size = 1.0 / math.sqrt(x * x + y * y + 1.0)
                    dx = (R[0, 0] * x + R[0, 1] * y + R[0, 2]) * size
                    dy = (R[1, 0] * x + R[1, 1] * y + R[1, 2]) * size
                    dz = (R[2, 0] * x + R[2, 1] * y + R[2, 2]) * size
                    _look(scene, stack, lamps, light, ox, oy, oz, dx, dy, dz, ax, ay, az, spread, seed,
                          -1, extra)  # fmt: skip
                    seen = visible if extra[6] < 0.0 else 1.0
                    r += extra[0] + seen * extra[3]
                    g += extra[1] + seen * extra[4]
                    b_ += extra[2] + seen * extra[5]
                r, g, b_ = 0.25 * r, 0.25 * g, 0.25 * b_
            image[i, j, 0], image[i, j, 1], image[i, j, 2] = r, g, b_


def develop(
    light: Float32[np.ndarray, "h w 3"], camera: Camera, seed: int
) -> UInt8[np.ndarray, "h w 3"]:
    """Expose, add the sensor's noise, balance the white, bend the tone, quantise."""
    out = np.empty(light.shape, np.uint8)
    settings = np.array(
        [camera.full_well, camera.sensitivity, camera.shortest_s, camera.longest_s,
         camera.largest_gain, camera.read_noise, camera.key]
    )  # fmt: skip
    _develop(light, settings, seed, out)
    return out


@kernel
def _develop(light, settings, seed, out):  # type: ignore[no-untyped-def]
    full_well, sensitivity, shortest, longest, largest_gain, read_noise, key = settings
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
    wanted = key * full_well / (sensitivity * max(mean, 1e-9))  # seconds times gain
    exposure = min(max(wanted, shortest), longest)
    gain = min(max(wanted / exposure, 1.0), largest_gain)
    # half way to grey: an evening stays warm but is not pink
    red, blue = (green / red) ** 0.65, (green / blue) ** 0.65
    scale = sensitivity * exposure
    inverse_size = 1.0 / (0.25 * (w * w + h * h))
    for i in range(h):
        for j in range(w):
            away = ((j - 0.5 * w) ** 2 + (i - 0.5 * h) ** 2) * inverse_size
            vignette = 1.0 - 0.28 * away
            for c in range(3):
                electrons = light[i, j, c] * scale * vignette
                noise = math.sqrt(max(electrons, 0.0) + read_noise * read_noise)
                electrons += noise * normal(seed, i * w + j, c)
                x = max(electrons * gain / full_well, 0.0)
                x *= red if c == 0 else (blue if c == 2 else 1.0)
                # shoulder: white is reached at four times the scale
                x = x * (1.0 + x / 16.0) / (1.0 + 0.75 * x) * 1.15
                x = 12.92 * x if x < 0.0031308 else 1.055 * x ** (1.0 / 2.4) - 0.055
                out[i, j, c] = np.uint8(min(max(x * 255.0 + 0.5, 0.0), 255.0))
