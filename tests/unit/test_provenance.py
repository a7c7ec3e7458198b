# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from adafusion.provenance import git_commit, software_versions


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    def git(*arguments: str) -> None:
        identity = ["-c", "user.name=t", "-c", "user.email=t@example.org"]
        subprocess.run(["git", "-C", tmp_path, *identity, *arguments], check=True)

    git("init", "-q")
    (tmp_path / "code.py").write_text("1\n")
    git("add", "code.py")
    git("commit", "-q", "-m", "one")
    return tmp_path


def test_it_names_the_commit_and_whether_files_changed(repository: Path) -> None:
    commit = git_commit(repository / "code.py")
    assert commit is not None
    assert len(commit) == 40
    (repository / "code.py").write_text("2\n")
    assert git_commit(repository / "code.py") == commit + "+"


def test_it_takes_no_commit_of_a_repository_that_does_not_hold_the_code(repository: Path) -> None:
    (repository / "installed.py").write_text("")
    assert git_commit(repository / "installed.py") is None


def test_it_knows_no_commit_outside_a_repository_or_without_git(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert git_commit(tmp_path / "code.py") is None
    assert git_commit(tmp_path / "no" / "folder" / "code.py") is None
    monkeypatch.setenv("PATH", str(tmp_path))
    assert git_commit() is None


def test_it_lists_the_versions_that_decide_numbers() -> None:
    versions = software_versions()
    assert {"python", "platform", "numpy", "torch", "numba"} <= set(versions)
