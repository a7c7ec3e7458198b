# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from adafusion.models import AdaFusion, ModelConfig, describe, load_model, read_header, save_model
from adafusion.models.backbones import add_norms, fold_norms, image_backbone, initialise_he
from adafusion.models.config import System
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid
from adafusion.types import UserError

TINY = ModelConfig(
    width=0.125,
    dim=16,
    preprocess=Preprocess(image=ImageSettings(size=(48, 64)), voxels=VoxelGrid(shape=(16, 16, 8))),
)


def build(**changes: object) -> AdaFusion:
    torch.manual_seed(0)
    return AdaFusion(replace(TINY, **changes))


def batch(n: int = 2) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(n, 3, 48, 64, generator=generator) * 2 - 1
    return image, (torch.rand(n, 1, 16, 16, 8, generator=generator) < 0.1).float()


def count(module: nn.Module | None) -> int:
    assert module is not None
    return sum(p.numel() for p in module.parameters())


@pytest.mark.parametrize(
    ("dim", "image", "lidar", "whole"),
    [
        (128, 813_888, 637_344, 1_661_042),
        (192, 896_960, 831_008, 1_966_450),
        (256, 998_464, 1_079_968, 2_345_586),
        (512, 1_588_800, 2_628_768, 4_599_410),
    ],
)
def test_it_has_the_papers_parameters(dim: int, image: int, lidar: int, whole: int) -> None:
    model = AdaFusion(ModelConfig(dim=dim))
    assert (count(model.image_net), count(model.voxel_net), count(model)) == (image, lidar, whole)


def test_the_weight_branch_has_the_papers_parameters() -> None:
    branch = AdaFusion(ModelConfig()).weight_net
    assert branch is not None
    assert count(branch.image_attention) == 87_032
    assert count(branch.voxel_attention) == 161_528
    assert count(branch.head) == 18_594


def test_concat_is_the_two_backbones_alone() -> None:
    assert count(AdaFusion(ModelConfig(system="concat"))) == 2_078_432


@pytest.mark.parametrize("attention", ["released", "paper"])
@pytest.mark.parametrize("levels", [0, 1, 2, 3])
def test_every_parameter_learns(attention: str, levels: int) -> None:
    model = build(attention=attention, attention_levels=levels)
    fused = model(*batch(4)).fused
    assert fused is not None
    (fused * torch.randn(fused.shape, generator=torch.Generator().manual_seed(2))).sum().backward()
    stuck = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()]
    # a bias before a batch norm, and one added to every key alike, cannot change anything
    silent = ("fuse.0.bias",)
    assert not [name for name in stuck if not name.endswith(silent)], stuck


@pytest.mark.parametrize("system", ["adafusion", "concat", "image", "lidar"])
def test_a_system_gives_only_what_it_has(system: str) -> None:
    d = build(system=system).eval()(*batch())
    assert (d.image_half is None) == (system == "lidar")
    assert (d.lidar_half is None) == (system == "image")
    assert (d.alpha is None) == (system != "adafusion")
    assert d.fused is not None
    assert d.fused.shape == (2, 16 if system in ("adafusion", "concat") else 8)


def test_the_descriptor_is_the_weighted_halves() -> None:
    d = build().eval()(*batch())
    weighted = torch.cat([d.alpha[:, :1] * d.image_half, d.alpha[:, 1:] * d.lidar_half], dim=1)
    assert torch.equal(d.fused, weighted)
    assert ((d.alpha > 0) & (d.alpha < 1)).all()


def test_without_a_sensor_the_other_half_alone_is_given() -> None:
    model = build().eval()
    image, voxels = batch()
    whole, no_image, no_cloud = model(image, voxels), model(None, voxels), model(image, None)
    assert no_image.fused is None
    assert no_image.alpha is None
    assert no_image.image_half is None
    assert torch.equal(no_image.lidar_half, whole.lidar_half)
    assert torch.equal(no_cloud.image_half, whole.image_half)
    with pytest.raises(ValueError, match="nothing"):
        model(None, None)
    with pytest.raises(ValueError, match="nothing"):
        build(system="image")(None, voxels)


def test_one_frame_is_a_row_of_a_batch() -> None:
    model = build().eval()
    image, voxels = batch(3)
    together, alone = model(image, voxels), model(image[1:2], voxels[1:2])
    for whole, one in zip(together, alone, strict=True):
        assert torch.allclose(whole[1:2], one, atol=1e-5)


def test_a_single_frame_is_convolved_by_another_kernel_to_the_same_numbers() -> None:
    model = build().eval()
    inputs = batch(1)
    with torch.no_grad():
        usual = model(*inputs)
    fast = describe(model, [inputs])
    for theirs, ours in zip(usual, fast, strict=True):
        assert np.allclose(theirs.numpy(), ours, atol=1e-6)


def test_tensors_of_another_size_are_refused() -> None:
    model = build()
    image, voxels = batch()
    with pytest.raises(ValueError, match=r"takes \(48, 64\)"):
        model(image[..., :32], voxels)
    with pytest.raises(ValueError, match=r"takes \(1, 16, 16, 8\)"):
        model(image, voxels[..., :4])


def test_frozen_backbones_stay_as_they_are_while_the_weight_branch_learns() -> None:
    model = build()
    model.freeze_backbones()
    model.train()
    before = {k: v.clone() for k, v in model.state_dict().items()}
    optimizer = torch.optim.Adam([p for p in model.parameters() if p.requires_grad], lr=0.1)
    model(*batch(4)).fused.square().sum().backward()
    optimizer.step()
    changed = {k.split(".")[0] for k, v in model.state_dict().items() if not v.equal(before[k])}
    assert changed == {"weight_net"}


def test_folded_norms_leave_the_trained_network_as_it_was() -> None:
    generator = torch.Generator().manual_seed(3)
    net = image_backbone(half=8, width=0.125)
    plain_parameters = count(net)
    initialise_he(net, generator)
    add_norms(net)
    x = torch.randn(4, 3, 48, 64, generator=generator)
    net.train()
    for _ in range(3):
        net(x * 2 + 1)  # the running statistics move away from 0 and 1
    net.eval()
    before = net(x)[0]
    fold_norms(net)
    assert count(net) == plain_parameters
    assert torch.allclose(net(x)[0], before, atol=1e-5)


def test_describe_turns_batches_into_arrays_and_leaves_the_mode_alone() -> None:
    model = build().train()
    d = describe(model, [batch(2), batch(3)])
    assert model.training
    assert d.fused is not None
    assert d.fused.shape == (5, 16)
    assert d.fused.dtype == np.float32


def test_a_described_model_can_still_learn() -> None:
    model = build()
    describe(model, [batch(1)])
    fused = model.train()(*batch(2)).fused
    assert fused is not None
    fused.sum().backward()
    assert all(p.grad is not None for p in model.parameters())


def test_a_model_file_carries_its_preprocessing_and_identity(tmp_path: Path) -> None:
    model = build()
    save_model(model, tmp_path / "mine.safetensors", card={"seed": 3})
    again = load_model(tmp_path / "mine.safetensors")
    assert again.config == model.config
    assert again.fingerprint == model.fingerprint
    assert again.name == "mine"
    assert not again.training
    assert read_header(tmp_path / "mine.safetensors")[1] == {"seed": 3}


def test_a_training_s_model_is_called_by_its_folder(tmp_path: Path) -> None:
    for run in ("x", "y"):
        (tmp_path / run).mkdir()
        save_model(build(), tmp_path / run / "model.safetensors")
    assert [load_model(tmp_path / run / "model.safetensors").name for run in "xy"] == ["x", "y"]


def test_another_weight_or_another_preprocessing_is_another_model() -> None:
    model, other = build(), build()
    assert model.fingerprint == other.fingerprint
    with torch.no_grad():
        next(other.parameters()).add_(1e-3)
    assert model.fingerprint != other.fingerprint
    rounded = replace(TINY.preprocess, voxels=replace(TINY.preprocess.voxels, index="round"))
    assert build(preprocess=rounded).fingerprint != model.fingerprint


def test_an_unknown_name_lists_the_shipped_models() -> None:
    with pytest.raises(UserError, match="adafusion-s"):
        load_model("adafusoin-s")


def test_a_truncated_model_file_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "cut.safetensors"
    save_model(build(), path)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(UserError, match=r"cut\.safetensors"):
        load_model(path)


def test_nonsense_configurations_are_refused() -> None:
    for changes in ({"dim": 255}, {"width": 0.0}, {"attention_levels": 4}):
        with pytest.raises(ValueError, match=next(iter(changes))):
            replace(TINY, **changes)


@pytest.mark.parametrize(
    ("system", "changes", "words"),
    [
        ("lidar", {"voxels": VoxelGrid(shape=(16, 16, 7))}, "at least 8"),
        ("image", {"image": ImageSettings(size=(15, 64))}, "at least 16"),
    ],
)
def test_an_input_too_small_for_a_branch_is_refused(
    system: System, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(UserError, match=words):
        AdaFusion(ModelConfig(system=system, preprocess=Preprocess(**changes)))
    other: System = "image" if system == "lidar" else "lidar"
    AdaFusion(ModelConfig(system=other, preprocess=Preprocess(**changes)))  # looks at the other
