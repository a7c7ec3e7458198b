# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from safetensors.torch import save_file
from torch import nn

from adafusion.config import load_config
from adafusion.models import ModelConfig, load_model, save_model
from adafusion.models.netvlad import VGG16, NetVLAD, fit_whitening, reduce_by_pca
from adafusion.models.systems import SYSTEMS
from adafusion.preprocess import ImageSettings, Preprocess
from adafusion.training import TrainConfig
from adafusion.types import UserError

CONFIGS = Path(__file__).parents[2] / "configs"
TINY = ModelConfig(
    system="netvlad",
    width=1 / 32,  # 16 channels in the end
    clusters=4,
    dim=0,
    preprocess=Preprocess(image=ImageSettings(size=(48, 64), colours="imagenet")),
)
TINY_LENGTH = 4 * 16


def build(**changes: object) -> NetVLAD:
    torch.manual_seed(0)
    model = NetVLAD(replace(TINY, **changes))
    model.initialise(torch.Generator().manual_seed(0))
    return model


def images(n: int = 2) -> torch.Tensor:
    return torch.randn(n, 3, 48, 64, generator=torch.Generator().manual_seed(1))


def count(module: nn.Module, *, learning: bool = False) -> int:
    return sum(p.numel() for p in module.parameters() if p.requires_grad or not learning)


def test_it_has_the_papers_parameters_and_length() -> None:
    model = NetVLAD(replace(TINY, width=1.0, clusters=64))
    assert count(model.image_net) == 14_714_688
    assert count(model.vlad) == 65_536
    assert count(model) == 14_780_224
    assert model.vlad.length == 32_768


def test_an_image_of_the_papers_size_has_18_by_25_local_features() -> None:
    with torch.device("meta"):
        assert VGG16()(torch.empty(1, 3, 300, 400)).shape == (1, 512, 18, 25)


def test_the_convolutions_are_called_as_in_torchvision_and_the_last_has_no_relu() -> None:
    features = VGG16(1 / 32).features
    at = [i for i, layer in enumerate(features) if isinstance(layer, nn.Conv2d)]
    assert at == [0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28]
    assert [i for i, layer in enumerate(features) if isinstance(layer, nn.MaxPool2d)] == [
        4, 9, 16, 23,
    ]  # fmt: skip
    assert len(features) == 29
    assert (build().image_net(images()) < 0).any()


@pytest.mark.parametrize(("dim", "length"), [(0, TINY_LENGTH), (10, 10)])
def test_the_descriptor_has_the_length_asked_for_and_length_1(dim: int, length: int) -> None:
    d = build(dim=dim).eval()(images(), None)
    assert d.fused.shape == (2, length)
    assert torch.allclose(d.fused.norm(dim=1), torch.ones(2))
    assert torch.equal(d.image_half, d.fused)
    assert d.lidar_half is None
    assert d.alpha is None


@pytest.mark.parametrize("dim", [0, 10])
def test_every_parameter_learns(dim: int) -> None:
    model = build(dim=dim)
    fused = model(images(4), None).fused
    (fused * torch.randn(fused.shape, generator=torch.Generator().manual_seed(2))).sum().backward()
    stuck = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()]
    assert not stuck, f"no gradient reaches {stuck}"


def test_one_image_is_a_row_of_a_batch() -> None:
    model = build(dim=10).eval()
    x = images(3)
    assert torch.allclose(model(x, None).fused[1:2], model(x[1:2], None).fused, atol=1e-6)


def test_an_image_is_needed_in_the_model_s_size_and_a_cloud_changes_nothing() -> None:
    model = build().eval()
    voxels = torch.rand(2, 1, 72, 72, 48)
    assert torch.equal(model(images(), voxels).fused, model(images(), None).fused)
    with pytest.raises(ValueError, match="nothing"):
        model(None, voxels)
    with pytest.raises(ValueError, match=r"takes \(48, 64\)"):
        model(images()[..., :32], None)


def test_what_it_starts_from_is_a_function_of_the_generator() -> None:
    first, second = build(dim=10), NetVLAD(replace(TINY, dim=10))
    torch.manual_seed(99)
    second.initialise(torch.Generator().manual_seed(0))
    for name, value in first.state_dict().items():
        assert torch.equal(value, second.state_dict()[name]), name


def test_clusters_start_at_the_means_of_the_local_features_that_are_nearest() -> None:
    model = build()
    batches = [images(4), images(3) + 0.5]
    model.initialise_clusters(batches, torch.Generator().manual_seed(3))
    maps = torch.cat([model.image_net(x) for x in batches])  # 12 cells: fewer than are drawn
    local = F.normalize(maps.flatten(2), dim=1).mT.flatten(0, 1)
    centroids = model.vlad.centroids
    nearest = torch.cdist(local, centroids).argmin(dim=1)
    for k in range(4):
        assert torch.allclose(centroids[k], local[nearest == k].mean(dim=0), atol=1e-5)


def imagenet_file(path: Path, width: float = 1 / 32) -> Path:
    torch.manual_seed(7)
    state = {key: value.clone() for key, value in VGG16(width).state_dict().items()}
    save_file({**state, "classifier.0.weight": torch.zeros(2, 2)}, path)
    return path


def test_with_weights_from_imagenet_only_conv5_and_what_follows_learn(tmp_path: Path) -> None:
    model = NetVLAD(replace(TINY, width=1.0))
    assert count(model, learning=True) == count(model)
    model.load_imagenet(imagenet_file(tmp_path / "vgg16.safetensors", width=1.0))
    assert count(model.image_net, learning=True) == 7_079_424
    learning = {name for name, p in model.named_parameters() if p.requires_grad}
    assert learning == {
        *(f"image_net.features.{i}.{part}" for i in (24, 26, 28) for part in ("weight", "bias")),
        "vlad.assignment.weight",
        "vlad.centroids",
    }
    torch.manual_seed(7)
    for key, value in VGG16().state_dict().items():
        assert torch.equal(model.image_net.state_dict()[key], value), key


def test_a_pickle_is_read_as_tensors(tmp_path: Path) -> None:
    torch.save(VGG16(1 / 32).state_dict(), tmp_path / "vgg16.pth")
    model = build()
    model.load_imagenet(tmp_path / "vgg16.pth")
    saved = torch.load(tmp_path / "vgg16.pth", weights_only=True)
    assert torch.equal(model.image_net.features[28].weight, saved["features.28.weight"])


class Harmful:
    def __reduce__(self) -> tuple[object, ...]:
        return (exec, ("raise SystemExit('ran')",))


def test_other_files_are_refused_by_name_and_change_nothing(tmp_path: Path) -> None:
    model = build()
    before = model.fingerprint
    wide = imagenet_file(tmp_path / "wide.safetensors", width=1 / 16)
    cut = tmp_path / "cut.safetensors"
    save_file({"features.0.weight": VGG16(1 / 32).features[0].weight.data}, cut)
    harmful, noise = tmp_path / "harmful.pth", tmp_path / "noise.pth"
    harmful.write_bytes(pickle.dumps({"features.0.weight": Harmful()}, protocol=2))
    noise.write_bytes(b"no weights")
    for path in (wide, cut, harmful, noise, tmp_path / "absent.pth"):
        with pytest.raises(UserError, match=path.name):
            model.load_imagenet(path)
    assert model.fingerprint == before
    assert count(model, learning=True) == count(model)


def test_weights_from_imagenet_need_its_colours(tmp_path: Path) -> None:
    unit = replace(TINY.preprocess, image=ImageSettings(size=(48, 64)))
    with pytest.raises(UserError, match="colours=imagenet"):
        build(preprocess=unit).load_imagenet(imagenet_file(tmp_path / "vgg16.safetensors"))


def test_whitening_of_four_points_by_hand() -> None:
    points = np.array([[4.0, 5.0], [0.0, 5.0], [2.0, 6.0], [2.0, 4.0]])
    mean, projection = fit_whitening(points, 2)  # variances 8/3 and 2/3
    assert np.allclose(mean, [2, 5])
    assert np.allclose(np.abs(projection), np.diag([np.sqrt(3 / 8), np.sqrt(3 / 2)]))


@pytest.mark.parametrize("n", [30, 200])  # fewer and more than numbers in a descriptor
def test_whitened_descriptors_have_the_identity_as_their_covariance(n: int) -> None:
    rng = np.random.default_rng(0)
    x = (rng.normal(size=(n, 50)) @ rng.normal(size=(50, 50)) + 3.0).astype(np.float32)
    mean, projection = fit_whitening(x, 12)
    white = (x - mean) @ projection.T
    assert np.allclose(white.mean(axis=0), 0.0, atol=1e-9)
    assert np.allclose(np.cov(white.T), np.eye(12), atol=1e-9)
    # along the directions of most spread, most first: those that a singular value decomposition has
    _, s, v = np.linalg.svd(x - mean, full_matrices=False)
    assert np.allclose(1.0 / np.linalg.norm(projection, axis=1), s[:12] / np.sqrt(n - 1))
    assert np.allclose(
        np.abs(np.sum(F.normalize(torch.tensor(projection)).numpy() * v[:12], axis=1)), 1.0
    )


def test_too_few_descriptors_or_directions_cannot_be_whitened() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(8, 20))
    with pytest.raises(UserError, match="fewer than 8 directions"):
        fit_whitening(x, 8)
    with pytest.raises(UserError, match="fewer than 5 directions"):
        fit_whitening(np.repeat(x[:4], 10, axis=0), 5)
    for dim in (0, 21):
        with pytest.raises(ValueError, match="of 20 numbers"):
            fit_whitening(x, dim)


def test_reduction_by_pca_is_the_whitened_descriptor_of_length_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SYSTEMS, "netvlad", NetVLAD)
    model = build().eval()
    before = model.fingerprint
    x = images(20)
    with torch.no_grad():
        whole = model(x, None).fused.numpy()
    reduced = reduce_by_pca(model, whole, 6)
    mean, projection = fit_whitening(whole, 6)
    white = (whole - mean) @ projection.T
    expected = white / np.linalg.norm(white, axis=1, keepdims=True)
    assert np.allclose(reduced(x, None).fused.numpy(), expected, atol=1e-4)
    assert (model.fingerprint, model.config.dim) == (before, 0)

    save_model(reduced, tmp_path / "reduced.safetensors")
    again = load_model(tmp_path / "reduced.safetensors")
    assert again.config.dim == 6
    assert torch.equal(again(x, None).fused, reduced(x, None).fused)
    with pytest.raises(ValueError, match="reduced already"):
        reduce_by_pca(reduced, whole, 3)


@pytest.mark.parametrize(
    ("name", "parameters"), [("netvlad", 14_780_224), ("netvlad-s", 1_449_424)]
)
def test_the_configurations_load_and_say_how_large_they_are(name: str, parameters: int) -> None:
    path = CONFIGS / f"{name}.yaml"
    config = load_config(TrainConfig, path)
    assert count(NetVLAD(config.model)) == parameters
    assert f"{parameters:,} parameters" in path.read_text(encoding="utf-8")
    assert config.model.p == 2
