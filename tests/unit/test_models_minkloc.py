# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""MinkLoc++ has its paper's parameters and shapes, and what is asked of every system."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from adafusion.config import load_config
from adafusion.models import ModelConfig
from adafusion.models.minkloc import CloudBranch, GeneralisedMean, ImageBranch, MinkLoc
from adafusion.models.sparse import occupied
from adafusion.preprocess import ImageSettings, PointSet, Preprocess
from adafusion.training.settings import TrainConfig
from adafusion.types import Description, UserError

CONFIGS = Path(__file__).parents[2] / "configs"
PAPER = ModelConfig(
    system="minkloc",
    preprocess=Preprocess(image=ImageSettings(size=(240, 320), colours="imagenet"), lidar="points"),
)
TINY = ModelConfig(
    system="minkloc",
    width=0.125,
    dim=16,
    preprocess=Preprocess(
        image=ImageSettings(size=(48, 64), colours="imagenet"),
        lidar="points",
        points=PointSet(count=200, quantum=0.05),
    ),
)


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def build(**changes: object) -> MinkLoc:
    torch.manual_seed(0)
    return MinkLoc(replace(TINY, **changes))


def batch(n: int = 2) -> tuple[Tensor, Tensor]:
    image = torch.randn(n, 3, 48, 64, generator=seeded(1))
    return image, torch.rand(n, 200, 3, generator=seeded(2)) * 2 - 1


def settled(**changes: object) -> MinkLoc:
    """A model whose batch norms have seen some frames, describing."""
    model = build(**changes)
    for _ in range(3):
        model(*batch(4))
    return model.eval()


def count(*modules: nn.Module) -> int:
    return sum(p.numel() for module in modules for p in module.parameters())


@pytest.mark.parametrize("dim", [0, 256])
def test_it_has_the_papers_parameters(dim: int) -> None:
    model = MinkLoc(replace(PAPER, dim=dim))
    assert count(model.image_net) == 2_815_681
    assert count(model.cloud_net) == 646_122
    assert count(model) == 3_461_803


def test_branches_alone_at_full_length_have_the_papers_parameters() -> None:
    assert count(ImageBranch(256)) == 2_848_577
    assert count(CloudBranch(256)) == 1_055_722


def test_the_cloud_branch_s_pieces_have_the_parameters_counted_by_hand() -> None:
    net = CloudBranch(128)
    assert count(net.stem, net.norm) == 5**3 * 32 + 64
    one, two, three = net.stages
    norms = 2 * 32 + 2 * 2 * 32, 2 * 32 + 2 * 2 * 64 + 2 * 64, 2 * 64 + 2 * 2 * 64
    assert count(one) == 8 * 32 * 32 + 2 * 27 * 32 * 32 + 3 + norms[0]
    assert count(two) == 8 * 32 * 32 + 27 * (32 * 64 + 64 * 64) + 3 + 32 * 64 + norms[1]
    assert count(three) == 8 * 64 * 64 + 2 * 27 * 64 * 64 + 3 + norms[2]
    assert count(net.deep_lateral) == count(net.lateral) == 64 * 128
    assert count(net.up) == 8 * 128 * 128
    assert count(net.pool) == 1


def test_it_has_the_papers_shapes() -> None:
    model = MinkLoc(replace(PAPER, dim=0)).eval()
    image = torch.zeros(1, 3, 240, 320)
    assert model.image_net.resnet(image)[-1].shape == (1, 256, 15, 20)
    with torch.no_grad():
        d = model(image, torch.rand(1, 4096, 3, generator=seeded()) * 2 - 1)
    assert d.fused is not None
    assert d.fused.shape == (1, 256)
    assert d.image_half is not None
    assert d.image_half.shape == (1, 128)
    assert d.lidar_half is not None
    assert d.lidar_half.shape == (1, 128)


def test_the_descriptor_is_the_cloud_s_half_then_the_image_s() -> None:
    d = settled()(*batch())
    assert torch.equal(d.fused, torch.cat([d.lidar_half, d.image_half], dim=1))
    assert d.alpha is None
    assert d.fused.shape == (2, 16)


def test_without_a_sensor_the_other_half_alone_is_given() -> None:
    model = settled()
    image, points = batch()
    whole, no_image, no_cloud = model(image, points), model(None, points), model(image, None)
    assert no_image == Description(None, None, no_image.lidar_half, None)
    assert torch.equal(no_image.lidar_half, whole.lidar_half)
    assert no_cloud == Description(None, no_cloud.image_half, None, None)
    assert torch.equal(no_cloud.image_half, whole.image_half)
    with pytest.raises(ValueError, match="nothing"):
        model(None, None)


def test_every_parameter_learns() -> None:
    model = build()
    fused = model(*batch(4)).fused
    (fused * torch.randn(fused.shape, generator=seeded(2))).sum().backward()
    stuck = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()]
    assert not stuck, f"no gradient reaches {stuck}"


def test_one_frame_is_a_row_of_a_batch() -> None:
    model = settled()
    image, points = batch(3)
    together, alone = model(image, points), model(image[1:2], points[1:2])
    torch.testing.assert_close(together.fused[1:2], alone.fused, rtol=1e-4, atol=1e-5)


def test_equal_frames_are_described_and_taught_alike() -> None:
    results = []
    for _ in range(2):
        model = build()
        fused = model(*batch(4)).fused
        fused.square().sum().backward()
        results.append([fused.detach(), *(p.grad for p in model.parameters())])
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))


def test_weights_come_from_the_generator_alone() -> None:
    first, second = build(), build()
    with torch.no_grad():
        for parameter in second.parameters():
            parameter.add_(1.0)
    for model in (first, second):
        model.initialise(seeded(5))
    for (name, a), b in zip(first.named_parameters(), second.parameters(), strict=True):
        assert torch.equal(a, b), name


def test_its_image_s_stages_take_imagenet_weights(tmp_path: Path) -> None:
    model = build()
    weights = {k: v + 1 for k, v in model.image_net.resnet.state_dict().items()}
    torch.save(weights, tmp_path / "resnet18.pth")
    lateral = model.image_net.lateral.weight.clone()
    model.load_imagenet(tmp_path / "resnet18.pth")
    assert torch.equal(model.image_net.resnet.conv1.weight, weights["conv1.weight"])
    assert torch.equal(model.image_net.lateral.weight, lateral)
    unit = replace(TINY.preprocess, image=ImageSettings(size=(48, 64)))
    with pytest.raises(UserError, match="colours=imagenet"):
        build(preprocess=unit).load_imagenet(tmp_path / "resnet18.pth")


def test_points_in_one_cell_are_one_point_and_their_order_does_not_matter() -> None:
    model = settled()
    image, points = batch(1)
    whole = model(image, points).lidar_half
    assert torch.equal(model(image, points.flip(1)).lidar_half, whole)
    centres = (points / 0.05).floor() * 0.05 + 0.025
    assert torch.equal(model(image, centres).lidar_half, whole)


def test_a_cloud_without_points_is_described() -> None:
    model = settled()
    d = model(None, torch.zeros(1, 200, 3))
    assert torch.isfinite(d.lidar_half).all()


def test_the_generalised_mean_is_what_its_formula_says() -> None:
    pool = GeneralisedMean()
    x = torch.tensor([[1.0, -5.0], [2.0, -1.0]])
    pooled = pool(x, lambda rows: rows.mean(dim=0, keepdim=True))
    # the cube root of (1 + 8) / 2; what is negative counts as the least there is
    torch.testing.assert_close(pooled, torch.tensor([[4.5 ** (1 / 3), 1e-6]]))
    with torch.no_grad():
        pool.power.fill_(1.0)
    assert pool(x, lambda rows: rows.mean(dim=0, keepdim=True))[0, 0].item() == pytest.approx(1.5)


def test_a_channel_s_weight_is_set_by_its_mean_and_its_neighbours() -> None:
    stage = build().cloud_net.stages[0]
    sites = occupied(torch.rand(2, 30, 3, generator=seeded()), 0.2)
    with torch.no_grad():
        stage.channels.conv.weight.copy_(torch.tensor([[[1.0, 0.0, -2.0]]]))
    x = torch.randn(len(sites.cells), 4, generator=seeded(1))
    mean = x[sites.cells[:, 0] == 1].mean(dim=0)
    left, right = (
        torch.cat([mean.new_zeros(1), mean[:-1]]),
        torch.cat([mean[1:], mean.new_zeros(1)]),
    )
    expected = x[sites.cells[:, 0] == 1] * (left - 2 * right).sigmoid()
    torch.testing.assert_close(stage.channels(x, sites)[sites.cells[:, 0] == 1], expected)


def test_nonsense_is_refused_with_a_remedy() -> None:
    with pytest.raises(UserError, match=r"preprocess\.lidar=points"):
        build(preprocess=replace(TINY.preprocess, lidar="voxels"))
    with pytest.raises(UserError, match="even"):
        build(dim=15)
    with pytest.raises(ValueError, match=r"takes \(200, 3\)"):
        build()(None, torch.zeros(2, 100, 3))
    with pytest.raises(ValueError, match=r"takes \(48, 64\)"):
        build()(torch.zeros(2, 3, 48, 48), None)


@pytest.mark.parametrize(
    ("file", "parameters"), [("minkloc.yaml", 3_461_803), ("minkloc-s.yaml", 980_891)]
)
def test_its_configurations_have_the_parameters_they_say(file: str, parameters: int) -> None:
    config = load_config(TrainConfig, CONFIGS / file)
    assert count(MinkLoc(config.model)) == parameters
    assert f"{parameters:,}" in (CONFIGS / file).read_text()
