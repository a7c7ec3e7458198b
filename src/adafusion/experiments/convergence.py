# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a training had come to its end when its budget did."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

LEAST = 4  # evaluations without which nothing can be said

RISING, NEVER_BEGAN = "not converged", "did not learn"  # why a row is not ranked


def half_width(recall: float, num_answers: int) -> float:
    """Half of the 95 % interval of a share measured on so many answers."""
    return 1.96 * float(np.sqrt(max(recall * (1.0 - recall), 0.0) / num_answers))


def why_not_ranked(
    curve: Sequence[float],
    num_answers: int,
    *,
    parts: Sequence[Sequence[float]] = (),
    scratch: Sequence[Sequence[float]] = (),
) -> str:
    """`RISING`, `NEVER_BEGAN` or, where the row may be ranked, nothing.

    curve: validation recall@1 of the row from before the first batch on, on so many answers; parts:
    that of each training that led to it. None of them may still rise at its end: the last phase of
    a chain is short, and says little of whether its branches had learnt all they could. scratch:
    that of each training that began with weights drawn by chance. Each must have learnt something.
    """
    if any(still_rising(one, num_answers) for one in (curve, *parts)):
        return RISING
    return NEVER_BEGAN if any(never_began(one, num_answers) for one in scratch) else ""


def never_began(curve: Sequence[float], num_answers: int) -> bool:
    """Whether a training from scratch came to nothing: its best is within chance of its start."""
    return len(curve) > 1 and max(curve) - curve[0] <= half_width(curve[0], num_answers)


def still_rising(curve: Sequence[float], num_answers: int) -> bool:
    """Whether validation recall@1 was still gaining in the last quarter of the evaluations.

    It was if the best of the last quarter exceeds the best before by more than chance moves a
    recall measured on `num_answers` validation queries: the binomial half-width at the best recall
    before. Queries of one place err together, which would widen it; both recalls are of the same
    queries, which narrows it. Where it is too narrow a row that had levelled off is left out of
    the ranking; where it is too wide a row that had not would be ranked, so the narrow one is
    taken. With fewer than four evaluations nothing shows the end, and the answer is yes.
    """
    if len(curve) < LEAST:
        return True
    before = best_before(curve)
    return max(curve) - before > half_width(before, num_answers)


def best_before(curve: Sequence[float]) -> float:
    """The best of all evaluations but the last quarter."""
    return max(curve[: len(curve) - len(curve) // 4])
