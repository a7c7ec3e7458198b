# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Work spread over processes that never outlive the one that started them."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from typing import TypeVar

from adafusion.types import JobFailed, UserError

T = TypeVar("T")
R = TypeVar("R")

_WAITING = 4  # items a process that are handed out ahead: what bounds the memory of a long job


def map_in_processes(
    work: Callable[[T], R],
    items: Iterable[T],
    workers: int,
    *,
    start: Callable[..., None] | None = None,
    arguments: tuple[object, ...] = (),
) -> Iterator[R]:
    """Yield `work(item)` in the order of `items`, which are taken only a few ahead.

    With one worker all happens here. Else processes are spawned: `work`, items and results must be
    picklable, and each process calls `start(*arguments)` first. What `work` raises is raised here.
    UserError for fewer workers than one, JobFailed where a process was killed.
    """
    if workers < 1:
        raise UserError(f"workers = {workers}: one process is the least")
    if workers == 1:
        if start is not None:
            start(*arguments)
        for item in items:
            yield work(item)
        return
    waiting: deque[Future[R]] = deque()
    with ProcessPoolExecutor(
        workers,
        mp_context=get_context("spawn"),
        initializer=_start,
        initargs=(start, arguments),
    ) as pool:
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) >= _WAITING * workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        except BrokenProcessPool as error:
            raise JobFailed(
                "a working process was killed (out of memory?): repeat the command, with fewer "
                "--workers if need be"
            ) from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _start(start: Callable[..., None] | None, arguments: tuple[object, ...]) -> None:
    parent = parent_process()
    if parent is not None:  # a killed parent must not leave its workers working
        watch = [parent.sentinel]
        threading.Thread(target=lambda: (wait(watch), os._exit(1)), daemon=True).start()
    if start is not None:
        start(*arguments)
