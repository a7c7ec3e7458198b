# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""PointNetVLAD as its authors made it, above all where the common port does otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import nn

from adafusion.config import load_config
from adafusion.losses import lazy_quadruplet
from adafusion.models.config import ModelConfig
from adafusion.models.pointnetvlad import PointFeatures, PointNetVLAD, TransformNet
from adafusion.preprocess import PointSet, Preprocess
from adafusion.training import TrainConfig
from adafusion.types import UserError

CONFIGS = Path(__file__).parents[2] / "configs"
PAPER = ModelConfig(system="pointnetvlad", dim=0, preprocess=Preprocess(lidar="points"))
TINY = replace(
    PAPER,
    dim=12,
    width=0.0625,
    clusters=4,
    preprocess=Preprocess(lidar="points", points=PointSet(count=32)),
)


@pytest.fixture(scope="module")
def paper() -> PointNetVLAD:
    return PointNetVLAD(PAPER).eval()


def build(seed: int = 0, **changes: object) -> PointNetVLAD:
    model = PointNetVLAD(replace(TINY, **changes))
    model.initialise(torch.Generator().manual_seed(seed))
    return model


def moved(model: PointNetVLAD) -> PointNetVLAD:
    """The network after some training: transforms that are no identity, norms that know clouds."""
    random = torch.Generator().manual_seed(5)
    with torch.no_grad():
        for net in (model.point_net.align_points, model.point_net.align_features):
            net.matrix.weight.normal_(0.0, 0.05, generator=random)
        for _ in range(10):
            model.train()(None, clouds(8))
    return model


def clouds(n: int = 2) -> torch.Tensor:
    return torch.rand(n, 32, 3, generator=torch.Generator().manual_seed(1)) * 2 - 1


def count(*modules: nn.Module) -> int:
    return sum(p.numel() for module in modules for p in module.parameters())


def layers(module: nn.Module) -> Iterator[str]:
    return (type(layer).__name__ for layer in module.modules() if not list(layer.children()))


def test_it_has_the_papers_parameters(paper: PointNetVLAD) -> None:
    points = paper.point_net
    assert count(points.align_points) == 803_081
    assert count(points.align_features) == 1_857_344
    assert count(points.low, points.high) == 148_992
    assert count(paper.vlad, paper.reduce, paper.norm, paper.gate) == 16_974_976
    assert count(paper) == 19_784_393


def test_a_submap_becomes_a_descriptor_of_the_papers_length(paper: PointNetVLAD) -> None:
    submap = torch.rand(1, 4096, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    with torch.inference_mode():
        assert paper.point_net(submap).shape == (1, 1024, 4096)
        d = paper(None, submap)
    assert paper.vlad.length == 65_536
    assert d.fused.shape == (1, 256)
    assert d.fused is d.lidar_half
    assert d.image_half is None
    assert d.alpha is None


# the seven places where the port differs


def test_1_the_mlp_of_all_points_has_no_norm(paper: PointNetVLAD) -> None:
    points = paper.point_net
    assert list(layers(points.low)) == ["Linear", "ReLU"] * 2
    assert list(layers(points.high))[:4] == ["Linear", "ReLU"] * 2


def test_2_the_transform_nets_have_norms(paper: PointNetVLAD) -> None:
    for net in (paper.point_net.align_points, paper.point_net.align_features):
        assert list(layers(net)) == ["Linear", "BatchNorm1d", "ReLU"] * 5 + ["Linear"]


def test_3_the_widest_layer_ends_in_a_relu_too(paper: PointNetVLAD) -> None:
    assert list(layers(paper.point_net.high))[4:] == ["Linear", "ReLU"]
    features = build().point_net(clouds())
    assert features.amin() == 0.0
    assert features.amax() > 0.0


def test_4_each_point_counts_alike_however_long_its_feature() -> None:
    model = build().eval()
    features = model.point_net(clouds())
    lengths = torch.linspace(0.5, 3.0, 32)
    assert torch.allclose(model.vlad(features), model.vlad(features * lengths), atol=1e-6)


def test_5_the_descriptor_has_length_1() -> None:
    d = moved(build()).eval()(None, clouds(3))
    assert torch.allclose(d.fused.norm(dim=1), torch.ones(3))


def test_6_the_loss_takes_the_nearest_true_match() -> None:
    near_and_far = torch.tensor([[0.1, 5.0]])
    negative = torch.tensor([[0.7]])  # beyond the nearest by more than both margins
    assert lazy_quadruplet(near_and_far, negative, negative).item() == 0.0


def test_7_it_learns_at_the_originals_rate_margins_and_tuples() -> None:
    config = load_config(TrainConfig, CONFIGS / "pointnetvlad.yaml")
    assert (config.optimiser.kind, config.optimiser.learning_rate) == ("adam", 5e-5)
    assert config.optimiser.learning_rate * config.optimiser.floor == pytest.approx(1e-5)
    assert (config.loss.kind, config.loss.margin, config.loss.other_margin) == (
        "lazy-quadruplet",
        0.5,
        0.2,
    )
    s = config.sampling
    assert s.tuples * (1 + s.positives + s.negatives + 1) == 44  # clouds a batch
    assert replace(config.model, preprocess=PAPER.preprocess) == replace(PAPER, dim=256)


def test_a_transform_is_the_identity_until_it_is_trained() -> None:
    random = torch.Generator().manual_seed(0)
    net = TransformNet(3, width=0.125)
    assert torch.equal(net(torch.randn(4, 9, 3, generator=random)), torch.eye(3).expand(4, 3, 3))


def test_a_transform_multiplies_points_as_rows() -> None:
    net = PointFeatures(width=0.0625).eval()
    quarter_turn = torch.tensor([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    points = clouds()
    turned = net(torch.stack([-points[..., 1], points[..., 0], points[..., 2]], dim=2))
    with torch.no_grad():
        net.align_points.matrix.bias.copy_(quarter_turn.flatten())
    assert torch.allclose(net(points), turned, atol=1e-6)


def test_the_gate_lets_half_through_before_it_knows_anything() -> None:
    gate = build().gate.eval()
    nn.init.zeros_(gate.linear.weight)
    x = torch.randn(2, 12, generator=torch.Generator().manual_seed(0))
    assert torch.equal(gate(x), x / 2)


def test_the_order_of_the_points_does_not_matter() -> None:
    model = moved(build()).eval()
    points = clouds()
    shuffled = points[:, torch.randperm(32, generator=torch.Generator().manual_seed(2))]
    assert torch.allclose(model(None, points).fused, model(None, shuffled).fused, atol=1e-5)


def test_one_cloud_is_a_row_of_a_batch() -> None:
    model = moved(build()).eval()
    points = clouds(3)
    assert torch.allclose(model(None, points).fused[1:2], model(None, points[1:2]).fused, atol=1e-5)


def test_every_parameter_learns() -> None:
    model = moved(build()).train()
    fused = model(None, clouds(8)).fused
    (fused * torch.randn(12, generator=torch.Generator().manual_seed(2))).sum().backward()
    silent = {  # an offset before a norm cannot change anything
        f"point_net.{net}.{part}.{i}.bias"
        for net in ("align_points", "align_features")
        for part, linears in (("each", (0, 3, 6)), ("whole", (0, 3)))
        for i in linears
    }
    parameters = dict(model.named_parameters())
    assert silent < set(parameters)
    stuck = [name for name, p in parameters.items() if p.grad is None or p.grad.abs().max() < 1e-7]
    assert set(stuck) <= silent


def test_the_transforms_begin_to_learn_with_the_first_batch() -> None:
    model = build().train()
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    for _ in range(2):  # the first reaches their last layer, which begins at zero; then all
        optimizer.zero_grad()
        (model(None, clouds(8)).fused * torch.linspace(-1, 1, 12)).sum().backward()
        optimizer.step()
    for net in (model.point_net.align_points, model.point_net.align_features):
        assert net.each[0].weight.grad.any()


def test_its_weights_come_from_the_generator_alone() -> None:
    torch.manual_seed(1)
    one = build().state_dict()
    torch.manual_seed(2)
    two = build().state_dict()
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert build().fingerprint != build(seed=1).fingerprint


def test_without_offsets_the_first_features_tell_points_apart() -> None:
    features = nn.functional.normalize(build(width=0.5).eval().point_net(clouds(1))[0], dim=0)
    assert (features.T @ features).mean() < 0.95


def test_an_empty_cloud_is_a_place_too() -> None:
    d = moved(build()).eval()(None, torch.zeros(1, 32, 3))
    assert d.fused.isfinite().all()


def test_what_it_cannot_look_at_is_refused() -> None:
    with pytest.raises(UserError, match=r"preprocess\.lidar=points"):
        PointNetVLAD(ModelConfig(system="pointnetvlad"))
    with pytest.raises(ValueError, match=r"takes \(32, 3\)"):
        build()(None, torch.zeros(1, 31, 3))
    with pytest.raises(ValueError, match="nothing"):
        build()(torch.zeros(1, 3, 300, 400), None)


def test_the_small_one_stays_below_a_million_parameters() -> None:
    config = load_config(TrainConfig, CONFIGS / "pointnetvlad-s.yaml").model
    assert count(PointNetVLAD(config)) == 930_421
