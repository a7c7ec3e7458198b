# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""A reconstruction of the system of Oertel, Cieslewski and Scaramuzza (RA-L 2020)."""

from __future__ import annotations

from adafusion.models.adafusion import AdaFusion


class Oertel(AdaFusion):
    """One image and one voxel grid in, the means over both networks' cells joined out.

    The network's code is not public. Known are a 2-D network over the image and a 3-D one over a
    binary grid, global average pooling and plain concatenation, and that AdaFusion took its loss
    from there. So both branches are AdaFusion's, and the network computes what `concat` does.

    The rest of the reconstruction is data and training (`configs/oertel.yaml`): a grid in front of
    the vehicle alone, wrong pairs mined, another optimiser. The structure is the LiDAR's here, and
    was a camera's there, from motion. Tables should call it "Oertel-style composite".
    """
