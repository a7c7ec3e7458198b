# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from adafusion.readers.text import path_inside, read_numbers, read_records, read_text
from adafusion.types import UserError


@pytest.fixture
def table(tmp_path: Path):
    """Write text or bytes; return the path."""

    def write(content: str | bytes) -> Path:
        path = tmp_path / "table.txt"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def test_text_comes_without_a_byte_order_mark(table) -> None:
    assert read_text(table("\ufeffgrün\r\n"), "mend") == "grün\n"


@pytest.mark.parametrize("content", [b"\xff\xfe", b"a\x80"])
def test_text_that_is_no_utf8_is_refused(table, content: bytes) -> None:
    with pytest.raises(UserError, match=r"table\.txt cannot be read .*: fetch it again"):
        read_text(table(content), "fetch it again")


def test_text_that_is_missing_or_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"none is missing: fetch it"):
        read_text(tmp_path / "none", "fetch it")
    with pytest.raises(UserError, match=r"cannot be read .*: fetch it"):
        read_text(tmp_path, "fetch it")


@pytest.mark.timeout(20)
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no pipes among its files")
def test_only_a_regular_file_of_bounded_size_is_text(tmp_path: Path) -> None:
    pipe, device, large = (tmp_path / name for name in ("pipe", "device", "large"))
    os.mkfifo(pipe)
    device.symlink_to("/dev/zero")
    with large.open("wb") as file:
        file.truncate(2**31 + 1)  # of which nothing is on disk
    for path, told in ((pipe, "no regular file"), (device, "no regular file"), (large, "2048 MB")):
        with pytest.raises(UserError, match=rf"{path.name} cannot be read .*{told}.*: fetch it"):
            read_text(path, "fetch it")
        with pytest.raises(UserError, match=rf"{path.name} cannot be read .*{told}.*: fetch it"):
            read_numbers(path, 3, remedy="fetch it")


def test_numbers_are_read_past_comments_and_blank_lines(table) -> None:
    path = table("head\n# note\n1 2.5\t-3e2\n\n   \n  # more\n4 5 6\n")
    rows = read_numbers(path, 3, remedy="mend", skip_lines=1)
    np.testing.assert_array_equal(rows, [(1, 2.5, -300), (4, 5, 6)])


def test_numbers_may_have_any_delimiter_and_width(table) -> None:
    path = table("1,2\n3, 4\n")
    np.testing.assert_array_equal(
        read_numbers(path, None, remedy="mend", delimiter=","), [(1, 2), (3, 4)]
    )


def test_microseconds_since_1970_are_exact(table) -> None:
    [[time]] = read_numbers(table("1326652855123457\n"), 1, remedy="mend")
    assert int(time) == 1_326_652_855_123_457


def test_an_empty_table_has_no_rows(table) -> None:
    assert read_numbers(table(""), 3, remedy="mend").shape == (0, 3)
    assert read_numbers(table("# none\n"), None, remedy="mend").shape == (0, 0)


def test_nan_is_taken_only_where_it_is_allowed(table) -> None:
    path = table("1 2\nnan 3\n")
    rows = read_numbers(path, 2, remedy="mend", allow_nan=True)
    np.testing.assert_array_equal(rows, [(1, 2), (np.nan, 3)])
    with pytest.raises(UserError, match=r"table\.txt: line 2 is not 2 finite numbers: mend"):
        read_numbers(path, 2, remedy="mend")


@pytest.mark.parametrize(
    ("content", "columns", "told"),
    [
        ("1 2\n3\n", 2, "line 2 is not 2 finite numbers: mend"),
        ("1 2\n\n3 4 5\n", None, "line 3 is not 2 finite numbers: mend"),
        ("# a\n1 x\n", 2, "line 2 is not 2 finite numbers: mend"),
        ("one\n", None, "line 1 is not finite numbers: mend"),
        ("inf\n", 1, "line 1 is not 1 finite numbers: mend"),
        ("1,2\n", 2, "line 1 is not 2 finite numbers: mend"),
    ],
)
def test_a_bad_row_is_named_by_its_line(
    table, content: str, columns: int | None, told: str
) -> None:
    with pytest.raises(UserError, match=rf"table\.txt: {told}"):
        read_numbers(table(content), columns, remedy="mend")


def test_records_come_by_the_names_of_the_header(table) -> None:
    path = table("b, a ,c\n1, 2,x y\n\n3,,5\n")
    records = list(read_records(path, ["a", "b"], remedy="mend"))
    assert records == [
        (2, {"b": "1", "a": "2", "c": "x y"}),
        (4, {"b": "3", "a": "", "c": "5"}),
    ]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("", "has no column a, b: mend"),
        ("a,c\n1,2\n", "has no column b: mend"),
        ("a,b\n1,2\n1\n", ": line 3 has 1 fields, its header 2: mend"),
        ("a,b\n1,2,3\n", ": line 2 has 3 fields, its header 2: mend"),
        ("a,b,a\n1,2,3\n", "has two columns a: mend"),
    ],
)
def test_records_that_do_not_fit_are_refused(table, content: str, told: str) -> None:
    with pytest.raises(UserError, match=rf"table\.txt{'' if told[0] == ':' else ' '}{told}"):
        list(read_records(table(content), ["a", "b"], remedy="mend"))


def test_columns_without_a_name_may_be_many(table) -> None:
    assert [line for line, _ in read_records(table("a,,\n1,2,3\n"), ["a"], remedy="mend")] == [2]


@pytest.mark.parametrize("name", ["a", "a/b.png", "./a", "a b/ü.png", "..a", "a..b/c"])
def test_names_below_the_root_are_kept(tmp_path: Path, name: str) -> None:
    assert path_inside(tmp_path, name, "t.csv") == tmp_path / name


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../a", "a/../../b", "a/..", "/etc/passwd", "//a", "a\\..\\b", "a\0b"]
)
def test_names_that_lead_out_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UserError, match=r"t\.csv names .* no file below .*: mend the table"):
        path_inside(tmp_path, name, "t.csv")
