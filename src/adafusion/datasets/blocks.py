# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Regions for a recording that nobody has split yet: whole blocks of ground, cut in chunks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from adafusion.datasets.splits import GUARD, Box, Regions, box_gap, with_guard
from adafusion.types import UserError

CHUNK_BLOCKS = 9  # blocks of 100 m: as large as a test box of the RobotCar split

Cell = tuple[int, int]  # of a grid through the world's origin


class Chosen(NamedTuple):
    """Blocks that make a region."""

    boxes: list[list[float]]  # of whole blocks, several in one where they make a rectangle
    blocks: int
    eligible: int  # blocks that two runs visit and that are far enough from other regions
    visited: int  # blocks that any run visits


def choose_blocks(
    positions_xy: Float[np.ndarray, "n 2"],
    runs: Sequence[str],
    share: float,
    rng: np.random.Generator,
    *,
    block_m: float = 100.0,
    keep_off: Sequence[tuple[Box, float]] = (),
) -> Chosen:
    """Choose blocks of `block_m` that hold about `share` of all frames, where two runs or more go.

    A query needs a map of another run, so a block that only one run visits can judge nobody.
    Blocks are taken in connected chunks from random starts: a few wide regions lose fewer frames to
    the guard around them than many small ones. Blocks nearer than so many metres to the boxes of
    `keep_off` are left alone. UserError where no block can be chosen.
    """
    if not 0.0 < share < 1.0 or not 0.0 < block_m < np.inf:
        raise UserError(
            f"a share of {share:g} in blocks of {block_m:g} m: give a share of the frames between "
            "0 and 1, and blocks of some metres"
        )
    cells = [(int(x), int(y)) for x, y in np.floor(positions_xy / block_m)]
    frames: dict[Cell, int] = {}
    seen_by: dict[Cell, set[str]] = {}
    for cell, run in zip(cells, runs, strict=True):
        frames[cell] = frames.get(cell, 0) + 1
        seen_by.setdefault(cell, set()).add(run)
    free = {
        cell
        for cell, by in seen_by.items()
        if len(by) > 1
        and all(box_gap(_box(cell, cell, block_m), box) >= gap for box, gap in keep_off)
    }
    eligible = frozenset(free)
    if not free:
        raise UserError(
            f"none of {len(frames)} blocks of {block_m:g} m is visited by two runs and lies apart "
            "from the other regions: drive the route twice, or choose other blocks (--block-m), a "
            "smaller guard (--buffer-m) or boxes by hand (--box)"
        )
    target, got = share * len(cells), 0
    chosen: set[Cell] = set()
    chunk: set[Cell] = set()
    while free and got < target:
        near = {cell: len(_around(cell) & chunk) for cell in free if _around(cell) & chunk}
        if not near or len(chunk) >= CHUNK_BLOCKS:
            chunk, near = set(), dict.fromkeys(free, 0)
        most = max(near.values())  # the more neighbours a block has, the rounder the chunk
        cell = _draw(rng, (cell for cell, count in near.items() if count == most))
        free.remove(cell)
        if got + frames[cell] - target > target - got:
            continue  # a block where the vehicle stood for long may be far more than what lacks
        chosen.add(cell)
        chunk.add(cell)
        got += frames[cell]
    chosen = chosen or {min(eligible, key=lambda cell: (frames[cell], cell))}
    return Chosen(_rectangles(chosen, block_m), len(chosen), len(eligible), len(frames))


def cut_region(
    name: str,
    share: float,
    regions: Regions,
    positions_xy: Float[np.ndarray, "n 2"],
    runs: Sequence[str],
    rng: np.random.Generator,
    *,
    block_m: float = 100.0,
    buffer_m: float = 25.0,
) -> tuple[dict[str, list[list[float]]], Chosen]:
    """Cut one more region out of training, with a guard around; those that are there stay.

    It holds about `share` of all frames, none of them within `buffer_m` of a frame of training or
    of another region. `runs` names the run of each position.
    """
    if name in regions:
        raise UserError(f"there is a {name} region already: leave it, or begin without")
    keep_off = [
        (box, 0.0 if other == GUARD else buffer_m)
        for other, boxes in regions.items()
        for box in boxes
    ]
    chosen = choose_blocks(positions_xy, runs, share, rng, block_m=block_m, keep_off=keep_off)
    old = {other: [list(box) for box in boxes] for other, boxes in regions.items()}
    new = with_guard({name: chosen.boxes}, buffer_m)
    strips = old.pop(GUARD, []) + new.pop(GUARD, [])
    # the guard last: it covers the boxes that it surrounds
    return old | new | ({GUARD: strips} if strips else {}), chosen


def _around(cell: Cell) -> set[Cell]:
    return {(cell[0] + dx, cell[1] + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)} - {cell}


def _draw(rng: np.random.Generator, cells: Iterable[Cell]) -> Cell:
    ordered = sorted(cells)  # sets have no order that a seed could repeat
    return ordered[rng.integers(len(ordered))]


def _box(first: Cell, last: Cell, block_m: float) -> list[float]:
    """The box from one block to another, both in it; grid lines are the same from either side."""
    return [
        first[0] * block_m,
        first[1] * block_m,
        (last[0] + 1) * block_m,
        (last[1] + 1) * block_m,
    ]


def _rectangles(cells: set[Cell], block_m: float) -> list[list[float]]:
    """The cells as few boxes: along x first, then rows of the same reach on one another."""
    rows: list[tuple[Cell, Cell]] = []
    for x, y in sorted(cells, key=lambda cell: (cell[1], cell[0])):
        if rows and rows[-1][1] == (x - 1, y):
            rows[-1] = (rows[-1][0], (x, y))
        else:
            rows.append(((x, y), (x, y)))
    boxes: dict[tuple[int, int], list[tuple[Cell, Cell]]] = {}
    for first, last in rows:
        column = boxes.setdefault((first[0], last[0]), [])
        if column and column[-1][1][1] == first[1] - 1:
            column[-1] = (column[-1][0], last)
        else:
            column.append((first, last))
    return [_box(first, last, block_m) for column in boxes.values() for first, last in column]
