# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What all tests share: checked shapes, the way to data outside the repository, counted skips."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

install_import_hook("adafusion", "beartype.beartype")  # signatures hold while the tests run


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of real recordings (`kitti_odometry/`, ...), named by ADAFUSION_REAL_DATA."""
    return folder_from_environment("ADAFUSION_REAL_DATA")


@pytest.fixture(scope="session")
def reference_data() -> Path:
    """Folder of values that the released code computed, named by ADAFUSION_REFERENCE."""
    return folder_from_environment("ADAFUSION_REFERENCE")


def folder_from_environment(variable: str) -> Path:
    """Skip where the variable is not set; fail where it is set and leads to nothing."""
    if variable not in os.environ:
        pytest.skip(f"{variable} is not set: it names a folder of data that is not shipped")
    folder = Path(os.environ[variable])
    if not os.environ[variable] or not folder.is_dir() or not any(folder.iterdir()):
        pytest.fail(f"{variable}={os.environ[variable]!r} is no folder with data in it")
    return folder


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    terminalreporter.write_line(f"skipped tests: {len(terminalreporter.stats.get('skipped', []))}")
