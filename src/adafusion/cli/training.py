# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The command that trains."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from adafusion.cli.common import Cache, bar, cache_folder, check_unit, named_config, open_data, say

if TYPE_CHECKING:
    from adafusion.training import Step

Accelerator = Literal["auto", "cpu", "cuda"]
DONE = "done"  # a phase of a staged training that ran to its end


def train(
    out: Annotated[
        Path, typer.Argument(help="Folder for checkpoints, logs and model.safetensors.")
    ],
    datasets: Annotated[
        list[Path],
        typer.Argument(help="What teaches: datasets, or world-v1-small/train."),
    ],
    model: Annotated[
        str | None,
        typer.Option(
            help="A configuration that comes with the package, by name (above). Without it and "
            "without --config: AdaFusion at full size, for a GPU."
        ),
    ] = None,
    config: Annotated[Path | None, typer.Option(help="YAML; see `adafusion config show`.")] = None,
    change: Annotated[
        list[str] | None, typer.Option("--set", help="Change a key: --set loss.margin=12.5")
    ] = None,
    validation: Annotated[
        list[Path] | None,
        typer.Option(
            help="Dataset to choose by: its validation region, or all of it where it names no "
            "regions. Default: the validation region of DATASETS."
        ),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where OUT stopped.")] = False,
    cache: Cache = None,
    accelerator: Annotated[
        Accelerator, typer.Option(help="auto: an NVIDIA GPU where there is one, else the CPU.")
    ] = "auto",
) -> None:
    """Train a model on prepared or simulated datasets.

    Writes OUT/model.safetensors (the best on validation, never on test), OUT/train.yaml (the
    effective configuration), checkpoints, and a TensorBoard log. After a kill, the same command
    with --resume goes on as if nothing had happened.

    --model takes small (adafusion, staged, for two cores), paper, and each compared system at the
    size of its paper or, with -s, for two cores: netvlad-s, pointnetvlad-s, minkloc-s, coral-s,
    pic-net-s, oertel-s. adafusion-lite-s is small with an image branch from ImageNet. Single steps
    of small are image-s-coarse, image-s and lidar-s, one branch each, and adafusion-s, concat-s and
    adafusion-normalised-s (halves of one length), which join branches named in init. paper-oxford
    is paper for the benchmark's submaps.

    Where torchrun starts several processes they share every batch, each on a GPU of its own or all
    on a CPU, and learn what one process would. --set precision=bf16-mixed takes about half the
    time on a CPU that knows the format.

    \b
    Example: adafusion train runs/mine world-v1-small/train --model small
    Example: adafusion train runs/minkloc world-v1-small/train --model minkloc-s --set seed=1
    Example: adafusion train runs/mine data/world-1 data/world-2 --config configs/small.yaml
    Example: adafusion train runs/paper data/nclt --config configs/paper.yaml --accelerator cuda
    Example: torchrun --nproc-per-node 4 -m adafusion train runs/four data/nclt --model paper
    """
    from adafusion.config import load_config, save_config
    from adafusion.evaluation import validation_recall
    from adafusion.provenance import git_commit, software_versions
    from adafusion.training import TrainConfig, phases
    from adafusion.training import train as run
    from adafusion.training.checkpoint import STATE_FILE, require_config
    from adafusion.training.corpus import Corpus, with_camera
    from adafusion.training.loop import MODEL_FILE
    from adafusion.training.ranks import joined
    from adafusion.types import UserError

    if model is not None and config is not None:
        raise UserError("give --model or --config: each is a whole configuration")
    file = config if model is None else named_config(model)
    settings = load_config(TrainConfig, file, change or [])
    with joined(accelerator) as ranks:
        with ranks.first_ahead():  # which renders and prepares what the others then find
            asked = out / "asked.yaml"  # train.yaml holds one phase each
            if asked.exists() and not resume:
                raise UserError(
                    f"{out} holds a training: give --resume to go on, or another folder"
                )
            folder = cache_folder(cache)
            taught = Corpus(tuple(open_data(path, folder) for path in datasets))
            settings = with_camera(settings, taught.datasets)
            for dataset in taught.datasets:
                check_unit(dataset, settings.model, "this configuration")
            if asked.exists():
                require_config(asked, settings)
            data = taught.prepare(settings.model.preprocess, folder, bar)
            sensors = settings.model.sensors
            rows = taught.rows("train", sensors)
            if validation:
                judges = Corpus(tuple(open_data(path, folder) for path in validation))
                named = any(dataset.info.regions for dataset in judges.datasets)
                region = "validation" if named else None  # never a test region
                judge_rows = judges.rows(region, sensors)
            else:
                judges, judge_rows = taught, taught.rows("validation", sensors)
            judging = (
                data if judges is taught else judges.prepare(settings.model.preprocess, folder, bar)
            )
        if ranks.is_first:
            size = f"width {settings.model.width:g}"
            if "image" in sensors:
                size += ", images {} x {}".format(*settings.model.preprocess.image.size)
            say(
                f"training {settings.model.system} ({size}) on {len(rows)} frames, choosing on "
                f"{len(judge_rows)}"
            )
            save_config(settings, asked)
        card = {
            "data": taught.facts(),
            "validation_data": judges.facts(),
            "commit": git_commit(),
            "versions": software_versions(),
        }
        for phase in phases(settings, out):
            if resume and (phase.out / DONE).exists():
                if ranks.is_first:
                    say(f"{phase.name}: done already")
                continue
            steps = run(
                phase.config,
                data,
                rows,
                validation_recall(judging, judge_rows),
                phase.out,
                points=taught.points if phase.config.augment.jitter_m else None,
                resume=resume and (phase.out / STATE_FILE).exists(),
                card=card,
                cache=folder,
                accelerator=accelerator,
                ranks=ranks,
            )
            if not ranks.is_first:
                deque(steps, maxlen=0)  # the first process tells of them
                continue
            best = _watch(phase.name, steps, phase.out)
            (phase.out / DONE).touch()
            print(f"{phase.out / MODEL_FILE}: validation recall@1 {best:.1%}")


def _watch(name: str, steps: Iterable[Step], out: Path) -> float:
    """Draw the bar, write the TensorBoard log; give the best validation recall@1."""
    from torch.utils.tensorboard import SummaryWriter
    from tqdm import tqdm

    best = 0.0
    seen: dict[str, str] = {}
    passes, seconds = 0, 0.0
    with (
        SummaryWriter(out / "log") as log,
        tqdm(desc=name, unit="batch", dynamic_ncols=True) as shown,
    ):
        shown.set_postfix_str("validating before the first batch")  # which may take a minute
        for step in steps:
            if shown.total is None:
                shown.total, shown.initial, shown.n = step.batches, step.batch, step.batch
            shown.total = step.batches  # fewer where batches grow
            best = step.best
            shown.update(step.batch - shown.n)
            passes, seconds = passes + step.frames, seconds + step.seconds
            if step.batch:
                log.add_scalar("loss", step.loss, step.batch)
                log.add_scalar("active_pairs", step.active, step.batch)
                log.add_scalar("learning_rate", step.learning_rate, step.batch)
                seen |= {"loss": f"{step.loss:.3f}", "active": f"{step.active:.0%}"}
                seen |= {"frames/s": f"{passes / max(seconds, 1e-9):.0f}"}
            if step.validation is not None:
                for key, value in step.validation.items():
                    log.add_scalar(f"validation/{key}", value, step.batch)
                seen["recall@1"] = f"{step.validation['recall@1']:.1%}"
                tqdm.write(f"{name} batch {step.batch}: " + _in_words(step.validation))
            shown.set_postfix(seen, refresh=False)
    return best


def _in_words(values: Mapping[str, float]) -> str:
    return ", ".join(f"{key} {value:.3f}" for key, value in values.items())
