# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Spatial and channel attention over 2-D and 3-D maps alike, at the cells that survive.

The weight branch resizes every attended map by nearest neighbour to the cells of the deepest level.
Only the surviving cells are therefore ever asked for: keys and values see the whole map, queries
only those cells. Nothing is approximated, and no map of all cells against all cells is ever built
(3888 x 3888 in the released code). `plain.py` holds the slow forms.

Shape suffixes: B batch, C channels, N all cells of a level, M surviving cells.
"""

from __future__ import annotations

from functools import lru_cache
from math import prod

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from adafusion.models.backbones import Conv

KEY_CHANNELS = 4  # d_k
VALUE_CHANNELS = 16  # d_v, and the width that channel attention is reduced to


class SpatialAttention(nn.Module):
    """Every cell looks at all cells (paper Eq. 2-3, single head): softmax(Q K^T) V.

    One 3-wide convolution gives Q, K and V. The released code strides it by 2 on the two shallow
    levels and scales Q by 1/sqrt(d_k); the paper's text has stride 1 and no scale.
    """

    def __init__(self, conv: type[Conv], channels: int, stride: int, scaled: bool) -> None:
        super().__init__()
        self.qkv = conv(
            channels, 2 * KEY_CHANNELS + VALUE_CHANNELS, kernel_size=3, stride=stride, padding=1
        )
        self.scale = KEY_CHANNELS**-0.5 if scaled else 1.0

    def forward(
        self, x: Float[Tensor, "b c *cells"], out_cells: tuple[int, ...]
    ) -> Float[Tensor, "b value *out"]:
        """Attend at the cells that a nearest-neighbour resize to `out_cells` would keep."""
        qkv = self.qkv(x)
        keep = surviving_cells(tuple(qkv.shape[2:]), out_cells).to(x.device)
        qkv_BNC = qkv.flatten(2).mT
        q_BMK = qkv_BNC[:, keep, :KEY_CHANNELS]
        k_BNK = qkv_BNC[..., KEY_CHANNELS : 2 * KEY_CHANNELS]
        v_BNV = qkv_BNC[..., 2 * KEY_CHANNELS :]
        attended_BMV = F.scaled_dot_product_attention(q_BMK, k_BNK, v_BNV, scale=self.scale)
        return attended_BMV.mT.unflatten(2, out_cells)


class ChannelAttention(nn.Module):
    """Every channel looks at all channels, then a kernel-1 convolution narrows them to 16.

    The released code uses the raw map for Q, K and V (`projected=False`); the paper writes them as
    projections, read here as kernel-1 convolutions that keep the width.
    """

    def __init__(self, conv: type[Conv], channels: int, projected: bool) -> None:
        super().__init__()
        self.qkv = conv(channels, 3 * channels, kernel_size=1) if projected else None
        self.narrow = conv(channels, VALUE_CHANNELS, kernel_size=1)

    def forward(
        self, x: Float[Tensor, "b c *cells"], out_cells: tuple[int, ...]
    ) -> Float[Tensor, "b value *out"]:
        """Attend at the cells that a nearest-neighbour resize to `out_cells` would keep."""
        keep = surviving_cells(tuple(x.shape[2:]), out_cells).to(x.device)
        if self.qkv is None:
            q_BCN = k_BCN = v_BCN = x.flatten(2)
        else:
            q_BCN, k_BCN, v_BCN = self.qkv(x).flatten(2).chunk(3, dim=1)
        weight_BCC = (q_BCN @ k_BCN.mT).softmax(dim=-1)
        # narrow (weight v) = (narrow weight) v: 16 rows instead of C, at surviving cells only
        narrow_VC = self.narrow.weight.flatten(1)
        narrowed_BVM = (narrow_VC @ weight_BCC) @ v_BCN[:, :, keep]
        assert self.narrow.bias is not None
        return (narrowed_BVM + self.narrow.bias[:, None]).unflatten(2, out_cells)


def surviving_cells(cells: tuple[int, ...], out_cells: tuple[int, ...]) -> Int[Tensor, " m"]:
    """Flat indices of the cells that a nearest-neighbour resize to `out_cells` keeps."""
    return _surviving_cells(tuple(map(int, cells)), tuple(map(int, out_cells)))


@lru_cache(maxsize=64)
def _surviving_cells(cells: tuple[int, ...], out_cells: tuple[int, ...]) -> Tensor:
    with torch.inference_mode(False):
        flat = torch.zeros((), dtype=torch.int64)
        for n_in, n_out in zip(cells, out_cells, strict=True):
            # the framework's own rule in its own float arithmetic, not floor(i * n_in / n_out)
            row = torch.arange(n_in, dtype=torch.float32)[None, None]
            kept = F.interpolate(row, size=n_out, mode="nearest")[0, 0].long()
            flat = flat[..., None] * n_in + kept
        return flat.reshape(prod(out_cells))
