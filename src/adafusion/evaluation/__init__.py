# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""How well places are recognised: protocols, recall with intervals, trust in the sensors."""

from adafusion.evaluation.evaluate import Evaluation, SplitResult, compare, evaluate_splits
from adafusion.evaluation.judge import Judged, alpha_by, dataset_splits, judge
from adafusion.evaluation.protocols import (
    PROTOCOLS,
    answer_groups,
    describe_protocol,
    make_splits,
)
from adafusion.evaluation.record import result_record
from adafusion.evaluation.validation import validation_recall
from adafusion.evaluation.weights import contribution_shares, summarize_alpha

__all__ = [
    "PROTOCOLS",
    "Evaluation",
    "Judged",
    "SplitResult",
    "alpha_by",
    "answer_groups",
    "compare",
    "contribution_shares",
    "dataset_splits",
    "describe_protocol",
    "evaluate_splits",
    "judge",
    "make_splits",
    "result_record",
    "summarize_alpha",
    "validation_recall",
]
