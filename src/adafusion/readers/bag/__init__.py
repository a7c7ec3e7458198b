# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 1 and ROS 2, without ROS."""

from adafusion.readers.bag.reader import describe_topics, list_topics, read, recognises

__all__ = ["describe_topics", "list_topics", "read", "recognises"]
