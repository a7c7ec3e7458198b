# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Checkpoints of the authors' released code, turned into model files of ours."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import Tensor

from adafusion.models.adafusion import AdaFusion
from adafusion.models.config import ModelConfig
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid
from adafusion.types import UserError

# The released code numbers its layers as ours do, under other names; v is the image, l the LiDAR.
_SENSORS = {"v": ("image_net", "image_attention"), "l": ("voxel_net", "voxel_attention")}
_RULES: tuple[tuple[str, str], ...] = (
    (r"([vl])_feature([123])\.(.+)", "{net}.blocks.{level}.{rest}"),
    (r"([vl])_attention_pos([123])\.qkv_conv\.(.+)", "weight_net.{att}.spatial.{level}.qkv.{rest}"),
    (
        r"([vl])_attention_chn([123])\.bottleneck\.(.+)",
        "weight_net.{att}.channel.{level}.narrow.{rest}",
    ),
    (r"([vl])_atten_fusion()\.(.+)", "weight_net.{att}.fuse.{rest}"),
)


def import_released(checkpoint: str | Path) -> AdaFusion:
    """Read a checkpoint of the released code (.safetensors, or a .pth of plain tensors).

    The model rounds voxel indices as the released loader does and computes what the released code
    computes, within float rounding. A pickle is read as tensors only: no code in it runs.
    Raises UserError for a file that is no such checkpoint.
    """
    path = Path(checkpoint)
    state = {our_name(key, path): tensor for key, tensor in _read(path).items()}
    half = _length(state, "image_net.blocks.2.8.weight", path)
    config = ModelConfig(
        dim=2 * half,
        preprocess=Preprocess(image=ImageSettings(), voxels=VoxelGrid(index="round")),
    )
    model = AdaFusion(config, name=path.stem)
    try:
        model.load_state_dict(state)
    except RuntimeError as error:
        raise UserError(f"{path}: not the released network: {error}") from error
    return model.eval()


def our_name(key: str, path: Path) -> str:
    """Translate one key of the released state dict; a data-parallel wrapper's prefix is dropped."""
    key = key.removeprefix("module.")
    if key.startswith("vl_atten_fusion."):
        return key.replace("vl_atten_fusion", "weight_net.head", 1)
    for pattern, ours in _RULES:
        match = re.fullmatch(pattern, key)
        if match:
            sensor, level, rest = match.groups()
            net, attention = _SENSORS[sensor]
            return ours.format(net=net, att=attention, level=int(level or 1) - 1, rest=rest)
    raise UserError(
        f"{path}: key {key!r} is not one of the released AdaFusion network; give the state dict "
        "that its train.py saved (a model file of this package needs no import)"
    )


def _read(path: Path) -> Mapping[str, Tensor]:
    if not path.is_file():
        raise UserError(f"{path}: no such file; give a checkpoint of the released code")
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # the unpickler answers other files with errors of every kind
        raise UserError(
            f"{path}: cannot be read as a checkpoint of plain tensors ({type(error).__name__}); "
            "save model.state_dict() where the checkpoint came from, and give that"
        ) from error
    for key in ("state_dict", "model_state_dict", "model", "net"):
        if isinstance(content, Mapping) and isinstance(content.get(key), Mapping):
            content = content[key]
    if not isinstance(content, Mapping) or not all(
        isinstance(value, Tensor) for value in content.values()
    ):
        raise UserError(f"{path}: holds no state dict of tensors; save model.state_dict()")
    return content


def _length(state: Mapping[str, Tensor], name: str, path: Path) -> int:
    if name not in state:
        raise UserError(f"{path}: {name} is missing; this is not a whole released checkpoint")
    return len(state[name])
