# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""nuScenes."""

from adafusion.readers.nuscenes.reader import read, recognises

__all__ = ["read", "recognises"]
