# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The town: everything that stands still, the same for every run, from a seed.

    WorldSpec -> World     world.py

A `Plan` (plan.py) grows step by step: streets, passages with their interiors, blank walls, parks,
buildings, furniture. `shapes.py` collects the triangles.
"""
