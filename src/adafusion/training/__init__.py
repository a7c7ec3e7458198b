# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Training: who is a true and a wrong match, what a training is, and the loop."""

from adafusion.training.loop import Step, train
from adafusion.training.settings import Phase, TrainConfig, phases
from adafusion.training.start import build_model, folded, untrained_twin

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
