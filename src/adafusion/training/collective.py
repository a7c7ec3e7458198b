# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What processes of one training say to each other, and what is said where one has gone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch.distributed as dist
from torch import Tensor

from adafusion.types import JobFailed


@contextmanager
def speaking() -> Iterator[None]:
    """Say of a broken connection what it means."""
    try:
        yield
    except RuntimeError as error:
        raise JobFailed(
            f"another process of this training has stopped, and says why ({error})"
        ) from error


def sum_over_all(values: Tensor) -> None:
    """Replace values by their sum over all processes."""
    with speaking():
        dist.all_reduce(values)
