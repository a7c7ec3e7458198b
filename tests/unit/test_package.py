# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version

import pytest

import adafusion


def test_every_public_name_is_there() -> None:
    for name in adafusion.__all__:
        assert getattr(adafusion, name).__name__ == name
        assert name in dir(adafusion)
    with pytest.raises(AttributeError, match="load_modle"):
        adafusion.load_modle  # noqa: B018


def test_importing_it_waits_for_nothing_heavy() -> None:
    for module, heavy in (("adafusion", {"numpy"}), ("adafusion.cli", set())):
        code = f"import sys, {module}; print(*sys.modules)"
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        )
        assert not {"torch", "numba", "cv2", "lancedb", *heavy} & set(done.stdout.split())


def test_it_says_the_version_that_is_installed() -> None:
    assert adafusion.__version__ == version("adafusion")
