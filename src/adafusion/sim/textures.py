# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""How each material looks and how it answers a laser: procedural, anti-aliased, shared by type.

A texture knows its own coordinates and the style of its object, never the position in the world:
a pattern drawn in world space would be a fingerprint of each place.
"""

from __future__ import annotations

import math

import numpy as np

from adafusion.sim.buildings import BRICK, CURTAIN, METAL_SHEET, PLINTH_M, SLAB, STONE, TIMBER
from adafusion.sim.numeric import kernel, pulse, smooth, uniform, value_noise
from adafusion.sim.shapes import (
    FLOOR,
    GROUND,
    PITCH,
    SECOND,
    SEED,
    STYLE,
    TOP,
    WIN_H,
    WIN_W,
    Material,
)

# numba freezes module globals; an enum member would be a slow lookup
_ASPHALT, _PAVING, _GRASS = int(Material.ASPHALT), int(Material.PAVING), int(Material.GRASS)
_FACADE, _ROOF, _BARK = int(Material.FACADE), int(Material.ROOF), int(Material.BARK)
_LEAF, _METAL, _SIGN = int(Material.LEAF), int(Material.METAL), int(Material.SIGN)
_CAR_BODY, _GLASS, _RUBBER = int(Material.CAR_BODY), int(Material.GLASS), int(Material.RUBBER)
_WALL, _FLOOR, _CEILING = int(Material.WALL), int(Material.FLOOR), int(Material.CEILING)
_LAMP, _HEDGE, _STRIPES = int(Material.LAMP), int(Material.HEDGE), int(Material.STRIPES)
_NOTICE, _DOOR, _CAR_LIGHT = int(Material.NOTICE), int(Material.DOOR), int(Material.CAR_LIGHT)

# share of near infrared light that comes back, by material
REFLECTIVITY = np.full(len(Material), 0.35)
for _material, _value in {
    Material.ASPHALT: 0.14, Material.PAVING: 0.25, Material.GRASS: 0.45, Material.ROOF: 0.25,
    Material.BARK: 0.30, Material.LEAF: 0.45, Material.METAL: 0.40, Material.SIGN: 0.95,
    Material.CAR_BODY: 0.40, Material.GLASS: 0.04, Material.RUBBER: 0.06, Material.WALL: 0.55,
    Material.FLOOR: 0.30, Material.CEILING: 0.60, Material.HEDGE: 0.45, Material.STRIPES: 0.35,
}.items():  # fmt: skip
    REFLECTIVITY[_material] = _value


@kernel
def window_at(row, u, v):  # type: ignore[no-untyped-def]
    """Which pane of a facade (u, v) lies on; returns (kind, column, storey).

    Kind: 0 wall, 1 window, 2 shop window, 3 door, 4 gate. u counts cells, v is metres above ground.
    """
    column = math.floor(u)
    x, z = u - column, v - PLINTH_M
    storey = math.floor(z / row[FLOOR])
    if z < 0.0 or v > row[TOP] - 0.15:
        return 0, column, storey
    y = z / row[FLOOR] - storey
    ground = int(row[GROUND])
    if storey == 0 and ground == 1:
        return (2 if 0.06 < x < 0.94 and 0.08 < y < 0.74 else 0), column, storey
    if storey == 0 and ground == 2 and column % 4 == 1:
        if abs(x - 0.5) * row[PITCH] < 0.55 and y * row[FLOOR] < 2.15:
            return 3, column, storey
        return 0, column, storey
    if storey == 0 and ground == 3 and column % 3 == 1:
        return (4 if 0.12 < x < 0.88 and y < 0.92 else 0), column, storey
    low = 0.30 if row[WIN_H] < 0.6 else 0.20
    inside = abs(x - 0.5) < 0.5 * row[WIN_W] and low < y < low + row[WIN_H]
    return (1 if inside else 0), column, storey


@kernel
def facade(row, u, v, wu, wv, lit_share, lit_seed):  # type: ignore[no-untyped-def]
    """Colour, glassiness and light of a facade; (wu, wv) is the footprint of the pixel."""
    style = int(row[STYLE])
    r, g, b = row[0], row[1], row[2]
    x_m, cell_m = u * row[PITCH], row[PITCH]
    wx = wu * cell_m
    if style == BRICK:
        joint_z = pulse(v / 0.078, 0.14, wv / 0.078)
        course = math.floor(v / 0.078)
        joint_x = pulse(x_m / 0.235 + 0.5 * (int(course) & 1), 0.05, wx / 0.235)
        fade = 1.0 - smooth(0.10, 0.35, wv)
        tone = 0.86 + 0.28 * fade * uniform(int(math.floor(x_m / 0.235 + 0.5 * (int(course) & 1))),
                                            int(course), 17) + 0.14 * (1.0 - fade)  # fmt: skip
        mortar = min(joint_z + joint_x, 1.0) * 0.5
        r, g, b = (r * tone * (1 - mortar) + 0.38 * mortar, g * tone * (1 - mortar) + 0.36 * mortar,
                   b * tone * (1 - mortar) + 0.33 * mortar)  # fmt: skip
    elif style == STONE:
        dark = 0.75 * min(
            pulse(v / 0.45, 0.05, wv / 0.45)
            + pulse(x_m / 0.9 + 0.5 * (int(math.floor(v / 0.45)) & 1), 0.025, wx / 0.9),
            1.0,
        )
        tone = (1.0 - 0.45 * dark) * (0.92 + 0.16 * value_noise(x_m * 0.9, v * 0.9, 5))  # fmt: skip
        r, g, b = r * tone, g * tone, b * tone
    elif style == METAL_SHEET:
        tone = 1.0 - 0.28 * pulse(x_m / 0.32, 0.4, wx / 0.32)
        r, g, b = r * tone, g * tone, b * tone
    elif style == TIMBER:
        board = math.floor(v / 0.19)
        fade = 1.0 - smooth(0.1, 0.4, wv)
        tone = 0.9 + fade * 0.2 * uniform(int(board), 3, 5) + 0.1 * (1 - fade)
        tone *= 1.0 - 0.45 * pulse(v / 0.19, 0.1, wv / 0.19)
        r, g, b = r * tone, g * tone, b * tone
    elif style == SLAB:
        tone = 1.0 - 0.35 * min(
            pulse(u, 0.012, wu) + pulse((v - PLINTH_M) / row[FLOOR], 0.02, wv / row[FLOOR]), 1.0
        )
        tone *= 0.9 + 0.2 * value_noise(x_m * 0.35, v * 0.25, 9)
        r, g, b = r * tone, g * tone, b * tone
    else:
        tone = 0.93 + 0.14 * value_noise(x_m * 0.5, v * 0.5, 3)
        r, g, b = r * tone, g * tone, b * tone
    # rain and dirt: darker near the ground and under the eaves
    dirt = 0.80 + 0.20 * smooth(0.0, 1.6, v)
    dirt *= 1.0 - 0.15 * smooth(row[TOP] - 0.9, row[TOP], v)
    if v < PLINTH_M:
        r, g, b = 0.55 * r + 0.06, 0.55 * g + 0.06, 0.55 * b + 0.06
    r, g, b = r * dirt, g * dirt, b * dirt
    kind, column, storey = window_at(row, u, v)
    glass, er, eg, eb = 0.0, 0.0, 0.0, 0.0
    x, y = u - column, (v - PLINTH_M) / row[FLOOR] - storey
    sr, sg, sb = row[SECOND], row[SECOND + 1], row[SECOND + 2]
    if int(row[GROUND]) == 1 and storey == 0 and kind == 0:
        r, g, b = sr, sg, sb  # shop front
    if kind == 1 or kind == 2:
        glass = 1.0
        if kind == 1:
            low = 0.30 if row[WIN_H] < 0.6 else 0.20
            ex = (0.5 * row[WIN_W] - abs(x - 0.5)) * cell_m
            ey = min(y - low, low + row[WIN_H] - y) * row[FLOOR]
            bar = style != CURTAIN and abs(x - 0.5) * cell_m < 0.035
        else:
            ex, ey = min(x - 0.06, 0.94 - x) * cell_m, min(y - 0.08, 0.74 - y) * row[FLOOR]
            bar = False
        frame = 0.07 if style != CURTAIN else 0.04
        if min(ex, ey) < frame or bar:
            # a frame thinner than the pixel fades into the glass
            glass = 1.0 - min(1.0, frame / max(0.5 * (wx + wv), 1e-6))
            r, g, b = sr, sg, sb
        if glass > 0.0:
            # curtains and blinds: the same in all buildings of a style
            pattern = uniform(int(column), int(storey), 31 + style)
            dr, dg, db = 0.028, 0.034, 0.040
            if pattern < 0.30 and kind == 1 and y > 0.62:
                dr, dg, db = 0.30, 0.29, 0.26
            elif pattern > 0.86:
                dr, dg, db = 0.20, 0.19, 0.17
            r, g, b = (r * (1 - glass) + dr * glass, g * (1 - glass) + dg * glass,
                       b * (1 - glass) + db * glass)  # fmt: skip
            pick = uniform(int(column) + 64 * int(storey), int(row[SEED]), lit_seed)
            share = lit_share if kind == 1 else 0.4 + 0.5 * lit_share
            if lit_share > 0.0 and pick < share:
                level = 0.45 + 1.1 * uniform(
                    int(column), int(row[SEED]) + int(storey), lit_seed + 1
                )
                cold = 1.25 if pick < 0.25 * share else 1.0
                er, eg, eb = (
                    glass * level,
                    glass * level * (1.0 + 0.1 * (cold - 1.0)),
                    glass * level * cold,
                )
    elif kind == 3:
        door = 0.35 + 0.3 * uniform(style, int(column), 3)
        r, g, b = sr * door, sg * door, sb * door
        if y * row[FLOOR] > 1.3 and abs(x - 0.5) * cell_m < 0.3:
            glass = 0.7
    elif kind == 4:
        slat = 1.0 - 0.3 * pulse(v / 0.25, 0.15, wv / 0.25)
        r, g, b = sr * slat, sg * slat, sb * slat
    elif (
        kind == 0
        and storey >= 0
        and v < row[TOP] - 0.15
        and style != CURTAIN
        and style != METAL_SHEET
    ):
        low = 0.30 if row[WIN_H] < 0.6 else 0.20
        if abs(x - 0.5) < 0.5 * row[WIN_W] + 0.03 and low - 0.045 < y < low:
            r, g, b = 0.5 * (r + sr), 0.5 * (g + sg), 0.5 * (b + sb)  # sill
    return r, g, b, glass, er, eg, eb


@kernel
def asphalt(row, u, v, w):  # type: ignore[no-untyped-def]
    """Road: grain, patches, worn wheel tracks, and paint by the marking style."""
    style = int(row[STYLE])
    grain = 1.0 - smooth(0.02, 0.2, w)
    tone = (
        0.86
        + 0.22 * value_noise(u * 0.35, v * 0.12, 3)
        + 0.10 * grain * (value_noise(u * 17.0, v * 17.0, 4) - 0.5)
    )
    tone *= 1.0 - 0.10 * math.exp(-((abs(abs(u) - 2.0) - 0.75) ** 2) / 0.08)
    r, g, b = row[0] * tone, row[1] * tone, row[2] * tone
    paint = 0.0
    lateral = abs(u)
    if style == 1 or style == 2:
        near = min(max((0.075 + 0.5 * w - lateral) / max(w, 0.02), 0.0), 1.0) * min(
            1.0, 0.15 / max(w, 0.15)
        )
        paint = near * (pulse(v / 6.0, 0.5, w / 6.0) if style == 1 else 1.0)
    if style != 0:
        line = min(max((0.06 + 0.5 * w - abs(lateral - 3.55)) / max(w, 0.02), 0.0), 1.0)
        paint = max(
            paint,
            0.8
            * line
            * min(1.0, 0.12 / max(w, 0.12))
            * (pulse(v / 5.9, 0.3, w / 5.9) if style == 3 else 1.0),
        )
    if lateral > 5.15:
        tone = 0.82  # gutter
        r, g, b = r * tone, g * tone, b * tone
    wear = 0.75 * paint
    return r * (1 - wear) + 0.60 * wear, g * (1 - wear) + 0.60 * wear, b * (1 - wear) + 0.57 * wear


@kernel
def surface(material, row, face, u, v, wu, wv, lit_share, lit_seed):  # type: ignore[no-untyped-def]
    """Albedo (r, g, b), glass share, and emission as a factor of the window or lamp colour."""
    r, g, b = row[0], row[1], row[2]
    glass, er, eg, eb = 0.0, 0.0, 0.0, 0.0
    w = max(wu, wv)
    if material == _FACADE:
        return facade(row, u, v, wu, wv, lit_share, lit_seed)
    if material == _ASPHALT:
        r, g, b = asphalt(row, u, v, w)
    elif material == _PAVING:
        joint = min(pulse(u / 0.6, 0.05, w / 0.6) + pulse(v / 0.6, 0.05, w / 0.6), 1.0)
        tone = (1.0 - 0.35 * joint) * (0.9 + 0.2 * value_noise(u * 0.6, v * 0.4, 6))
        r, g, b = r * tone, g * tone, b * tone
    elif material == _GRASS:
        fade = 1.0 - smooth(0.05, 0.5, w)
        # a lawn has no coordinates of its own: its noise tiles, lest it marks the place
        tone = 0.72 + 0.40 * value_noise(u * 0.25, v * 0.25, 7, 7)
        tone += 0.5 * fade * (value_noise(u * 9.0, v * 9.0, 8, 7) - 0.5)
        dry = 0.25 * value_noise(u * 0.125, v * 0.125, 12, 7)
        r, g, b = r * tone * (1 + dry), g * tone, b * tone
    elif material == _ROOF:
        tone = 0.85 + 0.15 * value_noise(u, v, 9) - 0.2 * pulse(v / 0.33, 0.2, wv / 0.33)
        r, g, b = r * tone, g * tone, b * tone
    elif material == _BARK:
        tone = 0.7 + 0.6 * value_noise(u * 14.0, v * 3.0, 2)
        r, g, b = 0.115 * tone, 0.085 * tone, 0.06 * tone
    elif material == _LEAF:
        tone = 0.65 + 0.7 * uniform(face, 3, 5)
        r, g, b = r * tone * (0.85 + 0.3 * uniform(face, 4, 5)), g * tone, b * tone
    elif material == _HEDGE:
        fade = 1.0 - smooth(0.05, 0.4, w)
        tone = 0.75 + 0.5 * fade * value_noise(u * 11.0, v * 11.0, 2) + 0.25 * (1 - fade)
        tone *= 0.8 + 0.4 * value_noise(u * 1.7, v * 1.7, 3)
        r, g, b = r * tone, g * tone, b * tone
    elif material == _SIGN:
        style = int(row[STYLE])
        radius = math.sqrt(u * u + v * v) if style == 0 else max(abs(u), abs(v))
        if style == 0 and radius > 1.0:
            r, g, b = 0.25, 0.25, 0.25
        elif radius < (0.72 if style != 2 else 0.0):
            dark = abs(u) < 0.16 and abs(v) < 0.5
            r, g, b = (0.04, 0.04, 0.04) if dark else (0.70, 0.70, 0.68)
    elif material == _GLASS:
        r, g, b, glass = 0.02, 0.022, 0.025, 1.0
    elif material == _RUBBER:
        r, g, b = 0.022, 0.022, 0.023
    elif material == _STRIPES:
        on = pulse(u / 1.0, 0.5, w)
        r, g, b = (0.105 + (r - 0.105) * on * 0.85, 0.105 + (g - 0.105) * on * 0.85,
                   0.11 + (b - 0.11) * on * 0.85)  # fmt: skip
    elif material == _WALL:
        style = int(row[STYLE])
        skirting = v < 0.10
        tone = 0.95 + 0.1 * value_noise(u * 0.8, v * 0.8, 4)
        if style == 0 and v > 1.1:  # painted to the shoulder, white above
            r, g, b = 0.62, 0.61, 0.57
        elif style == 1 and 1.0 < v < 1.25:  # a line of contrast
            r, g, b = 0.62 - 0.5 * r, 0.62 - 0.5 * g, 0.62 - 0.5 * b
        elif style == 2 and pulse(u / 1.2, 0.5, wu / 1.2) > 0.5:
            tone *= 0.82
        if skirting:
            r, g, b = 0.10, 0.10, 0.10
        r, g, b = r * tone, g * tone, b * tone
    elif material == _FLOOR:
        joint = min(pulse(u / 0.6, 0.02, w / 0.6) + pulse(v / 0.6, 0.02, w / 0.6), 1.0)
        tone = (1.0 - 0.3 * joint) * (0.92 + 0.16 * value_noise(u * 6.0, v * 6.0, 4))
        r, g, b = r * tone, g * tone, b * tone
    elif material == _CEILING:
        tone = 1.0 - 0.25 * min(pulse(u / 0.6, 0.03, w / 0.6) + pulse(v / 0.6, 0.03, w / 0.6), 1.0)
        r, g, b = r * tone, g * tone, b * tone
    elif material == _NOTICE:
        seed = int(row[SEED])
        column, line = math.floor(u / 0.34), math.floor(v / 0.42)
        x, y = u / 0.34 - column, v / 0.42 - line
        if 0.1 < x < 0.9 and 0.12 < y < 0.88:
            ink = 1.0 - 0.5 * pulse(y * 9.0, 0.45, wv * 21.0) * (0.3 if y > 0.6 else 1.0)
            r = ink * (0.25 + 0.6 * uniform(int(column), int(line), seed))
            g = ink * (0.25 + 0.6 * uniform(int(column), int(line), seed + 1))
            b = ink * (0.25 + 0.6 * uniform(int(column), int(line), seed + 2))
    elif material == _DOOR:
        style = int(row[STYLE])
        if u < 0.05 or u > 0.90 or v > 2.04:
            r, g, b = 0.12, 0.12, 0.12  # frame
        elif style == 1 and 1.35 < v < 1.9 and 0.3 < u < 0.65:
            r, g, b, glass = 0.05, 0.06, 0.06, 0.6
        elif abs(v - 1.05) < 0.03 and 0.75 < u < 0.87:
            r, g, b = 0.55, 0.55, 0.53  # handle
        elif style == 2 and v < 0.35:
            r, g, b = 0.40, 0.40, 0.41
    elif material == _LAMP or material == _CAR_LIGHT:
        er, eg, eb = r, g, b
    return r, g, b, glass, er, eg, eb
