# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Do the weights move along the way as the paper's demonstration shows them?

It shows alpha over its mean on a stretch of each of five kinds. Here each kind is a claim about the
whole test set, and the stretch an illustration (see `stretches` for where).

Indoor and outdoor are nearly one claim: over all frames both ratios have mean 1, so if the camera
leads indoors the LiDAR leads outdoors.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from adafusion.experiments.judging import blocks_and_worlds
from adafusion.experiments.page import in_percent
from adafusion.experiments.studies.described import WEIGHED, described_by_seed
from adafusion.experiments.studies.stretches import (
    CLAIMS,
    Claim,
    Rows,
    Stay,
    choose_stretch,
    stays,
)
from adafusion.experiments.studies.weights_picture import draw_weights
from adafusion.experiments.study import Study, Trained
from adafusion.experiments.verdict import NOT_RANKED, Asked, Verdict, judge_difference
from adafusion.types import SENSORS, Frame

NEAR = 4  # frames before a door and behind it that are compared
SAME_DOOR_M = 20.0  # between the first frames behind it, in two runs
EQUAL = 0.1  # ratios that differ by less are about equal
THUMBNAIL_PX = 120  # width


@dataclass(frozen=True, eq=False)
class TestFrames:
    """The test frames of all worlds: where each lies, as in `Asked`, with a run as the split."""

    __test__ = False  # no test, whatever its name

    frames: tuple[Frame, ...]
    asked: Asked
    rows: tuple[Rows, ...]  # of each world's dataset

    @classmethod
    def of(cls, trained: Trained) -> TestFrames:
        """The frames that ask a question under the first protocol."""
        frames: list[Frame] = []
        rows = []
        for exam in trained.exams:
            splits = exam.splits(trained.experiment.protocols[0])
            here = np.unique(np.concatenate([split.query_rows for split in splits]))
            rows.append(here.astype(np.int64))
            frames += [exam.dataset.frames[row] for row in here]
        block, world = blocks_and_worlds(trained.exams, rows)
        runs = [f"{w} {frame.run}" for w, frame in zip(world, frames, strict=True)]
        split = np.unique(runs, return_inverse=True)[1]
        return cls(tuple(frames), Asked(split, block, world), tuple(rows))


def judge_claim(
    claim: Claim, test: TestFrames, ratio: Float64[np.ndarray, "seed n 2"]
) -> Verdict | None:
    """The claim over all stays: the mean step at their doors, or the mean of all frames inside.

    `ratio` is alpha over its mean, of every test frame; it counts as known. The interval is that of
    `adafusion.experiments.verdict`, with a run for a split and a step at its first frame inside.
    None where the frames have no such stay.
    """
    image, lidar = np.moveaxis(ratio, -1, 0)
    read = {"image": image, "lidar": lidar, "lead": image - lidar}[claim.reads]
    found = stays(claim, test.frames)
    if claim.before is None:
        rows = np.concatenate([*(stay.inside for stay in found), np.zeros(0, np.int64)])
        values = read[:, rows]
    else:
        rows, values = _steps(found, read)
    if claim.less is not None:
        others = _steps(stays(claim.less, test.frames), read)
        rows, values = _less(rows, values, *others, test)
    if not len(rows):
        return None
    where = Asked(test.asked.split[rows], test.asked.block[rows], test.asked.world[rows])
    return judge_difference(values, np.zeros_like(values), where)


def _steps(
    found: Sequence[Stay], read: Float64[np.ndarray, "seed n"]
) -> tuple[Rows, Float64[np.ndarray, "seed stays"]]:
    """The first row inside of each stay, and by how much what is read rises at its door."""
    rows = np.array([stay.inside[0] for stay in found], np.int64)
    steps = np.zeros((len(read), len(found)))
    for k, stay in enumerate(found):
        steps[:, k] = read[:, stay.inside[:NEAR]].mean(axis=1)
        steps[:, k] -= read[:, stay.before[-NEAR:]].mean(axis=1)
    return rows, steps


def _less(
    rows: Int64[np.ndarray, " stays"],
    steps: Float64[np.ndarray, "seed stays"],
    other_rows: Int64[np.ndarray, " others"],
    others: Float64[np.ndarray, "seed others"],
    test: TestFrames,
) -> tuple[Int64[np.ndarray, " paired"], Float64[np.ndarray, "seed paired"]]:
    """Take off the mean of the other steps at each door; doors without another are left out."""
    xy, world = np.array([frame.position_m[:2] for frame in test.frames]), test.asked.world
    apart = np.hypot(*np.moveaxis(xy[rows, None] - xy[None, other_rows], -1, 0))
    is_same = (apart <= SAME_DOOR_M) & (world[rows, None] == world[None, other_rows])
    kept = is_same.any(axis=1)
    weight = is_same[kept] / is_same[kept].sum(axis=1, keepdims=True)
    return rows[kept], steps[:, kept] - others @ weight.T


def claim_word(claim: Claim, verdict: Verdict) -> str:
    """ "holds", "fails", "undecided", or "" where nothing is claimed.

    About equal holds if the interval lies within `EQUAL` of 0 and fails if it lies wholly beyond.
    """
    if not claim.expected:
        return ""
    interval = verdict.difference.interval
    if interval is None or len(verdict.by_seed) < 2:
        return "undecided"
    if claim.expected == "equal":
        low, high = interval
        if max(-low, high) < EQUAL:
            return "holds"
        return "fails" if low > EQUAL or high < -EQUAL else "undecided"
    if verdict.word == "undecided":
        return "undecided"
    return "holds" if verdict.word == claim.expected else "fails"


def measure_weights(trained: Trained) -> dict[str, Any]:
    """Every claim over the whole test set, and a stretch that shows it."""
    test = TestFrames.of(trained)
    chosen = [choose_stretch(claim, test.frames) for claim in CLAIMS]
    by_seed = []
    for descriptions in described_by_seed(trained, WEIGHED):
        parts = []
        for described, rows in zip(descriptions, test.rows, strict=True):
            assert described.alpha is not None  # the row has weights
            parts.append(described.alpha[rows])
        by_seed.append(np.concatenate(parts).astype(np.float64))
    alpha = np.stack(by_seed)
    mean = alpha.mean(axis=1, keepdims=True)
    ratio = alpha / mean
    claims = []
    for claim, stretch in zip(CLAIMS, chosen, strict=True):
        line: dict[str, Any] = {"name": claim.name, "words": claim.words, "reads": claim.reads}
        line |= {"claimed": claim.expected, "shown": claim.shown, "stretch": None}
        verdict = judge_claim(claim, test, ratio)
        if verdict is not None and stretch is not None:
            word = claim_word(claim, verdict)
            line |= {
                "difference": asdict(verdict.difference),
                "by_seed": list(verdict.by_seed),
                "counted": verdict.num_queries,
                "verdict": word if not word or WEIGHED in trained.converged else NOT_RANKED,
                "stretch": _stretch(trained, test, *stretch, ratio),
            }
        claims.append(line)
    return {"frames": len(test.frames), "mean_alpha": mean[:, 0].tolist(), "claims": claims}


def _stretch(
    trained: Trained,
    test: TestFrames,
    rows: Rows,
    door: int | None,
    ratio: Float64[np.ndarray, "seed n 2"],
) -> dict[str, Any]:
    """What the picture needs of a stretch, with three of its images."""
    frames = [test.frames[row] for row in rows]
    dataset = trained.exams[int(test.asked.world[rows[0]])].dataset
    images = [dataset.load(frame).image for frame in frames]
    seen = [image for image in images if image is not None]  # all: a test frame has both sensors
    return {
        "frames": [frame.key for frame in frames],
        "zones": [frame.zone for frame in frames],
        "door": door,
        "brightness": [round(float(image.mean()) / 255, 3) for image in seen],
        "ratio": {s: ratio[:, rows, i].round(4).tolist() for i, s in enumerate(SENSORS)},
        "pictures": {str(at): thumbnail(seen[at]) for at in (0, len(seen) // 2, len(seen) - 1)},
    }


def thumbnail(image: UInt8[np.ndarray, "h w 3"]) -> str:
    """A small JPEG in base 64, so that the results can be drawn without the data."""
    height, width = image.shape[:2]
    size = (THUMBNAIL_PX, round(THUMBNAIL_PX * height / width))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR))
    assert done
    return base64.b64encode(data.tobytes()).decode()


def weights_section(study: Mapping[str, Any]) -> list[str]:
    """A table of the claims over the whole test set; differences in percent of the mean weight."""
    lines = [
        "",
        "## Do the weights move as claimed?",
        "",
        f"Alpha of {WEIGHED} over its mean of the {study['frames']} test frames, in percent: the "
        f"step at a door (mean of the first {NEAR} frames behind it minus that of the last {NEAR} "
        "before), or image minus LiDAR inside. 95 % intervals over 50 m blocks, and over seeds "
        "where there are several. "
        f"Rises, falls, leads: the interval leaves 0 out; about equal: it lies within "
        f"{100 * EQUAL:g} of 0. Over all frames both means are 100, so indoor and outdoor are "
        "nearly one claim. A rise from dark to bright speaks of light only where what light adds "
        "is above 0 as well. The picture shows one stretch of each, chosen by zone, run and "
        "position.",
        "",
        "| where | claim | brightness of the stretch shown | found | doors or frames | |",
        "|---|---|---|---|---|---|",
    ]
    for claim in study["claims"]:
        name = f"| {claim['name']} | {claim['words']} |"
        stretch = claim["stretch"]
        if stretch is None:
            lines.append(f"{name} | no such stretch in these data | | |")
            continue
        lines.append(
            f"{name} {_brightness(stretch)} | {in_percent(claim['difference'], '+')} | "
            f"{claim['counted']} | {claim['verdict']} |"
        )
    return lines


def _brightness(stretch: Mapping[str, Any]) -> str:
    """Mean brightness of the stretch's images, before and behind the door where it has one."""
    seen, door = stretch["brightness"], stretch["door"]
    parts = [seen] if door is None else [seen[max(door - NEAR, 0) : door], seen[door : door + NEAR]]
    return " to ".join(f"{100 * np.mean(part):.0f} %" for part in parts)


WEIGHTS = Study(measure=measure_weights, section=weights_section, draw=draw_weights)
