# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Batch norms that count over the parts of all processes.

The framework's own need a GPU; these are made of sums, which every backend has.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.distributed as dist
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from adafusion.training.collective import sum_over_all


class _Normalise(torch.autograd.Function):
    """Batch norm (Ioffe and Szegedy, 2015) by the mean and variance of all processes' values.

    Also gives that mean, the variance as running statistics take it (divided by n - 1) and no
    gradient to them.
    """

    @staticmethod
    def forward(
        ctx: Any, x: Tensor, weight: Tensor, bias: Tensor, eps: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        over = [axis for axis in range(x.ndim) if axis != 1]
        wide = torch.promote_types(x.dtype, torch.float32)  # half precision is too short for sums
        own_var, own_mean = torch.var_mean(x.to(wide), over, correction=0)
        own = torch.cat([own_mean, own_var, own_mean.new_tensor([x.numel() // x.shape[1]])])
        every = own.new_zeros(dist.get_world_size(), len(own), dtype=torch.float64)
        every[dist.get_rank()] = own.double()
        sum_over_all(every)
        means, variances, counts = every.split([x.shape[1], x.shape[1], 1], dim=1)
        count = counts.sum()
        mean = (counts * means).sum(dim=0) / count
        var = (counts * (variances + (means - mean).square())).sum(dim=0) / count
        mean, var, rate = mean.to(wide), var.to(wide), (var + eps).rsqrt().to(wide)
        unbiased = var * (count / (count - 1)).to(wide)
        ctx.save_for_backward(x, weight, mean, rate, count.to(wide))
        ctx.mark_non_differentiable(mean, unbiased)
        return F.batch_norm(x, mean, var, weight, bias, eps=eps), mean, unbiased

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        x, weight, mean, rate, count = ctx.saved_tensors
        over = [axis for axis in range(x.ndim) if axis != 1]
        per_channel = (1, -1, *(1 for _ in over[1:]))
        dy = slopes[0].to(mean.dtype)
        unit = (x.to(mean.dtype) - mean.view(per_channel)).mul_(rate.view(per_channel))
        own = torch.stack([dy.sum(over), (dy * unit).sum(over)])
        every = own.clone()
        sum_over_all(every)
        shift, scale = (every / count).view(2, *per_channel).unbind()
        dx = (dy - unit.mul_(scale).add_(shift)).mul_((weight * rate).view(per_channel))
        return dx.to(x.dtype), own[1], own[0], None


class _Synced(_BatchNorm):
    """A batch norm over the values of all processes while it learns."""

    def forward(self, input: Float[Tensor, "b c *cells"]) -> Float[Tensor, "b c *cells"]:
        """Normalise; in eval mode by the running statistics, and nothing is sent."""
        if not self.training:
            return super().forward(input)
        assert self.running_mean is not None
        assert self.running_var is not None
        assert self.num_batches_tracked is not None
        assert self.momentum is not None
        y, mean, var = _Normalise.apply(  # type: ignore[no-untyped-call]
            input, self.weight, self.bias, self.eps
        )
        with torch.no_grad():
            self.num_batches_tracked.add_(1)
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(var, self.momentum)
        return y


class SyncedNorm1d(_Synced, nn.BatchNorm1d):
    """Of vectors (B, C) or sequences (B, C, L)."""


class SyncedNorm2d(_Synced, nn.BatchNorm2d):
    """Of images (B, C, H, W)."""


class SyncedNorm3d(_Synced, nn.BatchNorm3d):
    """Of volumes (B, C, X, Y, Z)."""


SYNCED: dict[type[_BatchNorm], type[_BatchNorm]] = {
    nn.BatchNorm1d: SyncedNorm1d,
    nn.BatchNorm2d: SyncedNorm2d,
    nn.BatchNorm3d: SyncedNorm3d,
}
