# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The bytes of PCD, PLY and LAS files as x y z, just as the file has them.

Sources: the PCD page of the Point Cloud Library and its LZF compression, Turk's description of PLY,
the ASPRS specification LAS 1.4. ValueError says what is wrong with the bytes. A file says how much
it holds before it holds it: a claim beyond its own size is refused before memory is asked for.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

_HEADER_BYTES = 65_536


def join_columns(*xyz: Shaped[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """Coordinates of any type and byte order as points; double only where one of them is."""
    wide = any(axis.dtype.kind != "f" or axis.dtype.itemsize > 4 for axis in xyz)
    return np.stack([axis.astype(np.float64 if wide else np.float32) for axis in xyz], axis=1)


def _read_lines(data: bytes, last: str) -> tuple[list[list[str]], int]:
    """Words of each header line up to the one that begins with `last`, and where the body is."""
    lines: list[list[str]] = []
    start = 0
    while not lines or lines[-1][:1] != [last]:
        end = data.find(b"\n", start, _HEADER_BYTES)
        if end < 0:
            raise ValueError(f"has no header that ends with {last}")
        lines.append(data[start:end].decode("latin-1").split())
        start = end + 1
    return lines, start


def _whole(word: str) -> int:
    """A count from a header."""
    if not (word.isascii() and word.isdigit() and len(word) < 19):
        raise ValueError(f"has a header with {word[:40]!r} for a count")
    return int(word)


def _require(claimed: int, there: int, what: str) -> None:
    if claimed > there:
        raise ValueError(f"is cut short: its header claims {claimed} {what}, {there} are there")


# -------------------------------------------------------------------------------------------- PCD


def _pcd(data: bytes) -> Float[np.ndarray, "n 3"]:
    lines, start = _read_lines(data, "DATA")
    entries = {words[0]: words[1:] for words in lines if words}
    names = entries.get("FIELDS", entries.get("COLUMNS", []))
    sizes = [_whole(word) for word in entries.get("SIZE", [])]
    counts = [_whole(word) for word in entries.get("COUNT", ["1"] * len(names))]
    kinds = entries.get("TYPE", [])
    if not names or not len(names) == len(sizes) == len(kinds) == len(counts):
        raise ValueError("has a header whose FIELDS, SIZE, TYPE and COUNT do not match")
    shape = [entries.get(key, ["1"])[:1] or ["?"] for key in ("WIDTH", "HEIGHT")]
    in_rows = math.prod(_whole(word) for [word] in shape)
    number = _whole((entries.get("POINTS") or [str(in_rows)])[0])
    if "WIDTH" in entries and number != in_rows:
        raise ValueError(f"has a header with {number} POINTS, but WIDTH x HEIGHT are {in_rows}")

    fields = []  # of x, y, z: type, bytes and words that come before it within a point
    for axis in "xyz":
        at = names.index(axis) if axis in names else -1
        kind = at >= 0 and {"F": "f", "I": "i", "U": "u"}.get(kinds[at])
        if not kind or counts[at] != 1 or f"{kind}{sizes[at]}" not in _PCD_TYPES:
            raise ValueError(f"has no field {axis} of a known type")
        width = sum(size * count for size, count in zip(sizes[:at], counts[:at], strict=True))
        fields.append((np.dtype(f"<{kind}{sizes[at]}"), width, sum(counts[:at])))
    stride = sum(size * count for size, count in zip(sizes, counts, strict=True))
    form = entries["DATA"][:1]
    if form == ["ascii"]:
        words = data[start:].split()
        _require(number * sum(counts), len(words), "numbers")
        words = words[: number * sum(counts)]
        return np.array([[float(w) for w in words[at :: sum(counts)]] for *_, at in fields]).T
    if form == ["binary"]:
        _require(number * stride, len(data) - start, "bytes")
        return join_columns(
            *(np.ndarray(number, t, data, start + at, (stride,)) for t, at, _ in fields)
        )
    if form == ["binary_compressed"]:  # all x, then all y, ...
        if len(data) - start < 8:
            raise ValueError("is cut short: it has no sizes after its header")
        packed, unpacked = struct.unpack_from("<II", data, start)
        _require(packed, len(data) - start - 8, "bytes")
        if unpacked != number * stride:
            raise ValueError(f"unpacks to {unpacked} bytes, {number} points take {number * stride}")
        _require(unpacked, packed * _LZF_MOST, "bytes, of which")
        raw = _unpack_lzf(data[start + 8 : start + 8 + packed], unpacked)
        return join_columns(*(np.frombuffer(raw, t, number, number * at) for t, at, _ in fields))
    raise ValueError(f"has DATA {' '.join(form)[:40]!r}, not ascii, binary or binary_compressed")


_PCD_TYPES = ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8")
_LZF_MOST = 88  # three bytes stand for 264 at most


def _unpack_lzf(packed: bytes, size: int) -> bytearray:
    """Unpack LZF: runs of bytes as they are, and repeats of what came up to 8 KiB before."""
    padded = packed + b"\0\0"  # what a cut repeat reads; the length at the end gives it away
    out = bytearray()
    at = 0
    while at < len(packed) and len(out) <= size:
        control = packed[at]
        at += 1
        if control < 32:
            out += packed[at : at + control + 1]
            at += control + 1
            continue
        length = (control >> 5) + 2
        if length == 9:
            length += padded[at]
            at += 1
        back = ((control & 31) << 8) + padded[at] + 1
        at += 1
        if back > len(out):
            raise ValueError("is damaged: its compressed points refer to what is not there")
        piece = out[len(out) - back : len(out) - back + length]
        out += (piece * (length // len(piece) + 1))[:length]  # a short piece is a pattern
    if len(out) != size or at != len(packed):
        raise ValueError("is damaged: its compressed points do not unpack to their size")
    return out


# -------------------------------------------------------------------------------------------- PLY

_PLY_TYPES = {
    name: kind
    for names, kind in (
        ("char int8", "i1"),
        ("uchar uint8", "u1"),
        ("short int16", "i2"),
        ("ushort uint16", "u2"),
        ("int int32", "i4"),
        ("uint uint32", "u4"),
        ("float float32", "f4"),
        ("double float64", "f8"),
    )
    for name in names.split()
}


class _Property(NamedTuple):
    name: str
    kind: np.dtype  # of a number
    length: np.dtype | None  # of how many there are, for a list


class _Element(NamedTuple):
    name: str
    number: int
    properties: list[_Property]

    @property
    def has_lists(self) -> bool:
        return any(p.length for p in self.properties)

    @property
    def size(self) -> int:
        """Bytes of one, where there are no lists."""
        return sum(p.kind.itemsize for p in self.properties)


def _ply(data: bytes) -> Float[np.ndarray, "n 3"]:
    lines, start = _read_lines(data, "end_header")
    form, elements = _ply_elements(lines)
    before = []
    for element in elements:
        if element.name == "vertex":
            break
        before.append(element)
    else:
        raise ValueError("has no element vertex")
    names = [p.name for p in element.properties]
    if element.has_lists or any(names.count(axis) != 1 for axis in "xyz"):
        raise ValueError("has a vertex without x, y, z, or with a list")
    at = [names.index(axis) for axis in "xyz"]
    if form == "ascii":
        rows = [line for line in data[start:].splitlines() if line.strip()]
        first = sum(other.number for other in before if other.properties)
        _require(first + element.number, len(rows), "lines")
        words = [row.split() for row in rows[first : first + element.number]]
        if any(len(row) != len(names) for row in words):
            raise ValueError(f"has a vertex that is not {len(names)} numbers")
        return np.array([[float(row[i]) for i in at] for row in words]).reshape(-1, 3)
    for other in before:
        start = _skip(data, start, other)
    _require(element.number * element.size, len(data) - start, "bytes")
    offsets = [sum(p.kind.itemsize for p in element.properties[:i]) for i in at]
    return join_columns(
        *(
            np.ndarray(
                element.number, element.properties[i].kind, data, start + offset, (element.size,)
            )
            for i, offset in zip(at, offsets, strict=True)
        )
    )


def _ply_elements(lines: list[list[str]]) -> tuple[str, list[_Element]]:
    form = ""
    elements: list[_Element] = []
    for words in lines:
        match words:
            case ["format", ("ascii" | "binary_little_endian" | "binary_big_endian") as form, *_]:
                pass
            case ["element", name, number]:
                elements.append(_Element(name, _whole(number), []))
            case ["property", "list", length, kind, name] if elements:
                types = _ply_type(kind, form), _ply_type(length, form)
                if types[1].kind == "f":
                    raise ValueError(f"has a list whose length is a {length}")
                elements[-1].properties.append(_Property(name, *types))
            case ["property", kind, name] if elements:
                elements[-1].properties.append(_Property(name, _ply_type(kind, form), None))
            case ["ply"] | ["comment" | "obj_info", *_] | ["end_header"] | []:
                pass
            case _:
                raise ValueError(f"has a header line {' '.join(words)[:40]!r}")
    if lines[0] != ["ply"] or not form:
        raise ValueError("has no PLY header with a known format")
    return form, elements


def _ply_type(name: str, form: str) -> np.dtype:
    if name not in _PLY_TYPES:
        raise ValueError(f"has a property of the unknown type {name[:40]!r}")
    return np.dtype((">" if form == "binary_big_endian" else "<") + _PLY_TYPES[name])


def _skip(data: bytes, start: int, element: _Element) -> int:
    """Where the element that follows begins; lists have to be walked through."""
    if not element.has_lists:
        start += element.number * element.size
        _require(start, len(data), "bytes")
        return start
    for _ in range(element.number):
        for p in element.properties:
            number = 1
            if p.length:
                _require(start + p.length.itemsize, len(data), "bytes")
                number = int(np.frombuffer(data, p.length, 1, start)[0])
                start += p.length.itemsize
            if number < 0:
                raise ValueError("is damaged: a list has fewer than no entries")
            start += number * p.kind.itemsize
        _require(start, len(data), "bytes")
    return start


# -------------------------------------------------------------------------------------------- LAS

_LAS_RECORD_BYTES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)  # least, by point format


def _las(data: bytes) -> Float[np.ndarray, "n 3"]:
    if data[:4] != b"LASF" or len(data) < 227:
        raise ValueError("has no LAS header")
    major, minor = data[24], data[25]
    if major != 1 or minor > 4 or (minor == 4 and len(data) < 375):
        raise ValueError(f"is LAS {major}.{minor}, not 1.0 to 1.4, or cut short in its header")
    start = struct.unpack_from("<I", data, 96)[0]
    form, stride, number = struct.unpack_from("<BHI", data, 104)
    scale_offset = struct.unpack_from("<6d", data, 131)
    if minor == 4:
        number = struct.unpack_from("<Q", data, 247)[0]
    if form & 0xC0:
        raise ValueError("is compressed (LAZ): unpack it to .las with `laszip` or `pdal translate`")
    if form >= len(_LAS_RECORD_BYTES) or stride < _LAS_RECORD_BYTES[form]:
        raise ValueError(f"has point format {form} with {stride} bytes a point, which is none")
    if not all(map(math.isfinite, scale_offset)) or min(scale_offset[:3]) <= 0:
        raise ValueError("has a scale that is not above 0, or an offset that is not finite")
    _require(start + number * stride, len(data), "bytes")
    with np.errstate(over="ignore"):
        axes = [
            np.ndarray(number, "<i4", data, start + 4 * i, (stride,)) * scale_offset[i]
            + scale_offset[3 + i]
            for i in range(3)
        ]
    return np.stack(axes, axis=1)


PARSERS: dict[str, Callable[[bytes], Float[np.ndarray, "n 3"]]] = {
    ".pcd": _pcd,
    ".ply": _ply,
    ".las": _las,
}
