# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""NCLT, as recorded."""

from adafusion.readers.nclt.reader import read, recognises

__all__ = ["read", "recognises"]
