# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What sensors make of a scene: rays through trees of triangles, then a camera or a LiDAR.

World, parked, traffic -> Scene   scene.py over bvh.py
Scene -> radiance                 rendering.py, with textures.py, lighting.py, weather.py
radiance -> picture               camera.py: lens.py, then sensor.py
ray <-> pixel                     projection.py
Scene -> points                   lidar.py, with textures.py, weather.py
"""
