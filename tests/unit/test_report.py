# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import base64
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from adafusion.report import (
    AlphaTrace,
    Candidate,
    Estimate,
    MeanAlpha,
    PairDistances,
    ProtocolFacts,
    ReportData,
    Retrieval,
    RouteView,
    SeenPlace,
    SplitCount,
    SystemResult,
    write_report,
)
from adafusion.report.html import interval, jpeg, percent, points, render, who_may_answer
from adafusion.types import AlphaSummary

VOID = {"meta", "link", "br", "img", "input", "hr"}


class Page(HTMLParser):
    """Text, tags and attributes of a page; an element that does not close is an error."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(html)
        self.close()
        assert not self.open
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words.append(data)


def bare(**changes: object) -> ReportData:
    """The least that a report can be made of."""
    data = ReportData(
        title="day against night",
        created="2026-11-22",
        dataset="campus 1",
        synthetic=False,
        protocol=ProtocolFacts(name="cross-run", words="", radius_m=20.0, distance="L1"),
        systems=(SystemResult(name="lidar", recall={1: Estimate(0.5), 2: Estimate(0.75)}),),
    )
    return replace(data, **changes)


def full() -> ReportData:
    rng = np.random.default_rng(0)
    along = np.arange(12.0)
    place = SeenPlace(
        key="night/17",
        image=rng.integers(0, 255, (60, 80, 3), dtype=np.uint8),
        points_body=rng.normal(0, 5, (100, 3)).astype(np.float32),
        alpha=(0.25, 0.75),
    )
    top1 = Candidate(place=place, rank=1, distance=3.5, away_m=120.0, image_share=0.3)
    nothing = SeenPlace(key="night/18")
    return bare(
        synthetic=True,
        protocol=ProtocolFacts(
            name="cross-run",
            words="One run asks, another answers.",
            radius_m=20.0,
            distance="L1",
            splits=(SplitCount(name="day->night", queries=1234, left_out=7, database=240),),
            intervals="bootstrap",
        ),
        systems=tuple(
            SystemResult(
                name=name,
                recall={
                    k: Estimate(r, (r - 0.1, r + 0.1))
                    for k, r in zip((1, 5, 10), (0.5, 0.7, 0.9), strict=True)
                },
                recall_at_1_percent=Estimate(0.7, (0.6, 0.8)),
                gap=Estimate(-0.02, (-0.05, 0.01)) if name == "lidar" else None,
                fingerprint="0123456789abcdef",
            )
            for name in ("lidar", "adafusion")
        ),
        routes=(
            RouteView(
                system="adafusion",
                split="day->night",
                database_xy_m=rng.normal(0, 50, (30, 2)),
                query_xy_m=rng.normal(0, 50, (12, 2)),
                is_hit=along > 4,
                is_answerable=along > 1,
                top1_xy_m=rng.normal(0, 50, (12, 2)),
            ),
        ),
        mean_alpha=(
            MeanAlpha(
                system="adafusion",
                by_run={"day": AlphaSummary(12, (0.2, 0.8), (0.0, 0.0))},
                by_zone={"tunnel": AlphaSummary(6, (0.15, 0.85), (0.05, 0.1))},
            ),
        ),
        alpha=tuple(
            AlphaTrace(
                system="adafusion",
                run=run,
                along_m=along,
                alpha=np.full((12, 2), (0.2, 0.8)),
                zones=("street",) * 6 + ("tunnel",) * 6,
            )
            for run in ("day", "night")
        ),
        retrievals=(
            Retrieval(system="adafusion", query=place, top1=top1, true=None, is_hit=False),
            Retrieval(
                system="adafusion",
                query=nothing,
                top1=replace(top1, place=nothing),
                true=top1,
                is_hit=True,
            ),
        ),
        distances=(
            PairDistances(system="adafusion", true=rng.random(50), wrong=1 + rng.random(50)),
        ),
        facts={"commit": "abc1234"},
        command="adafusion evaluate <model>",
        config="model: {name: adafusion}",
    )


@pytest.fixture(scope="module")
def html() -> str:
    return render(full())


def test_a_report_is_one_whole_file(tmp_path: Path) -> None:
    path = write_report(str(tmp_path / "new" / "report.html"), bare())
    assert path.read_text(encoding="utf-8") == render(bare())
    assert [file.name for file in path.parent.iterdir()] == ["report.html"]


def test_a_report_is_well_formed_and_says_what_was_measured(html: str) -> None:
    page = Page(html)
    for words in (
        "adafusion names the right place first 50.0 % of the time",
        "(95 % interval 40.0–60.0 %)",
        "asked 1 227 queries",
        "Right means within 20 m, protocol cross-run",
        "SYNTHETIC",
        "−2.0 −5.0 to +1.0",
        "may answer every frame of the database queries counted 1 227; 7 more",
        "day → night 1 234 7 240",
        "✗ miss adafusion: answered 120 m away",
        "rank 1, 120.0 m from the query, distance 3.5",
        "distance 30 : 70",
        "adafusion run day 12 0.20 ± 0.00 0.80 ± 0.00",
        "adafusion zone tunnel 6 0.15 ± 0.05 0.85 ± 0.10",
        "no image no cloud",
        "adafusion evaluate <model>",
        "abc1234",
    ):
        assert words in page.text


def test_a_report_asks_nothing_of_the_network(html: str) -> None:
    page = Page(html)
    for tag, attributes in page.tags:
        assert tag not in {"script", "iframe", "object"}
        for name in ("src", "href", "xlink:href"):
            address = attributes.get(name) or "#"
            assert address.startswith(("data:", "#")), f"<{tag} {name}={address[:60]}>"
    assert "@import" not in html
    assert all(address.startswith("#") for address in re.findall(r"url\((.*?)\)", html))


def test_no_two_elements_share_an_id(html: str) -> None:
    ids = [attributes["id"] for _, attributes in Page(html).tags if "id" in attributes]
    assert len(ids) == len(set(ids))


def test_every_picture_has_words_for_who_cannot_see_it(html: str) -> None:
    tags = Page(html).tags
    assert all(attributes.get("alt") for tag, attributes in tags if tag == "img")
    assert all(attributes.get("aria-label") for tag, attributes in tags if tag == "svg")


def test_the_same_data_make_the_same_page(html: str) -> None:
    assert render(full()) == html


def test_a_report_without_extras_shows_only_the_recall() -> None:
    page = Page(render(bare()))
    assert (
        "lidar names the right place first 50.0 % of the time. Right means within 20 m" in page.text
    )
    for absent in ("SYNTHETIC", "trusted", "route", "side by side", "fingerprint", "Configuration"):
        assert absent not in page.text


def test_words_from_outside_stay_words() -> None:
    html = render(bare(title="<script>alert(1)</script>", dataset="a & b"))
    assert "<script" not in html
    assert "a &amp; b" in html


def test_an_answer_that_is_the_true_match_is_shown_once() -> None:
    found = full().retrievals[0].top1
    hit = replace(full().retrievals[0], true=found, is_hit=True)
    page = Page(render(bare(retrievals=(hit,))))
    assert "The answer is the true match." in page.text
    assert page.text.count("rank 1,") == 1


def test_names_of_runs_may_hold_anything() -> None:
    trace = AlphaTrace(
        system="a&b", run="$夜$ <1>", along_m=np.arange(3.0), alpha=np.full((3, 2), 0.5)
    )
    means = MeanAlpha(system="a&b", by_run={"$夜$ <1>": AlphaSummary(3, (0.5, 0.5), (0.0, 0.0))})
    page = Page(render(bare(alpha=(trace,), mean_alpha=(means,))))
    assert page.text.count("$夜$ <1>") == 2  # in the table and in the chart


def test_without_jinja_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(ModuleNotFoundError, match=r"adafusion\[report\]"):
        render(bare())


def test_an_unknown_headline_is_refused() -> None:
    with pytest.raises(ValueError, match="none of the systems"):
        bare(headline="fused")


@pytest.mark.parametrize("recall", [{1: Estimate(50.0)}, {5: Estimate(0.5)}])
def test_recall_in_percent_or_without_its_first_entry_is_refused(
    recall: dict[int, Estimate],
) -> None:
    with pytest.raises(ValueError, match=r"fractions in \[0, 1\]"):
        SystemResult(name="lidar", recall=recall)


@pytest.mark.parametrize(
    ("exclude_self", "exclude_query_run", "words"),
    [
        (False, False, "every frame of the database"),
        (True, False, "its neighbours in its own run may"),
        (True, True, "except those of the query's own run"),
    ],
)
def test_who_may_answer_is_said_in_words(
    exclude_self: bool, exclude_query_run: bool, words: str
) -> None:
    facts = ProtocolFacts(
        name="union",
        words="",
        radius_m=20.0,
        distance="L1",
        exclude_self=exclude_self,
        exclude_query_run=exclude_query_run,
    )
    assert who_may_answer(facts).endswith(words)


def test_numbers_are_printed_in_percent() -> None:
    assert percent(1 / 3) == "33.3\u00a0%"
    assert interval(Estimate(0.5)) == ""
    assert interval(Estimate(0.5, (0.25, 0.75))) == "25.0–75.0"
    assert points(0.0312) == "+3.1"


def test_a_large_image_is_made_smaller_and_keeps_its_colours() -> None:
    red = np.zeros((300, 800, 3), np.uint8)
    red[..., 0] = 255
    data = base64.b64decode(jpeg(red).removeprefix("data:image/jpeg;base64,"))
    seen = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB)
    assert seen.shape == (150, 400, 3)
    assert seen[75, 200, 0] > 240
    assert seen[75, 200, 1:].max() < 20
