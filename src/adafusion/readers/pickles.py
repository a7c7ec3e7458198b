# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Pickles of published code, read and never run.

A pickle is a program: Python's own reader calls whatever function it names. Here a machine of a
few dozen instructions builds plain values from it, and knows no function but those that NumPy's
arrays and numbers are made by; those it does itself. Everything else is refused by name.
"""

from __future__ import annotations

import math
import pickletools
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from adafusion.types import UserError

LARGEST_BYTES = 128 << 20
LARGEST_STEPS = 20_000_000  # of a program; a step makes one object, or copies what it is given
LARGEST_COPIES = 16  # sizes of the file: what all arrays may hold together

_LONGEST_MESSAGE = 200  # letters of it that a file decides


def load_pickle(path: str | Path) -> Any:
    """Build what a pickle holds: None, numbers, text, bytes, lists, tuples, dicts and arrays.

    NumPy's numbers come as Python's, a `TrainingTuple` as the dict of its attributes. UserError
    where the file is missing, too large, damaged, or wants anything else; nothing of it is run.
    """
    path = Path(path)
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise UserError(f"{path} is larger than {LARGEST_BYTES >> 20} MB: leave it out")
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path} cannot be read ({error.strerror}): fetch it again") from error
    try:
        return _Machine().run(data)
    except _Refused as refusal:
        told = str(refusal)[:_LONGEST_MESSAGE]
        raise UserError(f"{path} {told}: remove it, it is not what it should be") from None
    except Exception as error:  # a damaged program fails as anything
        told = str(error)[:_LONGEST_MESSAGE]
        raise UserError(f"{path} is damaged ({told}): fetch it again") from error


class _Refused(Exception):
    """What a pickle wants and may not have."""


@dataclass(frozen=True)
class _Known:
    """A function or class that may be named."""

    name: str


@dataclass
class _Unbuilt:
    """A dtype, an array or an object whose contents come with a later instruction."""

    kind: str
    code: str = ""  # of a dtype
    memo: list[int] = field(default_factory=list)  # where it is remembered


_MODULES = {
    "dtype": ("numpy",),
    "ndarray": ("numpy",),
    "_reconstruct": ("numpy.core.multiarray", "numpy._core.multiarray"),
    "scalar": ("numpy.core.multiarray", "numpy._core.multiarray"),
    "_frombuffer": ("numpy.core.numeric", "numpy._core.numeric"),
    "encode": ("_codecs",),  # how old protocols write bytes
    "object": ("builtins", "__builtin__"),
    "_reconstructor": ("copyreg", "copy_reg"),  # how old protocols write objects
    "TrainingTuple": ("datasets.oxford", "datasets.base_datasets", "datasets.dataset_utils"),
}
_PUSHED = {  # their argument is the value
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
    *("STRING", "SHORT_BINSTRING", "BINSTRING", "SHORT_BINBYTES", "BINBYTES", "BINBYTES8"),
    *("UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8", "BYTEARRAY8"),
}
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
_MARK = object()


class _Machine:
    """Runs the instructions of one pickle over a stack and a memo."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}
        self.copied = 0

    def run(self, data: bytes) -> Any:
        for step, (opcode, argument, _) in enumerate(pickletools.genops(data)):
            if step > LARGEST_STEPS:
                raise _Refused(f"holds more than {LARGEST_STEPS} values")
            if opcode.name == "STOP":
                return self._pop()
            self._do(opcode.name, argument)
            if self.copied > LARGEST_COPIES * len(data):
                raise _Refused("holds more than a file of its size can")
        raise ValueError("no end")

    def _do(self, name: str, argument: Any) -> None:
        stack = self.stack
        if name in _PUSHED:
            stack.append(argument)
        elif name in _CONSTANTS:
            stack.append(_CONSTANTS[name])
        elif name == "MARK":
            stack.append(_MARK)
        elif name in ("PUT", "BINPUT", "LONG_BINPUT"):
            self._remember(argument)
        elif name == "MEMOIZE":
            self._remember(len(self.memo))
        elif name in ("GET", "BINGET", "LONG_BINGET"):
            stack.append(self.memo[argument])
        elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
            stack.append(tuple(reversed([self._pop() for _ in range(int(name[-1]))])))
        elif name == "TUPLE":
            stack.append(tuple(self._to_mark()))
        elif name in ("EMPTY_LIST", "LIST"):
            stack.append([] if name == "EMPTY_LIST" else self._to_mark())
        elif name in ("APPEND", "APPENDS"):
            items = [self._pop()] if name == "APPEND" else self._to_mark()
            self._top(list).extend(items)
        elif name in ("EMPTY_DICT", "DICT"):
            stack.append({} if name == "EMPTY_DICT" else dict(_pairs(self._to_mark())))
        elif name in ("SETITEM", "SETITEMS"):
            items = [self._pop(), self._pop()][::-1] if name == "SETITEM" else self._to_mark()
            self._top(dict).update(_pairs(items))
        elif name == "GLOBAL":
            stack.append(_known(*argument.split(" ", 1)))
        elif name == "STACK_GLOBAL":
            attribute, module = self._pop(), self._pop()
            stack.append(_known(module, attribute))
        elif name in ("REDUCE", "NEWOBJ"):
            arguments, function = self._pop(), self._pop()
            if not isinstance(function, _Known) or not isinstance(arguments, tuple):
                raise ValueError("a call of what is no function")
            stack.append(_call(function.name, arguments))
            self._count(stack[-1])
        elif name == "BUILD":
            state, unbuilt = self._pop(), self._top(_Unbuilt)
            stack[-1] = _build(unbuilt, state)
            self._count(stack[-1])
            for place in unbuilt.memo:
                self.memo[place] = stack[-1]
        elif name not in ("PROTO", "FRAME"):
            raise _Refused(f"uses the instruction {name}")

    def _pop(self) -> Any:
        value = self.stack.pop()
        if value is _MARK:
            raise ValueError("a value is missing")
        return value

    def _to_mark(self) -> list[Any]:
        """Take all values above the last mark, and the mark."""
        items: list[Any] = []
        while (value := self.stack.pop()) is not _MARK:
            items.append(value)
        return items[::-1]

    def _top(self, kind: type) -> Any:
        if not isinstance(self.stack[-1], kind):
            raise ValueError(f"no {kind.__name__.strip('_').lower()} to fill")
        return self.stack[-1]

    def _count(self, value: Any) -> None:
        if isinstance(value, np.ndarray | bytes):
            self.copied += value.nbytes if isinstance(value, np.ndarray) else len(value)

    def _remember(self, place: int) -> None:
        value = self.stack[-1]
        self.memo[place] = value
        if isinstance(value, _Unbuilt):
            value.memo.append(place)


def _pairs(items: list[Any]) -> Iterator[tuple[Any, Any]]:
    for key, value in zip(items[::2], items[1::2], strict=True):
        if type(key) not in (int, str):  # hashing anything deeper may exhaust the stack
            raise ValueError("a key is neither number nor text")
        yield key, value


def _known(module: object, name: object) -> _Known:
    # what is not text may be nested so deeply that to print it fills the memory
    if not isinstance(module, str) or not isinstance(name, str):
        raise ValueError("a name that is no text")
    if module not in _MODULES.get(name, ()):
        raise _Refused(f"wants {module}.{name}, which is not allowed")
    return _Known(name)


def _call(name: str, arguments: tuple[Any, ...]) -> Any:
    if name in ("TrainingTuple", "_reconstructor"):
        return _Unbuilt("object")
    if name == "_reconstruct":
        return _Unbuilt("array")
    if name == "dtype":
        code = arguments[0]
        if not isinstance(code, str):
            raise ValueError("a type that is no text")
        if not re.fullmatch("b1|[iu][1248]|f[248]|O[48]?", code):
            raise _Refused(f"wants an array of {code!r}, which is not allowed")
        return _Unbuilt("dtype", code)
    if name == "encode":
        text, encoding = arguments
        if encoding != "latin1":
            raise ValueError("bytes in an unknown encoding")
        return text.encode(encoding)
    if name == "scalar":
        dtype, raw = arguments
        return _array((), dtype, raw, "C").item()
    if name == "_frombuffer":
        raw, dtype, shape, order = arguments
        return _array(shape, dtype, raw, order)
    raise ValueError(f"a call of {name}")


def _build(unbuilt: _Unbuilt, state: Any) -> Any:
    if unbuilt.kind == "object":
        if not isinstance(state, dict):
            raise ValueError("an object without attributes")
        return state
    if unbuilt.kind == "dtype":
        _, order, *parts = state
        if any(parts[:3]) or order not in ("<", ">", "|"):
            raise _Refused("wants an array of records, which is not allowed")
        return np.dtype(unbuilt.code).newbyteorder(order)
    _, shape, dtype, is_fortran, raw = state
    return _array(shape, dtype, raw, "F" if is_fortran else "C")


def _array(shape: Any, dtype: Any, raw: Any, order: str) -> Shaped[np.ndarray, ...]:
    """An array of exactly what the file holds: the size that it claims is not believed."""
    if not isinstance(dtype, np.dtype) or order not in ("C", "F"):
        raise ValueError("an array without a type")
    if not isinstance(shape, tuple) or any(type(n) is not int or n < 0 for n in shape):
        raise ValueError("an array without a shape")
    if dtype.hasobject:  # pandas gives rows of numbers so
        raw = np.array([float(value) for value in raw]).tobytes()
        dtype = np.dtype(float)
    if isinstance(raw, str):  # Python 2 knew no bytes
        raw = raw.encode("latin1")
    if math.prod(shape) * dtype.itemsize != len(raw):
        raise ValueError("an array of another size")
    return np.frombuffer(raw, dtype).reshape(shape, order="F" if order == "F" else "C")
