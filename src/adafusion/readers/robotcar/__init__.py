# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Oxford RobotCar, as recorded."""

from adafusion.readers.robotcar.reader import read, recognises

__all__ = ["read", "recognises"]
