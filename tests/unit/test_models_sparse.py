# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Sparse convolutions give what dense ones give at the occupied cells, gradients and all."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from adafusion.models import sparse
from adafusion.models.sparse import Double, Halve, Sites, SparseConv3d, occupied

SIDE = 8


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def scattered(share: float = 0.3, items: int = 2) -> Sites:
    """Cells of an 8 x 8 x 8 grid an item, about `share` of them occupied, each item's its own."""
    return Sites((torch.rand(items, SIDE, SIDE, SIDE, generator=seeded()) < share).nonzero())


def dense(x: Tensor, sites: Sites, side: int = SIDE) -> Tensor:
    item, *xyz = sites.cells.T
    grid = x.new_zeros(len(sites.counts), x.shape[1], side, side, side)
    return grid.movedim(1, -1).index_put((item, *xyz), x).movedim(-1, 1)


def at(grid: Tensor, sites: Sites) -> Tensor:
    item, *xyz = sites.cells.T
    return grid.movedim(1, -1)[(item, *xyz)]


def as_dense_kernel(weight: Tensor, size: int) -> Tensor:
    return weight.permute(2, 1, 0).unflatten(2, (size, size, size))  # out, in, x, y, z


def rows(n: int, channels: int) -> Tensor:
    x = torch.randn(n, channels, generator=seeded(1), dtype=torch.float64)
    return x.requires_grad_()


def assert_same(ours: Tensor, theirs: Tensor, *inputs: Tensor) -> None:
    """Values and gradients of two ways to compute the same from the same inputs."""
    pull = torch.randn(ours.shape, generator=seeded(2), dtype=ours.dtype)
    torch.testing.assert_close(ours, theirs)
    gradients = [torch.autograd.grad((y * pull).sum(), inputs) for y in (ours, theirs)]
    for mine, other in zip(*gradients, strict=True):
        assert mine.any()
        torch.testing.assert_close(mine, other)


@pytest.mark.parametrize("size", [1, 3, 5])
@pytest.mark.parametrize("gathered", [1, 2**18])
def test_it_convolves_as_a_dense_grid_does(
    size: int, gathered: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sparse, "CPU_GATHERED", gathered)  # 1: cell by cell
    sites = scattered(share=0.05 if gathered == 1 else 0.3)
    conv = SparseConv3d(3, 4, size).double()
    x = rows(len(sites.cells), 3)
    kernel = as_dense_kernel(conv.weight, size)
    theirs = at(F.conv3d(dense(x, sites), kernel, padding=size // 2), sites)
    assert_same(conv(x, sites), theirs, x, conv.weight)


def test_it_halves_as_a_dense_convolution_of_stride_2_does() -> None:
    sites = scattered(share=0.1)
    halve = Halve(3, 4).double()
    x = rows(len(sites.cells), 3)
    coarse = sites.halved[0]
    theirs = at(F.conv3d(dense(x, sites), as_dense_kernel(halve.weight, 2), stride=2), coarse)
    assert_same(halve(x, sites), theirs, x, halve.weight)


def test_it_doubles_as_a_dense_transposed_convolution_does() -> None:
    sites = scattered(share=0.1)
    double = Double(3, 4).double()
    coarse = sites.halved[0]
    x = rows(len(coarse.cells), 3)
    kernel = double.weight.permute(1, 2, 0).unflatten(2, (2, 2, 2))  # in, out, x, y, z
    theirs = at(F.conv_transpose3d(dense(x, coarse, SIDE // 2), kernel, stride=2), sites)
    assert_same(double(x, sites), theirs, x, double.weight)


def test_its_gradients_are_the_differences_quotients() -> None:
    sites = scattered(share=0.05, items=1)
    conv = SparseConv3d(2, 2, 3).double()
    x = rows(len(sites.cells), 2)
    assert torch.autograd.gradcheck(lambda x, _: conv(x, sites), (x, conv.weight))


def test_a_first_layer_s_input_needs_no_gradient() -> None:
    sites = scattered()
    conv = SparseConv3d(1, 2, 3)
    conv(torch.ones(len(sites.cells), 1), sites).sum().backward()
    assert conv.weight.grad is not None
    # the weight of the centre meets every cell, with a gradient of 1 for each output
    assert conv.weight.grad[13].tolist() == [[len(sites.cells)] * 2]


def test_points_occupy_each_cell_once_and_a_cell_owns_its_lower_faces() -> None:
    points = torch.tensor(
        [
            [[0.5, 0.5, 0.5], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
            [[-0.25, 0.5, 3.0], [-0.75, 0.5, 3.75], [-1.25, 0.5, 3.5]],
        ]
    )
    sites = occupied(points, 1.0)
    assert sites.cells.tolist() == [[0, 0, 0, 0], [0, 1, 0, 0], [1, -2, 0, 3], [1, -1, 0, 3]]
    assert sites.counts == (2, 2)


def test_cells_twice_as_large_are_the_same_on_either_side_of_zero() -> None:
    sites = Sites(torch.tensor([[0, -3, 0, 0], [0, -2, 1, 0], [0, -1, 1, 1], [1, 0, 0, 1]]))
    coarse, slot = sites.halved
    assert coarse.cells.tolist() == [[0, -2, 0, 0], [0, -1, 0, 0], [1, 0, 0, 0]]
    # row of the large cell, then which of its corners: 4 x + 2 y + z
    assert slot.tolist() == [8 * 0 + 4, 8 * 1 + 2, 8 * 1 + 7, 8 * 2 + 1]


def test_neighbours_are_found_within_an_item_alone() -> None:
    sites = Sites(torch.tensor([[0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 1, -1], [1, 0, 0, 0]]))
    table = sites.neighbours(3)
    found = [(i, int(k), int(row[k])) for i, row in enumerate(table) for k in (row < 4).nonzero()]
    # of 27 cells, z fastest, the centre is 13, the next z 14, the next y and last z 15
    assert found == [
        *[(0, 13, 0), (0, 14, 1), (0, 15, 2)],
        *[(1, 12, 0), (1, 13, 1)],
        *[(2, 11, 0), (2, 13, 2)],
        (3, 13, 3),
    ]


def test_cells_at_the_edges_of_rows_and_planes_are_no_neighbours() -> None:
    sites = Sites(torch.tensor([[0, 0, 4, 9], [0, 0, 5, 0], [0, 0, 9, 9], [0, 1, 0, 0]]))
    for size in (3, 5):
        table = sites.neighbours(size)
        assert ((table < 4).sum(dim=1) == 1).all()
        assert table[:, size**3 // 2].tolist() == [0, 1, 2, 3]


def test_what_is_found_is_kept_for_all_layers_of_one_level() -> None:
    sites = scattered()
    assert sites.neighbours(3) is sites.neighbours(3)
    assert sites.halved is sites.halved
    assert sites.neighbours(3) is not sites.neighbours(5)


def test_the_order_of_points_and_what_else_is_in_the_batch_do_not_matter() -> None:
    points = torch.rand(2, 50, 3, generator=seeded())
    conv = SparseConv3d(1, 4, 3)

    def describe(points: Tensor) -> Tensor:
        sites = occupied(points, 0.1)
        return sites.mean(conv(torch.ones(len(sites.cells), 1), sites).relu())

    whole = describe(points)
    assert torch.equal(describe(points.flip(1)), whole)
    torch.testing.assert_close(describe(points[1:] + 0.0), whole[1:])


def test_means_and_scales_are_each_item_s_own() -> None:
    sites = Sites(torch.tensor([[0, 0, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0]]))
    x = torch.tensor([[1.0, 2.0], [3.0, 6.0], [5.0, 7.0]])
    assert sites.mean(x).tolist() == [[2.0, 4.0], [5.0, 7.0]]
    scaled = sites.scale(x, torch.tensor([[1.0, 0.5], [2.0, 3.0]]))
    assert scaled.tolist() == [[1.0, 1.0], [3.0, 3.0], [10.0, 21.0]]


def test_it_computes_in_mixed_precision() -> None:
    sites = scattered()
    conv, halve, double = SparseConv3d(2, 2, 3), Halve(2, 2), Double(2, 2)
    x = torch.randn(len(sites.cells), 2, generator=seeded(1)).requires_grad_()
    exact = double(halve(conv(x, sites), sites), sites)
    with torch.autocast("cpu", torch.bfloat16):
        mixed = double(halve(conv(x, sites), sites), sites)
    torch.testing.assert_close(mixed.float(), exact, rtol=0.05, atol=0.02)
    mixed.float().square().sum().backward()
    assert all(p.grad is not None for p in (x, conv.weight, halve.weight, double.weight))


def test_points_too_far_apart_for_the_size_of_the_cells_are_refused() -> None:
    with pytest.raises(ValueError, match="larger"):
        occupied(torch.tensor([[[0.0, 0.0, 0.0], [1e4, 1e4, 1e4]]]), 1e-4)


def test_weights_come_from_the_generator_alone() -> None:
    layers = [SparseConv3d(2, 8, 3), Halve(2, 8), Double(2, 8)]
    drawn = []
    for _ in range(2):
        generator = seeded(4)
        for layer in layers:
            layer.initialise(generator)
        drawn.append([layer.weight.detach().clone() for layer in layers])
    assert all(torch.equal(a, b) for a, b in zip(*drawn, strict=True))
    # He's: the square root of 2 by (cells of the kernel times channels out)
    assert float(drawn[0][0].std()) == pytest.approx((2 / (27 * 8)) ** 0.5, rel=0.15)
