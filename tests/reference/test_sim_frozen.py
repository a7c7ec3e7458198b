# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What the sensors gave when the named worlds were frozen, in a few numbers a frame.

Hashes hold what stands and moves; these hold how it is seen. Recorded by
`python tests/reference/test_sim_frozen.py` when they were; another machine's arithmetic may
differ in the last bits, a changed texture, lamp or laser does not fit in the tolerance.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from adafusion.sim.benchmarks import BENCHMARKS
from adafusion.sim.studio import Studio, make_job

RECORD = Path(__file__).with_name("frozen_world_v1.json")
PLACES = (12, 60, 100)


def look(run: str) -> dict[str, object]:
    """Mean colours of the picture in 3 x 4 fields, and the ranges of the scan in eight sectors."""
    part = BENCHMARKS["world-v1-tiny"].parts["test"]
    studio = Studio(make_job(part.seed, [run], part.profile))
    seen = {}
    for k in PLACES:
        image = studio.image(run, k).astype(float)
        fields = image[:75, :100].reshape(3, 25, 4, 25, 3).mean(axis=(1, 3))
        points = studio.points(run, k)
        sector = ((np.arctan2(points[:, 1], points[:, 0]) + np.pi) / (np.pi / 4)).astype(int) % 8
        far = np.linalg.norm(points, axis=1)
        seen[str(k)] = {
            "fields": np.round(fields, 1).tolist(),
            "points": len(points),
            "mean_range_m": [round(float(far[sector == s].mean()), 2) for s in range(8)],
        }
    return seen


def record() -> dict[str, object]:
    return {run: look(run) for run in BENCHMARKS["world-v1-tiny"].runs}


@pytest.mark.parametrize("run", BENCHMARKS["world-v1-tiny"].runs)
def test_the_sensors_still_give_what_they_gave(run: str) -> None:
    frozen, now = json.loads(RECORD.read_text(encoding="utf-8"))[run], look(run)
    for k in frozen:
        np.testing.assert_allclose(now[k]["fields"], frozen[k]["fields"], atol=1.5)
        np.testing.assert_allclose(now[k]["mean_range_m"], frozen[k]["mean_range_m"], rtol=0.02)
        assert now[k]["points"] == pytest.approx(frozen[k]["points"], rel=0.005)


if __name__ == "__main__":
    RECORD.write_text(json.dumps(record(), indent=1) + "\n", encoding="utf-8")
    print(RECORD, file=sys.stderr)
