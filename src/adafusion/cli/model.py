# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Commands about models and configurations."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from adafusion.cli.common import packaged_configs

config_app = typer.Typer(
    help="Configurations: what every key is and what it is set to.", no_args_is_help=True
)


def import_released(
    checkpoint: Annotated[Path, typer.Argument(help=".pth or .safetensors of the released code.")],
    out: Annotated[Path, typer.Argument(help="The model file to write (.safetensors).")],
) -> None:
    """Convert a checkpoint of the authors' released AdaFusion code into a model file.

    The result computes what the released code computes. It rounds voxel indices as that code does,
    and says so in its header. No code inside the checkpoint is run.

    \b
    Example: adafusion import-released adafusion_nclt.pth models/adafusion-nclt.safetensors
    """
    from adafusion.models import import_released as convert
    from adafusion.models import load_model, save_model

    model = convert(checkpoint)
    save_model(model, out, card={"source": f"released code's checkpoint {checkpoint.name}"})
    parameters = sum(p.numel() for p in model.parameters())
    print(f"{out}: {parameters:,} parameters, fingerprint {load_model(out).fingerprint}")


@config_app.command("show")
def show(
    what: Annotated[
        str,
        typer.Argument(
            help="train, model, preprocess, a training that comes with the package (lidar-s), or a "
            "preset of the world: day, night."
        ),
    ] = "train",
    overrides: Annotated[
        list[str] | None, typer.Argument(help="Changes, as loss.margin=12.5.")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="A YAML file to begin with.")] = None,
) -> None:
    """Print a configuration with every key, ready to be edited and given back.

    \b
    Example: adafusion config show train --config configs/paper.yaml seed=3 > mine.yaml
    Example: adafusion config show netvlad-s sampling.tuples=2 > mine.yaml
    Example: adafusion config show night fog_per_m=0.02
    """
    from adafusion.config import change_config, dump_config, load_config
    from adafusion.models import ModelConfig
    from adafusion.preprocess import Preprocess
    from adafusion.sim.run.conditions import PRESETS
    from adafusion.training import TrainConfig
    from adafusion.types import UserError

    if what in PRESETS:
        if config is not None:
            raise UserError(f"--config {config}: a preset has no file; change single factors")
        print(dump_config(change_config(PRESETS[what], overrides or [])), end="")
        return
    kinds: dict[str, type] = {"train": TrainConfig, "model": ModelConfig, "preprocess": Preprocess}
    trainings = packaged_configs()
    if what in trainings and config is None:
        what, config = "train", trainings[what]
    if what not in kinds:
        choices = ", ".join([*kinds, *trainings, *PRESETS])
        raise UserError(f"unknown configuration {what!r}: choose from {choices}")
    print(dump_config(load_config(kinds[what], config, overrides or [])), end="")
