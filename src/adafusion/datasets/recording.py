# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A recording as its reader describes it, and the one loop that turns any of them into a dataset.

A reader looks at tables and file names alone and says which frames there will be, and how each
one's image and cloud are decoded. `write_recording` does that, on all cores, a few frames at a
time whatever the length of the recording; it resumes, skips what is damaged where it is told to,
and says where the time went.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, UInt8

from adafusion.datasets.native import DatasetInfo
from adafusion.types import Frame


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """One frame of a recording, its files not yet made.

    The functions travel to other processes, so they must be picklable: `functools.partial` of a
    function at the top of a module, with small arguments (paths and numbers; what is large and
    shared is read again by each process, behind `functools.cache`). They raise UserError, which
    names the file, the offset where there is one, and the remedy.
    """

    frame: Frame  # whose `image` and `cloud` are None
    # RGB; or the bytes of a PNG or JPEG file, checked already, to be kept as they are
    image: Callable[[], UInt8[np.ndarray, "h w 3"] | bytes] | None
    cloud: Callable[[], Float[np.ndarray, "n 3"]] | None  # body frame, metres
    image_suffix: str = ".png"  # ".jpg" where the bytes are JPEG


@dataclass(frozen=True, kw_only=True)
class Recording:
    """All that a reader found."""

    # `source` names the reader's settings (spacing, camera, slop): another setting, another dataset
    info: DatasetInfo
    shots: Iterable[Shot]  # read once, in order; a generator where the source is a stream
    total: int | None = None  # how many, where that is known
    # what a person should know, as "12 of 400 scans have no image within 10 ms: left out"; a
    # generator of shots may append to it to the end
    notes: list[str] = field(default_factory=list)
