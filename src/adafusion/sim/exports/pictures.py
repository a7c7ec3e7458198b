# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What layouts need of pictures: encoded bytes, and where a lens puts a pixel."""

from __future__ import annotations

import math

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from adafusion.sim.sensing.camera import Camera


def shrinkage(real_width: int, width: int) -> int:
    """The power of two by which a real camera's pictures are made about `width` pixels wide."""
    return 2 ** max(round(math.log2(real_width / width)), 0)


def encode_image(image: UInt8[np.ndarray, "h w"] | UInt8[np.ndarray, "h w 3"], kind: str) -> bytes:
    """The file of a grey or RGB image; `kind` is a suffix such as ".png"."""
    done, data = cv2.imencode(kind, image if image.ndim == 2 else image[..., ::-1])
    if not done:
        raise ValueError(f"an image of shape {image.shape} cannot be encoded as {kind}")
    return data.tobytes()


def undistortion(camera: Camera) -> Float64[np.ndarray, "h w 2"]:
    """For each pixel of the undistorted picture: column and row in the picture as taken."""
    h, w = camera.size
    row, column = np.mgrid[:h, :w].astype(float)
    K = camera.K
    rays = np.stack([(column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1], np.ones((h, w))], -1)
    still = np.zeros(3)
    pixels = cv2.projectPoints(rays.reshape(-1, 3), still, still, K, np.array(camera.distortion))[0]
    return pixels.reshape(h, w, 2)
