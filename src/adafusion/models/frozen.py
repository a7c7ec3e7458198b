# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What frozen branches give of every frame, on disk: computed once, for all that fuse them.

    <cache>/<key>/index.json     what this is, and the shape of each output
    <cache>/<key>/outputs.f32    (N, L) float32, a row a frame: f_I, its stages, f_P, its stages
    <cache>/<key>/crc.npy        (N,) checksum of each row

The key is that of the branches' weights and of the prepared frames. A frame takes 744 kB at
150 x 200 pixels, 36 x 36 x 24 cells and half the paper's width. A folder is whole or not there: one
that was killed while it was written is begun anew. Any of them may be deleted at any time.
"""

from __future__ import annotations

import json
import shutil
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import prod
from pathlib import Path

import numpy as np
import torch
from filelock import FileLock
from jaxtyping import Bool, Float32, Int, UInt32
from torch import Tensor, nn

from adafusion.config import identity
from adafusion.files import fingerprint, write_json
from adafusion.models.adafusion import AdaFusion
from adafusion.models.base import PlaceModel
from adafusion.models.config import LEVELS
from adafusion.models.describe import describe, use_channels_last
from adafusion.preprocess.cache import PreparedFrames, PreparedSet
from adafusion.types import Description, Descriptions, Progress, UserError, silent

FROZEN_VERSION = 1  # raise it when equal branches and frames come to give other outputs
BATCH = 32  # frames
SEEN = 1 + LEVELS  # outputs of a branch: its feature and its stages


class FusionOnly(nn.Module):
    """A model that starts where its branches end: takes their outputs, gives what it would give."""

    def __init__(self, model: PlaceModel) -> None:
        super().__init__()
        self.model = _of_two_branches(model)

    def forward(self, *outputs: Float32[Tensor, "b ..."]) -> Description:
        """Describe a batch from f_I, its stages, f_P and its stages."""
        f_I, *image_stages = outputs[:SEEN]
        f_P, *voxel_stages = outputs[SEEN:]
        return self.model.fuse((f_I, image_stages), (f_P, voxel_stages))


@dataclass(frozen=True, eq=False)
class FrozenFrames:
    """Outputs of both branches for the frames of one dataset, as a memory map.

    Each row is checked against its checksum when it is first read: UserError where the disk lost
    it.
    """

    folder: Path
    shapes: tuple[tuple[int, ...], ...]  # of one frame's f_I, its stages, f_P, its stages
    _rows: Float32[np.ndarray, "n l"] = field(repr=False)
    _crc: UInt32[np.ndarray, " n"] = field(repr=False)
    _checked: Bool[np.ndarray, " n"] = field(repr=False)

    def read(self, rows: Int[np.ndarray, " b"]) -> Float32[np.ndarray, "b l"]:
        """Whole rows, checked."""
        values = self._rows[rows]
        for row, value in zip(rows, values, strict=True):
            if not self._checked[row]:
                if zlib.crc32(value) != self._crc[row]:
                    raise _damaged(self.folder / "outputs.f32", f"row {row}")
                self._checked[row] = True
        return values


@dataclass(frozen=True, eq=False)
class FrozenSet:
    """Outputs of both branches for a prepared set, row for row."""

    parts: tuple[FrozenFrames, ...]
    worlds: Int[np.ndarray, " n"]  # which part a row belongs to

    def tensors(self, rows: Int[np.ndarray, " b"]) -> tuple[Float32[Tensor, "b ..."], ...]:
        """f_I, its stages, f_P and its stages, as `FusionOnly` takes them."""
        shapes = self.parts[0].shapes
        values = np.empty((len(rows), sum(map(prod, shapes))), np.float32)
        for world in np.unique(self.worlds[rows]):
            here = np.flatnonzero(self.worlds[rows] == world)
            first = int(np.searchsorted(self.worlds, world))
            values[here] = self.parts[world].read(rows[here] - first)
        outputs = torch.from_numpy(values).split([prod(shape) for shape in shapes], dim=1)
        return tuple(o.unflatten(1, shape) for o, shape in zip(outputs, shapes, strict=True))

    def batches(
        self, rows: Int[np.ndarray, " n"], batch_size: int = BATCH
    ) -> Iterator[tuple[Float32[Tensor, "b ..."], ...]]:
        """Read rows, a batch at a time."""
        for start in range(0, len(rows), batch_size):
            yield self.tensors(rows[start : start + batch_size])


def branches_fingerprint(model: PlaceModel) -> str:
    """Identity of what the branches compute, whatever is made of it."""
    weights = [
        part
        for name, tensor in sorted(model.state_dict().items())
        if name.startswith(("image_net.", "voxel_net."))
        for part in (name, tensor.detach().cpu().contiguous().numpy().tobytes())
    ]
    return fingerprint(identity(model.config.branches), *weights)


def freeze(
    model: PlaceModel, data: PreparedSet, cache_dir: str | Path, progress: Progress = silent
) -> FrozenSet:
    """Open what the model's branches give of every frame of `data`; compute it first if need be.

    Two processes that need the same outputs take turns. Raises ValueError for a model that does not
    fuse two branches, UserError for a damaged folder and a full disk.
    """
    model = _of_two_branches(model)
    branches = branches_fingerprint(model)
    parts = []
    for part in data.parts:
        key = fingerprint(f"frozen {FROZEN_VERSION}", branches, part.folder.name)
        folder = Path(cache_dir) / key
        if not folder.exists():
            folder.parent.mkdir(parents=True, exist_ok=True)
            with FileLock(folder.with_suffix(".lock")):  # let go when its process dies
                if not folder.exists():
                    _build(model, part, folder, progress)
        parts.append(_open(folder, len(part)))
    return FrozenSet(tuple(parts), data.worlds)


def describe_frozen(
    model: PlaceModel,
    data: PreparedSet,
    rows: Int[np.ndarray, " n"],
    cache_dir: str | Path,
    progress: Progress = silent,
) -> Descriptions:
    """As `describe` over those rows, by the outputs of the branches on disk."""
    return describe(FusionOnly(model), freeze(model, data, cache_dir, progress).batches(rows))


def _of_two_branches(model: PlaceModel) -> AdaFusion:
    if not isinstance(model, AdaFusion) or len(model.backbones) != 2:
        raise ValueError(f"{model.name} does not fuse two branches")
    return model


def _build(model: AdaFusion, part: PreparedFrames, folder: Path, progress: Progress) -> None:
    growing = folder.with_suffix(".part")
    shutil.rmtree(growing, ignore_errors=True)  # of one that was killed
    growing.mkdir()
    starts = range(0, len(part), BATCH)
    crc: list[int] = []
    shapes: list[list[int]] = []
    with (growing / "outputs.f32").open("wb") as file:
        for start in progress(starts, total=len(starts), desc=f"frozen branches of {model.name}"):
            rows = np.arange(start, min(start + BATCH, len(part)))
            outputs = _outputs(model, *part.tensors(rows))
            if not shapes:
                shapes = [list(o.shape[1:]) for o in outputs]
                needed = 4 * len(part) * sum(map(prod, shapes))
                _require_room(folder.parent, needed)
            values = torch.cat([o.flatten(1) for o in outputs], dim=1).float().cpu().numpy()
            crc += [zlib.crc32(value) for value in values]
            file.write(values.tobytes())
    np.save(growing / "crc.npy", np.array(crc, np.uint32), allow_pickle=False)
    index = {"frames": len(part), "prepared": part.folder.name, "shapes": shapes}
    write_json(growing / "index.json", index)
    growing.rename(folder)


@torch.inference_mode()
def _outputs(model: AdaFusion, image: Tensor, lidar: Tensor) -> list[Tensor]:
    was_training = model.training
    use_channels_last(model.eval())
    device = next(model.parameters()).device
    seen = []
    for net, x in zip(model.backbones, (image, lidar), strict=True):
        feature, stages = net(x.to(device))
        seen += [feature, *stages]
    model.train(was_training)
    return seen


def _require_room(folder: Path, needed: int) -> None:
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise UserError(
            f"{folder}: the outputs of frozen branches need {needed / 1e9:.1f} GB and its disk has "
            f"{free / 1e9:.1f} GB left: make room or choose another cache folder"
        )


def _open(folder: Path, frames: int) -> FrozenFrames:
    path = folder / "index.json"
    try:
        index = json.loads(path.read_text(encoding="utf-8"))
        shapes = tuple(tuple(map(int, shape)) for shape in index["shapes"])
        path = folder / "crc.npy"
        crc = np.load(path, allow_pickle=False)
        path = folder / "outputs.f32"
        length = sum(map(prod, shapes))
        if len(crc) != frames or path.stat().st_size != 4 * frames * length:
            raise ValueError(f"not of {frames} frames")
        rows = np.memmap(path, np.float32, "r", shape=(frames, length))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _damaged(path, str(error)) from error
    return FrozenFrames(folder, shapes, rows, crc, np.zeros(frames, np.bool_))


def _damaged(path: Path, what: str) -> UserError:
    return UserError(f"{path} is damaged ({what}): delete {path.parent}, it will be built again")
