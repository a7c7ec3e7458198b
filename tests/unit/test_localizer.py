# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from adafusion.datasets import Dataset, DatasetInfo
from adafusion.mapping import Localizer, MapHeader, PlaceMap
from adafusion.models import AdaFusion, ModelConfig, describe
from adafusion.preprocess import ImageSettings, Preprocess, VoxelGrid
from adafusion.types import Description, Descriptions, Frame, UserError

PREPROCESS = Preprocess(image=ImageSettings(size=(4, 6)), voxels=VoxelGrid(shape=(2, 2, 2)))


class Means(AdaFusion):
    """A model to compute by hand: a half is a multiple of one mean, and trust is constant.

    Image half: brightness in [-1, 1], twice. LiDAR half: share of voxels occupied, twice.
    """

    def __init__(self, system: str = "adafusion", scale: float = 1.0) -> None:
        nn.Module.__init__(self)
        self.config = ModelConfig(system=system, dim=4, preprocess=PREPROCESS)
        self.name = f"means-{system}"
        self.scale = nn.Parameter(torch.tensor(scale))
        self._backbones_frozen = False

    def forward(self, image: Tensor | None, voxels: Tensor | None) -> Description:
        assert not self.training
        image_half, lidar_half = (
            None if x is None else (x.flatten(1).mean(1, keepdim=True) * self.scale).repeat(1, 2)
            for x in (image, voxels)
        )
        system = self.config.system
        if system == "image":
            return Description(image_half, image_half, None, None)
        if system == "lidar":
            return Description(lidar_half, None, lidar_half, None)
        if image_half is None or lidar_half is None:
            return Description(None, image_half, lidar_half, None)
        alpha = None if system == "concat" else torch.tensor([[0.75, 0.25]] * len(image_half))
        w = torch.ones(1, 2) if alpha is None else alpha
        fused = torch.cat([w[:, :1] * image_half, w[:, 1:] * lidar_half], dim=1)
        return Description(fused, image_half, lidar_half, alpha)


def grey(level: int) -> np.ndarray:
    return np.full((8, 12, 3), level, np.uint8)


def cloud(occupied: int) -> np.ndarray:
    """Points in so many of the eight voxels (20 x 20 x 2.5 m each)."""
    corners = [(x, y, z) for x in (-10.0, 10.0) for y in (-10.0, 10.0) for z in (1.0, 4.0)]
    return np.array(corners[:occupied], np.float32)


SEEN = ((0, 8), (102, 6), (204, 4), (255, 2))  # grey level and voxels; brightness -1, -0.2, 0.6, 1


def header_of(model: AdaFusion, p: int = 1) -> MapHeader:
    info = DatasetInfo(
        name="any", version="1", source="hand", licence="CC0-1.0", synthetic=True, world="any"
    )
    return MapHeader.of(model, Dataset(Path("any"), info, ()), p)


def make_map(model: AdaFusion, p: int = 1) -> PlaceMap:
    tensors = [model.preprocess(grey(level), cloud(n)) for level, n in SEEN]
    images, voxels = (torch.stack(column) for column in zip(*tensors, strict=True))
    frames = [
        Frame(
            run="day",
            timestamp_us=i,
            position_m=(10.0 * i, 0.0, 0.0),
            T_world_body=np.eye(4) if i else None,
        )
        for i in range(len(SEEN))
    ]
    return PlaceMap.from_descriptions(
        frames,
        describe(model, [(images, voxels)]),
        header=header_of(model, p),
        dataset="hand-made",
    )


def distances(localizer: Localizer, image: np.ndarray | None, points: np.ndarray | None) -> dict:
    return {place.key: place.distance for place in localizer.locate(image, points).places}


def test_it_ranks_the_places_by_fused_distance() -> None:
    model = Means()
    answer = Localizer(model, make_map(model)).locate(grey(102), cloud(4))
    assert answer.used == ("image", "lidar")
    assert answer.alpha == (0.75, 0.25)
    # 2 (0.75 |brightness| + 0.25 |occupancy|) apart from (-0.2, 0.5)
    expected = {"day/1": 0.125, "day/2": 1.2, "day/0": 1.45, "day/3": 1.925}
    assert [place.key for place in answer.places] == list(expected)
    assert [p.distance for p in answer.places] == pytest.approx(list(expected.values()))


def test_it_uses_the_maps_own_distance() -> None:
    model = Means()
    found = distances(Localizer(model, make_map(model, p=2)), grey(102), cloud(4))
    assert found["day/1"] == pytest.approx(0.125 / np.sqrt(2))


@pytest.mark.parametrize("system", ["adafusion", "concat"])
def test_it_compares_the_other_half_unweighted_when_a_sensor_is_missing(system: str) -> None:
    model = Means(system)
    localizer = Localizer(model, make_map(model))
    by_image, by_lidar = localizer.locate(grey(204), None), localizer.locate(None, cloud(6))
    assert (by_image.used, by_lidar.used) == (("image",), ("lidar",))
    assert by_image.alpha is None
    assert by_lidar.alpha is None
    assert by_image.places[0].key == "day/2"
    assert by_lidar.places[0].key == "day/1"
    assert distances(localizer, grey(204), None) == pytest.approx(
        {"day/2": 0.0, "day/3": 0.8, "day/1": 1.6, "day/0": 3.2}, abs=1e-6
    )
    assert distances(localizer, None, cloud(6)) == pytest.approx(
        {"day/1": 0.0, "day/0": 0.5, "day/2": 0.5, "day/3": 1.0}
    )


@pytest.mark.parametrize(("system", "used"), [("image", ("image",)), ("lidar", ("lidar",))])
def test_it_says_which_sensor_a_system_of_one_used(system: str, used: tuple[str]) -> None:
    model = Means(system)
    answer = Localizer(model, make_map(model)).locate(grey(102), cloud(6))
    assert answer.used == used
    assert answer.alpha is None
    assert answer.places[0].key == "day/1"
    assert answer.places[0].distance == 0.0


def test_it_refuses_a_query_its_system_has_no_use_for() -> None:
    by_image, by_lidar = Means("image"), Means("lidar")
    with pytest.raises(UserError, match="'means-image' needs an image; the query has a cloud"):
        Localizer(by_image, make_map(by_image)).locate(None, cloud(6))
    with pytest.raises(UserError, match="'means-lidar' needs a cloud; the query has an image"):
        Localizer(by_lidar, make_map(by_lidar)).locate(grey(102), None)
    with pytest.raises(UserError, match="needs an image or a cloud; the query has neither"):
        Localizer(Means(), make_map(Means())).locate(None, None)


def test_it_needs_both_sensors_where_a_map_has_no_halves() -> None:
    model = Means("concat")
    whole = make_map(model)
    fused_only = replace(whole, descriptions=Descriptions(whole.descriptions.fused, *[None] * 3))
    localizer = Localizer(model, fused_only)
    assert localizer.locate(grey(102), cloud(6)).places[0].key == "day/1"
    with pytest.raises(UserError, match="needs an image and a cloud; the query has an image"):
        localizer.locate(grey(102), None)


def test_it_gives_the_pose_where_the_map_knows_it() -> None:
    model = Means()
    places = {p.key: p for p in Localizer(model, make_map(model)).locate(grey(0), None).places}
    assert places["day/0"].T_map_body is None
    assert places["day/1"].T_map_body is not None
    np.testing.assert_array_equal(places["day/1"].T_map_body, np.eye(4))
    assert places["day/1"].position_m == (10.0, 0.0, 0.0)


def test_it_gives_k_places_or_as_many_as_there_are() -> None:
    model = Means()
    place_map = make_map(model)
    assert len(Localizer(model, place_map, k=2).locate(grey(0), None).places) == 2
    assert len(Localizer(model, place_map, k=9).locate(grey(0), None).places) == 4
    with pytest.raises(ValueError, match="k 0"):
        Localizer(model, place_map, k=0)


def test_it_answers_in_plain_values_for_json() -> None:
    model = Means()
    localizer = Localizer(model, make_map(model), k=1)
    told = json.loads(json.dumps(localizer.locate(grey(0), cloud(8)).to_dict()))
    assert told == {
        "places": [
            {"key": "day/0", "distance": 0.0, "position_m": [0.0, 0.0, 0.0], "T_map_body": None}
        ],
        "alpha": {"image": 0.75, "lidar": 0.25},
        "used": ["image", "lidar"],
    }
    told = localizer.locate(grey(102), None).to_dict()
    assert told["alpha"] is None
    assert told["places"][0]["T_map_body"] == np.eye(4).tolist()


def test_it_refuses_a_map_of_another_model() -> None:
    with pytest.raises(UserError, match=r"model: 'means-adafusion', .* model fingerprint .* load"):
        Localizer(Means(scale=2.0), make_map(Means()))


def test_it_refuses_a_map_of_another_preprocessing() -> None:
    model, other = Means(), Means()
    other.config = replace(other.config, preprocess=Preprocess())
    with pytest.raises(UserError, match=r"preprocess fingerprint .* instead of .* load the"):
        Localizer(other, make_map(model))


def test_it_leaves_the_map_and_the_mode_of_the_model_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "campus.map"
    model = Means()
    make_map(model).save(path)
    stored = {p: p.read_bytes() for p in path.rglob("*") if p.is_file()}
    place_map = PlaceMap.open(path)
    model.train()
    localizer = Localizer(model, place_map)
    for query in ((grey(0), cloud(8)), (grey(0), None), (None, cloud(8))):
        localizer.locate(*query)
    with pytest.raises(UserError):
        localizer.locate(None, None)
    assert model.training
    assert {p: p.read_bytes() for p in path.rglob("*") if p.is_file()} == stored
    assert PlaceMap.open(path).fingerprint == place_map.fingerprint == make_map(model).fingerprint


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((8, 12), np.uint8), r"uint8 of shape \(8, 12\); give RGB"),
        (np.zeros((3, 8, 12), np.uint8), r"shape \(3, 8, 12\); give RGB"),
        (np.zeros((8, 12, 3), np.float32), r"float32 of shape"),
        (np.zeros((0, 12, 3), np.uint8), r"image is empty"),
    ],
)
def test_it_refuses_what_is_no_image(image: np.ndarray, message: str) -> None:
    with pytest.raises(UserError, match=message):
        Localizer(Means(), make_map(Means())).locate(image, cloud(8))


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((5, 4), np.float32), r"shape \(5, 4\).*points\[:, :3\]"),
        (np.zeros(3, np.float32), r"shape \(3,\)"),
        (np.zeros((5, 3), np.int32), r"int32"),
        (np.zeros((0, 3), np.float32), r"cloud is empty"),
        (np.full((5, 3), [[0, np.nan, 1]], np.float32), r"5 of 5 points of the cloud are NaN"),
        (np.array([[0, 0, 1], [np.inf, 0, 1]]), r"1 of 2 points"),
        (np.full((5, 3), 500.0, np.float32), r"no point of the cloud falls into"),
    ],
)
def test_it_refuses_what_is_no_cloud(points: np.ndarray, message: str) -> None:
    with pytest.raises(UserError, match=message):
        Localizer(Means(), make_map(Means())).locate(grey(0), points)


def test_it_takes_clouds_in_double_precision() -> None:
    model = Means()
    localizer = Localizer(model, make_map(model))
    assert localizer.locate(None, cloud(6).astype(np.float64)).places[0].key == "day/1"


@pytest.mark.parametrize("system", ["adafusion", "concat", "image", "lidar"])
def test_it_finds_each_place_of_a_map_made_by_the_network_itself(system: str) -> None:
    preprocess = Preprocess(image=ImageSettings(size=(48, 64)), voxels=VoxelGrid(shape=(16, 16, 8)))
    torch.manual_seed(0)
    model = AdaFusion(ModelConfig(system=system, width=0.125, dim=16, preprocess=preprocess))
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 256, (60, 80, 3), dtype=np.uint8) for _ in range(3)]
    clouds = [rng.uniform((-20, -20, 0.5), (20, 20, 5), (300, 3)) for _ in range(3)]
    batches = [
        tuple(x[None] for x in model.preprocess(image, points))
        for image, points in zip(images, clouds, strict=True)
    ]
    place_map = PlaceMap.from_descriptions(
        [Frame(run="day", timestamp_us=i, position_m=(float(i), 0.0, 0.0)) for i in range(3)],
        describe(model, batches),
        header=header_of(model),
        dataset="random",
    )
    localizer = Localizer(model, place_map)
    sensors = {"image": images, "lidar": clouds}
    asked = [("image", "lidar"), *((name,) for name in sensors if system not in sensors)]
    for used in asked:
        for i in range(3):
            query = (values[i] if name in used else None for name, values in sensors.items())
            best = localizer.locate(*query).places[0]
            assert (best.key, best.distance) == (f"day/{i}", pytest.approx(0.0, abs=1e-4))
