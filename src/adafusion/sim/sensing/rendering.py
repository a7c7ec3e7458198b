# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Rays to radiance in one fused kernel.

Sun with shadows, one ambient-occlusion ray a pixel, the nearest lamps, headlights and fog. Pixels
on edges get two more rays, those on wet ground one that is mirrored.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float32, Float64

from adafusion.sim.numeric import Vector, dot, inlined, kernel, smooth, step, unit
from adafusion.sim.sensing.bvh import Stack, new_stack
from adafusion.sim.sensing.lighting import (
    LAMP_RADIANCE,
    Light,
    add_headlights,
    add_lamps,
    ambient_on,
    sky_radiance,
)
from adafusion.sim.sensing.projection import View, undistorted
from adafusion.sim.sensing.scene import (
    Scene,
    blocked,
    outdoor_length,
    texture_uv,
    trace_scene,
    zone_of,
)
from adafusion.sim.sensing.textures import surface
from adafusion.sim.sensing.weather import SNOW_RGB, snow_on, soaked, water_on
from adafusion.sim.town.shapes import LIT, STYLE, Material

FAR_M = 400.0
_LEAF, _CAR_BODY = int(Material.LEAF), int(Material.CAR_BODY)
_LAMP, _CAR_LIGHT = int(Material.LAMP), int(Material.CAR_LIGHT)

# layers of a picture before its ambient light is added: direct RGB, ambient RGB, then
_VISIBLE, _DEPTH, _SURFACE, _WATER, _LAYERS = 6, 7, 8, 9, 10
_PIXELS, _EDGES, _MIRRORED = range(3)  # sweeps over the picture
_NO_SKY, _MIRROR = -1, -2  # rays that cast none for occlusion; the second kind left a puddle


@kernel
def render(
    scene: Scene,
    lamps: Float64[np.ndarray, "k 7"],
    light: Light,
    view: View,
    indoors: Float64[np.ndarray, "z 7"],
    image: Float32[np.ndarray, "h w 3"],
    depth: Float32[np.ndarray, "h w"],
) -> None:
    """Fill linear RGB and the distance to what is seen, in metres.

    `indoors` are the zones of the scene near enough to be looked into.
    """
    h, w = depth.shape
    layers = np.empty((h, w, _LAYERS), np.float32)
    seen = np.empty(_LAYERS, np.float32)
    stack = new_stack()
    # one loop for all kinds of rays: the compiler inlines the shader where it is called
    for sweep in range(3 if light.wetness > 0.0 else 2):
        for i in range(h):
            for j in range(w):
                own, visible, rays = layers[i, j], 0.0, 1
                if sweep == _EDGES:
                    visible, edge = _look_around(layers, i, j)
                    rays = 2 if edge else 0
                    depth[i, j] = own[_DEPTH]
                    for c in range(3):
                        image[i, j, c] = own[c] + visible * own[3 + c]
                elif sweep == _MIRRORED and own[_WATER] < 0.02:
                    rays = 0
                for k in range(rays):
                    di, dj = 0.0, 0.0
                    if sweep == _EDGES:
                        di, dj = 0.5 * k - 0.25, 0.33 - 0.66 * k
                    o, d = view.eye, _direction(view, i + di, j + dj)
                    pick, come = _NO_SKY, 0.0
                    if sweep == _PIXELS:
                        # every block of 5 x 5 pixels asks all 25 directions for occlusion
                        pick = (i % 5) * 5 + j % 5
                    elif sweep == _MIRRORED:  # the ground is nearly level
                        pick, come = _MIRROR, float(own[_DEPTH])
                        o = step(step(o, d, come), (0.0, 0.0, 1.0), 5e-3)
                        d = d[0], d[1], abs(d[2])
                    _look(scene, stack, lamps, light, view, indoors, o, d, come, pick, seen)
                    if sweep == _PIXELS:
                        for c in range(_LAYERS):
                            own[c] = seen[c]
                    elif sweep == _EDGES:
                        share = visible if seen[_VISIBLE] < 0.0 else 1.0
                        for c in range(3):
                            image[i, j, c] += seen[c] + share * seen[3 + c]
                    else:
                        for c in range(3):
                            image[i, j, c] += own[_WATER] * (seen[c] + 0.7 * seen[3 + c])
                if sweep == _EDGES and rays > 0:
                    for c in range(3):
                        image[i, j, c] *= 1.0 / 3.0


@inlined
def _direction(view: View, i: float, j: float) -> Vector:
    """Unit vector in the world through row i and column j."""
    R = view.R_world_camera
    x, y = undistorted((j - view.cx) / view.fx, (i - view.cy) / view.fy, view.distortion)
    size = 1.0 / math.sqrt(x * x + y * y + 1.0)
    return (
        (R[0, 0] * x + R[0, 1] * y + R[0, 2]) * size,
        (R[1, 0] * x + R[1, 1] * y + R[1, 2]) * size,
        (R[2, 0] * x + R[2, 1] * y + R[2, 2]) * size,
    )


@inlined
def _look_around(layers: Float32[np.ndarray, "h w 10"], i: int, j: int) -> tuple[float, bool]:
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
    view: View,
    indoors: Float64[np.ndarray, "z 7"],
    o: Vector,
    d: Vector,
    come: float,
    pick: int,
    out: Float32[np.ndarray, " 10"],
) -> None:
    """Look along one ray, which has `come` some metres already, and fill the layers of its pixel.

    Ambient light is kept apart because one occlusion ray says little: `pick` is which of 25
    directions it takes, and neighbours average. With `pick` < 0 none is cast and the visibility
    is -1.
    """
    t, face, b1, b2 = trace_scene(scene, stack, o, d, FAR_M, light.foliage)
    if face < 0:
        _look_at_sky(light, indoors, o, d, out)
        return
    n = scene.normal[face, 0], scene.normal[face, 1], scene.normal[face, 2]
    cosine = dot(d, n)
    if cosine > 0.0:
        n = -n[0], -n[1], -n[2]
    cosine = abs(cosine)
    p = step(o, d, t)
    q = step(p, n, 2e-3)  # off the surface, lest it shades itself
    material, zone = scene.material[face], zone_of(scene.zones, q)
    u, v = texture_uv(scene, face, b1, b2)
    # a slanted pixel is long one way only: the root keeps textures readable along a street
    footprint = (come + t) / (view.fx * math.sqrt(max(cosine, 0.02)))
    wu, wv = footprint * scene.uv_per_m[face, 0], footprint * scene.uv_per_m[face, 1]
    row = scene.objects[scene.object_id[face]]
    albedo, glass, glow = surface(
        material, row, face, u, v, wu, wv, light.autumn, light.lit_windows, light.window_seed
    )
    white, water = 0.0, 0.0
    if zone < 0 and light.snow > 0.0:
        white = snow_on(material, face, u, v, max(wu, wv), n[2], light.snow)
        glass *= 1.0 - white
    if zone < 0 and light.wetness > 0.0:
        fresnel = 0.02 + 0.98 * (1.0 - cosine) ** 5
        water = fresnel * (1.0 - white) * water_on(material, u, v, n[2], light.wetness)
        albedo = step((0.0, 0.0, 0.0), albedo, soaked(material, light.wetness))
    bare = (1.0 - white) * (1.0 - water)
    leaf = material == _LEAF
    sun = _sun_on(scene, stack, light, q, n, leaf)
    direct = step((0.0, 0.0, 0.0), light.sun_rgb, sun)
    direct = add_lamps(direct, lamps, zone, q, n, leaf)
    if light.headlights > 0.0 and pick != _MIRROR:
        R = view.R_world_camera
        axis = d[0] * R[0, 2] + d[1] * R[1, 2] + d[2] * R[2, 2]
        direct = add_headlights(direct, light.headlights, axis, t, cosine, p[2] - o[2])
    ambient = ambient_on(scene, light, zone, n)
    diffuse = (1.0 - 0.9 * glass) / math.pi
    for c in range(3):
        tint = (albedo[c] * bare + SNOW_RGB[c] * white) * diffuse
        out[c] = tint * direct[c]
        out[3 + c] = tint * ambient[c]
    if zone < 0 and (glass > 0.0 or material == _CAR_BODY):
        _add_mirror(light, d, n, cosine, glass, 1.0 - white, sun > 0.0, out)
    if material == _LAMP:
        # indoors always on; one that is off is a white cover
        power = LAMP_RADIANCE if zone >= 0 or light.street_lamps > 0.0 else 0.0
        for c in range(3):
            out[c] += glow[c] * power
    elif material == _CAR_LIGHT:  # a lens that throws some daylight back
        power = 0.5 * LAMP_RADIANCE * light.headlights if row[STYLE] == LIT else 0.0
        for c in range(3):
            out[c] += glow[c] * power
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
    out[_WATER] = water
    _add_fog(light, indoors, o, d, t, out)


@inlined
def _look_at_sky(
    light: Light,
    indoors: Float64[np.ndarray, "z 7"],
    o: Vector,
    d: Vector,
    out: Float32[np.ndarray, " 10"],
) -> None:
    """Fill the layers of a pixel that sees no surface."""
    sky = sky_radiance(light, (d[0], d[1], max(d[2], 0.0)), True)
    land = 1.0 - (0.55 - 0.5 * light.snow) * smooth(0.0, 0.05, -d[2])  # open land beyond the town
    for c in range(3):
        out[c], out[3 + c] = sky[c] * land, 0.0
    out[_VISIBLE], out[_DEPTH], out[_SURFACE], out[_WATER] = 1.0, FAR_M, -1.0, 0.0
    # fog lies 40 m deep
    _add_fog(light, indoors, o, d, FAR_M if d[2] < 0.02 else min(FAR_M, 40.0 / d[2]), out)


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
    bare: float,
    sunlit: bool,
    out: Float32[np.ndarray, " 10"],
) -> None:
    """Add what panes and the lacquer of cars mirror: sky, street, and the sun on lacquer.

    `bare` is the share without snow on it.
    """
    fresnel = 0.05 + 0.75 * (1.0 - cosine) ** 4
    strength = (fresnel + 0.06) * glass if glass > 0.0 else 0.5 * fresnel * bare
    way = step(d, n, 2.0 * cosine)
    if way[2] > 0.0:
        seen = sky_radiance(light, way, False)
        strength *= 0.3 + 0.7 * smooth(0.05, 0.45, way[2])  # houses opposite hide the lower sky
    else:
        seen = step((0.0, 0.0, 0.0), light.below, 1.0 / math.pi)
    shine = 0.0
    if sunlit and glass == 0.0:
        shine = 0.35 * bare * max(dot(unit(step(light.sun, d, -1.0)), n), 0.0) ** 60
    for c in range(3):
        out[c] += strength * seen[c] + shine * light.sun_rgb[c]


@inlined
def _add_fog(
    light: Light,
    indoors: Float64[np.ndarray, "z 7"],
    o: Vector,
    d: Vector,
    t: float,
    out: Float32[np.ndarray, " 10"],
) -> None:
    """Dim what lies behind the air and add the light that the air scatters."""
    if light.fog <= 0.0:
        return
    clear = math.exp(-light.fog * outdoor_length(indoors, o, d, t))
    glow = 0.06 * max(dot(d, light.sun), 0.0) ** 8
    for c in range(3):
        veil = 0.85 * light.horizon[c] + 0.15 * light.zenith[c] + glow * light.sun_rgb[c]
        out[c] = out[c] * clear + veil * (1.0 - clear)
        out[3 + c] *= clear
    out[_WATER] *= clear
