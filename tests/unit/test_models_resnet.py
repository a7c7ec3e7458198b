# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""ResNet-18 is torchvision's, by its names and numbers, and takes its weights or says why not."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from adafusion.models.resnet import (
    BasicBlock,
    ResNet,
    Thinned,
    load_imagenet_resnet18,
    read_weights,
    resnet18,
    stages,
)
from adafusion.types import UserError


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def count(module: nn.Module) -> int:
    return sum(p.numel() for p in module.parameters())


def trained(width: float = 0.125) -> dict[str, Tensor]:
    """Weights of a whole network, with its classifier, as a file has them."""
    weights = {
        key: torch.rand(value.shape, generator=seeded(1)) if value.is_floating_point() else value
        for key, value in resnet18(4, width).state_dict().items()
    }
    return weights | {"fc.weight": torch.zeros(1000, 64), "fc.bias": torch.zeros(1000)}


@pytest.mark.parametrize(
    ("layers", "parameters"), [(1, 157_504), (2, 683_072), (3, 2_782_784), (4, 11_176_512)]
)
def test_it_has_resnet_18_s_parameters(layers: int, parameters: int) -> None:
    assert count(resnet18(layers)) == parameters


def test_its_maps_are_quarters_to_thirty_seconds_of_the_image() -> None:
    maps = resnet18(4, width=0.125).eval()(torch.zeros(1, 3, 240, 320))
    assert [tuple(m.shape[1:]) for m in maps] == [
        (8, 60, 80),
        (16, 30, 40),
        (32, 15, 20),
        (64, 8, 10),
    ]


def test_its_stem_may_pad_less_and_not_pool() -> None:
    net = ResNet([4, 8, 16, 32], padding=1, pool=False).eval()
    assert [m.shape[-1] for m in net(torch.zeros(1, 3, 112, 112))] == [54, 27, 14, 7]


def test_its_parts_have_torchvision_s_names() -> None:
    norm = ["weight", "bias", "running_mean", "running_var", "num_batches_tracked"]

    def block(name: str, *, shortcut: bool = False) -> set[str]:
        keys = {f"{name}.conv{i}.weight" for i in (1, 2)}
        keys |= {f"{name}.bn{i}.{part}" for i in (1, 2) for part in norm}
        if shortcut:
            keys |= {f"{name}.downsample.0.weight", *(f"{name}.downsample.1.{p}" for p in norm)}
        return keys

    expected = {"conv1.weight", *(f"bn1.{part}" for part in norm)}
    for layer in (1, 2, 3, 4):
        expected |= block(f"layer{layer}.0", shortcut=layer > 1) | block(f"layer{layer}.1")
    assert set(resnet18().state_dict()) == expected


def test_a_block_adds_its_change_to_what_came_in() -> None:
    block = BasicBlock(2, 2).eval()
    with torch.no_grad():
        block.conv2.weight.zero_()
    x = torch.randn(1, 2, 4, 4, generator=seeded())
    assert torch.equal(block(x), x.relu())


def test_stages_feed_each_other() -> None:
    made = stages(3, [4, 6], blocks=[1, 3], strides=[2, 2])
    assert [len(stage) for stage in made] == [1, 3]
    x = torch.zeros(2, 3, 16, 16)
    for stage in made:
        x = stage(x)
    assert x.shape == (2, 6, 4, 4)


def test_every_parameter_learns() -> None:
    net = resnet18(4, width=0.125)
    x = torch.randn(4, 3, 64, 64, generator=seeded())
    last = net(x)[-1]
    (last * torch.randn(last.shape, generator=seeded(1))).sum().backward()
    assert not [name for name, p in net.named_parameters() if p.grad is None or not p.grad.any()]


def test_weights_come_from_the_generator_alone_and_keep_the_signal() -> None:
    nets = [resnet18(4, width=0.25), resnet18(4, width=0.25)]
    for net in nets:
        net.initialise(seeded(3))
    pairs = zip(*(net.state_dict().values() for net in nets), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    maps = nets[0](torch.randn(4, 3, 64, 64, generator=seeded()))
    assert all(0.3 < m.std().item() < 3 for m in maps)


@pytest.mark.parametrize("suffix", [".safetensors", ".pth"])
@pytest.mark.parametrize("layers", [3, 4])
def test_it_takes_the_part_of_a_file_that_it_has(suffix: str, layers: int, tmp_path: Path) -> None:
    path, weights = tmp_path / f"resnet18{suffix}", trained()
    if suffix == ".pth":  # torchvision's older files count no batches
        weights = {k: v for k, v in weights.items() if not k.endswith("num_batches_tracked")}
        torch.save(weights, path)
    else:
        save_file(weights, path)
    net = resnet18(layers, width=0.125)
    load_imagenet_resnet18(net, path)
    for key, value in net.state_dict().items():
        assert key.endswith("num_batches_tracked") or torch.equal(value, weights[key]), key


def test_weights_of_another_network_or_width_are_refused(tmp_path: Path) -> None:
    path, weights = tmp_path / "resnet18.safetensors", trained()
    save_file(weights, path)
    with pytest.raises(UserError, match=r"model\.width=1"):
        load_imagenet_resnet18(resnet18(3, width=0.25), path)
    del weights["layer2.0.downsample.0.weight"]
    save_file(weights, path)
    before = resnet18(3, width=0.125)
    after = resnet18(3, width=0.125)
    after.load_state_dict(before.state_dict())
    with pytest.raises(UserError, match=r"layer2\.0\.downsample\.0\.weight"):
        load_imagenet_resnet18(after, path)
    pairs = zip(before.state_dict().values(), after.state_dict().values(), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)


class Unwelcome:
    """What a file of `torch.save` could run when it is read carelessly."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return print, ("run",)


def test_a_file_that_is_no_weights_is_refused_and_nothing_of_it_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "w.pth"
    for content in (Unwelcome(), {"epoch": 3}, [torch.zeros(2)]):
        torch.save(content, path)
        with pytest.raises(UserError, match=r"w\.pth"):
            read_weights(path)
    assert "run" not in capsys.readouterr().out
    for name in ("cut.pth", "cut.safetensors"):
        (tmp_path / name).write_bytes(b"PK\x03\x04 no more")
        with pytest.raises(UserError, match="cut"):
            read_weights(tmp_path / name)
    with pytest.raises(UserError, match=r"absent\.pth is missing"):
        read_weights(tmp_path / "absent.pth")


@pytest.mark.parametrize("channels", [4, 8, 16])
def test_a_thinned_convolution_equals_a_strided_one_and_keeps_to_its_memory(channels: int) -> None:
    torch.manual_seed(0)
    plain = nn.Conv2d(channels, 2 * channels, 1, 2, bias=False)
    thinned = Thinned(channels, 2 * channels, 1, 2, bias=False)
    thinned.load_state_dict(plain.state_dict())
    for size in (54, 27):
        x = torch.rand(16, channels, size, size)
        assert torch.allclose(thinned(x), plain(x), atol=1e-6)
        last = x.contiguous(memory_format=torch.channels_last).requires_grad_()
        thinned(last).square().sum().backward()
        assert torch.isfinite(last.grad).all()
