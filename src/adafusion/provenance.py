# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Which software made a result: versions, machine, and the commit where there is one."""

from __future__ import annotations

import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("adafusion", "torch", "numpy", "scipy", "numba", "opencv-python-headless")


def software_versions() -> dict[str, str]:
    """Versions of Python, of the packages that decide numbers, and the machine they ran on."""
    versions = {"python": platform.python_version(), "platform": platform.platform()}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:  # the source tree, used without installing it
            continue
    return versions


def git_commit(path: str | Path = __file__) -> str | None:
    """Commit of the repository that tracks `path`, "+" behind it where tracked files were changed.

    None where nothing is known: no git, no repository, or one that does not hold `path` (such as a
    project that merely has this package installed inside its folder).
    """
    path = Path(path).resolve()
    try:
        _git(path.parent, "ls-files", "--error-unmatch", path.name)
        commit = _git(path.parent, "rev-parse", "HEAD")
        changed = _git(path.parent, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return None
    return commit + ("+" if changed else "")


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10)
    return done.stdout.strip()
