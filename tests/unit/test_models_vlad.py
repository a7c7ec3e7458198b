# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import pytest
import torch

from adafusion.models.vlad import SoftVLAD, k_means

KINDS = [{}, {"bias": True}, {"normalised_assignment": True}]


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def build(dim: int = 5, clusters: int = 3, **kind: bool) -> SoftVLAD:
    vlad = SoftVLAD(dim, clusters, **kind)
    vlad.initialise(generator())
    return vlad.eval()


def features(n: int = 7, dim: int = 5, batch: int = 2) -> torch.Tensor:
    return torch.randn(batch, dim, n, generator=generator(1))


@pytest.mark.parametrize(
    ("dim", "clusters", "kind", "parameters"),
    [
        (512, 64, {}, 65_536),  # NetVLAD
        (256, 32, {"bias": True}, 16_416),  # CORAL
        (1024, 64, {"normalised_assignment": True}, 131_200),  # PointNetVLAD
    ],
)
def test_it_has_the_papers_parameters(
    dim: int, clusters: int, kind: dict[str, bool], parameters: int
) -> None:
    vlad = SoftVLAD(dim, clusters, **kind)
    assert sum(p.numel() for p in vlad.parameters()) == parameters
    assert vlad.length == dim * clusters


@torch.no_grad()
def test_two_features_between_two_centroids_add_up_by_hand() -> None:
    vlad = build(2, 2)
    vlad.assignment.weight.copy_(torch.tensor([[math.log(3.0), 0.0], [0.0, 0.0]]))
    vlad.centroids.copy_(torch.tensor([[0.0, 1.0], [1.0, 0.0]]))
    x = torch.tensor([[[2.0, 0.0], [0.0, 5.0]]])  # columns (2, 0) and (0, 5): their lengths go
    # (1, 0) belongs to the clusters by 3/4 and 1/4, (0, 1) by 1/2 and 1/2
    assert torch.allclose(
        vlad.belonging(torch.eye(2)[None]), torch.tensor([[[0.75, 0.5], [0.25, 0.5]]])
    )
    # cluster 0: 3/4 (1, -1) + 1/2 (0, 0); cluster 1: 1/4 (0, 0) + 1/2 (-1, 1); then to length 1
    half = torch.tensor([[0.5, -0.5, -0.5, 0.5]])
    assert torch.allclose(vlad(x), half, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
@torch.no_grad()
def test_it_equals_a_plain_loop(kind: dict[str, bool]) -> None:
    vlad = build(**kind)
    x, weight = features(), torch.rand(2, 7, generator=generator(2))
    if vlad.norm is not None:
        vlad.norm.running_mean.copy_(torch.tensor([0.1, -0.2, 0.3]))
        vlad.norm.running_var.copy_(torch.tensor([0.5, 1.0, 2.0]))
    for b, row in enumerate(vlad(x, weight)):
        parts = [torch.zeros(5) for _ in range(3)]
        for n in range(7):
            feature = x[b, :, n] / x[b, :, n].norm()
            logits = vlad.assignment.weight @ feature
            if vlad.assignment.bias is not None:
                logits = logits + vlad.assignment.bias
            if vlad.norm is not None:
                spread = (vlad.norm.running_var + 1e-3).sqrt()
                logits = (logits - vlad.norm.running_mean) / spread
            share = logits.exp() / logits.exp().sum()
            for k in range(3):
                parts[k] += weight[b, n] * share[k] * (feature - vlad.centroids[k])
        expected = torch.cat([part / part.norm() for part in parts]) / math.sqrt(3)
        assert torch.allclose(row, expected, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_order_and_length_of_the_features_do_not_matter(kind: dict[str, bool]) -> None:
    vlad, x = build(**kind), features()
    stretched = x[:, :, torch.randperm(7, generator=generator(3))] * 9.0
    assert torch.allclose(vlad(x), vlad(stretched), atol=1e-6)
    assert torch.allclose(vlad(x).norm(dim=1), torch.ones(2))


def test_a_weight_of_zero_leaves_a_feature_out() -> None:
    vlad, x = build(), features()
    weight = torch.ones(2, 7)
    assert torch.allclose(vlad(x, weight), vlad(x), atol=1e-6)
    weight[:, 4:] = 0.0
    assert torch.allclose(vlad(x, weight), vlad(x[:, :, :4]), atol=1e-6)


def test_a_place_without_any_feature_is_a_number_still() -> None:
    vlad = build()
    x = torch.zeros(1, 5, 4, requires_grad=True)
    given = vlad(x, torch.zeros(1, 4))
    given.sum().backward()
    assert torch.equal(given, torch.zeros(1, 15))
    assert x.grad is not None
    assert x.grad.isfinite().all()


@pytest.mark.parametrize("kind", KINDS)
def test_every_parameter_learns(kind: dict[str, bool]) -> None:
    vlad = build(**kind).train()
    (vlad(features()) * torch.randn(15, generator=generator(4))).sum().backward()
    assert all(p.grad is not None and p.grad.any() for p in vlad.parameters())


@pytest.mark.parametrize("kind", KINDS)
def test_its_weights_come_from_the_generator_alone(kind: dict[str, bool]) -> None:
    torch.manual_seed(1)
    one = build(**kind).state_dict()
    torch.manual_seed(2)
    two = build(**kind).state_dict()
    assert all(torch.equal(one[key], two[key]) for key in one)


@torch.no_grad()
def test_without_a_norm_the_first_logits_vary_by_about_one() -> None:
    vlad = build(256, 32)
    x = torch.nn.functional.normalize(torch.randn(4000, 256, generator=generator(5)), dim=1)
    assert vlad.assignment(x).std().item() == pytest.approx(1.0, abs=0.05)


def clumps(centres: torch.Tensor, spread: float, n: int = 50) -> torch.Tensor:
    noise = spread * torch.randn(len(centres) * n, centres.shape[1], generator=generator(6))
    return centres.repeat_interleave(n, dim=0) + noise


def test_k_means_finds_clumps() -> None:
    centres = torch.tensor([[0.0, 0.0], [5.0, 0.0], [0.0, 5.0], [5.0, 5.0]])
    found = k_means(clumps(centres, 0.1), 4, generator())
    assert torch.cdist(centres, found).amin(dim=1).max() < 0.1


def test_k_means_leaves_no_cluster_without_a_point() -> None:
    points = torch.tensor([[0.0], [0.0], [0.0], [9.0]])  # two places for three clusters
    found = k_means(points, 3, generator())
    assert sorted(set(found.flatten().tolist())) == [0.0, 9.0]
    with pytest.raises(ValueError, match="3 points"):
        k_means(points[:3], 4, generator())


def test_a_start_from_k_means_is_as_steep_as_the_features_ask_for() -> None:
    # three directions at right angles: cosines 1 and 0, so the gap is 1 and the steepness ln 100
    vlad = build(3, 3)
    vlad.initialise_from(7.0 * torch.eye(3).repeat(10, 1), generator())
    assert torch.allclose(vlad.centroids.sum(dim=0), torch.ones(3))  # features come to length 1
    assert torch.allclose(vlad.assignment.weight, vlad.centroids * math.log(100.0))
    shares = vlad.belonging(torch.eye(3)[None])[0].sort(dim=0).values
    assert torch.allclose(shares[1] / shares[2], torch.full((3,), 0.01))


def test_a_start_that_features_do_not_allow_is_refused() -> None:
    with pytest.raises(ValueError, match="alike"):
        build().initialise_from(torch.ones(20, 5), generator())
    with pytest.raises(ValueError, match="2 points"):
        build().initialise_from(torch.ones(2, 5), generator())
    with pytest.raises(ValueError, match="norm"):
        build(normalised_assignment=True).initialise_from(torch.eye(5), generator())
    with pytest.raises(ValueError, match="bias"):
        build(normalised_assignment=True, bias=True)
