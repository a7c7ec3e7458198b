# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Model files: safetensors weights whose header carries the configuration and a model card."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from adafusion.config import from_plain, to_plain
from adafusion.files import atomic_path
from adafusion.models.base import PlaceModel
from adafusion.models.config import ModelConfig
from adafusion.models.systems import build_system
from adafusion.types import UserError

FORMAT = "adafusion-model-1"
SHIPPED = ("adafusion-s", "concat-s", "image-s", "lidar-s")


def load_model(name_or_path: str | Path, device: str | torch.device = "cpu") -> PlaceModel:
    """Load a shipped model by name, or a .safetensors file, ready to describe places, not to learn.

    A file is known by its stem, or by its folder where it has the name that every training gives:
    runs/mine/model.safetensors is "mine". Nothing in the file is executed. Raises UserError for an
    unknown name or a file that is not a whole model file.
    """
    path = model_path(name_or_path)
    config, _ = read_header(path)
    name = path.resolve().parent.name if path.stem == "model" else path.stem
    model = build_system(config, name)
    try:
        with safe_open(path, framework="pt") as file:
            model.load_state_dict({key: file.get_tensor(key) for key in file.keys()})  # noqa: SIM118
    except (RuntimeError, SafetensorError) as error:
        raise UserError(f"{path}: weights do not fit the model in its header: {error}") from error
    return model.to(device).eval().requires_grad_(False)


def save_model(model: PlaceModel, path: str | Path, card: Mapping[str, Any] | None = None) -> None:
    """Write a model file atomically; `card` (plain JSON values) says where the weights are from."""
    weights = {key: value.detach().cpu().contiguous() for key, value in model.state_dict().items()}
    header = {
        "format": FORMAT,
        "config": json.dumps(to_plain(model.config), sort_keys=True),
        "card": json.dumps(dict(card or {}), sort_keys=True, allow_nan=False),
    }
    with atomic_path(path) as temporary:
        save_file(weights, temporary, metadata=header)


def read_header(path: str | Path) -> tuple[ModelConfig, dict[str, Any]]:
    """Read the configuration and the card of a model file, not its weights."""
    path = Path(path)
    try:
        with safe_open(path, framework="pt") as file:
            header = file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise UserError(
            f"{path}: not a whole safetensors file ({error}); copy or train it again"
        ) from error
    if header.get("format") != FORMAT:
        raise UserError(
            f"{path}: holds no {FORMAT} header, so its sizes and preprocessing are unknown; "
            "use `adafusion import-released` for the released code's checkpoints"
        )
    try:
        config = from_plain(ModelConfig, json.loads(header["config"]))
        return config, json.loads(header["card"])
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path}: its header cannot be understood ({error})") from error


def model_path(name_or_path: str | Path) -> Path:
    """Find the file of a shipped name or a path; UserError where there is none."""
    path = Path(name_or_path)
    if str(name_or_path) in SHIPPED:
        path = Path(str(files("adafusion") / "weights" / f"{name_or_path}.safetensors"))
        if not path.is_file():
            raise UserError(
                f"{path}: the shipped weights are not installed; install the package again"
            )
    if not path.is_file():
        raise UserError(
            f"{path}: no such model file, and no shipped name: choose from {', '.join(SHIPPED)}"
        )
    return path
