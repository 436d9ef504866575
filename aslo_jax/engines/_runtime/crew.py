"""Threads that wait a moment for further work, since to start one takes as long as a small
run."""

import os
import queue
import threading
from collections.abc import Callable

LINGER = 1.0  # seconds


class Crew:
    """As many threads as there is work for. Each leaves after a while without, or after a
    piece of work that returns False."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """All of them, as in a forked process, which has none."""
        self._work: queue.SimpleQueue[Callable[[], bool] | None] = queue.SimpleQueue()
        # One for each thread that waits and is not promised any work.
        self._idle = threading.Semaphore(0)

    def begin(self, work: Callable[[], bool]) -> bool:
        """By a thread; whether the system has one."""
        if not self._idle.acquire(blocking=False):
            try:
                threading.Thread(target=self._serve, name="aslo_jax", daemon=True).start()
            except RuntimeError:
                return False
        self._work.put(work)
        return True

    def dismiss(self) -> None:
        """Those that wait."""
        while self._idle.acquire(blocking=False):
            self._work.put(None)

    def _serve(self) -> None:
        while (work := self._next()) is not None and work():
            del work  # and the arrays that it holds
            self._idle.release()

    def _next(self) -> Callable[[], bool] | None:
        while True:
            try:
                return self._work.get(timeout=LINGER)
            except queue.Empty:
                if self._idle.acquire(blocking=False):
                    return None


CREW = Crew()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=CREW.forget)
