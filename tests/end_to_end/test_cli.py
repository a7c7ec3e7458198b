# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The commands as a person types them, on a tiny world and a tiny model."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from adafusion.cli.common import named_config
from adafusion.config import change_config, load_config
from adafusion.datasets import Dataset
from adafusion.mapping import PlaceMap
from adafusion.models import AdaFusion, ModelConfig, load_model, save_model
from adafusion.training import TrainConfig

COMMANDS = [
    ["demo"],
    ["simulate"],
    ["prepare"],
    ["split"],
    ["doctor"],
    ["train"],
    ["evaluate"],
    ["experiment"],
    ["map", "build"],
    ["map", "add"],
    ["map", "info"],
    ["locate"],
    ["import-released"],
    ["world", "list"],
    ["world", "render"],
    ["world", "sheet"],
    ["world", "export"],
    ["config", "show"],
]


@pytest.fixture(scope="module")
def weights(tiny_model: ModelConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_model(AdaFusion(tiny_model), path)
    return path


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help_teaches_with_an_example(type_in, command: list[str]) -> None:
    said = type_in(*command, "--help")
    assert said.code == 0
    assert f"Example: adafusion {' '.join(command)}" in said.out


def test_help_comes_quickly_because_nothing_heavy_is_imported() -> None:
    code = "import sys, adafusion.cli; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"lancedb", "lightning", "matplotlib", "tensorboard"} & set(done.stdout.split())


def test_a_day_is_mapped_extended_and_the_night_found(
    type_in, tiny_world: Dataset, weights: Path, tmp_path: Path
) -> None:
    path = tmp_path / "town.map"
    model = ["--model", weights]
    said = type_in(
        "map", "build", tiny_world.root, path, "--runs", "day", "--frames", "::2", *model
    )
    assert said.code == 0, said.err
    said = type_in("map", "add", tiny_world.root, path, "--runs", "day", "--frames", "1::2", *model)
    assert said.code == 0, said.err
    days = sum(frame.run == "day" for frame in tiny_world.frames)
    facts = json.loads(type_in("map", "info", path, "--json").out)
    assert facts["places"] == days
    assert "SYNTHETIC" in type_in("map", "info", path).out

    before = PlaceMap.open(path).fingerprint
    said = type_in(
        "locate", path, "--dataset", tiny_world.root, "--runs", "night", "--json", *model
    )
    assert said.code == 0, said.err
    lines = [json.loads(line) for line in said.out.splitlines()]
    assert len(lines) == sum(frame.run == "night" for frame in tiny_world.frames)
    assert all(line["places"][0]["key"].startswith("day/") and "off_m" in line for line in lines)
    assert PlaceMap.open(path).fingerprint == before


def test_a_place_on_the_map_finds_itself_by_any_sensor(
    type_in, tiny_world: Dataset, weights: Path, tmp_path: Path
) -> None:
    path = tmp_path / "town.map"
    type_in("map", "build", tiny_world.root, path, "--runs", "day", "--model", weights)
    frame = next(frame for frame in tiny_world.frames if frame.run == "day")
    image, cloud = tiny_world.root / str(frame.image), tiny_world.root / str(frame.cloud)
    for given, used in (
        (["--image", image, "--cloud", cloud], ["image", "lidar"]),
        (["--image", image], ["image"]),
        (["--cloud", cloud], ["lidar"]),
    ):
        said = type_in("locate", path, *given, "--model", weights, "--json")
        answer = json.loads(said.out)
        assert answer["used"] == used
        assert answer["places"][0]["key"] == frame.key
        assert answer["places"][0]["distance"] == pytest.approx(0.0, abs=1e-5)
        assert (answer["alpha"] is None) == (len(used) == 1)


def test_evaluate_writes_a_result_that_can_be_repeated(
    type_in, tiny_world: Dataset, weights: Path, tmp_path: Path
) -> None:
    said = type_in("evaluate", tiny_world.root, tmp_path / "a", "--model", weights)
    assert said.code == 0, said.err
    assert "recall@1" in said.out
    again = type_in("evaluate", tiny_world.root, tmp_path / "b", "--model", weights, "--no-report")
    first, second = (
        json.loads((tmp_path / name / "result.json").read_text())["results"][0] for name in "ab"
    )
    assert again.code == 0
    assert first["recall"] == second["recall"]
    assert first["data"]["fingerprint"] == tiny_world.fingerprint
    assert first["data"]["synthetic"]
    assert first["model"]["fingerprint"] == load_model(weights).fingerprint
    page = (tmp_path / "a" / "report.html").read_text()
    assert "SYNTHETIC" in page.upper()
    assert not (tmp_path / "b" / "report.html").exists()


def test_a_packaged_training_is_shown_by_its_name_as_it_would_be_trained(
    type_in, tmp_path: Path
) -> None:
    shown = tmp_path / "lidar.yaml"
    shown.write_text(type_in("config", "show", "lidar-s", "seed=4").out)
    assert load_config(TrainConfig, shown) == change_config(
        load_config(TrainConfig, named_config("lidar-s")), ("seed=4",)
    )


def test_train_writes_a_model_that_the_other_commands_take(
    type_in, tiny_world: Dataset, weights: Path, tmp_path: Path
) -> None:
    config = tmp_path / "mine.yaml"
    config.write_text(type_in("config", "show", "train").out)
    model = load_model(weights).config.preprocess
    said = type_in(
        "train", tmp_path / "out", tiny_world.root, "--config", config,
        "--set", "model.width=0.125", "--set", "model.dim=16",
        "--set", f"model.preprocess.image.size={list(model.image.size)}",
        "--set", f"model.preprocess.voxels.shape={list(model.voxels.shape)}",
        "--set", "sampling.places=4", "--set", "batches=2",
    )  # fmt: skip
    assert said.code == 0, said.err
    assert (tmp_path / "out" / "train.yaml").exists()
    trained = tmp_path / "out" / "model.safetensors"
    said = type_in("map", "build", tiny_world.root, tmp_path / "m.map", "--model", trained)
    assert said.code == 0, said.err


def test_a_released_checkpoint_becomes_a_model_file(type_in, tmp_path: Path) -> None:
    ours = AdaFusion(ModelConfig()).state_dict()
    names = {
        "image_net.blocks.": "v_feature{}",
        "voxel_net.blocks.": "l_feature{}",
    }
    state = {}
    for key, tensor in ours.items():
        for prefix, released in names.items():
            if key.startswith(prefix):
                level, rest = key.removeprefix(prefix).split(".", 1)
                key = f"{released.format(int(level) + 1)}.{rest}"
        for att, letter in (("image_attention", "v"), ("voxel_attention", "l")):
            if key.startswith(f"weight_net.{att}."):
                kind, rest = key.removeprefix(f"weight_net.{att}.").split(".", 1)
                if kind == "fuse":
                    key = f"{letter}_atten_fusion.{rest}"
                else:
                    level, rest = rest.split(".", 1)
                    short, layer = {
                        "spatial": ("pos", rest.replace("qkv", "qkv_conv")),
                        "channel": ("chn", rest.replace("narrow", "bottleneck")),
                    }[kind]
                    key = f"{letter}_attention_{short}{int(level) + 1}.{layer}"
        key = key.replace("weight_net.head", "vl_atten_fusion")
        state[f"module.{key}"] = tensor
    torch.save({"state_dict": state}, tmp_path / "released.pth")
    said = type_in("import-released", tmp_path / "released.pth", tmp_path / "ours.safetensors")
    assert said.code == 0, said.err
    model = load_model(tmp_path / "ours.safetensors")
    assert model.config.preprocess.voxels.index == "round"
    assert all(torch.equal(value, ours[key]) for key, value in model.state_dict().items())

    save_file(
        {k: v for k, v in load_file(tmp_path / "ours.safetensors").items() if "head" not in k},
        tmp_path / "half.safetensors",
    )
    said = type_in("import-released", tmp_path / "half.safetensors", tmp_path / "x.safetensors")
    assert said.code == 2
    assert "half.safetensors" in said.err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["locate", "absent.map", "--image", "x.png", "--model", "WEIGHTS"], "absent.map"),
        (["locate", "absent.map"], "--image"),
        (["map", "build", "absent", "m.map", "--model", "WEIGHTS"], "absent"),
        (["map", "build", "WORLD", "m.map", "--model", "absent.safetensors"], "absent.safetensors"),
        (["map", "build", "WORLD", "m.map", "--model", "WEIGHTS", "--runs", "fog"], "fog"),
        (["map", "build", "WORLD", "m.map", "--model", "WEIGHTS", "--frames", "a"], "--frames"),
        (["evaluate", "WORLD", "out", "--model", "WEIGHTS", "--protocol", "mine"], "cross-run"),
        (["prepare", "kitti", "a", "b"], "kitti-odometry"),
        (["config", "show", "train", "loss.magrin=1"], "loss.margin"),
        (["simulate", "out", "--profile", "huge"], "tiny"),
        (["simulate", "out", "--runs", "day,hail"], "hail"),
        (["locate"], "Missing argument"),
    ],
)
def test_bad_input_is_named_on_stderr_and_exits_with_2(
    type_in, tiny_world: Dataset, weights: Path, tmp_path: Path, words: list[str], message: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    real = {"WORLD": str(tiny_world.root), "WEIGHTS": str(weights)}
    said = type_in(*[real.get(word, word) for word in words])
    assert said.code == 2
    assert message in said.err
    assert "Traceback" not in said.err
    assert not list(tmp_path.iterdir()), "nothing may be left behind"


def test_a_query_that_cannot_be_read_leaves_the_map_alone(
    type_in, tiny_world: Dataset, weights: Path, tmp_path: Path
) -> None:
    path = tmp_path / "town.map"
    type_in("map", "build", tiny_world.root, path, "--runs", "day", "--model", weights)
    before = PlaceMap.open(path).fingerprint
    frame = tiny_world.frames[0]
    image, cloud = tiny_world.root / str(frame.image), tiny_world.root / str(frame.cloud)
    half = tmp_path / "half.png"
    half.write_bytes(image.read_bytes()[: image.stat().st_size // 2])
    cut = tmp_path / "cut.npy"
    cut.write_bytes(cloud.read_bytes()[:-7])
    empty, holes = tmp_path / "empty.npy", tmp_path / "holes.npy"
    np.save(empty, np.zeros((0, 3), np.float32))
    points = np.load(cloud)
    points[3] = np.nan
    np.save(holes, points)
    double = tmp_path / "double.npy"
    np.save(double, np.load(cloud).astype(np.float64))
    other = tmp_path / "other.bin"
    other.write_bytes(b"\0" * 19)
    for words, name in (
        (["--image", half], "half.png"),
        (["--cloud", cut], "cut.npy"),
        (["--cloud", empty], "empty.npy"),
        (["--cloud", holes], "holes.npy"),
        (["--cloud", other], "--lidar-height-m"),
        (["--cloud", other, "--lidar-height-m", "1.73"], "other.bin"),
        (["--cloud", cloud, "--lidar-height-m", "1.73"], "--lidar-height-m"),
        (["--cloud", double], "astype(np.float32)"),
    ):
        said = type_in("locate", path, *words, "--model", weights)
        assert said.code == 2, name
        assert name in said.err
    assert PlaceMap.open(path).fingerprint == before
    assert cv2.imread(str(image)) is not None


def test_a_resume_with_another_configuration_is_refused_and_changes_nothing(
    type_in, tiny_world: Dataset, weights: Path, tmp_path: Path
) -> None:
    model = load_model(weights).config.preprocess
    out = tmp_path / "out"
    words = [
        "train", out, tiny_world.root, "--set", "model.width=0.125", "--set", "model.dim=16",
        "--set", f"model.preprocess.image.size={list(model.image.size)}",
        "--set", f"model.preprocess.voxels.shape={list(model.voxels.shape)}",
        "--set", "sampling.places=4",
    ]  # fmt: skip
    assert type_in(*words, "--set", "batches=1").code == 0
    asked = (out / "asked.yaml").read_bytes()
    again = type_in(*words, "--set", "batches=1")
    assert (again.code, "--resume" in again.err) == (2, True)
    other = type_in(*words, "--set", "batches=2", "--resume")
    assert (other.code, "differs" in other.err) == (2, True)
    assert "preparing" not in other.err, "refused before the work"
    assert (out / "asked.yaml").read_bytes() == asked
    assert "done already" in type_in(*words, "--set", "batches=1", "--resume").err


@pytest.mark.parametrize("name", ["README.md", "pyproject.toml", "LICENSE"])
def test_a_file_that_is_no_checkpoint_is_named_without_a_traceback(
    type_in, tmp_path: Path, name: str
) -> None:
    wrong = Path(__file__).parents[2] / name
    said = type_in("import-released", wrong, tmp_path / "x.safetensors")
    assert said.code == 2
    assert name in said.err
    assert "weights_only" not in said.err
