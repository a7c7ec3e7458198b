# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from adafusion.models import (
    AdaFusion,
    ModelConfig,
    build_system,
    describe,
    load_model,
    prepared_batches,
    save_model,
)
from adafusion.models.frozen import FusionOnly, branches_fingerprint, describe_frozen, freeze
from adafusion.models.plain import plain_forward
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid
from adafusion.preprocess.cache import PreparedSet, prepare_cache
from adafusion.types import Frame, Observation, UserError

SETTINGS = Preprocess(image=ImageSettings(size=(48, 64)), voxels=VoxelGrid(shape=(16, 16, 8)))
TINY = ModelConfig(width=0.125, dim=16, preprocess=SETTINGS)
FUSIONS = (
    {},
    {"attention_levels": 0},
    {"attention": "paper"},
    {"fusion": "one-stage-weights", "attention_levels": 2},
    {"fusion": "linear"},
    {"attend_features": True},
    {"attend_features": True, "fusion": "one-stage-weights"},
    {"system": "concat"},
)


class Street:
    """Frames that all look different."""

    def __init__(self, name: str, count: int) -> None:
        self.root, self.fingerprint = Path(name), name
        self.frames = [
            Frame(run="day", timestamp_us=i, position_m=(50.0 * i, 0.0, 0.0), image="i", cloud="c")
            for i in range(count)
        ]

    def load(self, frame: Frame) -> Observation:
        rng = np.random.default_rng([frame.timestamp_us, len(self.frames)])
        return Observation(
            image=rng.integers(0, 255, (48, 64, 3), dtype=np.uint8),
            points_body=rng.uniform((-15, -15, 0.5), (15, 15, 4), (300, 3)).astype(np.float32),
        )


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> PreparedSet:
    """Two datasets, the first of more frames than are computed at once."""
    cache = tmp_path_factory.mktemp("cache")
    streets = Street("long", 35), Street("short", 4)
    return PreparedSet(tuple(prepare_cache(street, SETTINGS, cache) for street in streets))


def build(**changes: object) -> AdaFusion:
    torch.manual_seed(0)
    model = build_system(replace(TINY, **changes))
    assert isinstance(model, AdaFusion)
    generator = torch.Generator().manual_seed(1)
    for layer in (model.image_add, model.voxel_add, model.linear):
        if layer is not None:  # as if it had learnt
            torch.nn.init.normal_(layer.weight, std=0.3, generator=generator)
    return model.eval()


def inputs(n: int = 3) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(2)
    image = torch.rand(n, 3, 48, 64, generator=generator) * 2 - 1
    return image, (torch.rand(n, 1, 16, 16, 8, generator=generator) < 0.1).float()


# --------------------------------------------------------------------------------- the fusions


def test_one_stage_has_no_layers_within_a_sensor() -> None:
    """Three levels of a spatial and a channel map, 16 channels each, of two sensors."""
    one, two = build(fusion="one-stage-weights"), build()
    assert one.weight_net is not None
    assert two.weight_net is not None
    assert one.weight_net.head[0].in_features == 2 * 3 * 2 * 16
    assert two.weight_net.head[0].in_features == 2 * 128
    assert not list(one.weight_net.image_attention.fuse.parameters())


@pytest.mark.parametrize("levels", [1, 3])
def test_one_stage_is_what_the_plain_form_gives(levels: int) -> None:
    model = build(fusion="one-stage-weights", attention_levels=levels)
    for ours, plain in zip(model(*inputs()), plain_forward(model, *inputs()), strict=True):
        assert torch.allclose(ours, plain, atol=1e-5)


@pytest.mark.parametrize("change", [{}, {"normalise_halves": True}, {"unit_length": True}])
def test_attended_features_are_what_the_plain_form_gives(change: dict[str, object]) -> None:
    model = build(attend_features=True, **change)
    for ours, plain in zip(model(*inputs()), plain_forward(model, *inputs()), strict=True):
        assert torch.allclose(ours, plain, atol=1e-5)


def test_a_linear_fusion_begins_as_the_joined_features_and_has_no_weights() -> None:
    torch.manual_seed(0)
    model = AdaFusion(replace(TINY, fusion="linear")).eval()
    d = model(*inputs())
    assert d.alpha is None
    assert torch.equal(d.fused, torch.cat([d.image_half, d.lidar_half], dim=1))
    assert sum(p.numel() for p in model.linear.parameters()) == 16 * 16 + 16


def test_attended_features_begin_as_the_branches_own() -> None:
    torch.manual_seed(0)
    attended = AdaFusion(replace(TINY, attend_features=True)).eval()
    torch.manual_seed(0)
    plain = AdaFusion(TINY).eval()
    for ours, theirs in zip(attended(*inputs()), plain(*inputs()), strict=True):
        assert torch.equal(ours, theirs)


def test_attended_features_are_of_their_sensor_alone() -> None:
    model = build(attend_features=True)
    image, voxels = inputs()
    whole = model(image, voxels)
    assert torch.equal(model(image, None).image_half, whole.image_half)
    assert torch.equal(model(None, voxels).lidar_half, whole.lidar_half)
    weighted = [whole.alpha[:, :1] * whole.image_half, whole.alpha[:, 1:] * whole.lidar_half]
    assert torch.equal(whole.fused, torch.cat(weighted, dim=1))


@pytest.mark.parametrize("changes", FUSIONS[3:7])
def test_every_parameter_of_a_fusion_learns(changes: dict[str, object]) -> None:
    model = build(**changes).train()
    fused = model(*inputs(4)).fused
    (fused * torch.randn(fused.shape, generator=torch.Generator().manual_seed(2))).sum().backward()
    stuck = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()]
    assert not [name for name in stuck if not name.endswith("fuse.0.bias")], stuck


@pytest.mark.parametrize(
    "changes",
    [
        {"fusion": "one-stage-weights", "attention_levels": 0},
        {"attend_features": True, "attention_levels": 0},
        {"attend_features": True, "fusion": "linear"},
    ],
)
def test_a_fusion_without_what_it_needs_is_refused(changes: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"attention"):
        replace(TINY, **changes)


@pytest.mark.parametrize("changes", FUSIONS)
def test_a_file_carries_its_fusion(changes: dict[str, object], tmp_path: Path) -> None:
    model = build(**changes)
    save_model(model, tmp_path / "mine.safetensors")
    again = load_model(tmp_path / "mine.safetensors")
    assert again.config == model.config
    assert torch.allclose(again(*inputs()).fused, model(*inputs()).fused, atol=1e-6)


# ----------------------------------------------------------------------------------- the cache


@pytest.mark.parametrize("changes", FUSIONS)
def test_it_describes_by_the_cache_as_through_the_model(
    changes: dict[str, object], data: PreparedSet, tmp_path: Path
) -> None:
    model = build(**changes)
    rows = np.array([38, 0, 34, 35, 7, 33])  # of both datasets, in no order
    through = describe(model, prepared_batches(data, rows))
    by_cache = describe_frozen(model, data, rows, tmp_path)
    for ours, theirs in zip(by_cache, through, strict=True):
        if theirs is None:
            assert ours is None
        else:
            assert np.allclose(ours, theirs, atol=1e-5)


def test_fusions_of_the_same_branches_share_the_cache(data: PreparedSet, tmp_path: Path) -> None:
    first = build()
    for changes in FUSIONS:
        model = build(**changes)
        model.image_net.load_state_dict(first.image_net.state_dict())
        model.voxel_net.load_state_dict(first.voxel_net.state_dict())
        assert branches_fingerprint(model) == branches_fingerprint(first)
        freeze(model, data, tmp_path)
    assert len([path for path in tmp_path.iterdir() if path.is_dir()]) == 2  # one a dataset
    with torch.no_grad():
        first.image_net.blocks[0][0].bias[0] += 1e-3
    assert branches_fingerprint(first) != branches_fingerprint(model)


def test_a_killed_build_is_begun_anew(data: PreparedSet, tmp_path: Path) -> None:
    def killed(items, *, total=None, desc=""):
        yield next(iter(items))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        freeze(build(), data, tmp_path, killed)
    assert [path.suffix for path in tmp_path.iterdir() if path.is_dir()] == [".part"]
    freeze(build(), data, tmp_path)
    assert not [path for path in tmp_path.iterdir() if path.suffix == ".part"]


def test_a_damaged_cache_is_refused_by_name(data: PreparedSet, tmp_path: Path) -> None:
    long, _ = freeze(build(), data, tmp_path).parts
    file = long.folder / "outputs.f32"
    whole = file.read_bytes()
    turned = bytearray(whole)
    turned[-1] ^= 1  # in the last row
    file.write_bytes(turned)
    again = freeze(build(), data, tmp_path)
    again.tensors(np.arange(34))
    with pytest.raises(UserError, match=r"outputs.f32 is damaged \(row 34\)"):
        again.tensors(np.array([34]))
    file.write_bytes(whole[:-4])
    with pytest.raises(UserError, match=r"outputs.f32 is damaged"):
        freeze(build(), data, tmp_path)
    file.write_bytes(whole)
    (long.folder / "index.json").write_text("{")
    with pytest.raises(UserError, match=r"index.json is damaged"):
        freeze(build(), data, tmp_path)


@pytest.mark.parametrize("system", ["image", "lidar"])
def test_a_model_of_one_branch_has_nothing_to_fuse(
    system: str, data: PreparedSet, tmp_path: Path
) -> None:
    model = build(system=system)
    with pytest.raises(ValueError, match="does not fuse"):
        freeze(model, data, tmp_path)
    with pytest.raises(ValueError, match="does not fuse"):
        FusionOnly(model)
