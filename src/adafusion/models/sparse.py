# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Convolutions over the occupied cells of 3-D grids, where a dense grid would be too large.

Features are rows, one an occupied cell, in the order of the cells in their `Sites`. Which cells
meet in a kernel is found once for all layers over the same cells, by a search in their sorted
numbers; a layer then gathers rows and multiplies once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import torch
from jaxtyping import Float, Int, Int32
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

MAX_NUMBER = torch.iinfo(torch.int64).max  # of a cell, and beyond that of every cell
CPU_GATHERED = 2**18  # numbers gathered at once: as many as stay in a core's cache
GPU_GATHERED = 2**26  # as many as memory has room for beside the features


@dataclass(frozen=True)
class Sites:
    """The occupied cells of a batch of grids, none twice, sorted by item, then by x, y and z."""

    cells: Int[Tensor, "n 4"]  # item, x, y, z

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Cells of each item."""
        return tuple(torch.bincount(self.cells[:, 0]).tolist())

    @cached_property
    def _neighbours(self) -> dict[int, Int32[Tensor, "n k"]]:
        return {}

    def neighbours(self, size: int) -> Int32[Tensor, "n k"]:
        """Rows of the cells that a kernel of odd size sees from each cell; n where one is empty.

        The kernel's cells are in the order of a dense kernel's: x slowest, z fastest.
        """
        if size not in self._neighbours:
            self._neighbours[size] = _neighbours(self.cells, size)
        return self._neighbours[size]

    @cached_property
    def halved(self) -> tuple[Sites, Int[Tensor, " n"]]:
        """The cells twice as large that hold these, and the slot of each of these in them.

        The slot is eight times the large cell's row plus the corner, 0 to 7, that this cell fills.
        """
        coarse = self.cells.clone()
        coarse[:, 1:] >>= 1  # rounds down on either side of zero
        first, parent = _unique(_numbered(coarse)[0])
        corner = ((self.cells[:, 1:] & 1) * self.cells.new_tensor([4, 2, 1])).sum(dim=1)
        return Sites(coarse[first]), 8 * parent + corner

    def mean(self, x: Float[Tensor, "n c"]) -> Float[Tensor, "b c"]:
        """Mean of each item's rows; equal from run to run on a GPU too, unlike a scattered sum."""
        return torch.stack([rows.mean(dim=0) for rows in x.split(self.counts)])

    def scale(self, x: Float[Tensor, "n c"], by: Float[Tensor, "b c"]) -> Float[Tensor, "n c"]:
        """Each item's rows times its own row of `by`; equal from run to run, as is `mean`."""
        return torch.cat([rows * row for rows, row in zip(x.split(self.counts), by, strict=True)])


def occupied(points: Float[Tensor, "b n 3"], size: float) -> Sites:
    """The cells of edge `size` that hold a point; a cell owns its lower faces.

    Raises ValueError for points so far apart that the cells between them cannot be numbered.
    """
    index = (points / size).floor().long()
    item = torch.arange(len(points), device=points.device).repeat_interleave(points.shape[1])
    cells = torch.cat([item[:, None], index.flatten(0, 1)], dim=1)
    return Sites(cells[_unique(_numbered(cells)[0])[0]])


class SparseConv3d(nn.Module):
    """A convolution of odd size and stride 1, without bias, whose outputs are the inputs' cells."""

    def __init__(self, c_in: int, c_out: int, size: int) -> None:
        super().__init__()
        self.size = size
        self.weight = nn.Parameter(torch.empty(size**3, c_in, c_out))
        self.initialise()

    def forward(self, x: Float[Tensor, "n c"], sites: Sites) -> Float[Tensor, "n out"]:
        """Convolve the rows of x."""
        x = x.to(self.weight.dtype)  # may differ where the arithmetic is of mixed precision
        neighbours = sites.neighbours(self.size)
        return _Convolve.apply(x, self.weight, neighbours)  # type: ignore[no-untyped-call]

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw the weights so that gradients would keep their size in a full grid."""
        initialise_fan_out(self.weight, generator)


class Halve(nn.Module):
    """A convolution of size 2 and stride 2, without bias: from cells to those twice as large."""

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(8, c_in, c_out))
        self.initialise()

    def forward(self, x: Float[Tensor, "n c"], sites: Sites) -> Float[Tensor, "m out"]:
        """Convolve the rows of x, those of `sites`, to rows of `sites.halved`."""
        coarse, slot = sites.halved
        corners = x.new_zeros(8 * len(coarse.cells), x.shape[1]).index_copy(0, slot, x)
        return corners.unflatten(0, (-1, 8)).flatten(1) @ self.weight.flatten(0, 1)

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw the weights so that gradients would keep their size in a full grid."""
        initialise_fan_out(self.weight, generator)


class Double(nn.Module):
    """The transpose of `Halve`: back to cells that are known, each from the one that holds it."""

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(8, c_in, c_out))
        self.initialise()

    def forward(self, x: Float[Tensor, "m c"], sites: Sites) -> Float[Tensor, "n out"]:
        """Spread the rows of x, those of `sites.halved`, to rows of `sites`."""
        _, slot = sites.halved
        corners = x @ self.weight.transpose(0, 1).flatten(1)
        return corners.unflatten(1, (8, -1)).flatten(0, 1).index_select(0, slot)

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw the weights so that gradients would keep their size in a full grid."""
        initialise_fan_out(self.weight, generator)


def initialise_fan_out(
    weight: Float[Tensor, "k c out"], generator: torch.Generator | None = None
) -> None:
    """Draw weights as He et al. (2015) do, by how many outputs an input has."""
    fan_out = weight.shape[0] * weight.shape[2]
    nn.init.normal_(weight, 0.0, (2.0 / fan_out) ** 0.5, generator=generator)


class _Convolve(torch.autograd.Function):
    """Gather the neighbours of some cells, multiply, go on with the next cells.

    Gathers anew for the gradient: to keep what was gathered would take as many times the features'
    memory as the kernel has cells. Nothing is scattered, so the sums' order never changes.
    """

    @staticmethod
    def forward(
        ctx: Any,
        x: Float[Tensor, "n c"],
        weight: Float[Tensor, "k c out"],
        neighbours: Int32[Tensor, "n k"],
    ) -> Float[Tensor, "n out"]:
        ctx.save_for_backward(x, weight, neighbours)
        kernel = weight.flatten(0, 1)
        return torch.cat([(seen @ kernel).to(x) for _, seen in _gathered(x, neighbours)])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, y_grad: Float[Tensor, "n out"]) -> tuple[Tensor | None, Tensor, None]:
        x, weight, neighbours = ctx.saved_tensors
        weight_grad = weight.new_zeros(neighbours.shape[1] * x.shape[1], y_grad.shape[1])
        for part, seen in _gathered(x, neighbours):
            weight_grad += seen.mT @ y_grad[part]
        x_grad = None
        if ctx.needs_input_grad[0]:  # who sees a cell is whom it sees, through the kernel mirrored
            back = weight.flip(0).mT.flatten(0, 1)
            x_grad = torch.cat([seen @ back for _, seen in _gathered(y_grad, neighbours)])
        return x_grad, weight_grad.view_as(weight), None


def _gathered(
    x: Float[Tensor, "n c"], neighbours: Int32[Tensor, "n k"]
) -> Iterator[tuple[slice, Float[Tensor, "part kc"]]]:
    """Give the neighbours' rows side by side, zero where there is none, some cells at a time."""
    x = torch.cat([x, x.new_zeros(1, x.shape[1])])
    columns = neighbours.shape[1] * x.shape[1]
    step = max(1, (CPU_GATHERED if x.device.type == "cpu" else GPU_GATHERED) // columns)
    for start in range(0, len(neighbours), step):
        part = slice(start, start + step)
        yield part, x.index_select(0, neighbours[part].flatten()).view(-1, columns)


def _neighbours(cells: Int[Tensor, "n 4"], size: int) -> Int32[Tensor, "n k"]:
    """See `Sites.neighbours`."""
    reach = size // 2
    numbers, steps = _numbered(cells, margin=reach)
    beyond = torch.cat([numbers, numbers.new_tensor([MAX_NUMBER])])
    table = torch.full((len(cells), size**3), len(cells), dtype=torch.int32, device=cells.device)

    # the kernel's cells of one x and y have numbers that follow each other: look for the first of
    # them that is occupied, then see whether those that follow it are among them too
    rows = list(product(range(-reach, reach + 1), range(-reach, reach + 1), [-reach]))
    lowest = numbers + (cells.new_tensor(rows) * steps[1:]).sum(dim=1)[:, None]
    at = torch.searchsorted(numbers, lowest)
    row, here = (beyond[at] - lowest < size).nonzero(as_tuple=True)
    at, lowest = at[row, here], lowest[row, here]
    while len(at):
        table[here, size * row + numbers[at] - lowest] = at.int()
        at = at + 1
        found = beyond[at] - lowest < size
        row, here, at, lowest = row[found], here[found], at[found], lowest[found]
    return table


def _numbered(
    cells: Int[Tensor, "n 4"], margin: int = 0
) -> tuple[Int[Tensor, " n"], Int[Tensor, " 4"]]:
    """Number cells in their order, and say by how much a step along each axis changes it.

    With a margin no cell of one row, plane or item comes that close to the next one's.
    """
    lower = cells.amin(dim=0) - cells.new_tensor([0, margin, margin, margin])
    upper = cells.amax(dim=0) + cells.new_tensor([1, 1 + margin, 1 + margin, 1 + margin])
    items, *spans = (upper - lower).tolist()
    if min(spans) < 1 or items * math.prod(spans) >= MAX_NUMBER:
        raise ValueError(f"points span {spans} cells, too many to number: take larger ones")
    steps = cells.new_tensor([math.prod(spans[i:]) for i in range(4)])
    return ((cells - lower) * steps).sum(dim=1), steps


def _unique(numbers: Int[Tensor, " n"]) -> tuple[Int[Tensor, " m"], Int[Tensor, " n"]]:
    """Where each number first appears, numbers ascending; and which of these each entry is."""
    ascending, order = numbers.sort(stable=True)
    new = torch.ones_like(ascending, dtype=torch.bool)
    new[1:] = ascending[1:] != ascending[:-1]
    rank = torch.empty_like(order)
    rank[order] = new.cumsum(dim=0) - 1
    return order[new], rank
