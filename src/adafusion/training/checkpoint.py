# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The folder of a training: whose it is, and where a resumed one goes on.

Weights lie in a safetensors file of their own; optimiser, schedule and counts in a second one that
names it and is read as plain tensors and numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from safetensors.torch import load_file, save_file

from adafusion.config import load_config, save_config
from adafusion.files import atomic_path, sweep_temporaries
from adafusion.models import PlaceModel
from adafusion.training.sampler import Course, Sampler
from adafusion.training.settings import TrainConfig
from adafusion.types import UserError

CONFIG_FILE = "train.yaml"
STATE_FILE = "state.pt"  # where a resumed training goes on


@dataclass(kw_only=True)
class Standing:
    """How far a training is, and how it came there."""

    batches: int = 0
    passes: int = 0  # frame passes that taught
    mining_passes: int = 0  # and those that chose wrong matches
    seconds: float = 0.0  # without what a kill undid
    best: float = -math.inf  # recall@1 on validation of the model kept so far
    curve: list[dict[str, Any]] = field(default_factory=list)  # a line an evaluation


def claim(out: Path, config: TrainConfig, resume: bool) -> None:
    """Make `out` this training's folder, or see that it already is."""
    has_state = (out / STATE_FILE).exists()
    if resume and not has_state:
        raise UserError(f"{out / STATE_FILE}: no such file; start without --resume")
    if not resume and has_state:
        raise UserError(f"{out} holds a training: give --resume to go on, or another folder")
    out.mkdir(parents=True, exist_ok=True)
    sweep_temporaries(out)
    if resume:
        require_config(out / CONFIG_FILE, config)
    save_config(config, out / CONFIG_FILE)


def require_config(path: Path, config: TrainConfig) -> None:
    """Raise UserError unless the configuration kept at `path` is `config`."""
    if load_config(TrainConfig, path) != config:
        raise UserError(
            f"{path} differs from the configuration given now; resume with that file, or train "
            "into another folder"
        )


def save_checkpoint(
    out: Path,
    model: PlaceModel,
    optimizer: Any,
    scheduler: Any,
    sampler: Sampler,
    standing: Standing,
    same: Mapping[str, str],
) -> None:
    """Write weights, then the state that names them: a kill in between leaves the last pair."""
    weights = f"weights-{standing.batches}.safetensors"
    with atomic_path(out / weights) as temporary:
        save_file(
            {k: v.detach().cpu().contiguous() for k, v in model.state_dict().items()}, temporary
        )
    state = {
        "weights": weights,
        "standing": asdict(standing),
        "same": dict(same),
        "course": asdict(sampler.course),
        "optimizer": optimizer.state_dict(),
        "scheduler": {k: v for k, v in scheduler.state_dict().items() if not callable(v)},
    }
    with atomic_path(out / STATE_FILE) as temporary:
        torch.save(state, temporary)
    for old in out.glob("weights-*.safetensors"):
        if old.name != weights:
            old.unlink()
    for _, old in _described_before(out, standing.batches)[:-1]:
        old.unlink()


def read_standing(out: Path) -> Standing:
    """How far the training in `out` was at its last checkpoint; UserError where none is whole."""
    path = out / STATE_FILE
    try:
        return Standing(**torch.load(path, map_location="cpu", weights_only=True)["standing"])
    except Exception as error:
        raise _lost(path, error) from error


def keep_described(out: Path, done: int, descriptors: Float[np.ndarray, "n d"]) -> None:
    """Keep the descriptors that batches after `done` are mined by, for a resumed training."""
    with atomic_path(out / f"described-{done}.npy") as temporary:
        np.save(temporary, descriptors, allow_pickle=False)


def restore_described(out: Path, done: int) -> Float[np.ndarray, "n d"] | None:
    """The descriptors that the batch after `done` was to be mined by; None before the first."""
    kept = _described_before(out, done)
    if not kept:
        return None
    try:
        return np.load(kept[-1][1], allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise UserError(f"{kept[-1][1]} is damaged ({error}); train into a new folder") from error


def _described_before(out: Path, done: int) -> list[tuple[int, Path]]:
    """Kept descriptors of `done` batches and fewer, by rising number."""
    numbered = [(int(path.stem.split("-")[1]), path) for path in out.glob("described-*.npy")]
    return sorted(one for one in numbered if one[0] <= done)


def restore_checkpoint(
    out: Path,
    model: PlaceModel,
    optimizer: Any,
    scheduler: Any,
    sampler: Sampler,
    same: Mapping[str, str],
) -> Standing:
    """Take training up where the last checkpoint left it.

    `same` is what must not have changed since, by name.
    """
    path = out / STATE_FILE
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        if changed := [name for name in same if state["same"][name] != same[name]]:
            raise ValueError(f"it was begun with another {' and another '.join(changed)}")
        model.load_state_dict(load_file(out / state["weights"]))
        optimizer.load_state_dict(state["optimizer"])
        scheduler.load_state_dict(state["scheduler"])
        sampler.go_on(Course(**state["course"]))
        return Standing(**state["standing"])
    except Exception as error:
        raise _lost(path, error) from error


def _lost(path: Path, error: Exception) -> UserError:
    return UserError(
        f"{path}: cannot be resumed ({type(error).__name__}: {error}); delete {path.parent} and "
        "repeat the command, or train into a new folder"
    )
