# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Training: who is a true and a wrong match, what a training is, and the loop."""

from adafusion.training.loop import Step, build_model, folded, train, untrained_twin
from adafusion.training.settings import Phase, TrainConfig, phases

__all__ = [
    "Phase",
    "Step",
    "TrainConfig",
    "build_model",
    "folded",
    "phases",
    "train",
    "untrained_twin",
]
