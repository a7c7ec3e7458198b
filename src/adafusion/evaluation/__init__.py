# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""How well places are recognised: protocols, recall with intervals, trust in the sensors."""

from adafusion.evaluation.evaluate import (
    Estimate,
    Evaluation,
    SplitResult,
    compare,
    evaluate_splits,
)
from adafusion.evaluation.protocols import PROTOCOLS, describe_protocol, make_splits
from adafusion.evaluation.record import result_record
from adafusion.evaluation.weights import AlphaSummary, contribution_shares, summarize_alpha

__all__ = [
    "PROTOCOLS",
    "AlphaSummary",
    "Estimate",
    "Evaluation",
    "SplitResult",
    "compare",
    "contribution_shares",
    "describe_protocol",
    "evaluate_splits",
    "make_splits",
    "result_record",
    "summarize_alpha",
]
