# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A run: its conditions, the way it takes, and what is parked or moves while it goes on.

Conditions             conditions.py: light, weather, season, faults
World -> Drive         route.py
World -> parked Soup   vehicles.py
World, time -> Soup    traffic.py: vehicles and people
"""
