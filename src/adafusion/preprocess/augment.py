# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Random changes to training data that leave the place the same.

The paper augments without giving sizes; the defaults are those in the released code.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

GREY = (0.299, 0.587, 0.114)  # luma of R, G, B (ITU-R BT.601), as Pillow and torchvision weigh them


def jitter_points(
    points_body: Float[np.ndarray, "n 3"],
    rng: np.random.Generator,
    sigma_m: float = 0.02,
    clip_m: float = 0.05,
) -> Float[np.ndarray, "n 3"]:
    """Move every point by normal noise of `sigma_m` metres an axis, at most `clip_m`.

    The defaults are in the cloud's own unit. With metres and cells of half a metre they change
    next to nothing; half a cell (`sigma_m=0.1`) is what a network feels.
    """
    noise = rng.standard_normal(points_body.shape, dtype=np.float32)
    return points_body + np.clip(noise * np.float32(sigma_m), -clip_m, clip_m).astype(
        points_body.dtype
    )


def color_jitter(
    images: Float[Tensor, "b 3 h w"],
    generator: torch.Generator,
    *,
    brightness: float = 0.2,
    contrast: float = 0.2,
    saturation: float = 0.2,
) -> Float[Tensor, "b 3 h w"]:
    """Change brightness, contrast and saturation of RGB images in [-1, 1], each in its own way.

    Each image draws three factors f, uniform in [1 - s, 1 + s] for a strength s in [0, 1], and the
    order of the three changes. A change blends a colour x in [0, 1] to f x + (1 - f) b, where b is
    black (brightness), the mean grey of the image (contrast), or the grey of x (saturation). The
    result is clipped once, at the end. Equal generator states give equal results.
    """
    strength = torch.tensor((brightness, contrast, saturation), dtype=images.dtype)
    if not ((strength >= 0) & (strength <= 1)).all():
        raise ValueError(f"strengths {strength.tolist()} must lie in [0, 1]")
    draws = torch.rand(len(images), 6, generator=generator, device=generator.device)
    draws = draws.to(images)
    factor = 1 + strength.to(images) * (2 * draws[:, :3] - 1)
    order = draws[:, 3:].argsort(dim=1)

    # every change is affine in the colour, x -> A x + c, so the three are multiplied together
    # first and the pixels, of which there are many, are touched once
    to_grey = images.new_tensor(GREY).expand(3, 3)
    mean = (images.mean(dim=(2, 3)) + 1)[..., None] / 2
    A = torch.eye(3).to(images).repeat(len(images), 1, 1)
    c = torch.zeros_like(mean)
    for change in order.T:
        f = factor.gather(1, change[:, None])[..., None]
        contrasts, saturates = (change == 1)[:, None, None], (change == 2)[:, None, None]
        mean_grey = to_grey @ (A @ mean + c)
        A, c = (
            f * A + (1 - f) * saturates * (to_grey @ A),
            f * c + (1 - f) * (saturates * (to_grey @ c) + contrasts * mean_grey),
        )
    offset = A.sum(dim=2, keepdim=True) + 2 * c - 1  # the same map between colours in [-1, 1]
    return torch.baddbmm(offset, A, images.flatten(2)).clamp_(-1, 1).view_as(images)


def blank_sensors(
    images: Float[Tensor, "b 3 h w"],
    lidar: Float[Tensor, "b ..."],
    share: float,
    rng: np.random.Generator,
) -> None:
    """Take one of its two sensors, chosen by chance, from about `share` of the frames, in place.

    A blanked image is black (-1), a blanked LiDAR tensor is zero. Where a sensor can fail, the
    loss has a reason to move the weights; on data where neither ever does it has next to none.
    """
    lost = rng.random(len(images)) < share
    is_image = rng.random(len(images)) < 0.5
    images[torch.from_numpy(lost & is_image)] = -1.0
    lidar[torch.from_numpy(lost & ~is_image)] = 0.0
