# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""How each material looks and how it answers a laser: procedural, anti-aliased, shared by type.

A texture knows its own coordinates and the style of its object, never the position in the world:
a pattern drawn in world space would be a fingerprint of each place.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float32

from adafusion.sim.numeric import (
    Vector,
    blend,
    inlined,
    pulse,
    smooth,
    step,
    uniform,
    value_noise,
)
from adafusion.sim.town.buildings import (
    BRICK,
    CURTAIN,
    DOORS,
    GATES,
    METAL_SHEET,
    PLINTH_M,
    SHOPS,
    SLAB,
    STONE,
    TIMBER,
)
from adafusion.sim.town.shapes import (
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

Row = Float32[np.ndarray, " 16"]  # of the object table

# numba freezes module globals; an enum member would be a slow lookup
_ASPHALT, _PAVING, _GRASS = int(Material.ASPHALT), int(Material.PAVING), int(Material.GRASS)
_FACADE, _ROOF, _BARK = int(Material.FACADE), int(Material.ROOF), int(Material.BARK)
_LEAF, _SIGN = int(Material.LEAF), int(Material.SIGN)
_GLASS, _RUBBER = int(Material.GLASS), int(Material.RUBBER)
_WALL, _FLOOR, _CEILING = int(Material.WALL), int(Material.FLOOR), int(Material.CEILING)
_LAMP, _HEDGE, _STRIPES = int(Material.LAMP), int(Material.HEDGE), int(Material.STRIPES)
_NOTICE, _DOOR, _CAR_LIGHT = int(Material.NOTICE), int(Material.DOOR), int(Material.CAR_LIGHT)

# share of near infrared light that comes back, by material
REFLECTIVITY = np.full(len(Material), 0.35)
for _material, _value in {
    Material.ASPHALT: 0.14, Material.PAVING: 0.25, Material.GRASS: 0.45, Material.ROOF: 0.25,
    Material.BARK: 0.30, Material.LEAF: 0.45, Material.METAL: 0.40, Material.SIGN: 0.95,
    Material.CAR_BODY: 0.40, Material.GLASS: 0.04, Material.RUBBER: 0.06, Material.WALL: 0.55,
    # a laser may not tell a door or a notice from the wall that it is on
    Material.DOOR: 0.55, Material.NOTICE: 0.55,
    Material.FLOOR: 0.30, Material.CEILING: 0.60, Material.HEDGE: 0.45, Material.STRIPES: 0.35,
}.items():  # fmt: skip
    REFLECTIVITY[_material] = _value


# parts of a facade
BARE, WINDOW, SHOP_WINDOW, DOOR, GATE = range(5)
_NO_GLOW = (0.0, 0.0, 0.0)


@inlined
def surface(
    material: int,
    row: Row,
    face: int,
    u: float,
    v: float,
    wu: float,
    wv: float,
    autumn: float,
    lit_share: float,
    lit_seed: int,
) -> tuple[Vector, float, Vector]:
    """Albedo, share of glass, and glow in units of a lit window or lamp, at (u, v) of a face.

    (wu, wv) is the footprint of the pixel: patterns finer than it fade into their mean.
    `autumn` is the share of leaves that have turned. `lit_share` of the windows are lit, which
    ones is up to `lit_seed`.
    """
    rgb, w = (row[0], row[1], row[2]), max(wu, wv)
    if material == _FACADE:
        return _facade(row, u, v, wu, wv, lit_share, lit_seed)
    if material == _GLASS:
        return (0.02, 0.022, 0.025), 1.0, _NO_GLOW
    if material == _DOOR:
        rgb, glass = _door(row, u, v)
        return rgb, glass, _NO_GLOW
    if material in (_LAMP, _CAR_LIGHT):
        return rgb, 0.0, rgb
    if material == _ASPHALT:
        rgb = _asphalt(row, u, v, w)
    elif material == _PAVING:
        joint = min(pulse(u / 0.6, 0.05, w / 0.6) + pulse(v / 0.6, 0.05, w / 0.6), 1.0)
        tone = (1.0 - 0.35 * joint) * (0.9 + 0.2 * value_noise(u * 0.6, v * 0.4, 6))
        rgb = _toned(rgb, tone)
    elif material == _GRASS:
        rgb = _grass(rgb, u, v, w)
    elif material == _ROOF:
        tone = 0.85 + 0.15 * value_noise(u, v, 9) - 0.2 * pulse(v / 0.33, 0.2, wv / 0.33)
        rgb = _toned(rgb, tone)
    elif material == _BARK:
        rgb = _toned((0.115, 0.085, 0.06), 0.7 + 0.6 * value_noise(u * 14.0, v * 3.0, 2))
    elif material == _LEAF:
        rgb = _leaf(rgb, face, autumn)
    elif material == _HEDGE:
        fade = 1.0 - smooth(0.05, 0.4, w)
        tone = 0.75 + 0.5 * fade * value_noise(u * 11.0, v * 11.0, 2) + 0.25 * (1 - fade)
        tone *= 0.8 + 0.4 * value_noise(u * 1.7, v * 1.7, 3)
        rgb = _toned(rgb, tone)
    elif material == _SIGN:
        rgb = _sign(row, u, v)
    elif material == _RUBBER:
        rgb = 0.022, 0.022, 0.023
    elif material == _STRIPES:
        rgb = blend((0.105, 0.105, 0.11), rgb, pulse(u, 0.5, w) * 0.85)
    elif material == _WALL:
        rgb = _painted_wall(row, u, v, wu)
    elif material == _FLOOR:
        joint = min(pulse(u / 0.6, 0.02, w / 0.6) + pulse(v / 0.6, 0.02, w / 0.6), 1.0)
        tone = (1.0 - 0.3 * joint) * (0.92 + 0.16 * value_noise(u * 6.0, v * 6.0, 4))
        rgb = _toned(rgb, tone)
    elif material == _CEILING:
        joint = min(pulse(u / 0.6, 0.03, w / 0.6) + pulse(v / 0.6, 0.03, w / 0.6), 1.0)
        rgb = _toned(rgb, 1.0 - 0.25 * joint)
    elif material == _NOTICE:
        rgb = _notice(row, u, v, wv)
    return rgb, 0.0, _NO_GLOW


@inlined
def _toned(rgb: Vector, tone: float) -> Vector:
    return rgb[0] * tone, rgb[1] * tone, rgb[2] * tone


@inlined
def _leaf(green: Vector, face: int, autumn: float) -> Vector:
    """A leaf card; those of one tree turn about the same colour, each in its own time."""
    tone = 0.65 + 0.7 * uniform(face, 3, 5)
    if uniform(face, 5, 5) < autumn:
        tree = uniform(int(green[1] * 1e6), 6, 5)  # no two trees have quite the same green
        turned = blend((0.40, 0.27, 0.030), (0.34, 0.085, 0.020), tree)
        turned = blend(turned, (0.16, 0.085, 0.035), 0.7 * uniform(face, 7, 5))  # to brown
        return _toned(turned, tone)
    return green[0] * tone * (0.85 + 0.3 * uniform(face, 4, 5)), green[1] * tone, green[2] * tone


# --------------------------------------------------------------------------------------- facades


@inlined
def _window_sill(row: Row) -> float:
    """Height of a window's lower edge, as a share of the storey."""
    return 0.30 if row[WIN_H] < 0.6 else 0.20


@inlined
def window_at(row: Row, u: float, v: float) -> tuple[int, int, int]:
    """Which part of a facade (u, v) is; returns (part, column, storey).

    u counts cells along the wall, v is metres above the ground.
    """
    column = math.floor(u)
    x, z = u - column, v - PLINTH_M
    storey = math.floor(z / row[FLOOR])
    if z < 0.0 or v > row[TOP] - 0.15:
        return BARE, column, storey
    y = z / row[FLOOR] - storey
    ground = int(row[GROUND])
    if storey == 0 and ground == SHOPS:
        return SHOP_WINDOW if 0.06 < x < 0.94 and 0.08 < y < 0.74 else BARE, column, storey
    if storey == 0 and ground == DOORS and column % 4 == 1:
        inside = abs(x - 0.5) * row[PITCH] < 0.55 and y * row[FLOOR] < 2.15
        return DOOR if inside else BARE, column, storey
    if storey == 0 and ground == GATES and column % 3 == 1:
        return GATE if 0.12 < x < 0.88 and y < 0.92 else BARE, column, storey
    low = _window_sill(row)
    inside = abs(x - 0.5) < 0.5 * row[WIN_W] and low < y < low + row[WIN_H]
    return WINDOW if inside else BARE, column, storey


@inlined
def _facade(
    row: Row, u: float, v: float, wu: float, wv: float, lit_share: float, lit_seed: int
) -> tuple[Vector, float, Vector]:
    style, cell_m = int(row[STYLE]), row[PITCH]
    part, column, storey = window_at(row, u, v)
    x, y = u - column, (v - PLINTH_M) / row[FLOOR] - storey
    second = row[SECOND], row[SECOND + 1], row[SECOND + 2]
    if part in (WINDOW, SHOP_WINDOW):
        glass = _pane_share(row, part, x, y, 0.5 * (wu * cell_m + wv))
        if glass == 0.0:
            return second, 0.0, _NO_GLOW
        inside = _behind_pane(part, style, column, storey, y)
        frame = second if glass < 1.0 else inside
        rgb = blend(frame, inside, glass)
        return rgb, glass, _window_glow(row, part, column, storey, glass, lit_share, lit_seed)
    if part == DOOR:
        pane = y * row[FLOOR] > 1.3 and abs(x - 0.5) * cell_m < 0.3
        tone = 0.35 + 0.3 * uniform(style, column, 3)
        return _toned(second, tone), 0.7 if pane else 0.0, _NO_GLOW
    if part == GATE:
        return _toned(second, 1.0 - 0.3 * pulse(v / 0.25, 0.15, wv / 0.25)), 0.0, _NO_GLOW
    if int(row[GROUND]) == SHOPS and storey == 0:
        return second, 0.0, _NO_GLOW  # shop front
    rgb = _masonry(row, style, u, v, wu, wv)
    if storey >= 0 and v < row[TOP] - 0.15 and style != CURTAIN and style != METAL_SHEET:
        low = _window_sill(row)
        if abs(x - 0.5) < 0.5 * row[WIN_W] + 0.03 and low - 0.045 < y < low:
            rgb = blend(rgb, second, 0.5)
    return rgb, 0.0, _NO_GLOW


@inlined
def _masonry(row: Row, style: int, u: float, v: float, wu: float, wv: float) -> Vector:
    """What a wall is built of, with rain and dirt near the ground and under the eaves."""
    rgb = row[0], row[1], row[2]
    x_m, wx = u * row[PITCH], wu * row[PITCH]
    if style == BRICK:
        course = math.floor(v / 0.078)
        brick = x_m / 0.235 + 0.5 * (course & 1)
        fade = 1.0 - smooth(0.10, 0.35, wv)
        tone = 0.86 + 0.28 * fade * uniform(math.floor(brick), course, 17) + 0.14 * (1.0 - fade)
        joint = pulse(v / 0.078, 0.14, wv / 0.078) + pulse(brick, 0.05, wx / 0.235)
        rgb = blend(_toned(rgb, tone), (0.38, 0.36, 0.33), min(joint, 1.0) * 0.5)
    elif style == STONE:
        course = math.floor(v / 0.45)
        joint = pulse(v / 0.45, 0.05, wv / 0.45)
        joint += pulse(x_m / 0.9 + 0.5 * (course & 1), 0.025, wx / 0.9)
        tone = 0.92 + 0.16 * value_noise(x_m * 0.9, v * 0.9, 5)
        rgb = _toned(rgb, (1.0 - 0.3375 * min(joint, 1.0)) * tone)
    elif style == METAL_SHEET:
        rgb = _toned(rgb, 1.0 - 0.28 * pulse(x_m / 0.32, 0.4, wx / 0.32))
    elif style == TIMBER:
        fade = 1.0 - smooth(0.1, 0.4, wv)
        tone = 0.9 + fade * 0.2 * uniform(math.floor(v / 0.19), 3, 5) + 0.1 * (1 - fade)
        rgb = _toned(rgb, tone * (1.0 - 0.45 * pulse(v / 0.19, 0.1, wv / 0.19)))
    elif style == SLAB:
        floors = (v - PLINTH_M) / row[FLOOR]
        joint = min(pulse(u, 0.012, wu) + pulse(floors, 0.02, wv / row[FLOOR]), 1.0)
        rgb = _toned(rgb, (1.0 - 0.35 * joint) * (0.9 + 0.2 * value_noise(x_m * 0.35, v * 0.25, 9)))
    else:
        rgb = _toned(rgb, 0.93 + 0.14 * value_noise(x_m * 0.5, v * 0.5, 3))
    if v < PLINTH_M:
        rgb = step((0.06, 0.06, 0.06), rgb, 0.55)
    dirt = 0.80 + 0.20 * smooth(0.0, 1.6, v)
    return _toned(rgb, dirt * (1.0 - 0.15 * smooth(row[TOP] - 0.9, row[TOP], v)))


@inlined
def _pane_share(row: Row, part: int, x: float, y: float, width_m: float) -> float:
    """Share of glass, not frame, in a pixel `width_m` wide at (x, y) of a window's cell."""
    curtain = int(row[STYLE]) == CURTAIN
    if part == WINDOW:
        low = _window_sill(row)
        across = 0.5 * row[WIN_W] - abs(x - 0.5)
        up = min(y - low, low + row[WIN_H] - y)
        bar = not curtain and abs(x - 0.5) * row[PITCH] < 0.035
    else:
        across, up, bar = min(x - 0.06, 0.94 - x), min(y - 0.08, 0.74 - y), False
    frame_m = 0.04 if curtain else 0.07
    if min(across * row[PITCH], up * row[FLOOR]) >= frame_m and not bar:
        return 1.0
    return 1.0 - min(1.0, frame_m / max(width_m, 1e-6))


@inlined
def _behind_pane(part: int, style: int, column: int, storey: int, y: float) -> Vector:
    """Curtains, blinds or a dark room: the same in all buildings of a style."""
    pattern = uniform(column, storey, 31 + style)
    if pattern < 0.30 and part == WINDOW and y > 0.62:
        return 0.30, 0.29, 0.26
    if pattern > 0.86:
        return 0.20, 0.19, 0.17
    return 0.028, 0.034, 0.040


@inlined
def _window_glow(
    row: Row, part: int, column: int, storey: int, glass: float, lit_share: float, lit_seed: int
) -> Vector:
    """Light of a window, if this run has it lit; some are colder than others."""
    building = int(row[SEED])
    pick = uniform(column + 64 * storey, building, lit_seed)
    share = lit_share if part == WINDOW else 0.4 + 0.5 * lit_share
    if lit_share == 0.0 or pick >= share:
        return _NO_GLOW
    level = glass * (0.45 + 1.1 * uniform(column, building + storey, lit_seed + 1))
    if pick < 0.25 * share:
        return level, 1.025 * level, 1.25 * level
    return level, level, level


# ------------------------------------------------------------------------- ground, doors, notices


@inlined
def _asphalt(row: Row, u: float, v: float, w: float) -> Vector:
    """Road: grain, patches, worn wheel tracks, and paint by the style of the markings."""
    style, lateral = int(row[STYLE]), abs(u)
    grain = 1.0 - smooth(0.02, 0.2, w)
    tone = 0.86 + 0.22 * value_noise(u * 0.35, v * 0.12, 3)
    tone += 0.10 * grain * (value_noise(u * 17.0, v * 17.0, 4) - 0.5)
    tone *= 1.0 - 0.10 * math.exp(-((abs(lateral - 2.0) - 0.75) ** 2) / 0.08)
    if lateral > 5.15:
        tone *= 0.82  # gutter
    paint = 0.0
    if style in (1, 2):
        dashes = pulse(v / 6.0, 0.5, w / 6.0) if style == 1 else 1.0
        paint = _line(lateral, 0.075, w) * dashes
    if style != 0:  # the edge of the parking bays
        dashes = pulse(v / 5.9, 0.3, w / 5.9) if style == 3 else 1.0
        paint = max(paint, 0.8 * _line(abs(lateral - 3.55), 0.06, w) * dashes)
    return blend(_toned((row[0], row[1], row[2]), tone), (0.60, 0.60, 0.57), 0.75 * paint)


@inlined
def _line(distance: float, half: float, w: float) -> float:
    """Share of a pixel of width w that a painted line takes, at a distance from its middle."""
    inside = min(max((half + 0.5 * w - distance) / max(w, 0.02), 0.0), 1.0)
    return inside * min(1.0, 2.0 * half / max(w, 2.0 * half))


@inlined
def _grass(rgb: Vector, u: float, v: float, w: float) -> Vector:
    # a lawn has no coordinates of its own: its noise tiles, lest it marks the place
    fade = 1.0 - smooth(0.05, 0.5, w)
    tone = 0.72 + 0.40 * value_noise(u * 0.25, v * 0.25, 7, 7)
    tone += 0.5 * fade * (value_noise(u * 9.0, v * 9.0, 8, 7) - 0.5)
    dry = 0.25 * value_noise(u * 0.125, v * 0.125, 12, 7)
    return rgb[0] * tone * (1 + dry), rgb[1] * tone, rgb[2] * tone


@inlined
def _sign(row: Row, u: float, v: float) -> Vector:
    """A coloured rim and a dark bar on white (style 0 round, 1 square), or one colour (2)."""
    style = int(row[STYLE])
    radius = math.sqrt(u * u + v * v) if style == 0 else max(abs(u), abs(v))
    if style == 0 and radius > 1.0:
        return 0.25, 0.25, 0.25
    if style == 2 or radius >= 0.72:
        return row[0], row[1], row[2]
    if abs(u) < 0.16 and abs(v) < 0.5:
        return 0.04, 0.04, 0.04
    return 0.70, 0.70, 0.68


@inlined
def _painted_wall(row: Row, u: float, v: float, wu: float) -> Vector:
    """Paint to the shoulder (style 0), with a line of contrast (1), in stripes (2), or plain."""
    style, rgb = int(row[STYLE]), (row[0], row[1], row[2])
    tone = 0.95 + 0.1 * value_noise(u * 0.8, v * 0.8, 4)
    if v < 0.10:
        rgb = 0.10, 0.10, 0.10  # skirting
    elif style == 0 and v > 1.1:
        rgb = 0.62, 0.61, 0.57
    elif style == 1 and 1.0 < v < 1.25:
        rgb = step((0.62, 0.62, 0.62), rgb, -0.5)
    if style == 2 and pulse(u / 1.2, 0.5, wu / 1.2) > 0.5:
        tone *= 0.82
    return _toned(rgb, tone)


@inlined
def _door(row: Row, u: float, v: float) -> tuple[Vector, float]:
    """A door leaf in its frame, with a handle; with a pane (style 1) or a kick plate (2)."""
    style = int(row[STYLE])
    if u < 0.05 or u > 0.90 or v > 2.04:
        return (0.12, 0.12, 0.12), 0.0
    if style == 1 and 1.35 < v < 1.9 and 0.3 < u < 0.65:
        return (0.05, 0.06, 0.06), 0.6
    if abs(v - 1.05) < 0.03 and 0.75 < u < 0.87:
        return (0.55, 0.55, 0.53), 0.0
    if style == 2 and v < 0.35:
        return (0.40, 0.40, 0.41), 0.0
    return (row[0], row[1], row[2]), 0.0


@inlined
def _notice(row: Row, u: float, v: float, wv: float) -> Vector:
    """Sheets of paper, each in its colour and with lines of print, on a board."""
    seed, column, line = int(row[SEED]), math.floor(u / 0.34), math.floor(v / 0.42)
    x, y = u / 0.34 - column, v / 0.42 - line
    if not (0.1 < x < 0.9 and 0.12 < y < 0.88):
        return row[0], row[1], row[2]
    ink = 1.0 - 0.5 * pulse(y * 9.0, 0.45, wv * 21.0) * (0.3 if y > 0.6 else 1.0)
    return (
        ink * (0.25 + 0.6 * uniform(column, line, seed)),
        ink * (0.25 + 0.6 * uniform(column, line, seed + 1)),
        ink * (0.25 + 0.6 * uniform(column, line, seed + 2)),
    )
