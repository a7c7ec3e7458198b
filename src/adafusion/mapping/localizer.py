# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Where on a map an image and a cloud were taken."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from adafusion.mapping.place_map import PlaceMap
from adafusion.models import PlaceModel, describe
from adafusion.search import rank
from adafusion.types import SENSORS, UserError


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Place:
    """One candidate of an answer."""

    key: str  # run/timestamp_us of the frame on the map
    distance: float  # between descriptors; comparable only between answers with equal `used`
    position_m: tuple[float, float, float]  # in the map frame
    T_map_body: Float[np.ndarray, "4 4"] | None  # None where the map knows the position alone


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """Where a query may have been taken, best first, and on which sensors that rests."""

    places: tuple[Place, ...]
    alpha: tuple[float, float] | None  # trust in (image, LiDAR); None where nothing was weighed
    used: tuple[str, ...]  # ("image", "lidar"), ("image",) or ("lidar",)

    def to_dict(self) -> dict[str, Any]:
        """Give plain values for JSON."""
        return {
            "places": [
                {
                    "key": place.key,
                    "distance": place.distance,
                    "position_m": list(place.position_m),
                    "T_map_body": None if place.T_map_body is None else place.T_map_body.tolist(),
                }
                for place in self.places
            ],
            "alpha": None if self.alpha is None else dict(zip(SENSORS, self.alpha, strict=True)),
            "used": list(self.used),
        }


class Localizer:
    """Finds queries on one map with the model that made it. The map is never changed.

    k: how many candidates an answer holds, or all places of a smaller map.

    Raises UserError if the map was made by another model or preprocessing: distances between
    their descriptors would mean nothing.
    """

    def __init__(self, model: PlaceModel, place_map: PlaceMap, k: int = 5) -> None:
        if k < 1:
            raise ValueError(f"k {k} must be at least 1")
        header = place_map.header
        ours = replace(
            header,
            model=model.name,
            model_fingerprint=model.fingerprint,
            preprocess_fingerprint=model.preprocess_fingerprint,
        )
        if differences := header.differences(ours):
            raise UserError(
                f"this map was made with another model: {header.model!r}, while the query's is "
                f"{model.name!r} with {'; '.join(differences)}; "
                "load the map's model, or build the map again with this one"
            )
        self.model = model
        self.place_map = place_map
        self.k = k

    def locate(self, image_u8: np.ndarray | None, points_m: np.ndarray | None) -> Answer:
        """Rank the places of the map by their distance to what the sensors saw.

        image_u8: (H, W, 3) RGB, uint8, any size. points_m: (N, 3) floats, metres, body frame
        (x forward, y left, z up, z = 0 the ground). Either may be None: then its half is left out
        on both sides, and the other half is compared unweighted.

        Raises UserError for an input of another form, and where the system has no use for the
        sensors given.
        """
        given = {"image": _checked_image(image_u8), "lidar": _checked_cloud(points_m)}
        used, part = self._choose([name for name in SENSORS if given[name] is not None])
        image, lidar = self.model.preprocess(
            *(given[name] if name in used else None for name in SENSORS)
        )
        # of an elevation map, the first channel is what the LiDAR saw
        if lidar is not None and not (lidar if lidar.ndim == 2 else lidar[0]).any():
            raise UserError(
                "no point of the cloud falls into the box that the model looks at; "
                "give metres in the body frame (x forward, y left, z up, z = 0 the ground)"
            )
        batch = (None if image is None else image[None], None if lidar is None else lidar[None])
        query = describe(self.model, [batch])
        rows, distances = rank(
            getattr(query, part),
            getattr(self.place_map.descriptions, part),
            k=min(self.k, len(self.place_map)),
            p=self.place_map.header.p,
        )
        alpha = query.alpha
        return Answer(
            places=tuple(
                self._place(int(row), float(distance))
                for row, distance in zip(rows[0], distances[0], strict=True)
            ),
            alpha=None if alpha is None else (float(alpha[0, 0]), float(alpha[0, 1])),
            used=used,
        )

    def _choose(self, given: list[str]) -> tuple[tuple[str, ...], str]:
        """Which of the given sensors the map can use, and the part of a description to compare."""
        halves = [name for name in SENSORS if f"{name}_half" in self.place_map.parts]
        known = halves or list(SENSORS)  # a system without halves needs both sensors
        used = tuple(name for name in given if name in known)
        if used == tuple(known):
            return used, "fused"  # of a system with one sensor: its half
        if len(used) == 1 and halves:
            return used, f"{used[0]}_half"
        words = {"image": "an image", "lidar": "a cloud"}
        needed = (" or " if halves else " and ").join(words[name] for name in known)
        has = " and ".join(words[name] for name in given) or "neither"
        raise UserError(
            f"model {self.place_map.header.model!r} needs {needed}; the query has {has}"
        )

    def _place(self, row: int, distance: float) -> Place:
        x, y, z = self.place_map.positions_m[row].tolist()
        T_map_body = self.place_map.T_map_body[row]
        return Place(
            key=self.place_map.keys[row],
            distance=distance,
            position_m=(x, y, z),
            T_map_body=T_map_body if np.isfinite(T_map_body).all() else None,
        )


def _checked_image(image_u8: np.ndarray | None) -> np.ndarray | None:
    if image_u8 is None:
        return None
    if image_u8.ndim != 3 or image_u8.shape[2] != 3 or image_u8.dtype != np.uint8:
        raise UserError(
            f"the image is {image_u8.dtype} of shape {image_u8.shape}; "
            "give RGB as uint8 of shape (height, width, 3)"
        )
    if image_u8.size == 0:
        raise UserError("the image is empty; give None for a camera that saw nothing")
    return image_u8


def _checked_cloud(points_m: np.ndarray | None) -> np.ndarray | None:
    if points_m is None:
        return None
    if points_m.ndim != 2 or points_m.shape[1] != 3 or points_m.dtype.kind != "f":
        raise UserError(
            f"the cloud is {points_m.dtype} of shape {points_m.shape}; give x, y, z in metres "
            "as floats of shape (N, 3): points[:, :3] drops an intensity"
        )
    if len(points_m) == 0:
        raise UserError("the cloud is empty; give None for a LiDAR that saw nothing")
    bad = int((~np.isfinite(points_m)).any(axis=1).sum())
    if bad:
        raise UserError(
            f"{bad} of {len(points_m)} points of the cloud are NaN or infinite; "
            "drop them first: points[np.isfinite(points).all(axis=1)]"
        )
    return points_m.astype(np.float32, copy=False)
