# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A synthetic world with a camera and a LiDAR, for all who have no recordings: never called real.

    town     what stands still: streets, buildings, identical passages
    run      what differs between runs: conditions, way, parked cars, traffic
    sensing  what camera and LiDAR make of it

and, from these three: studio.py (any frame of any run), simulate.py (runs as a dataset), regions.py
(what teaches, chooses, judges), benchmarks.py (named worlds that never change), sheet.py (contact
sheets) and exports (the layouts of recorded data sets). All of them use numeric.py: keyed random
numbers and compiled kernels.
"""
