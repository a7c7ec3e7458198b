# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Random changes to training data that leave the place the same.

The paper augments without giving sizes; the defaults are those in the released code.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

# what MinkLoc++'s released training (jac99/MinkLocMultimodal, datasets/augmentation.py) does to
# point sets; lengths are in the sets' own unit, of which most clouds span two
SET_JITTER, SET_JITTER_CLIP = 0.001, 0.002  # standard deviation of a point's shift; its bound
SET_DROPPED = 0.1  # of the points, at most
SET_SHIFT = 0.01  # standard deviation of a whole set's shift along each axis
ERASE_CHANCE = 0.4  # that an upright box of a set is emptied
ERASE_AREA = (0.02, 0.33)  # of the box, as a share of the set's extent in x and y
ERASE_ASPECT = (0.3, 3.3)  # of the box: its extent in y by that in x
YAW_RAD = math.radians(5.0)  # at most
FLIP_X, FLIP_Y = 0.25, 0.25  # chances that x, or else y, is turned over

# and what it does to images beside changing their colours
IMAGE_ERASE_AREA = (0.1, 0.4)  # of the emptied box, as a share of the image
IMAGE_ERASE_ASPECT = (0.3, 3.3)  # of the box: its height by its width

Among = tuple[int, slice]  # size of a whole batch, and the part of it that is given

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


def augment_points(
    points: Float[Tensor, "b n 3"], generator: torch.Generator, among: Among | None = None
) -> Float[Tensor, "b n 3"]:
    """Change point sets as MinkLoc++'s training does; z is upright, and zero is their middle.

    Each set has its points jittered, some dropped, all shifted, and perhaps an upright box emptied.
    Then one turn about z, and perhaps one flip of x or of y, for the whole batch: no set is turned
    against another. Points that go away go to zero, so that sets keep their size. Equal generator
    states give equal results, also for a part of a batch.
    """
    n = points.shape[1]
    b, part = among or (len(points), slice(None))
    draws = torch.rand(b, 6, generator=generator, device=generator.device)[part].to(points)
    order = torch.rand(b, n, generator=generator, device=generator.device)[part].to(points)
    noise = torch.randn(b, n + 1, 3, generator=generator, device=generator.device)[part].to(points)
    turn, flip = torch.rand(2, generator=generator, device=generator.device).tolist()

    jitter = (SET_JITTER * noise[:, :n]).clamp(-SET_JITTER_CLIP, SET_JITTER_CLIP)
    points = points + jitter + SET_SHIFT * noise[:, n:]
    dropped = order.argsort(dim=1) < (SET_DROPPED * n * draws[:, :1]).floor()
    points = points.masked_fill((dropped | _in_box(points, draws[:, 1:]))[..., None], 0.0)
    return points @ _turn(YAW_RAD * (2 * turn - 1), flip).to(points)


def _in_box(points: Float[Tensor, "b n 3"], draws: Float[Tensor, "b 5"]) -> Bool[Tensor, "b n"]:
    """Which points lie in the upright box that is to be emptied, in the sets that have one."""
    chance, area, aspect, *place = draws.T
    lower, upper = points[..., :2].amin(dim=1), points[..., :2].amax(dim=1)
    extent = upper - lower
    area = _between(ERASE_AREA, area) * extent.prod(dim=1)
    aspect = _between(ERASE_ASPECT, aspect)
    size = torch.stack([(area / aspect).sqrt(), (area * aspect).sqrt()], dim=1)
    start = lower + torch.stack(place, dim=1) * (extent - size)
    xy = points[..., :2]
    inside = (xy > start[:, None]) & (xy < (start + size)[:, None])
    return inside.all(dim=2) & (chance < ERASE_CHANCE)[:, None]


def _between(bounds: tuple[float, float], draw: Tensor) -> Tensor:
    return bounds[0] + (bounds[1] - bounds[0]) * draw


def _turn(yaw_rad: float, flip: float) -> Float[Tensor, "3 3"]:
    """What rows are multiplied by to turn them about z, then flip x or y as the draw says."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    x = -1.0 if flip < FLIP_X else 1.0
    y = -1.0 if FLIP_X <= flip < FLIP_X + FLIP_Y else 1.0
    return torch.tensor([[x * cos, y * sin, 0.0], [-x * sin, y * cos, 0.0], [0.0, 0.0, 1.0]])


def color_jitter(
    images: Float[Tensor, "b 3 h w"],
    generator: torch.Generator,
    *,
    brightness: float = 0.2,
    contrast: float = 0.2,
    saturation: float = 0.2,
    among: Among | None = None,
) -> Float[Tensor, "b 3 h w"]:
    """Change brightness, contrast and saturation of RGB images in [-1, 1], each in its own way.

    Each image draws three factors f, uniform in [1 - s, 1 + s] for a strength s in [0, 1], and the
    order of the three changes. A change blends a colour x in [0, 1] to f x + (1 - f) b, where b is
    black (brightness), the mean grey of the image (contrast), or the grey of x (saturation). The
    result is clipped once, at the end. Equal generator states give equal results, also for a part
    of a batch.
    """
    strength = torch.tensor((brightness, contrast, saturation), dtype=images.dtype)
    if not ((strength >= 0) & (strength <= 1)).all():
        raise ValueError(f"strengths {strength.tolist()} must lie in [0, 1]")
    size, part = among or (len(images), slice(None))
    draws = torch.rand(size, 6, generator=generator, device=generator.device)[part].to(images)
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


def hue_jitter(
    images: Float[Tensor, "b 3 h w"],
    generator: torch.Generator,
    strength: float = 0.1,
    among: Among | None = None,
) -> Float[Tensor, "b 3 h w"]:
    """Turn the hues of each RGB image by one share of the colour circle, at most `strength`.

    MinkLoc++'s training does this in one random order with the changes of `color_jitter`; here it
    follows them. Equal generator states give equal results, also for a part of a batch.
    """
    if not 0 <= strength <= 0.5:
        raise ValueError(f"strength {strength} must lie in [0, 0.5]: half a circle is all there is")
    size, part = among or (len(images), slice(None))
    draws = torch.rand(size, generator=generator, device=generator.device)[part].to(images)
    return turn_hue(images, strength * (2 * draws - 1))


def turn_hue(
    images: Float[Tensor, "b 3 h w"], turn: Float[Tensor, " b"]
) -> Float[Tensor, "b 3 h w"]:
    """Turn the hues of each image by a share of the colour circle: a third takes red to green.

    The hue of the HSV model: each pixel keeps its greatest and its least component. Any scale of
    colours does, as long as the three share it.
    """
    greatest, chroma = images.amax(dim=1), images.amax(dim=1) - images.amin(dim=1)
    red, green, blue = images.unbind(dim=1)
    sixths = torch.where(
        greatest == red,
        green - blue,
        torch.where(greatest == green, blue - red, red - green),
    ) / torch.where(chroma > 0, chroma, 1.0)
    after = torch.where(greatest == red, 0.0, torch.where(greatest == green, 2.0, 4.0))
    hue = sixths + after + 6 * turn[:, None, None]
    # a component is greatest for a third of the circle around its own hue, and least opposite
    own = hue.new_tensor((0.0, 2.0, 4.0))[:, None, None]
    away = ((hue[:, None] - own + 3) % 6 - 3).abs()
    return greatest[:, None] - chroma[:, None] * (away - 1).clamp(0, 1)


def erase_boxes(
    images: Float[Tensor, "b 3 h w"],
    generator: torch.Generator,
    chance: float = 0.5,
    among: Among | None = None,
) -> Float[Tensor, "b 3 h w"]:
    """Blacken (-1) an upright box in about a share `chance` of the images, another one in each.

    Its area is uniform and its aspect log-uniform within the bounds above, where a box of that area
    fits the image. Equal generator states give equal results, also for a part of a batch.
    """
    size, part = among or (len(images), slice(None))
    draws = torch.rand(size, 5, generator=generator, device=generator.device)[part].to(images)
    is_chosen, area, aspect, *place = draws.T
    height, width = images.shape[2:]
    area = _between(IMAGE_ERASE_AREA, area) * (height * width)
    flattest, tallest = (
        torch.full_like(area, bound).clamp(area / width**2, height**2 / area).log()
        for bound in IMAGE_ERASE_ASPECT
    )
    aspect = (flattest + (tallest - flattest) * aspect).exp()
    inside = []
    for length, extent, at in zip(
        (height, width), ((area * aspect).sqrt(), (area / aspect).sqrt()), place, strict=True
    ):
        extent = extent.round().clamp(1, length)
        start = (at * (length - extent + 1)).floor()[:, None]
        cells = torch.arange(length, device=images.device)
        inside.append((cells >= start) & (cells < start + extent[:, None]))
    box = inside[0][:, :, None] & inside[1][:, None] & (is_chosen < chance)[:, None, None]
    return images.masked_fill(box[:, None], -1.0)


def blank_sensors(
    images: Float[Tensor, "b 3 h w"],
    lidar: Float[Tensor, "b ..."],
    share: float,
    rng: np.random.Generator,
    among: Among | None = None,
) -> None:
    """Take one of its two sensors, chosen by chance, from about `share` of the frames, in place.

    A blanked image is black (-1), a blanked LiDAR tensor is zero. Where a sensor can fail, the
    loss has a reason to move the weights; on data where neither ever does it has next to none.
    """
    size, part = among or (len(images), slice(None))
    lost = (rng.random(size) < share)[part]
    is_image = (rng.random(size) < 0.5)[part]
    images[torch.from_numpy(lost & is_image)] = -1.0
    lidar[torch.from_numpy(lost & ~is_image)] = 0.0
