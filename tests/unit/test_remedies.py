# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The settings that may make weights gain: halves of one length, rates, weights taken over."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from adafusion.config import change_config, identity
from adafusion.experiments.ablations import REMEDIES
from adafusion.experiments.catalogue import build_experiment, packaged_recipe
from adafusion.models import AdaFusion, ModelConfig, load_model, save_model
from adafusion.models.adafusion import unit_scale
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid
from adafusion.training import TrainConfig, build_model
from adafusion.training.optimiser import build_optimizer
from adafusion.training.settings import Optimiser
from adafusion.training.start import take_branches

TINY = ModelConfig(
    width=0.125,
    dim=16,
    preprocess=Preprocess(image=ImageSettings(size=(48, 64)), voxels=VoxelGrid(shape=(16, 16, 8))),
)
BUDGET = 12_000


def build(seed: int = 0, **changes: object) -> AdaFusion:
    torch.manual_seed(seed)
    return AdaFusion(replace(TINY, **changes)).eval()


@pytest.fixture
def batch() -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(3, 3, 48, 64, generator=generator) * 2 - 1
    return image, (torch.rand(3, 1, 16, 16, 8, generator=generator) < 0.1).float()


def test_a_half_comes_to_a_mean_absolute_value_of_one() -> None:
    half = torch.tensor([[3.0, -1.0, 0.0, 4.0], [0.2, 0.2, -0.2, 0.2], [0.0, 0.0, 0.0, 0.0]])
    expected = [[1.5, -0.5, 0.0, 2.0], [1.0, 1.0, -1.0, 1.0], [0.0, 0.0, 0.0, 0.0]]
    torch.testing.assert_close(unit_scale(half), torch.tensor(expected))


@pytest.mark.parametrize("system", ["adafusion", "concat"])
def test_normalised_halves_weigh_what_the_weights_say(
    batch: tuple[torch.Tensor, torch.Tensor], system: str
) -> None:
    plain, unit = build(system=system), build(system=system, normalise_halves=True)
    assert plain.state_dict().keys() == unit.state_dict().keys()
    with torch.no_grad():
        before, after = plain(*batch), unit(*batch)
    for half, scaled in zip(before[1:3], after[1:3], strict=True):
        torch.testing.assert_close(scaled, unit_scale(half))
    length = after.fused.reshape(3, 2, 8).abs().mean(dim=2)
    if system == "concat":
        torch.testing.assert_close(length, torch.ones(3, 2))
    else:  # the weights read what they always read
        torch.testing.assert_close(after.alpha, before.alpha, rtol=0, atol=0)
        torch.testing.assert_close(length, after.alpha)


def test_normalised_halves_know_no_scale_of_the_branch(
    batch: tuple[torch.Tensor, torch.Tensor],
) -> None:
    model = build(system="concat", normalise_halves=True)
    with torch.no_grad():
        before = model(*batch).fused
        model.image_net.last_norm.weight.mul_(7.0)
        model.image_net.last_norm.bias.mul_(7.0)
        torch.testing.assert_close(model(*batch).fused, before)


def test_a_model_of_normalised_halves_is_saved_as_one(
    tmp_path: Path, batch: tuple[torch.Tensor, torch.Tensor]
) -> None:
    model = build(normalise_halves=True)
    save_model(model, tmp_path / "unit.safetensors")
    with torch.no_grad():
        again = load_model(tmp_path / "unit.safetensors")(*batch).fused
        torch.testing.assert_close(again, model(*batch).fused, rtol=0, atol=0)


def test_settings_at_their_defaults_rename_nothing() -> None:
    assert identity(TrainConfig()) == "{}"
    for row in build_experiment("headline", packaged_recipe, BUDGET).rows:
        text = identity(row.training.config)
        assert not any(word in text for word in ("normalise", "weights_share", "take_weights"))


def names(model: AdaFusion, parameters: list[torch.nn.Parameter]) -> list[str]:
    of = {id(p): name for name, p in model.named_parameters()}
    return [of[id(p)] for p in parameters]


@pytest.mark.parametrize(
    ("image_share", "weights_share", "groups"),
    [
        (1.0, 1.0, [("", 1.0)]),
        (0.1, 1.0, [("image_net.", 0.1), ("", 1.0)]),
        (1.0, 10.0, [("", 1.0), ("weight_net.", 10.0)]),
        (0.1, 10.0, [("image_net.", 0.1), ("", 1.0), ("weight_net.", 10.0)]),
    ],
)
def test_networks_learn_at_their_own_rates_in_the_order_that_checkpoints_have(
    image_share: float, weights_share: float, groups: list[tuple[str, float]]
) -> None:
    model = build()
    settings = Optimiser(learning_rate=0.5, image_share=image_share, weights_share=weights_share)
    found = build_optimizer(settings, model).param_groups
    assert [group["lr"] for group in found] == [0.5 * share for _, share in groups]
    own = tuple(net for net, _ in groups if net)
    everything = [name for name, _ in model.named_parameters()]
    for (net, _), group in zip(groups, found, strict=True):
        if net:
            expected = [name for name in everything if name.startswith(net)]
        else:
            expected = [name for name in everything if not name.startswith(own)]
        assert names(model, group["params"]) == expected


def test_frozen_branches_leave_the_weight_branch_as_the_only_one_that_learns() -> None:
    model = build()
    model.freeze_backbones()
    (group,) = build_optimizer(Optimiser(weights_share=2.0, learning_rate=0.1), model).param_groups
    assert all(name.startswith("weight_net.") for name in names(model, group["params"]))
    assert group["lr"] == 0.2


def test_weights_are_taken_over_only_where_asked_to(tmp_path: Path) -> None:
    source = build(seed=3)
    file = tmp_path / "model.safetensors"
    save_model(source, file)
    plain = TrainConfig(model=TINY, norms=False, init=(str(file),))
    for take in (False, True):
        model = build_model(replace(plain, take_weights=take))
        same = {
            name.split(".")[0]: all(
                torch.equal(value, source.state_dict()[key])
                for key, value in model.state_dict().items()
                if key.startswith(name)
            )
            for name in ("image_net.", "voxel_net.", "weight_net.head.")
        }
        assert same == {"image_net": True, "voxel_net": True, "weight_net": take}
    fresh = build(seed=4)
    take_branches(fresh, source)
    assert not torch.equal(fresh.weight_net.head[0].weight, source.weight_net.head[0].weight)


@pytest.mark.parametrize("change", [{"fusion": "linear"}, {"attend_features": True}])
def test_whatever_fuses_the_branches_is_taken_over_with_the_weights(
    tmp_path: Path, change: dict
) -> None:
    source = build(seed=3, **change)
    for parameter in source.parameters():
        torch.nn.init.normal_(parameter)
    file = tmp_path / "model.safetensors"
    save_model(source, file)
    config = TrainConfig(model=source.config, norms=False, init=(str(file),), take_weights=True)
    for key, value in build_model(config).state_dict().items():
        assert torch.equal(value, source.state_dict()[key]), key


@pytest.mark.parametrize(
    "change", [{"init": (), "schedule": "joint"}, {"model": replace(TINY, system="concat")}]
)
def test_weights_are_taken_from_a_file_into_a_model_that_has_some(change: dict) -> None:
    config = {"model": TINY, "norms": False, "init": ("a.safetensors",), **change}
    with pytest.raises(ValueError, match="take_weights"):
        TrainConfig(**config, take_weights=True)


@pytest.mark.parametrize("name", ["image_share", "weights_share"])
def test_a_rate_is_positive(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        Optimiser(**{name: 0.0})


def test_every_remedy_changes_what_it_says_and_starts_from_the_headlines_branches() -> None:
    headline = {
        row.label: row.training
        for row in build_experiment("headline", packaged_recipe, BUDGET).rows
    }
    rows = {
        row.label: row.training
        for row in build_experiment("remedies", packaged_recipe, BUDGET).rows
    }
    adafusion = headline["AdaFusion"]
    assert (rows["VL"], rows["AdaFusion"]) == (headline["VL"], adafusion)
    before = identity(adafusion.config)
    for label in REMEDIES:
        assert identity(rows[label].config) != before
        assert rows[label].starts_from == adafusion.starts_from
    assert rows["blanked sensors"].config == replace(
        adafusion.config, augment=replace(adafusion.config.augment, blank=0.3)
    )
    assert rows["normalised halves"].config == replace(
        adafusion.config, model=replace(adafusion.config.model, normalise_halves=True)
    )
    (alone,) = rows["weights first"].starts_from
    assert alone.config == replace(adafusion.config, stage="weights")
    assert alone.starts_from == adafusion.starts_from
    assert alone.passes + rows["weights first"].passes == adafusion.passes
    of_names = [one.name for row in rows.values() for one in row.chain()]
    assert len({(one.name, one.config) for row in rows.values() for one in row.chain()}) == len(
        set(of_names)
    )


def test_the_remedy_that_gained_most_has_a_name() -> None:
    named = packaged_recipe("adafusion-normalised-s")
    assert named == change_config(packaged_recipe("adafusion-s"), REMEDIES["normalised halves"])
