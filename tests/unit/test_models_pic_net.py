# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import nn

from adafusion.config import load_config
from adafusion.models.config import ModelConfig
from adafusion.models.pic_net import ChannelAttention, PicNet, PixelAttention
from adafusion.models.resnet import resnet18
from adafusion.preprocess import ImageSettings, PointSet, Preprocess
from adafusion.training import TrainConfig
from adafusion.types import UserError

CONFIGS = Path(__file__).parents[2] / "configs"
FULL = ModelConfig(
    system="pic-net",
    dim=0,
    preprocess=Preprocess(image=ImageSettings(colours="imagenet"), lidar="points"),
)
TINY = replace(
    FULL,
    dim=16,
    width=0.0625,
    clusters=4,
    preprocess=Preprocess(
        image=ImageSettings(size=(64, 96), colours="imagenet"),
        lidar="points",
        points=PointSet(count=32),
    ),
)


def build(seed: int = 0, **changes: object) -> PicNet:
    model = PicNet(replace(TINY, **changes))
    model.initialise(torch.Generator().manual_seed(seed))
    return model


def moved() -> PicNet:
    """The network after some training: transforms that are no identity, norms that know frames."""
    model, random = build(), torch.Generator().manual_seed(5)
    with torch.no_grad():
        for net in (model.point_net.align_points, model.point_net.align_features):
            net.matrix.weight.normal_(0.0, 0.05, generator=random)
        for _ in range(10):
            model.train()(*batch(8))
    return model


def batch(n: int = 2) -> tuple[torch.Tensor, torch.Tensor]:
    random = torch.Generator().manual_seed(1)
    image = torch.rand(n, 3, 64, 96, generator=random) * 2 - 1
    return image, torch.rand(n, 32, 3, generator=random) * 2 - 1


def count(*modules: nn.Module) -> int:
    return sum(p.numel() for module in modules for p in module.parameters())


def test_it_has_the_parameters_that_its_file_says() -> None:
    model = PicNet(FULL)
    assert count(model.image_net) == 11_176_512
    assert count(model.image_attention) == 2 * 49 + 1
    assert count(model.image_half) == 2 * 64 * 512 + 64 * 512 * 256 + 2 * 256
    assert count(model.point_net) == 2_809_417
    assert count(model.point_attention) == 1024 * 256 + 256 + 256 + 1
    assert count(model.lidar_half) == 2 * 64 * 1024 + 2 * 64 + 64 * 1024 * 256 + 2 * 256
    assert count(model.channel_attention) == 512 * 32 + 32 + 32 * 512 + 512
    assert count(model.fuse) == 512 * 256 + 256
    assert count(model) == 39_776_909


def test_an_image_comes_to_10_by_13_local_features() -> None:
    net = resnet18(width=0.0625)
    assert net(torch.zeros(1, 3, 300, 400))[-1].shape == (1, 32, 10, 13)


def test_descriptor_and_halves_are_of_length_1() -> None:
    d = moved().eval()(*batch(3))
    for part in d[:3]:
        assert part.shape == (3, 16)
        assert torch.allclose(part.norm(dim=1), torch.ones(3))
    assert d.alpha is None
    assert PicNet(replace(TINY, dim=0)).fuse.out_features == 256


def test_without_a_sensor_the_other_half_alone_is_given() -> None:
    model = moved().eval()
    image, points = batch()
    whole, no_image, no_cloud = model(image, points), model(None, points), model(image, None)
    assert torch.equal(no_image.lidar_half, whole.lidar_half)
    assert torch.equal(no_cloud.image_half, whole.image_half)
    assert no_image.image_half is no_image.fused is no_cloud.lidar_half is no_cloud.fused is None
    with pytest.raises(ValueError, match="nothing"):
        model(None, None)


def test_a_pixel_s_weight_looks_at_mean_and_greatest_channel() -> None:
    attention = PixelAttention()
    with torch.no_grad():
        attention.conv.weight.zero_()
        attention.conv.bias.fill_(-1.0)
        attention.conv.weight[0, :, 3, 3] = torch.tensor([2.0, 3.0])  # of the pixel itself
    x = torch.tensor([[[[0.0, 1.0]], [[0.0, 3.0]]]])  # two channels, two pixels
    expected = torch.tensor([[-1.0, 2.0 * 2.0 + 3.0 * 3.0 - 1.0]]).sigmoid()
    assert torch.allclose(attention(x), expected)


def test_a_point_s_weight_looks_at_that_point_alone() -> None:
    attention = build().point_attention
    x = torch.rand(2, 64, 5, generator=torch.Generator().manual_seed(0))
    changed = x.clone()
    changed[:, :, 3] += 1.0
    same = attention(x).isclose(attention(changed))
    assert same.tolist() == [[True, True, True, False, True]] * 2


def test_channels_pass_in_part() -> None:
    attention = ChannelAttention(32)
    for layer in attention.mlp[::2]:
        nn.init.zeros_(layer.weight)
        nn.init.zeros_(layer.bias)
    x = torch.randn(2, 32, generator=torch.Generator().manual_seed(0))
    assert torch.equal(attention(x), x / 2)


def test_what_the_attention_leaves_out_does_not_count() -> None:
    model = moved().eval()
    points = batch()[1]
    with torch.no_grad():
        features = model.point_net(points)
        weight = torch.ones(2, 32)
        weight[:, 20:] = 0.0
        some = model.lidar_half(features, weight)
        assert torch.allclose(
            some, model.lidar_half(features[:, :, :20], weight[:, :20]), atol=1e-5
        )


def test_the_order_of_the_points_does_not_matter() -> None:
    model = moved().eval()
    image, points = batch()
    shuffled = points[:, torch.randperm(32, generator=torch.Generator().manual_seed(2))]
    assert torch.allclose(model(image, points).fused, model(image, shuffled).fused, atol=1e-5)


def test_every_parameter_learns() -> None:
    model = moved().train()
    fused = model(*batch(8)).fused
    (fused * torch.randn(16, generator=torch.Generator().manual_seed(2))).sum().backward()
    silent = {  # an offset before a norm cannot change anything
        f"point_net.{net}.{part}.{i}.bias"
        for net in ("align_points", "align_features")
        for part, linears in (("each", (0, 3, 6)), ("whole", (0, 3)))
        for i in linears
    }
    parameters = dict(model.named_parameters())
    assert silent < set(parameters)
    stuck = [name for name, p in parameters.items() if p.grad is None or p.grad.abs().max() < 1e-8]
    assert set(stuck) <= silent


def test_one_frame_is_a_row_of_a_batch() -> None:
    model = moved().eval()
    image, points = batch(3)
    one = model(image[1:2], points[1:2])
    for whole, part in zip(model(image, points)[:3], one[:3], strict=True):
        assert torch.allclose(whole[1:2], part, atol=1e-5)


def test_both_halves_vary_alike_before_they_join() -> None:
    model = build().train()
    random = torch.Generator().manual_seed(3)
    points = batch(8)[1] * torch.rand(8, 1, 3, generator=random)  # boxes of several forms
    scenes = torch.rand(8, 3, 4, 6, generator=random) * 2 - 1
    features = model.image_net(nn.functional.interpolate(scenes, (64, 96)))[-1]
    v = model.image_half(features.flatten(2), model.image_attention(features))
    cloud = model.point_net(points)
    half = model.lidar_half(cloud, model.point_attention(cloud))
    for numbers in (v, half):
        # those of a network that has learnt nothing hardly differ: the norm's epsilon shows
        assert 0.9 < numbers.var(dim=0, correction=0).median() <= 1.0


def test_its_weights_come_from_the_generator_alone() -> None:
    torch.manual_seed(1)
    one = build().state_dict()
    torch.manual_seed(2)
    two = build().state_dict()
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert build().fingerprint != build(seed=1).fingerprint


def test_it_starts_from_imagenet_where_one_has_the_weights(tmp_path: Path) -> None:
    source = resnet18(width=TINY.width)
    source.initialise(torch.Generator().manual_seed(9))
    torch.save({**source.state_dict(), "fc.bias": torch.zeros(1000)}, tmp_path / "resnet18.pth")
    model = build()
    model.load_imagenet(tmp_path / "resnet18.pth")
    assert torch.equal(model.image_net.conv1.weight, source.conv1.weight)
    unit = build(preprocess=replace(TINY.preprocess, image=ImageSettings(size=(64, 96))))
    with pytest.raises(UserError, match=r"model\.preprocess\.image\.colours=imagenet"):
        unit.load_imagenet(tmp_path / "resnet18.pth")


def test_what_it_cannot_look_at_is_refused() -> None:
    with pytest.raises(UserError, match=r"preprocess\.lidar=points"):
        PicNet(ModelConfig(system="pic-net"))
    image, points = batch()
    with pytest.raises(ValueError, match=r"takes \(32, 3\)"):
        build()(image, points[:, :31])


def test_its_files_build_it() -> None:
    config = load_config(TrainConfig, CONFIGS / "pic-net.yaml")
    assert count(PicNet(config.model)) == 39_776_909
    s = config.sampling
    assert s.tuples * (1 + s.positives + s.negatives + 1) == 44  # frames a batch, as PointNetVLAD's
    assert config.optimiser.learning_rate == 5e-5
    small = load_config(TrainConfig, CONFIGS / "pic-net-s.yaml").model
    assert count(PicNet(small)) == 1_831_045
