"""Requests that newer ones have made needless."""

import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager

CLIENTS = 64  # pages whose newest requests are remembered


class StaleError(Exception):
    """A request that a newer one of the same page has made needless."""


class Newest:
    """The newest request of every page, by what it asks for."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: OrderedDict[tuple[str, str], int] = OrderedDict()
        self._busy: dict[str, threading.Lock] = {}

    @contextmanager
    def turn(self, client: str, what: str, number: int) -> Iterator[None]:
        """Within it, no other request for `what` is served.

        **Raises:** [`StaleError`][] where a newer one of the `client` has come meanwhile.
        """
        key = client, what
        with self._lock:
            self._newest[key] = max(number, self._newest.get(key, number))
            self._newest.move_to_end(key)
            while len(self._newest) > CLIENTS:
                self._newest.popitem(last=False)
            busy = self._busy.setdefault(what, threading.Lock())
        with busy:
            with self._lock:
                stale = self._newest.get(key, number) > number
            if stale:
                raise StaleError
            yield
