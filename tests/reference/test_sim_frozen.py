# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What the sensors gave when the named worlds were frozen, in a few numbers a frame.

Hashes hold what stands and moves; these hold how it is drawn. `python
tests/reference/test_sim_frozen.py` recorded them. Another machine's arithmetic may differ in the
last bits; a texture, a lamp or a laser that was changed does not fit in the tolerance.
"""

from __future__ import annotations

import json
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from adafusion.sim.run.conditions import PRESETS
from adafusion.sim.studio import Studio, make_job

RECORD = Path(__file__).with_name("frozen_world_v1.json")
SEED, PLACES = 1201, (12, 60, 100)
CASES = [*((preset, "tiny") for preset in sorted(PRESETS)), ("day", "compact")]


@cache
def studio(profile: str) -> Studio:
    return Studio(make_job(SEED, sorted(PRESETS), profile))


def look(run: str, profile: str) -> dict[str, dict[str, object]]:
    """Mean and spread of the picture in 3 x 4 fields, points and mean range in eight sectors."""
    seen: dict[str, dict[str, object]] = {}
    for k in PLACES:
        image = studio(profile).image(run, k).astype(float)
        h, w = image.shape[:2]
        fields = image.reshape(3, h // 3, 4, w // 4, 3)
        points = studio(profile).points(run, k)
        sector = ((np.arctan2(points[:, 1], points[:, 0]) + np.pi) / (np.pi / 4)).astype(int) % 8
        count = np.bincount(sector, minlength=8)
        far = np.bincount(sector, np.linalg.norm(points, axis=1), minlength=8)
        seen[str(k)] = {
            "mean": np.round(fields.mean(axis=(1, 3)), 1).tolist(),
            "spread": np.round(fields.std(axis=(1, 3)), 1).tolist(),
            "points": count.tolist(),
            "range_m": np.round(far / np.maximum(count, 1), 2).tolist(),
        }
    return seen


@pytest.mark.parametrize(("run", "profile"), CASES)
def test_the_sensors_still_give_what_they_gave(run: str, profile: str) -> None:
    frozen = json.loads(RECORD.read_text(encoding="utf-8"))[f"{run} {profile}"]
    now = look(run, profile)
    assert set(now) == set(frozen)
    for k, numbers in frozen.items():
        np.testing.assert_allclose(now[k]["mean"], numbers["mean"], atol=0.8)
        np.testing.assert_allclose(now[k]["spread"], numbers["spread"], atol=0.8)
        np.testing.assert_allclose(now[k]["points"], numbers["points"], rtol=0.01, atol=3)
        np.testing.assert_allclose(now[k]["range_m"], numbers["range_m"], rtol=0.01, atol=0.02)


if __name__ == "__main__":
    record = {f"{run} {profile}": look(run, profile) for run, profile in CASES}
    RECORD.write_text(json.dumps(record) + "\n", encoding="utf-8")
    print(RECORD, file=sys.stderr)
