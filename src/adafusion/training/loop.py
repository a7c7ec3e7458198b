# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The training loop, visible: a generator that yields what each batch did.

    for step in train(config, data, validate, out):
        print(step.batch, step.loss)

Everything random is drawn from the seed and the batch's number, so a training that was killed and
resumed does what the uninterrupted one would have done.
"""

from __future__ import annotations

import copy
import logging
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from adafusion.files import fingerprint
from adafusion.losses import pair_distance
from adafusion.models import (
    AdaFusion,
    PlaceModel,
    build_system,
    describe,
    load_model,
    prepared_batches,
    save_model,
    use_channels_last,
)
from adafusion.models.backbones import add_norms, fold_norms
from adafusion.models.frozen import FrozenSet, FusionOnly, freeze
from adafusion.preprocess.augment import (
    augment_points,
    blank_sensors,
    color_jitter,
    erase_boxes,
    hue_jitter,
    jitter_points,
)
from adafusion.preprocess.cache import PreparedSet
from adafusion.preprocess.image import from_unit, to_unit
from adafusion.training.checkpoint import (
    claim,
    keep_described,
    restore_checkpoint,
    restore_described,
    save_checkpoint,
)
from adafusion.training.objective import batch_loss, most_active
from adafusion.training.pairs import Batch
from adafusion.training.ranks import ALONE, Ranks
from adafusion.training.sampler import Sampler
from adafusion.training.settings import Augment, Loss, Optimiser, TrainConfig
from adafusion.types import JobFailed, UserError

log = logging.getLogger(__name__)

Validate = Callable[[PlaceModel], Mapping[str, float]]
Points = Callable[[int], Float[np.ndarray, "n 3"]]

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
    precision: str = "32-true",
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
    done, passes, best = 0, 0, -math.inf

    def gone() -> int:
        """How much of the length is behind, in batches or in frame passes."""
        return passes if config.counts_passes else done

    def in_all(frames: int) -> int:
        left = max(0, length - gone())
        return done + -(-left // (frames if config.counts_passes else 1))

    if accelerator == "auto":  # an Apple GPU lacks operations on volumes that the network needs
        accelerator = "cuda" if torch.cuda.is_available() else "cpu"
    own = 1 if ranks.is_alone or accelerator == "cpu" else [ranks.local]
    fabric = Fabric(accelerator=accelerator, devices=own, precision=precision)
    model = build_model(config)
    if not resume:
        looked_at = np.random.default_rng((config.seed, 2)).permutation(rows)[:BEGIN_FRAMES]
        generator = torch.Generator().manual_seed(config.seed)
        model.begin(prepared_batches(data, looked_at), generator)
    if config.balance and not resume and isinstance(model, AdaFusion):
        first = sampler.batches(0, BALANCE_BATCHES)
        balance_branches(model, data, first, config.loss, weighted=not config.cache_branches)
    optimizer = _optimizer(config.optimiser, model)
    scheduler = _scheduler(config, optimizer, lambda: (gone(), length))
    network: nn.Module = FusionOnly(model) if config.cache_branches else model
    wrapped, optimizer = fabric.setup(use_channels_last(network), optimizer)
    same = {"data": _data_fingerprint(data, rows), "precision": precision}
    if resume:  # after the setup, which moves the model to its device
        done, passes, best = restore_checkpoint(out, model, optimizer, scheduler, sampler, same)
        use_channels_last(model)
        sampler.described = restore_described(out, done)
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
        if ranks.is_first:
            keep_described(out, done, sampler.described)

    def evaluate() -> tuple[Mapping[str, float], bool]:
        nonlocal best
        values = ranks.from_first(lambda: validate(model.eval()))
        model.train()
        if is_best := values[SELECTED_BY] > best:
            best = values[SELECTED_BY]
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
                    "batches": done,
                    "frame_passes": passes,
                    "mining_passes": len(rows) * (0 if mining is None else mining.times(done)),
                    "validation": dict(values),
                },
            )
        return values, is_best

    if done == 0:
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
            best=best,
        )
    if mining is not None and done == 0 and mining.is_due(0):
        mine()
    batches = sampler.batches(first=done)
    while gone() < length:
        start, before = time.perf_counter(), gone()
        batch = next(batches)
        key, part = (config.seed, done), ranks.part(len(batch.rows))
        inputs: tuple[Tensor | None, ...]
        if frozen is None:
            inputs = _inputs(model, data, batch, config.augment, points, key, part)
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
                f"{out}: the loss of batch {done + 1} is {value}; train into another folder with a "
                "lower optimiser.learning_rate"
            )
        learning_rate = optimizer.param_groups[0]["lr"]
        optimizer.step()
        done, passes = done + 1, passes + len(batch.rows)
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
        if mining is not None and mining.is_due(done) and not is_over:
            mine()
        if ranks.is_first and (done % config.checkpoint_every == 0 or validation is not None):
            counts = (done, passes, best)
            save_checkpoint(out, model, optimizer, scheduler, sampler, *counts, same)
        yield Step(
            batch=done,
            batches=in_all(len(batch.rows)),
            loss=value,
            active=active,
            frames=len(batch.rows),
            seconds=seconds,
            learning_rate=learning_rate,
            waited=waited,
            validation=validation,
            is_best=is_best,
            best=best,
        )


def build_model(config: TrainConfig) -> PlaceModel:
    """Build the network that a training starts from, as a function of the configuration alone."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        model = build_system(config.model)
    if config.initialisation == "he":
        model.initialise(torch.Generator().manual_seed(config.seed))
    if config.imagenet is not None:
        model.load_imagenet(config.imagenet)
    for file in config.init:
        take_branches(model, load_model(file), with_weights=config.take_weights)
    if config.norms:
        for net in model.backbones:
            add_norms(net)
    if config.stage == "weights" and isinstance(model, AdaFusion):
        model.freeze_backbones()
    return model


def untrained_twin(model: PlaceModel, seed: int = 0) -> PlaceModel:
    """The network that a training of this model would start from: what training has to beat."""
    twin = build_model(TrainConfig(model=model.config, norms=False, seed=seed)).eval()
    twin.name = f"{model.name}, untrained"
    return twin


def take_branches(model: PlaceModel, source: PlaceModel, *, with_weights: bool = False) -> None:
    """Copy the branches that `source` has into `model`; its weight branch only where asked to."""
    for name in ("image_net", "voxel_net", *(["weight_net"] if with_weights else [])):
        ours, theirs = getattr(model, name, None), getattr(source, name, None)
        if ours is None or theirs is None:
            continue
        try:
            ours.load_state_dict(theirs.state_dict())
        except RuntimeError as error:
            raise UserError(
                f"the {name} of {source.name} is of another size than this training's: {error}"
            ) from error


def folded(model: PlaceModel) -> PlaceModel:
    """Copy a network in training as the paper's network that it computes in eval mode."""
    model = copy.deepcopy(model).eval()
    for net in model.backbones:
        fold_norms(net)
    return model


@torch.inference_mode()
def balance_branches(
    model: AdaFusion,
    data: PreparedSet,
    batches: Iterable[Batch],
    loss: Loss,
    *,
    weighted: bool = True,
) -> None:
    """Scale each branch so that the distances of its half lie around the margin.

    A branch trained by a cosine has no scale, and one trained alone has its own; joined as they
    are, the longer half would drown the other and the margin would first have to undo that. The
    middle between true and wrong pairs' mean L1 distance comes to lie at the margin for a half,
    divided by the weight that the model gives the half now (about 0.5 before the weights learn).
    Scaling the last batch norm scales the feature, and with it the deepest stage that the weight
    branch reads, which has not learnt anything yet. Without `weighted` that division is left out,
    and branches come out the same whatever is to fuse them.
    """
    model.eval()
    scaled = copy.copy(model)  # the same layers, whose halves keep the scale that is measured
    scaled.config = replace(model.config, normalise_halves=False)
    described = [
        (scaled(*_inputs(model, data, batch, Augment(color=0.0), None, (0, 0))), batch)
        for batch in batches
    ]
    for i, (part, net) in enumerate(
        (("image_half", model.image_net), ("lidar_half", model.voxel_net))
    ):
        if net is None:
            continue
        middles, weights = [], []
        for description, batch in described:
            half = getattr(description, part)
            distance = pair_distance(half, torch.from_numpy(batch.pair).to(half.device))
            is_positive = torch.from_numpy(batch.is_positive).to(half.device)
            middles.append(0.5 * (distance[is_positive].mean() + distance[~is_positive].mean()))
            alpha = description.alpha if weighted else None
            weights.append(1.0 if alpha is None else alpha[:, i].mean())
        margin, _ = loss.margins(model.config.dim // 2)
        factor = margin / float(sum(middles) / len(middles)) / float(sum(weights) / len(weights))
        net.scale(factor)
        log.info("%s scaled by %.3f to the margin", part, factor)


def _inputs(
    model: PlaceModel,
    data: PreparedSet,
    batch: Batch,
    augment: Augment,
    points: Points | None,
    key: tuple[int, int],
    part: slice = slice(None),
) -> tuple[Tensor | None, Tensor | None]:
    """The augmented tensors of a batch, only those that the system looks at.

    Those of a `part` are what they would be among the whole batch.
    """
    rows, among = batch.rows[part], (len(batch.rows), part)
    image = lidar = None
    if "image" in model.sensors:
        image = to_unit(data.images_u8(rows))
        if c := augment.color:
            generator = _generator(*key)
            image = color_jitter(
                image, generator, brightness=c, contrast=c, saturation=c, among=among
            )
        if augment.hue:
            image = hue_jitter(image, _generator(*key, 3), augment.hue, among)
        if augment.erase:
            image = erase_boxes(image, _generator(*key, 4), augment.erase, among)
    if "lidar" in model.sensors:
        if points is not None and augment.jitter_m:
            rng = np.random.default_rng(key)
            clouds = (points(int(row)) for row in batch.rows)
            lidar = torch.stack(
                [
                    data.settings.lidar_tensor(
                        jitter_points(cloud, rng, augment.jitter_m, augment.jitter_clip_m)
                    )
                    for cloud in clouds
                ][part]
            )
        else:
            lidar = data.lidar(rows)
        if augment.points and data.settings.lidar == "points":
            lidar = augment_points(lidar, _generator(*key, 2), among)
        if lidar.ndim == 5:
            lidar = lidar.contiguous(memory_format=torch.channels_last_3d)
    if image is not None and lidar is not None and augment.blank:
        blank_sensors(image, lidar, augment.blank, np.random.default_rng((*key, 1)), among)
    if image is not None:
        image = from_unit(image, data.settings.image)
        image = image.contiguous(memory_format=torch.channels_last)
    return image, lidar


def _generator(*key: int) -> torch.Generator:
    return torch.Generator().manual_seed(int(np.random.SeedSequence(key).generate_state(1)[0]))


def _data_fingerprint(data: PreparedSet, rows: Int[np.ndarray, " n"]) -> str:
    """Identity of the frames trained on, in their order."""
    return fingerprint(*(part.folder.name for part in data.parts), rows.tobytes())


def _optimizer(settings: Optimiser, model: PlaceModel) -> torch.optim.Optimizer:
    """What moves the parameters that may move; image network and weight branch at their rates."""
    image, rest, weights = [], [], []  # an optimiser's state is kept in this order
    for name, p in model.named_parameters():
        if not p.requires_grad:
            continue
        if settings.image_share != 1.0 and name.startswith("image_net."):
            image.append(p)
        elif settings.weights_share != 1.0 and name.startswith("weight_net."):
            weights.append(p)
        else:
            rest.append(p)
    rate = settings.learning_rate
    groups: list[dict[str, Any]] = [
        {"params": image, "lr": settings.image_share * rate},
        {"params": rest, "lr": rate},
        {"params": weights, "lr": settings.weights_share * rate},
    ]
    groups = [group for group in groups if group["params"]]
    decay = settings.weight_decay
    if settings.kind == "sgd":
        return torch.optim.SGD(groups, momentum=settings.momentum, weight_decay=decay)
    return torch.optim.Adam(groups, weight_decay=decay, amsgrad=settings.amsgrad)


def _scheduler(
    config: TrainConfig,
    optimizer: torch.optim.Optimizer,
    progress: Callable[[], tuple[int, int]],
) -> Any:
    """What lets the rate fall; `progress` says how much of the training is behind, and of what."""
    o = config.optimiser
    if o.schedule == "plateau":
        return torch.optim.lr_scheduler.ReduceLROnPlateau(
            optimizer, mode="max", factor=o.factor, patience=o.patience
        )

    def share(batch: int) -> float:
        gone, length = progress()
        if o.schedule == "step":
            falls = sum(gone >= at * length for at in o.milestones)
            return max(o.floor, o.factor ** (falls if o.milestones else gone * o.steps // length))
        rise = min(1.0, (batch + 1) / max(1, o.warmup))
        return rise * 0.5 * (1.0 + math.cos(math.pi * min(1.0, gone / length)))

    return torch.optim.lr_scheduler.LambdaLR(optimizer, share)
