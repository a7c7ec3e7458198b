# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What a trained model says of every frame of a test dataset, kept by content.

<out>/descriptions/<model>-<data>-<version>.npz   halves, descriptors and weights, one row a frame
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import torch

from adafusion.datasets import Dataset
from adafusion.files import atomic_path
from adafusion.models import PlaceModel, describe, load_model, prepared_batches
from adafusion.models.frozen import describe_frozen
from adafusion.preprocess.cache import PreparedSet, prepare_cache
from adafusion.types import Descriptions, Progress, UserError, silent

DESCRIPTION_VERSION = 1  # raise it when equal models and data come to be described otherwise
BATCH = 32


def load_trained(name: str, file: Path) -> PlaceModel:
    """Load what a training left, under the training's name, where it is quickest."""
    model = load_model(file, "cuda" if torch.cuda.is_available() else "cpu")
    model.name = name
    return model


def describe_frames(
    model: PlaceModel,
    dataset: Dataset,
    cache: Path,
    out: Path,
    progress: Progress = silent,
    *,
    frozen: bool = False,
) -> Descriptions:
    """Describe every frame of a dataset, once: what was described before is read from `out`.

    It is described by what the cache holds of it: the preprocessed frames or, with `frozen`, what
    the model's branches give of them. UserError for a kept file that is damaged.
    """
    stem = f"{model.fingerprint}-{dataset.fingerprint}-{DESCRIPTION_VERSION}"
    path = out / "descriptions" / f"{stem}.npz"
    if path.exists():
        return _read(path)
    prepared = prepare_cache(dataset, model.config.preprocess, cache, progress=progress)
    rows = np.arange(len(dataset.frames))
    if frozen:
        described = describe_frozen(model, PreparedSet((prepared,)), rows, cache, progress)
    else:
        batches = progress(
            prepared_batches(prepared, rows, BATCH),
            total=-(-len(rows) // BATCH),
            desc=f"describing by {model.name}",
        )
        described = describe(model, batches)
    path.parent.mkdir(parents=True, exist_ok=True)
    parts = {name: part for name, part in described._asdict().items() if part is not None}
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **parts)
    return described


def _read(path: Path) -> Descriptions:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
            return Descriptions(**{name: kept.get(name) for name in Descriptions._fields})
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise UserError(f"{path} is damaged ({error}): delete it and repeat the command") from None
