# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""What the world and its sensors share: keyed random numbers, compiled kernels, hashed noise."""

from __future__ import annotations

import hashlib
import inspect
import itertools
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar

import numba
import numpy as np

F = TypeVar("F", bound=Callable[..., object])
Vector = tuple[float, float, float]  # of the world, or linear RGB


def keyed_rng(*key: int | str) -> np.random.Generator:
    """Give the random numbers that belong to `key`, whatever else was or was not drawn before.

    A key reads (seed, object path, purpose). One stream for everything would let the leaves that
    fall in winter move the buildings drawn after them.
    """
    digest = hashlib.sha256("/".join(map(repr, key)).encode()).digest()
    return np.random.Generator(np.random.Philox(key=int.from_bytes(digest[:16], "little")))


def keyed_seed(*key: int | str) -> int:
    """31 bits that belong to `key`, for the hashes inside the kernels."""
    return int(keyed_rng(*key).integers(2**31))


def kernel(function: F) -> F:
    """Compile with numba and keep the machine code on disk.

    No threads inside: frames are rendered by processes, and a kernel that owns one core gives the
    same bytes on any number of them. Infinities stay legal, sums keep their order.
    """
    return _compiled(function, forceinline=False)


def inlined(function: F) -> F:
    """Compile a part of a kernel into its callers.

    A call would count the references of every array of a scene up and down.
    """
    return _compiled(function, forceinline=True)


def _compiled(function: F, *, forceinline: bool) -> F:
    # a run-time type checker may have wrapped the function; numba needs the bare one
    bare = inspect.unwrap(function)
    # numba keeps machine code under this name, and looks at the time of this one file alone: a
    # change in a part that is compiled in from another file must change the name
    bare.__qualname__ = f"{bare.__qualname__}-{_sources()}"
    return numba.njit(
        cache=True,
        nogil=True,
        error_model="numpy",
        fastmath={"contract", "arcp", "nsz", "afn"},
        forceinline=forceinline,
    )(bare)


@cache
def _sources() -> str:
    """Identity of the sources that kernels are compiled from."""
    here = Path(__file__)
    parts = (here.with_name(name).glob("*.py") for name in ("town", "run", "sensing"))
    digest = hashlib.sha256()
    for path in [here, *sorted(itertools.chain(*parts))]:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]


@inlined
def hashed(a: int, b: int, c: int) -> int:
    """Hash three integers to 32 bits."""
    h = (a * 374761393 + b * 668265263 + c * 1440662683 + 0x27D4EB2F) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 1103515245) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 1431655765) & 0xFFFFFFFF
    return h ^ (h >> 15)


@inlined
def uniform(a: int, b: int, c: int) -> float:
    """Hash three integers to (0, 1)."""
    return (hashed(a, b, c) + 0.5) * (1.0 / 4294967296.0)


@inlined
def normal(a: int, b: int, c: int) -> float:
    """Hash three integers to a standard normal number (Box and Muller)."""
    radius = math.sqrt(-2.0 * math.log(uniform(a, b, 2 * c)))
    return radius * math.cos(2.0 * math.pi * uniform(a, b, 2 * c + 1))


@inlined
def value_noise(x: float, y: float, seed: int, mask: int = -1) -> float:
    """Smooth noise in (0, 1) that varies over about one unit; it tiles every `mask` + 1 units."""
    fx, fy = math.floor(x), math.floor(y)
    u, v = x - fx, y - fy
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    ix, iy, jx, jy = int(fx) & mask, int(fy) & mask, (int(fx) + 1) & mask, (int(fy) + 1) & mask
    low = uniform(ix, iy, seed) * (1.0 - u) + uniform(jx, iy, seed) * u
    high = uniform(ix, jy, seed) * (1.0 - u) + uniform(jx, jy, seed) * u
    return low * (1.0 - v) + high * v


@inlined
def pulse(x: float, duty: float, width: float) -> float:
    """Stripes without aliasing: the share of `width` around x on which frac(x) < duty."""
    width = max(width, 1e-4)
    a, b = x - 0.5 * width, x + 0.5 * width
    fa, fb = math.floor(a), math.floor(b)
    return (fb * duty + min(b - fb, duty) - fa * duty - min(a - fa, duty)) / width


@inlined
def smooth(low: float, high: float, x: float) -> float:
    """Cubic step from 0 at `low` to 1 at `high`."""
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@inlined
def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def step(a: Vector, b: Vector, t: float) -> Vector:
    """a + t b."""
    return a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]


@inlined
def unit(a: Vector) -> Vector:
    """The vector over its length."""
    size = math.sqrt(dot(a, a))
    return a[0] / size, a[1] / size, a[2] / size


@inlined
def blend(a: Vector, b: Vector, t: float) -> Vector:
    """From a at t = 0 to b at t = 1."""
    return a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t
