# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Pickles as published code writes them, and pickles that nobody should run."""

from __future__ import annotations

import os
import pickle
import struct
import sys
import tracemalloc
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from adafusion.readers.benchmark_lists import (
    read_evaluation_sets,
    read_file_names,
    read_image_index,
    read_training_queries,
)
from adafusion.readers.pickles import load_pickle
from adafusion.types import UserError


@pytest.fixture
def write(tmp_path: Path):
    """Write bytes to a file."""

    def to_file(data: bytes, name: str = "some.pickle") -> Path:
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return to_file


@pytest.fixture
def training_tuple(monkeypatch: pytest.MonkeyPatch):
    """MinkLoc's class, under the module name that its pickles bear."""

    def make(module: str) -> type:
        class TrainingTuple:
            def __init__(self, **attributes: object) -> None:
                self.__dict__.update(attributes)

        TrainingTuple.__module__, TrainingTuple.__qualname__ = module, "TrainingTuple"
        package, fake = ModuleType("datasets"), ModuleType(module)
        fake.TrainingTuple = TrainingTuple
        monkeypatch.setitem(sys.modules, "datasets", package)
        monkeypatch.setitem(sys.modules, module, fake)
        return TrainingTuple

    return make


# ----------------------------------------------------------------------------------- what it reads


@pytest.mark.parametrize("protocol", range(6))
def test_plain_values_come_back_as_they_were(write, protocol: int) -> None:
    value = {
        "list": [1, -2, 2**40, 2**70, 0.25, "ä", None, True, False],
        7: ({"nested": []}, (), (1,), (1, 2), (1, 2, 3), (1, 2, 3, 4)),
        "bytes": b"\x00\xff",
        "long": list(range(1500)),
    }
    value["again"] = value["list"]
    assert load_pickle(write(pickle.dumps(value, protocol))) == value


@pytest.mark.parametrize("protocol", range(6))
def test_arrays_and_numbers_of_numpy_come_back(write, protocol: int) -> None:
    rows = np.arange(6, dtype=np.int64)
    value = [rows, rows, rows.reshape(2, 3).T, np.array([1.5], ">f4"), np.int64(-3), np.float64(2)]
    value.append(np.array([5735712.5, 620084.25], dtype=object))  # a row of a pandas table
    read = load_pickle(write(pickle.dumps(value, protocol)))
    assert read[0] is read[1]
    for here, there in zip(read, value, strict=True):
        np.testing.assert_array_equal(here, np.asarray(there, dtype=np.asarray(here).dtype))
    assert (type(read[4]), type(read[5])) == (int, float)


def test_it_reads_what_python_2_wrote(write) -> None:
    # {0: {"query": "a.bin", "x": numpy.float64(1.0)}}, protocol 2, module names of numpy 1
    number = struct.pack("<d", 1.0)
    data = (
        b"\x80\x02}K\x00}(U\x05queryU\x05a.binU\x01xcnumpy.core.multiarray\nscalar\n"
        b"cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xff"
        b"K\x00tbU\x08" + number + b"\x86Rus."
    )
    assert load_pickle(write(data)) == {0: {"query": "a.bin", "x": 1.0}}


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
@pytest.mark.parametrize("module", ["datasets.oxford", "datasets.base_datasets"])
def test_it_reads_training_tuples_of_minkloc(
    write, training_tuple, module: str, protocol: int
) -> None:
    make = training_tuple(module)
    queries = {
        k: make(
            id=k,
            timestamp=1400505894395159 + k,
            rel_scan_filepath=f"oxford/run/pointcloud_20m_10overlap/{1400505894395159 + k}.bin",
            positives=np.array([1 - k]),
            non_negatives=np.array([0, 1]),
            position=np.array([5735712.5, 620084.25 + k], dtype=object),
        )
        for k in range(2)
    }
    read = read_training_queries(write(pickle.dumps(queries, protocol)))
    assert read[1].file == "oxford/run/pointcloud_20m_10overlap/1400505894395160.bin"
    assert read[1].positives.tolist() == [0]
    assert read[1].non_negatives.tolist() == [0, 1]
    assert read[1].negatives is None


def test_it_reads_training_queries_of_pointnetvlad(write) -> None:
    queries = {
        0: {"query": "oxford/a/1.bin", "positives": [1], "negatives": [2]},
        1: {"query": "oxford/a/2.bin", "positives": [0], "negatives": []},
        2: {"query": "oxford/a/3.bin", "positives": [], "negatives": [0, 1]},
    }
    read = read_training_queries(write(pickle.dumps(queries, 2)))
    assert [query.file for query in read] == [f"oxford/a/{n}.bin" for n in (1, 2, 3)]
    assert [query.negatives.tolist() for query in read] == [[2], [], [0, 1]]
    assert read[0].non_negatives is None


def test_it_reads_evaluation_sets(write) -> None:
    queries = [
        {0: {"query": "oxford/a/1.bin", "northing": 5.0, "easting": np.float64(6.0), 1: [0, 3]}},
        {0: {"query": "oxford/b/2.bin", "northing": 7.0, "easting": 8, 0: []}},
    ]
    (first,), (second,) = read_evaluation_sets(write(pickle.dumps(queries)))
    assert (first.file, first.northing_m, first.easting_m) == ("oxford/a/1.bin", 5.0, 6.0)
    assert {run: rows.tolist() for run, rows in first.matches.items()} == {1: [0, 3]}
    assert second.matches[0].tolist() == []


def test_it_reads_which_image_is_nearest(write) -> None:
    times = np.array([1400505894395100, 1400505894395300])
    index = {np.int64(1400505894395159): list(times)}
    read = read_image_index(write(pickle.dumps(index)))
    assert read[1400505894395159].tolist() == times.tolist()


# --------------------------------------------------------------------------------- what it refuses


class Shell:
    """Makes a directory when it is unpickled by Python."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self):
        return os.system, (f"mkdir {self.folder}",)


@pytest.mark.parametrize("protocol", range(6))
def test_it_refuses_a_command_by_name_and_does_not_run_it(
    write, tmp_path: Path, protocol: int
) -> None:
    trap = tmp_path / "sprung"
    path = write(pickle.dumps({0: [Shell(trap)]}, protocol))
    with pytest.raises(UserError, match=r"some\.pickle wants (posix|nt)\.system"):
        load_pickle(path)
    assert not trap.exists()


@pytest.mark.parametrize(
    "data",
    [
        b"cbuiltins\neval\n(X\x04\x00\x00\x001+1\ntR.",
        b"cnumpy.core.multiarray\nfromfile\n.",
        b"cdatasets.oxford\n__import__\n.",
        b"cposix\nscalar\n.",
        b"(S'mkdir x'\nios\nsystem\n.",  # INST
        b"\x80\x02\x82\x01.",  # a number of the extension registry
        b"Psomething\n.",  # a persistent id
    ],
)
def test_it_refuses_every_other_name_and_instruction(write, data: bytes) -> None:
    with pytest.raises(UserError, match=r"wants|uses"):
        load_pickle(write(data))


def nested(levels: int) -> bytes:
    """Instructions that leave a tuple of two equal tuples of two ... on the stack."""
    return b")q\x00" + b"h\x00h\x00\x86q\x00" * levels


@pytest.mark.parametrize(
    "data",
    [
        nested(18) + b"X\x01\x00\x00\x00x\x93.",  # as the module of a name
        b"X\x01\x00\x00\x00x" + nested(18) + b"\x93.",  # as a name
        b"cnumpy\ndtype\n" + nested(18) + b"\x85R.",  # as the type of an array
        b"c" + b"a" * 100_000 + b"\nb\n.",
        b"cnumpy\ndtype\nX\x40\x42\x0f\x00" + b"a" * 1_000_000 + b"\x85R.",
    ],
)
def test_what_it_says_of_a_name_is_short_whatever_stands_for_it(write, data: bytes) -> None:
    with pytest.raises(UserError, match=r"some\.pickle") as error:
        load_pickle(write(b"\x80\x04" + data))
    path = str(write(b""))
    assert len(str(error.value)) < len(path) + 300


def test_arrays_of_objects_and_records_are_refused(write) -> None:
    for value in (np.zeros(2, [("a", "i4")]), np.array(["text"]), np.array([{}], dtype=object)):
        with pytest.raises(UserError, match=r"some\.pickle"):
            load_pickle(write(pickle.dumps(value)))


@pytest.mark.parametrize(
    "shape",
    [b"J\xff\xff\xff\x7f\x85", b"J\xff\xff\xff\x7fJ\xff\xff\xff\x7f\x86", b"J\xff\xff\xff\xff\x85"],
)
def test_an_array_is_not_believed_to_be_as_large_as_it_claims(write, shape: bytes) -> None:
    data = (
        b"\x80\x03cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R"
        b"(K\x01" + shape + b"cnumpy\ndtype\nX\x02\x00\x00\x00i8K\x00K\x01\x87R(K\x03X\x01\x00\x00"
        b"\x00<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89C\x08\x00\x00\x00\x00\x00\x00\x00"
        b"\x00tb."
    )
    with pytest.raises(UserError, match="an array"):
        load_pickle(write(data))


def test_what_is_copied_again_and_again_is_counted(write) -> None:
    text = b"X" + struct.pack("<I", 1000) + b"a" * 1000
    latin1 = b"X" + struct.pack("<I", 6) + b"latin1"
    first = b"c_codecs\nencode\nq\x00" + text + b"q\x01" + latin1 + b"q\x02\x86Ra"
    again = b"h\x00h\x01h\x02\x86Ra"
    assert len(load_pickle(write(b"\x80\x02]" + first + again * 3 + b"."))) == 4
    with pytest.raises(UserError, match="more than a file of its size"):
        load_pickle(write(b"\x80\x02]" + first + again * 1000 + b"."))


@pytest.mark.parametrize(
    "data", [b"", b".", b"]", b"\x80\x04\x95\xff", b"(.", b"t.", b"h\x07.", b"}]]s."]
)
def test_damage_names_the_file(write, data: bytes) -> None:
    with pytest.raises(UserError, match=r"some\.pickle"):
        load_pickle(write(data))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"none\.pickle cannot be read"):
        load_pickle(tmp_path / "none.pickle")


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "huge.pickle"
    with path.open("wb") as file:
        file.truncate(1 << 31)
    with pytest.raises(UserError, match="larger than 128 MB"):
        load_pickle(path)


@pytest.mark.parametrize("kind", [np.array, list])
@pytest.mark.parametrize("read", [read_training_queries, read_evaluation_sets, read_image_index])
def test_rows_that_many_entries_share_are_held_once(write, read, kind) -> None:
    rows = kind(np.arange(20_000).tolist())
    entry = {"query": "a", "northing": 1.0, "easting": 2.0, "positives": rows, 0: rows}
    value: object = {k: dict(entry) for k in range(300)}
    if read is read_evaluation_sets:
        value = [value]
    if read is read_image_index:
        value = dict.fromkeys(range(300), rows)
    path = write(pickle.dumps(value))
    tracemalloc.start()
    read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5_000_000  # of 300 copies: 48 MB


def test_entries_that_are_shared_are_held_once(write) -> None:
    entry = {"query": "a", "northing": 1.0, "easting": 2.0} | {k: [] for k in range(1000)}
    run = dict.fromkeys(range(1000), entry)
    path = write(pickle.dumps([run] * 100))
    tracemalloc.start()
    sets = read_evaluation_sets(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (len(sets), len(sets[99]), len(sets[99][999].matches)) == (100, 1000, 1000)
    assert peak < 5_000_000
    assert read_file_names(path) == {"a"}


def test_the_files_of_a_list_are_read_without_its_rows(write) -> None:
    no_rows = {"query": "a", "positives": "damaged"}
    assert read_file_names(write(pickle.dumps({0: no_rows, 1: {"query": "b"}}))) == {"a", "b"}
    assert read_file_names(write(pickle.dumps({0: {"rel_scan_filepath": "c"}}))) == {"c"}
    assert read_file_names(write(pickle.dumps([{0: {"query": "a"}}, {}]))) == {"a"}
    for other in (None, [1], {0: 1}, {0: {}}):
        with pytest.raises(UserError, match=r"some\.pickle.* is not what its name says"):
            read_file_names(write(pickle.dumps(other)))


@pytest.mark.parametrize(
    ("read", "value"),
    [
        (read_training_queries, [1, 2]),
        (read_training_queries, {0: {"query": "a"}}),
        (read_training_queries, {1: {"query": "a", "positives": []}}),
        (read_training_queries, {0: {"query": 3, "positives": []}}),
        (read_training_queries, {0: {"query": "a", "positives": [2**64]}}),
        (read_training_queries, {0: {"query": "a", "positives": [0.5]}}),
        (read_evaluation_sets, {0: {}}),
        (read_evaluation_sets, [{0: {"query": "a", "northing": float("nan"), "easting": 0}}]),
        (read_evaluation_sets, [{0: {"query": "a", "northing": "5", "easting": 0}}]),
        (read_image_index, {"1": [2]}),
        (read_image_index, {1: 2}),
        (read_image_index, None),
    ],
)
def test_lists_of_another_form_are_refused_by_name(write, read, value: object) -> None:
    with pytest.raises(UserError, match=r"some\.pickle.* is not what its name says"):
        read(write(pickle.dumps(value)))
