# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The town: everything that stands still, the same for every run, from a seed.

WorldSpec -> World        world.py: the steps, each from `Plan` (plan.py) to more of it
streets and passages      streets.py, passages.py
inside of passages        interiors.py, painted by paint.py
parks, trees, hedges      planting.py
blank walls               blank_walls.py, painted by paint.py
buildings                 buildings.py
lamps, signs, shelters    furniture.py

shapes.py collects the triangles, with what textures and lasers ask of each.
"""
