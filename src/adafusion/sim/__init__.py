# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A synthetic world with a camera and a LiDAR, for all who have no recordings: never called real.

WorldSpec -> World                 world.py: from plan, streets, corridors, buildings, planting,
                                   furniture; the same for every run
Conditions -> vehicles, Light      conditions.py, vehicles.py: what differs between runs
World + vehicles -> Scene          scene.py, bvh.py: made ready for rays
World -> Drive                     route.py: where the frames of a run are
Scene, pose -> image, points       camera.py, lidar.py, over the surfaces of textures.py
runs -> Dataset                    simulate.py
"""
