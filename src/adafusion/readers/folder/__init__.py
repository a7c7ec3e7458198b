# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Plain folders of images, clouds and poses."""

from adafusion.readers.folder.reader import read, recognises

__all__ = ["read", "recognises"]
