# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Numba's parallel kernels beside torch, which shares their thread pool."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def torch_threads_kept() -> Iterator[None]:
    """Give torch its number of threads back after a parallel kernel.

    The first such kernel starts numba's OpenMP pool and thereby sets the number of threads of the
    whole process. A network that was told to use one thread would silently use all from then on:
    another speed, and other rounding in a training that promises to repeat itself.
    """
    threads = torch.get_num_threads()
    try:
        yield
    finally:
        if torch.get_num_threads() != threads:
            torch.set_num_threads(threads)
