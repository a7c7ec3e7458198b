# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The command that trains."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from adafusion.cli.common import bar, cache_folder, say

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float, Int

    from adafusion.datasets import Dataset
    from adafusion.models import AdaFusion
    from adafusion.preprocess import Preprocess
    from adafusion.preprocess.cache import PreparedSet
    from adafusion.training import Step

DONE = "done"  # a phase of a staged training that ran to its end


def train(
    out: Annotated[
        Path, typer.Argument(help="Folder for checkpoints, logs and model.safetensors.")
    ],
    datasets: Annotated[list[Path], typer.Argument(help="Datasets whose training region teaches.")],
    config: Annotated[Path | None, typer.Option(help="YAML; see `adafusion config show`.")] = None,
    change: Annotated[
        list[str] | None, typer.Option("--set", help="Change a key: --set loss.margin=12.5")
    ] = None,
    validation: Annotated[
        list[Path] | None,
        typer.Option(help="Dataset to choose by; default: the validation region of DATASETS."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where OUT stopped.")] = False,
    cache: Annotated[Path | None, typer.Option(help="Folder of preprocessed frames.")] = None,
    accelerator: Annotated[str, typer.Option(help="auto, cpu, gpu or mps.")] = "auto",
    precision: Annotated[str, typer.Option(help="32-true, bf16-mixed or 16-mixed.")] = "32-true",
) -> None:
    """Train a model on prepared or simulated datasets.

    Writes OUT/model.safetensors (the best on validation, never on test), OUT/train.yaml (the
    effective configuration), checkpoints, and a TensorBoard log. After a kill, the same command
    with --resume goes on as if nothing had happened.

    \b
    Example: adafusion train runs/mine data/world-1 data/world-2 --config configs/small.yaml
    Example: adafusion train runs/paper data/nclt --config configs/paper.yaml --accelerator gpu
    """
    from adafusion.config import load_config
    from adafusion.provenance import git_commit, software_versions
    from adafusion.training import TrainConfig, phases
    from adafusion.training import train as run
    from adafusion.training.loop import MODEL_FILE, STATE_FILE

    settings = load_config(TrainConfig, config, change or [])
    folder = cache_folder(cache)
    taught = Corpus.prepare(datasets, settings.model.preprocess, folder)
    rows = taught.rows("train")
    if validation:
        judges = Corpus.prepare(validation, settings.model.preprocess, folder)
        judge_rows = judges.rows(None)
    else:
        judges, judge_rows = taught, taught.rows("validation")
    say(f"training on {len(rows)} frames, choosing on {len(judge_rows)}")
    card = {
        "data": taught.facts(),
        "validation_data": judges.facts(),
        "commit": git_commit(),
        "versions": software_versions(),
    }
    for phase in phases(settings, out):
        if resume and (phase.out / DONE).exists():
            say(f"{phase.name}: done already")
            continue
        steps = run(
            phase.config,
            taught.data,
            rows,
            validation_recall(judges.data, judge_rows),
            phase.out,
            points=taught.points if phase.config.augment.jitter_m else None,
            resume=resume and (phase.out / STATE_FILE).exists(),
            card=card,
            accelerator=accelerator,
            precision=precision,
        )
        best = _watch(phase.name, steps, phase.out)
        (phase.out / DONE).touch()
        print(f"{phase.out / MODEL_FILE}: validation recall@1 {best:.1%}")


@dataclass(frozen=True)
class Corpus:
    """Opened datasets and their preprocessed frames, row by row."""

    datasets: tuple[Dataset, ...]
    data: PreparedSet

    @classmethod
    def prepare(cls, paths: Sequence[Path], settings: Preprocess, cache: Path) -> Corpus:
        """Open the datasets and preprocess what the cache does not hold yet."""
        from adafusion.datasets import open_dataset
        from adafusion.preprocess.cache import PreparedSet, prepare_cache

        datasets = tuple(open_dataset(path) for path in paths)
        prepared = (prepare_cache(ds, settings, cache, progress=bar) for ds in datasets)
        return cls(datasets, PreparedSet(tuple(prepared)))

    def rows(self, region: str | None) -> Int[np.ndarray, " n"]:
        """Rows in the region that have both sensors; None: anywhere."""
        import numpy as np

        from adafusion.datasets.splits import region_of
        from adafusion.types import UserError

        keep = self.data.has_image & self.data.has_cloud
        if region is not None:
            names = [region_of(ds.positions_m[:, :2], ds.info.regions) for ds in self.datasets]
            keep = keep & (np.concatenate(names) == region)
        if not keep.any():
            raise UserError(
                f"{', '.join(str(ds.root) for ds in self.datasets)}: no frame with both sensors "
                f"in the {region or 'whole'} region: set `regions` in dataset.yaml, or choose by "
                "another dataset with --validation"
            )
        return np.flatnonzero(keep)

    def points(self, row: int) -> Float[np.ndarray, "n 3"]:
        """The raw cloud of a row, for jitter."""
        cloud = self.datasets[int(self.data.worlds[row])].load(self.data.frames[row]).points_body
        assert cloud is not None  # `rows` gives only rows that have one
        return cloud

    def facts(self) -> list[dict[str, object]]:
        """What a model card says of the data."""
        return [
            {
                "name": dataset.info.name,
                "version": dataset.info.version,
                "fingerprint": dataset.fingerprint,
                "synthetic": dataset.info.synthetic,
            }
            for dataset in self.datasets
        ]


def validation_recall(
    data: PreparedSet, rows: np.ndarray
) -> Callable[[AdaFusion], dict[str, float]]:
    """Make the function that judges a model: cross-run recall@1, fused and of each half."""
    import numpy as np

    from adafusion.evaluation import evaluate_splits, make_splits
    from adafusion.models import describe, prepared_batches

    frames = [data.frames[row] for row in rows]
    worlds = data.worlds[rows]
    splits_of = {}
    for world in np.unique(worlds):
        here = np.flatnonzero(worlds == world)
        region = np.full(len(here), "validation")
        splits_of[int(world)] = (
            here,
            make_splits("cross-run", [frames[i] for i in here], region, region="validation"),
        )
    positions = data.positions[rows]

    def recall(descriptors: np.ndarray) -> float:
        values = [
            evaluate_splits(descriptors[here], positions[here], splits, ks=[1]).recall["AR@1"]
            for here, splits in splits_of.values()
        ]
        return float(np.mean(values))

    def validate(model: AdaFusion) -> dict[str, float]:
        d = describe(model, prepared_batches(data, rows, batch_size=32))
        assert d.fused is not None
        values = {"recall@1": recall(d.fused)}
        if d.image_half is not None and d.lidar_half is not None:
            values["image_recall@1"] = recall(d.image_half)
            values["lidar_recall@1"] = recall(d.lidar_half)
        if d.alpha is not None:
            for i, sensor in enumerate(("image", "lidar")):
                values[f"alpha_{sensor}_mean"] = float(d.alpha[:, i].mean())
                values[f"alpha_{sensor}_std"] = float(d.alpha[:, i].std())
        return values

    return validate


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
        for step in steps:
            shown.total = step.batches
            shown.update(step.batch - shown.n)
            passes, seconds = passes + step.frames, seconds + step.seconds
            if step.batch:
                log.add_scalar("loss", step.loss, step.batch)
                log.add_scalar("active_pairs", step.active, step.batch)
                log.add_scalar("learning_rate", step.learning_rate, step.batch)
                seen |= {"loss": f"{step.loss:.3f}", "active": f"{step.active:.0%}"}
                seen |= {"frames/s": f"{passes / max(seconds, 1e-9):.0f}"}
            if step.validation is not None:
                best = max(best, step.validation["recall@1"])
                for key, value in step.validation.items():
                    log.add_scalar(f"validation/{key}", value, step.batch)
                seen["recall@1"] = f"{step.validation['recall@1']:.1%}"
                tqdm.write(f"{name} batch {step.batch}: " + _in_words(step.validation))
            shown.set_postfix(seen, refresh=False)
    return best


def _in_words(values: Mapping[str, float]) -> str:
    return ", ".join(f"{key} {value:.3f}" for key, value in values.items())
