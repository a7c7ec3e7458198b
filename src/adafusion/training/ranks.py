# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Several processes at one training, each describing its part of every batch.

    torchrun --nproc-per-node 2 -m adafusion train ...

They learn what one process would learn from the whole batch. Three things are sent: batch norms
count over all parts, every process computes the loss of all descriptors, and the gradients of the
parts are added up. For the latter the loss must be a function of the gathered description alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, TypeVar

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from adafusion.training.collective import speaking, sum_over_all
from adafusion.training.synced_norms import SYNCED
from adafusion.types import Description, JobFailed, UserError

T = TypeVar("T")

PATIENCE = timedelta(days=1)  # while the first process validates, the others wait for it
HOW = "start them with `torchrun --nproc-per-node N -m adafusion train ...`"


@dataclass(frozen=True)
class Ranks:
    """This process among those of one training. One that is alone sends and changes nothing."""

    rank: int = 0
    count: int = 1
    local: int = 0  # rank among those on this machine: which GPU is its own

    @property
    def is_alone(self) -> bool:
        """Whether one process trains."""
        return self.count == 1

    @property
    def is_first(self) -> bool:
        """Whether this is the process that validates, writes and prints."""
        return self.rank == 0

    def part(self, frames: int) -> slice:
        """The frames of a batch that are described here: parts differ by one frame at most."""
        if frames < self.count:
            raise UserError(
                f"{self.count} processes cannot share a batch of {frames} frames: start fewer, or "
                "put more into a batch (sampling)"
            )
        return slice(frames * self.rank // self.count, frames * (self.rank + 1) // self.count)

    def unite(self, model: nn.Module) -> None:
        """Give all processes the first one's weights, and the batch norms statistics of all parts.

        Norms keep their parameters and the names in the state dict.
        """
        if self.is_alone:
            return
        for value in model.state_dict().values():
            whole = value.contiguous()
            with speaking():
                dist.broadcast(whole, 0)
            value.copy_(whole)
        for module in model.modules():
            if isinstance(module, _BatchNorm):
                module.__class__ = SYNCED[type(module)]  # the same data, another forward

    def gather(self, description: Description, frames: int) -> Description:
        """The description of a whole batch from all its parts, with gradients to the own one."""
        if self.is_alone:
            return description
        part = self.part(frames)
        return Description(
            *(
                None if x is None else _Gather.apply(x, part, frames)  # type: ignore[no-untyped-call]
                for x in description
            )
        )

    def sum_gradients(self, model: nn.Module) -> None:
        """Add the gradients of all parts up, in every process."""
        if self.is_alone:
            return
        gradients = [p.grad for p in model.parameters() if p.grad is not None]
        flat = torch.cat([gradient.reshape(-1) for gradient in gradients])
        sum_over_all(flat)
        for gradient, whole in zip(
            gradients, flat.split([g.numel() for g in gradients]), strict=True
        ):
            gradient.copy_(whole.view_as(gradient))

    def from_first(self, call: Callable[[], T]) -> T:
        """What `call` gives in the first process, which alone makes it; the others wait."""
        if self.is_alone:
            return call()
        box: list[Any] = [call() if self.is_first else None]
        with speaking():
            dist.broadcast_object_list(box, 0)
        return box[0]

    @contextmanager
    def first_ahead(self) -> Iterator[None]:
        """Let the first process go through a block before all others; go on together."""
        if not self.is_first:
            self.wait()
        yield
        if self.is_first:
            self.wait()
        self.wait()

    def wait(self) -> None:
        """Go on when all processes have come here."""
        if not self.is_alone:
            with speaking():
                dist.barrier()


ALONE = Ranks()


@contextmanager
def joined(accelerator: str = "auto") -> Iterator[Ranks]:
    """Join the processes that torchrun started this one among; alone where it started no others.

    They speak through NCCL on GPUs, one each, else through gloo. UserError where the environment
    is not torchrun's or there are fewer GPUs than processes.
    """
    count = _number("WORLD_SIZE", 1)
    if count == 1:
        yield ALONE
        return
    if lost := [
        name
        for name in ("RANK", "LOCAL_RANK", "LOCAL_WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT")
        if name not in os.environ
    ]:
        raise UserError(f"WORLD_SIZE is {count}, but {', '.join(lost)} is not set: {HOW}")
    if not dist.is_available():
        raise UserError("this PyTorch was built without torch.distributed: train in one process")
    ranks = Ranks(_number("RANK"), count, _number("LOCAL_RANK"))
    backend = "gloo"
    if accelerator == "cuda" or (accelerator == "auto" and torch.cuda.is_available()):
        here, gpus = _number("LOCAL_WORLD_SIZE"), torch.cuda.device_count()
        if here > gpus:
            raise UserError(
                f"{here} processes for {gpus} GPU{'s' * (gpus != 1)}: start one a GPU, or give "
                "--accelerator cpu"
            )
        torch.cuda.set_device(ranks.local)
        backend = "nccl" if dist.is_nccl_available() else "gloo"
    try:
        dist.init_process_group(backend, timeout=PATIENCE)
    except (RuntimeError, ValueError) as error:
        raise JobFailed(f"process {ranks.rank} cannot reach the others: {error}") from error
    yield ranks
    dist.destroy_process_group()  # not after an error: it may wait for others that are no more


def _number(name: str, default: int | None = None) -> int:
    value = os.environ.get(name, str(default))
    if not value.isdecimal():
        raise UserError(f"{name}={value!r} is no number of processes: {HOW}")
    return int(value)


class _Gather(torch.autograd.Function):
    """Rows of all processes. As all compute the same loss, each keeps the slope of its own rows."""

    @staticmethod
    def forward(ctx: Any, own: Tensor, part: slice, rows: int) -> Tensor:
        whole = own.new_zeros(rows, *own.shape[1:])
        whole[part] = own
        sum_over_all(whole)  # of zeros and one number each: exact, and parts may differ in length
        ctx.part = part
        return whole

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor, None, None]:
        return slopes[0][ctx.part], None, None
