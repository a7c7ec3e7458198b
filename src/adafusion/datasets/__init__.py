# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Datasets: our own form on disk, its regions, and the loop that recordings are written by."""

from __future__ import annotations

from adafusion.datasets.native import Dataset, DatasetInfo, open_dataset
from adafusion.datasets.sensor_files import read_cloud, read_image, write_observation
from adafusion.datasets.writer import DatasetWriter

__all__ = [
    "Dataset",
    "DatasetInfo",
    "DatasetWriter",
    "open_dataset",
    "read_cloud",
    "read_image",
    "write_observation",
]
