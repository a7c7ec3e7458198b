# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A run: its conditions, the way it takes, and what is parked or moves while it goes on.

Conditions             conditions.py: light, weather, season, faults, seeds
World -> Drive         route.py: route, path, keyframes, clock
World -> parked Soup   parking.py
World, time -> Soup    traffic.py: who moves, and where at a time

vehicles.py and people.py hold the shapes, each built once; instances.py puts them into the world.
"""
