# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The training loop, visible: a generator that yields what each batch did.

    for step in train(config, data, rows, validate, out):
        print(step.batch, step.loss)

Everything random is drawn from the seed and the batch's number, so a training that was killed and
resumed does what the uninterrupted one would have done.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor, nn

from adafusion.files import fingerprint
from adafusion.models import (
    AdaFusion,
    PlaceModel,
    describe,
    load_model,
    prepared_batches,
    save_model,
    use_channels_last,
)
from adafusion.models.frozen import FrozenSet, FusionOnly, freeze
from adafusion.preprocess.cache import PreparedSet
from adafusion.training.checkpoint import (
    Standing,
    claim,
    keep_described,
    restore_checkpoint,
    restore_described,
    save_checkpoint,
)
from adafusion.training.inputs import Points, batch_inputs
from adafusion.training.objective import batch_loss, most_active
from adafusion.training.optimiser import build_optimizer, build_scheduler
from adafusion.training.ranks import ALONE, Ranks
from adafusion.training.sampler import Sampler
from adafusion.training.settings import TrainConfig
from adafusion.training.start import balance_branches, build_model, folded
from adafusion.types import JobFailed

log = logging.getLogger(__name__)

Validate = Callable[[PlaceModel], Mapping[str, float]]

MODEL_FILE = "model.safetensors"  # the best on validation or the last, ready to use
SELECTED_BY = "recall@1"
BALANCE_BATCHES = 4
MINING_BATCH = 32
BEGIN_FRAMES = 500  # that a system may look at before it learns


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """What one batch did. `validation` is None but after an evaluation."""

    batch: int  # batches done
    batches: int  # in all; where a training counts passes, if batches stay as large as this one
    loss: float
    active: float  # share of pairs that have not met the margin
    frames: int  # frame passes in this batch
    seconds: float
    learning_rate: float
    waited: float = 0.0  # seconds of these until the batch was read and augmented
    validation: Mapping[str, float] | None = None
    is_best: bool = False
    best: float = -math.inf  # recall@1 on validation of the model kept so far


def train(
    config: TrainConfig,
    data: PreparedSet,
    rows: Int[np.ndarray, " n"],
    validate: Validate,
    out: str | Path,
    *,
    points: Points | None = None,
    resume: bool = False,
    card: Mapping[str, Any] | None = None,
    cache: str | Path | None = None,
    accelerator: str = "auto",
    ranks: Ranks = ALONE,
) -> Iterator[Step]:
    """Train one phase on `rows` of `data`, yielding a `Step` after each batch.

    `validate` maps a model in eval mode to numbers; its "recall@1" chooses the checkpoint kept as
    `out/model.safetensors` and drives the plateau. `points` gives a row's raw cloud and is needed
    for jitter alone. `resume` goes on from `out/state.pt`. Of several processes (`ranks`) that see
    the same `out`, each describes a part of every batch; the first validates, mines and writes.
    `cache` is the folder for the outputs of frozen branches, where the configuration keeps them.

    Raises UserError for a folder that holds another training, JobFailed when the loss is no number.
    """
    try:
        from lightning.fabric import Fabric
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "training needs lightning: pip install 'adafusion[train]'"
        ) from error

    if config.augment.jitter_m and points is None:
        raise ValueError("augment.jitter_m moves raw points: give `points`")
    if config.cache_branches and cache is None:
        raise ValueError("cache_branches keeps outputs on disk: give `cache`")
    out = Path(out)
    if ranks.is_first:
        claim(out, config, resume)
    ranks.wait()  # also for what the first one wrote of a phase before
    sampler = Sampler(config.sampling, data, rows, config.seed)
    length = config.batches or config.passes or config.epochs * sampler.batches_per_epoch
    at, began = Standing(), time.perf_counter()

    def gone() -> int:
        """How much of the length is behind, in batches or in frame passes."""
        return at.passes if config.counts_passes else at.batches

    def in_all(frames: int) -> int:
        left = max(0, length - gone())
        return at.batches + -(-left // (frames if config.counts_passes else 1))

    if accelerator == "auto":  # an Apple GPU lacks operations on volumes that the network needs
        accelerator = "cuda" if torch.cuda.is_available() else "cpu"
    own = 1 if ranks.is_alone or accelerator == "cpu" else [ranks.local]
    fabric = Fabric(accelerator=accelerator, devices=own, precision=config.precision)
    model = build_model(config)
    if not resume:
        looked_at = np.random.default_rng((config.seed, 2)).permutation(rows)[:BEGIN_FRAMES]
        generator = torch.Generator().manual_seed(config.seed)
        model.begin(prepared_batches(data, looked_at), generator)
    if config.balance and not resume and isinstance(model, AdaFusion):
        first = sampler.batches(0, BALANCE_BATCHES)
        balance_branches(model, data, first, config.loss, weighted=not config.cache_branches)
    optimizer = build_optimizer(config.optimiser, model)
    scheduler = build_scheduler(config, optimizer, lambda: (gone(), length))
    network: nn.Module = FusionOnly(model) if config.cache_branches else model
    wrapped, optimizer = fabric.setup(use_channels_last(network), optimizer)
    same = {"data": _data_fingerprint(data, rows)}  # `claim` has compared the configuration
    if resume:  # after the setup, which moves the model to its device
        at = restore_checkpoint(out, model, optimizer, scheduler, sampler, same)
        began -= at.seconds
        use_channels_last(model)
        sampler.described = restore_described(out, at.batches)
    ranks.unite(model)
    frozen: FrozenSet | None = None
    if config.cache_branches and cache is not None:  # the branches are now what they will stay
        with ranks.first_ahead():  # which writes what the others then find
            frozen = freeze(model, data, cache)
    mining = config.sampling.mining
    model.train()

    def mine() -> None:
        """Describe all rows as the network is now, for the sampler to choose by."""
        sampler.described = ranks.from_first(
            lambda: describe(model, prepared_batches(data, rows, MINING_BATCH)).fused
        )
        assert sampler.described is not None
        at.mining_passes += len(rows)
        if ranks.is_first:
            keep_described(out, at.batches, sampler.described)

    def evaluate() -> tuple[Mapping[str, float], bool]:
        found = ranks.from_first(lambda: validate(model.eval()))
        values = {name: float(value) for name, value in found.items()}  # as a checkpoint can hold
        model.train()
        if is_best := values[SELECTED_BY] > at.best:
            at.best = values[SELECTED_BY]
        at.seconds = time.perf_counter() - began
        here = {"batch": at.batches, "frame_passes": at.passes, "seconds": round(at.seconds, 1)}
        at.curve.append({**here, **values})
        if ranks.is_first and (is_best or config.keep == "last"):
            save_model(
                folded(model),
                out / MODEL_FILE,
                {
                    **(card or {}),
                    "seed": config.seed,
                    "frames": len(rows),
                    "init": [
                        {"file": f, "fingerprint": load_model(f).fingerprint} for f in config.init
                    ],
                    "batches": at.batches,
                    "frame_passes": at.passes,
                    "mining_passes": at.mining_passes,
                    "validation": dict(values),
                },
            )
        return values, is_best

    if at.batches == 0:
        values, is_best = evaluate()  # the untrained twin: what training has to beat
        yield Step(
            batch=0,
            batches=in_all(sampler.course.frames),
            loss=math.nan,
            active=math.nan,
            frames=0,
            seconds=0.0,
            learning_rate=optimizer.param_groups[0]["lr"],
            validation=values,
            is_best=is_best,
            best=at.best,
        )
    if mining is not None and at.batches == 0 and mining.is_due(0):
        mine()
    batches = sampler.batches(first=at.batches)
    while gone() < length:
        start, before = time.perf_counter(), gone()
        batch = next(batches)
        key, part = (config.seed, at.batches), ranks.part(len(batch.rows))
        inputs: tuple[Tensor | None, ...]
        if frozen is None:
            inputs = batch_inputs(model, data, batch, config.augment, points, key, part)
        else:
            inputs = frozen.tensors(batch.rows[part])
        waited = time.perf_counter() - start
        description = wrapped(*fabric.to_device(inputs))
        description = ranks.gather(description, len(batch.rows))
        loss, active = batch_loss(description, batch, config.loss)
        optimizer.zero_grad(set_to_none=True)
        fabric.backward(loss)
        ranks.sum_gradients(model)
        value = loss.item()
        if not math.isfinite(value):
            raise JobFailed(
                f"{out}: the loss of batch {at.batches + 1} is {value}; train into another folder "
                "with a lower optimiser.learning_rate"
            )
        learning_rate = optimizer.param_groups[0]["lr"]
        optimizer.step()
        at.batches, at.passes = at.batches + 1, at.passes + len(batch.rows)
        if config.optimiser.schedule != "plateau":
            scheduler.step()
        if config.sampling.growth is not None:
            sampler.tell(most_active(description, batch, config.loss))
        seconds = time.perf_counter() - start

        validation: Mapping[str, float] | None = None
        is_best = False
        is_over = gone() >= length
        if gone() // config.evaluate_every > before // config.evaluate_every or is_over:
            validation, is_best = evaluate()
            if config.optimiser.schedule == "plateau":
                scheduler.step(validation[SELECTED_BY])
        if mining is not None and mining.is_due(at.batches) and not is_over:
            mine()
        is_due = at.batches % config.checkpoint_every == 0 or validation is not None
        if ranks.is_first and is_due:
            at.seconds = time.perf_counter() - began
            save_checkpoint(out, model, optimizer, scheduler, sampler, at, same)
        yield Step(
            batch=at.batches,
            batches=in_all(len(batch.rows)),
            loss=value,
            active=active,
            frames=len(batch.rows),
            seconds=seconds,
            learning_rate=learning_rate,
            waited=waited,
            validation=validation,
            is_best=is_best,
            best=at.best,
        )


def _data_fingerprint(data: PreparedSet, rows: Int[np.ndarray, " n"]) -> str:
    """Identity of the frames trained on, in their order."""
    return fingerprint(*(part.folder.name for part in data.parts), rows.tobytes())
