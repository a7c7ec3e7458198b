# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Every system by name, and the one way to build any of them."""

from __future__ import annotations

from adafusion.models.adafusion import AdaFusion
from adafusion.models.base import PlaceModel
from adafusion.models.config import ModelConfig
from adafusion.models.coral import Coral
from adafusion.models.minkloc import MinkLoc
from adafusion.models.netvlad import NetVLAD
from adafusion.models.oertel import Oertel
from adafusion.models.pic_net import PicNet
from adafusion.models.pointnetvlad import PointNetVLAD

SYSTEMS: dict[str, type[PlaceModel]] = {
    "adafusion": AdaFusion,
    "concat": AdaFusion,
    "image": AdaFusion,
    "lidar": AdaFusion,
    "netvlad": NetVLAD,
    "pointnetvlad": PointNetVLAD,
    "minkloc": MinkLoc,
    "coral": Coral,
    "pic-net": PicNet,
    "oertel": Oertel,
}


def build_system(config: ModelConfig, name: str = "") -> PlaceModel:
    """Build the network of `config.system`; its weights come from torch's random state."""
    return SYSTEMS[config.system](config, name)
