# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest

from adafusion.config import identity, load_config, save_config
from adafusion.types import UserError


@dataclass(frozen=True, kw_only=True)
class Grid:
    lower: tuple[float, float] = (0.0, 0.0)
    kind: Literal["floor", "round"] = "floor"

    def __post_init__(self) -> None:
        if self.lower[0] < 0:
            raise ValueError("lower must not be negative")


@dataclass(frozen=True, kw_only=True)
class Config:
    grid: Grid = field(default_factory=Grid)
    rate: float = 1e-3
    seed: int | None = None
    init: tuple[str, ...] = ()


def test_defaults_file_and_overrides_are_taken_in_that_order(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text("rate: 1e-4\ngrid: {lower: [1, 2], kind: round}\n")
    config = load_config(Config, path, ["grid.kind=floor", "seed=3", "init=[a, b]"])
    expected = Config(grid=Grid(lower=(1.0, 2.0)), rate=1e-4, seed=3, init=("a", "b"))
    assert config == expected


def test_what_is_saved_reads_back_equal(tmp_path: Path) -> None:
    config = Config(grid=Grid(lower=(1.5, 2.0), kind="round"), seed=3, init=("a",))
    save_config(config, tmp_path / "c.yaml")
    assert load_config(Config, tmp_path / "c.yaml") == config


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("grid: {knid: floor}", r"grid\.knid; did you mean grid\.kind"),
        ("lr: 1", "unknown key lr"),
        ("rate: fast", "rate"),
        ("grid: {kind: ceil}", "kind"),
        ("grid: {lower: [-1, 0]}", "lower must not be negative"),
        ("grid: {lower: [1]}", "lower"),
        ("- a", "key: value"),
        ("a: [", "YAML"),
    ],
)
def test_a_mistake_is_named_with_its_file(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    with pytest.raises(UserError, match=message) as error:
        load_config(Config, path)
    assert "wrong.yaml" in str(error.value)


def test_the_identity_is_what_differs_from_the_defaults() -> None:
    assert identity(Config()) == "{}"
    changed = Config(grid=Grid(lower=(0.0, 2.0)), init=("a",))
    assert identity(changed) == '{"grid": {"lower": [0.0, 2.0]}, "init": ["a"]}'


def test_a_setting_learnt_later_changes_no_identity() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Later(Config):
        warmup: int = 0

    assert identity(Later(rate=0.5)) == identity(Config(rate=0.5))
    assert identity(Later(rate=0.5, warmup=1)) != identity(Config(rate=0.5))


def test_a_missing_file_and_a_malformed_override_are_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such"):
        load_config(Config, tmp_path / "absent.yaml")
    with pytest.raises(UserError, match="key=value"):
        load_config(Config, None, ["rate"])


@pytest.mark.parametrize("override", ["seed=3.5", "seed=true", "seed=many"])
def test_a_count_is_a_whole_number(override: str) -> None:
    with pytest.raises(UserError, match="seed"):
        load_config(Config, None, [override])
    assert load_config(Config, None, ["seed=1e3"]).seed == 1000


def test_a_text_is_no_list_and_broken_yaml_is_no_value() -> None:
    with pytest.raises(UserError, match="write a list"):
        load_config(Config, None, ["init=runs/a/model.safetensors"])
    with pytest.raises(UserError, match="YAML"):
        load_config(Config, None, ["rate=[1"])
