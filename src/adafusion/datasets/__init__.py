# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Datasets: our own form on disk, and one module for each foreign format that is read into it."""

from __future__ import annotations

from adafusion.datasets.native import Dataset, DatasetInfo, DatasetWriter, open_dataset

__all__ = ["Dataset", "DatasetInfo", "DatasetWriter", "open_dataset"]
