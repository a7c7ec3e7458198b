# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The size that the file of an image claims, read before a decoder takes memory for it."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from functools import partial
from typing import NamedTuple


class Size(NamedTuple):
    """Of an image, in pixels."""

    height: int
    width: int


def claimed_size(data: bytes) -> Size:
    """Size by the header; ValueError says what is wrong with a file that is no whole image.

    Whole is a PNG that has all chunks with right sums up to IEND, and a JPEG that has its end
    marker; of a TIFF or BMP only the header is looked at.
    """
    size_of = next((read for start, read in _FORMATS.items() if data.startswith(start)), None)
    if size_of is None and len(data) >= _LONGEST_START:
        raise ValueError("is no PNG, JPEG, TIFF or BMP")
    try:
        size = _NOTHING if size_of is None else size_of(data)
    except struct.error:  # the data end within the header
        size = _NOTHING
    if min(size) <= 0:
        raise ValueError("is damaged or cut short")
    return size


_NOTHING = Size(0, 0)
_PNG_START = b"\x89PNG\r\n\x1a\n"
_LONGEST_START = len(_PNG_START)
# anything may lie before a marker: decoders pass over it
_JPEG_MARKER = re.compile(rb"\xff([^\x00\xff])")
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_BARE = frozenset((0x01, *range(0xD0, 0xD9)))  # markers without a segment


def _png_size(data: bytes) -> Size:
    start = len(_PNG_START)
    while start + 12 <= len(data):
        end = start + 12 + int.from_bytes(data[start : start + 4], "big")
        body, checksum = data[start + 4 : end - 4], data[end - 4 : end]
        if end > len(data) or zlib.crc32(body) != int.from_bytes(checksum, "big"):
            break
        if body.startswith(b"IEND"):
            kind, width, height = struct.unpack_from(">4sII", data, 12)
            return Size(height, width) if kind == b"IHDR" else _NOTHING
        start = end
    return _NOTHING


def _jpeg_size(data: bytes) -> Size:
    if not data.rstrip(b"\0").endswith(b"\xff\xd9"):  # some cameras pad with zeros
        return _NOTHING
    start = 2
    while marker := _JPEG_MARKER.search(data, start):
        start = marker.end()
        kind = marker[1][0]
        if kind in _JPEG_FRAMES:
            return Size(*struct.unpack_from(">HH", data, start + 3))
        if kind not in _JPEG_BARE:
            start += int.from_bytes(data[start : start + 2], "big")
    return _NOTHING


def _bmp_size(data: bytes) -> Size:
    (header_bytes,) = struct.unpack_from("<I", data, 14)
    width, height = struct.unpack_from("<HH" if header_bytes == 12 else "<ii", data, 18)
    return Size(abs(height), width)  # negative where rows come from the top


def _tiff_size(order: str, data: bytes) -> Size:
    """Of the first image, or of its tiles where those are larger: a decoder holds one of them."""
    (start,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, start)
    tags = {256: 0, 257: 0, 322: 0, 323: 0}  # width and height of the image, then of a tile
    for at in range(start + 2, start + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(f"{order}HH", data, at)
        if tag not in tags:
            continue
        if kind not in (3, 4):  # what the format allows: 16 or 32 bits
            return _NOTHING
        (value,) = struct.unpack_from(order + "HI"[kind - 3], data, at + 8)
        tags[tag] = max(tags[tag], value)
    return Size(max(tags[257], tags[323]), max(tags[256], tags[322]))


_FORMATS: dict[bytes, Callable[[bytes], Size]] = {
    _PNG_START: _png_size,
    b"\xff\xd8": _jpeg_size,
    b"BM": _bmp_size,
    b"II*\0": partial(_tiff_size, "<"),
    b"MM\0*": partial(_tiff_size, ">"),
}
