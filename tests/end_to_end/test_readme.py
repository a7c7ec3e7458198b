# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What the README says is what the package does."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer.main

import adafusion
from adafusion.cli import app
from adafusion.datasets import Dataset
from adafusion.mapping import MapHeader, PlaceMap
from adafusion.models import describe, frame_batches

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", README, flags=re.DOTALL)
COMMANDS = [
    line.split("  #")[0].strip()
    for language, block in BLOCKS
    if language == "sh"
    for line in block.splitlines()
    if line.startswith("adafusion ")
]


def test_there_are_commands_to_check() -> None:
    assert len(COMMANDS) >= 8


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_of_the_readme_exists_with_its_options(line: str) -> None:
    command, words = typer.main.get_command(app), shlex.split(line)[1:]
    while hasattr(command, "commands"):
        command, words = command.commands[words[0]], words[1:]
    known = {option for parameter in command.params for option in parameter.opts}
    known |= {option for parameter in command.params for option in parameter.secondary_opts}
    assert {word for word in words if word.startswith("--")} <= known


@pytest.mark.parametrize("name", re.findall(r"\]\(([\w/.-]+)\)", README))
def test_a_link_of_the_readme_leads_somewhere(name: str) -> None:
    assert (ROOT / name).exists()


@pytest.mark.parametrize("name", sorted(set(re.findall(r"configs/[\w-]+\.yaml", README))))
def test_a_configuration_that_the_readme_names_can_be_read(name: str) -> None:
    from adafusion.config import load_config
    from adafusion.training import TrainConfig

    load_config(TrainConfig, ROOT / name)


def test_the_python_of_the_readme_runs(
    tiny_world: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = next(block for language, block in BLOCKS if language == "python")
    model = adafusion.load_model("adafusion-s")
    frames = [frame for frame in tiny_world.frames if frame.run == "day"][:6]
    PlaceMap.from_descriptions(
        frames,
        describe(model, frame_batches(model, frames, tiny_world.load)),
        header=MapHeader.of(model, tiny_world),
        dataset=tiny_world.info.name,
    ).save(tmp_path / "campus.map")
    monkeypatch.chdir(tmp_path)
    seen = tiny_world.load(frames[2])
    names = {"image_u8": seen.image, "points_m": seen.points_body}
    exec(code, names)
    assert names["d"].fused.shape == (1, 256)
    assert names["answer"].places[0].key == frames[2].key
