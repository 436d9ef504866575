"""Threads that share a run, and how it is stopped."""

import atexit
import collections
import contextlib
import ctypes
import os
import queue
import threading
import time
from collections.abc import Callable

from .crew import CREW

Span = tuple[int, int]


class Run:
    """`work(span, limit)` on every span, by several threads, each of which takes one after
    the other. `limit` is the address of the number of steps, which the work reads again and
    again: it ends early where that is negative.

    The main thread only waits, unless the whole is `brief`: Python handles signals there,
    and not before it leaves foreign code. What the threads read and write lives as long as
    they hold `work`."""

    def __init__(
        self, work: Callable[[Span, int], None], spans: list[Span], steps: int
    ) -> None:
        self._work, self._left = work, collections.deque(spans)
        self._limit = ctypes.c_int64(steps)
        self._errors: list[BaseException] = []
        self._ended: list[None] = []  # one for each helper that has let go
        self._news: queue.SimpleQueue[None] = queue.SimpleQueue()

    def by(self, threads: int, brief: bool) -> None:
        """Runs all; an error of any thread ends the others, and is raised here."""
        takes_part = brief or threading.current_thread() is not threading.main_thread()
        helpers = min(threads, len(self._left)) - takes_part
        begun = 0
        try:
            _RUNS.add(self)
            for begun in range(1, helpers + 1):
                if not CREW.begin(self._help):
                    begun -= 1
                    takes_part = True
                    break
            if takes_part:
                self._take()
            while len(self._ended) < begun:
                self._wait()
        except BaseException:
            self.stop()
            latest = time.monotonic() + 2.0
            while len(self._ended) < begun and time.monotonic() < latest:
                self._wait()
            CREW.dismiss()
            raise
        finally:
            _RUNS.discard(self)
        if self._errors:
            CREW.dismiss()
            raise self._errors[0]
        if self._limit.value < 0:
            # The interpreter exits: the thread that waits for this run ends, silently.
            raise SystemExit

    def _wait(self) -> None:
        """In turns: on Windows a wait without an end is not interrupted."""
        with contextlib.suppress(queue.Empty):
            self._news.get(timeout=0.1)

    def stop(self) -> None:
        self._limit.value = -1

    def _help(self) -> bool:
        try:
            self._take()
        finally:
            self._ended.append(None)
            self._news.put(None)
        return self._limit.value >= 0

    def _take(self) -> None:
        address = ctypes.addressof(self._limit)
        try:
            while self._limit.value >= 0:
                try:
                    span = self._left.popleft()
                except IndexError:  # none is left, or another thread was faster
                    return
                self._work(span, address)
        except BaseException as error:
            self._errors.append(error)
            self.stop()


_RUNS: set[Run] = set()


@atexit.register
def _stop_all() -> None:
    """Runs that the interpreter does not wait for, those of daemon threads, end before what
    they use is torn down."""
    for run in list(_RUNS):
        run.stop()
    latest = time.monotonic() + 2.0
    while _RUNS and time.monotonic() < latest:
        time.sleep(1e-3)


if hasattr(os, "register_at_fork"):
    # A forked process has none of the threads of its parent.
    os.register_at_fork(after_in_child=_RUNS.clear)
