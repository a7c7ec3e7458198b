# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import os
import stat
from pathlib import Path

import pytest

from adafusion.files import (
    atomic_path,
    claim_folder,
    fingerprint,
    make_folder,
    sweep_temporaries,
    write_json,
    write_text,
)
from adafusion.types import UserError


def test_a_file_appears_whole_and_nothing_else_does(tmp_path: Path) -> None:
    target = tmp_path / "new" / "a.txt"
    with atomic_path(target) as temporary:
        temporary.write_text("half")
        assert not target.exists()
        temporary.write_text("whole")
    assert target.read_text() == "whole"
    assert list(target.parent.iterdir()) == [target]


def test_a_failure_leaves_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")

    def fail() -> None:
        with atomic_path(target) as temporary:
            temporary.write_text("half")
            raise RuntimeError("power cut")

    with pytest.raises(RuntimeError, match="power cut"):
        fail()
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_the_temporary_name_keeps_the_suffix_that_encoders_look_at(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "a.png") as temporary:
        assert temporary.suffix == ".png"


def test_others_may_read_what_the_umask_lets_them(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        write_text(tmp_path / "a.txt", "hello")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o644


def test_a_writer_that_makes_private_files_hides_nothing(tmp_path: Path) -> None:
    write_text(tmp_path / "a.txt", "hello")
    with atomic_path(tmp_path / "b.txt") as temporary:
        temporary.write_text("hello")
        temporary.chmod(0o600)
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "b.txt").stat().st_mode


def test_json_comes_back_and_nan_is_refused(tmp_path: Path) -> None:
    value = {"recall": 0.5, "names": ["ü"]}
    write_json(tmp_path / "a.json", value)
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == value
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "b.json", {"recall": float("nan")})
    assert not (tmp_path / "b.json").exists()


def test_a_fingerprint_tells_parts_apart() -> None:
    assert fingerprint("ab", "c") != fingerprint("a", "bc")
    assert fingerprint("a") == fingerprint(b"a")
    assert len(fingerprint()) == 16


def test_what_a_killed_writer_left_is_swept_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed_while_writing(path: Path) -> None:
        with atomic_path(path) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    (tmp_path / ".weights.pt").write_text("the user's")
    (tmp_path / "below").mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", lambda *_, **__: None)  # the killed clean nothing up
        for name in ("weights-30.pt", "README", "below/a.txt"):
            with pytest.raises(KeyboardInterrupt):
                killed_while_writing(tmp_path / name)
    assert len(list(tmp_path.iterdir())) == 4
    sweep_temporaries(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {".weights.pt", "below"}
    assert len(list((tmp_path / "below").iterdir())) == 1


def test_a_folder_of_somebody_elses_files_is_not_claimed(tmp_path: Path) -> None:
    folder = tmp_path / "job.partial"
    claim_folder(folder, "mark")
    claim_folder(folder, "mark")  # empty: nothing to lose
    (folder / ".note.tmp-0123456789abcdef.txt").touch()  # of a writer that was killed
    claim_folder(folder, "mark")
    (folder / "note.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(UserError, match=r"job\.partial holds files"):
        claim_folder(folder, "mark")
    assert (folder / "note.txt").exists()
    (folder / "mark").touch()
    claim_folder(folder, "other", "mark")


def test_a_folder_for_results_is_made_or_refused_by_name(tmp_path: Path) -> None:
    make_folder(tmp_path / "a" / "b")
    make_folder(tmp_path / "a" / "b")
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"file.c cannot be written.*choose another"):
        make_folder(tmp_path / "file" / "c")
    assert list((tmp_path / "a" / "b").iterdir()) == []
