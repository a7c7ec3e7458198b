# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from adafusion.config import load_config
from adafusion.models.config import ModelConfig
from adafusion.models.coral import Coral, TopDown, sample
from adafusion.models.describe import describe
from adafusion.preprocess import Elevation, ImageSettings, Preprocess
from adafusion.training import TrainConfig
from adafusion.types import UserError

CONFIGS = Path(__file__).parents[2] / "configs"
PAPER = ModelConfig(
    system="coral",
    dim=0,
    clusters=32,
    preprocess=Preprocess(image=ImageSettings(size=(112, 112)), lidar="elevation"),
)
TINY = replace(
    PAPER,
    width=0.125,
    clusters=4,
    preprocess=Preprocess(
        image=ImageSettings(size=(48, 64)), lidar="elevation", elevation=Elevation(shape=(48, 32))
    ),
)


@pytest.fixture(scope="module")
def paper() -> Coral:
    return Coral(PAPER).eval()


def build(seed: int = 0, **changes: object) -> Coral:
    model = Coral(replace(TINY, **changes))
    model.initialise(torch.Generator().manual_seed(seed))
    return model


def batch(n: int = 2) -> tuple[torch.Tensor, torch.Tensor]:
    """Images, and maps of which about half the cells are seen."""
    random = torch.Generator().manual_seed(1)
    image = torch.rand(n, 3, 48, 64, generator=random) * 2 - 1
    height = torch.rand(n, 1, 48, 32, generator=random)
    where = torch.rand(n, 2, 48, 32, generator=random) * 2 - 1
    unseen = torch.rand(n, 1, 48, 32, generator=random) < 0.5
    return image, torch.cat([height, where.masked_fill(unseen, 2.0)], dim=1)


def count(*modules: nn.Module) -> int:
    return sum(p.numel() for module in modules for p in module.parameters())


def test_it_has_the_papers_parameters(paper: Coral) -> None:
    assert count(paper.image_net.resnet) == 11_176_512
    assert count(paper.image_net.top_down) == 756_224
    assert count(paper.structure) == 18_912
    assert count(paper.colour) == 37_120
    assert count(paper.map_net.stages) == 5_955_328
    assert count(paper.map_net.top_down) == 214_016
    assert count(paper.vlad) == 16_416
    assert count(paper) == 18_174_528


def test_it_has_the_papers_maps(paper: Coral) -> None:
    image, lidar = torch.zeros(1, 3, 112, 112), torch.zeros(1, 3, 80, 80)
    cells = torch.zeros(1, 64, 80, 80)
    with torch.inference_mode():
        maps = paper.image_net.resnet(image)
        assert [tuple(x.shape[1:]) for x in maps] == [
            (64, 54, 54),
            (128, 27, 27),
            (256, 14, 14),
            (512, 7, 7),
        ]
        assert paper.image_net(image).shape == (1, 512, 56, 56)
        sizes = []
        for stage in paper.map_net.stages:
            cells = stage(cells)
            sizes.append(tuple(cells.shape[1:]))
        assert sizes == [(64, 40, 40), (128, 20, 20), (192, 10, 10), (256, 5, 5)]
        assert paper.map_net(torch.zeros(1, 64, 80, 80)).shape == (1, 256, 20, 20)
        assert paper(image, lidar).fused.shape == (1, 8192)


def test_a_length_adds_one_linear_layer(paper: Coral) -> None:
    short = Coral(replace(PAPER, dim=256))
    assert count(short) == count(paper) + 8192 * 256 + 256


@pytest.mark.parametrize(("dim", "length"), [(0, 128), (12, 12)])
def test_the_descriptor_is_of_length_1_and_there_are_no_halves(dim: int, length: int) -> None:
    d = build(dim=dim).eval()(*batch())
    assert d.fused.shape == (2, length)
    assert torch.allclose(d.fused.norm(dim=1), torch.ones(2))
    assert d[1:] == (None, None, None)


def test_without_a_sensor_there_is_nothing_to_give() -> None:
    model = build().eval()
    image, lidar = batch()
    assert all(part is None for part in model(image, None))
    assert all(part is None for part in model(None, lidar))
    with pytest.raises(ValueError, match="nothing"):
        model(None, None)


def test_a_cell_takes_what_the_image_has_at_its_place() -> None:
    features = torch.arange(8.0).view(1, 1, 2, 4)  # columns' middles at x = -3/4, -1/4, 1/4, 3/4
    x = torch.tensor([[-0.75, 0.0, 0.75, 1.0]])
    y = torch.tensor([[-0.5, -0.5, 0.5, 0.0]])  # rows' at -1/2 and 1/2
    taken = sample(features, torch.stack([x, y], dim=1)[:, :, None])
    assert taken.flatten().tolist() == pytest.approx([0.0, 1.5, 7.0, 5.0])


def test_the_map_of_features_covers_what_the_image_covers() -> None:
    """What changes in one corner of the image changes the features there, and nowhere far away."""
    net = build().image_net.eval()
    image = batch(1)[0]
    changed = image.clone()
    changed[..., 40:, 56:] = 1.0
    with torch.no_grad():
        for lateral in net.top_down.laterals[1:]:  # deeper maps see the whole image
            lateral.weight.zero_()
        difference = (net(changed) - net(image)).abs().sum(dim=1)[0]
    rows, columns = difference.shape
    assert (rows, columns) == (24, 32)  # half the image's
    difference[rows // 2 :, columns // 2 :] = 0.0
    assert not difference.any()


def test_a_cell_that_is_not_seen_takes_nothing_of_the_image() -> None:
    model = build().eval()
    image, lidar = batch()
    lidar[:, 1:] = 2.0
    assert torch.equal(model(image, lidar).fused, model(-image, lidar).fused)
    empty = torch.zeros_like(lidar)  # as where a frame's cloud is taken away in training
    assert torch.equal(model(image, empty).fused, model(-image, empty).fused)
    lidar[:, 1:, 3, 4] = 0.0
    assert not torch.equal(model(image, lidar).fused, model(-image, lidar).fused)


def test_maps_are_enlarged_and_added_to_the_first_ones_size() -> None:
    net = TopDown((1, 1), 1)
    with torch.no_grad():
        for layer in (*net.laterals, net.smooth):
            layer.weight.fill_(1.0)
            layer.bias.zero_()
        deep = torch.tensor([[[[1.0, 3.0]]]])
        shallow = torch.full((1, 1, 1, 4), 10.0)
        assert net([shallow, deep]).flatten().tolist() == [11.0, 11.5, 12.5, 13.0]


def test_every_parameter_learns() -> None:
    model = build(dim=12).train()
    fused = model(*batch(4)).fused
    (fused * torch.randn(fused.shape, generator=torch.Generator().manual_seed(2))).sum().backward()
    stuck = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()]
    assert not stuck


def test_one_frame_is_a_row_of_a_batch() -> None:
    model = build()
    image, lidar = batch(3)
    model.train()(image, lidar)  # norms that have seen something
    model.eval()
    assert torch.allclose(
        model(image, lidar).fused[1:2], model(image[1:2], lidar[1:2]).fused, atol=1e-5
    )


def test_it_is_described_as_any_system_is() -> None:
    d = describe(build(), [batch(2), batch(1)])
    assert d.fused.shape == (3, 128)
    assert d.fused.dtype == np.float32
    assert d.image_half is None
    assert d.lidar_half is None
    assert describe(build(), [(batch(2)[0], None)]).fused is None


def test_its_weights_come_from_the_generator_alone() -> None:
    torch.manual_seed(1)
    one = build(dim=12).state_dict()
    torch.manual_seed(2)
    two = build(dim=12).state_dict()
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert build().fingerprint != build(seed=1).fingerprint


def test_what_it_cannot_look_at_is_refused() -> None:
    with pytest.raises(UserError, match=r"preprocess\.lidar=elevation"):
        Coral(ModelConfig(system="coral"))
    image, lidar = batch()
    with pytest.raises(ValueError, match=r"takes \(3, 48, 32\)"):
        build()(image, lidar[:, :, :40])
    with pytest.raises(ValueError, match=r"takes \(48, 64\)"):
        build()(image[..., :32], lidar)


def test_its_training_is_the_papers() -> None:
    config = load_config(TrainConfig, CONFIGS / "coral.yaml")
    assert config.model == PAPER
    assert count(Coral(config.model)) == 18_174_528
    o, s = config.optimiser, config.sampling
    assert (o.kind, o.learning_rate, o.momentum, o.weight_decay) == ("sgd", 1e-3, 0.9, 5e-4)
    assert (o.schedule, o.steps) == ("step", 1)  # the rate stays as it is
    assert (config.loss.kind, config.loss.margin, config.loss.other_margin) == (
        "hard-quadruplet",
        0.5,
        0.2,
    )
    assert (s.tuples, s.positives, s.negatives, s.d_pos_m, s.d_neg_m) == (1, 2, 18, 10.0, 50.0)
    assert config.epochs == 100


def test_the_small_one_is_as_large_as_its_file_says() -> None:
    config = load_config(TrainConfig, CONFIGS / "coral-s.yaml").model
    assert count(Coral(config)) == 1_405_208
