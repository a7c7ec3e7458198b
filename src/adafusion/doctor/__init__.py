# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a dataset, found before a day is lost: `examine(open_dataset(path))`."""

from __future__ import annotations

from adafusion.doctor.examine import Diagnosis, examine
from adafusion.doctor.findings import LEVELS, Finding, Level

__all__ = ["LEVELS", "Diagnosis", "Finding", "Level", "examine"]
