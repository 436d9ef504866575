"""Contenders that take turns, so that what else the machine does falls on all of them."""

import os
import random
import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any


def interleaved(
    contenders: Mapping[Any, Callable[[], Any]], runs: int, shortest: float = 0.05
) -> tuple[dict[Any, float], dict[Any, Any]]:
    """The median seconds of one call of each contender over `runs` rounds, after a first
    call that compiles, and what that first call returned. After its first round a
    contender is called as often in a round as fills `shortest` seconds. Every round has
    another order: who comes after one thread finds the other processors idle."""
    values = {name: run() for name, run in contenders.items()}
    seconds: dict[Any, list[float]] = {name: [] for name in contenders}
    order, shuffle = list(contenders), random.Random(0).shuffle
    for _ in range(runs):
        shuffle(order)
        for name in order:
            before = seconds[name]
            repeats = max(1, round(shortest / before[0])) if before else 1
            before.append(_seconds(contenders[name], repeats))
    return {name: statistics.median(s) for name, s in seconds.items()}, values


def ratios(contenders: Mapping[Any, Callable[[], Any]], rounds: int) -> dict[Any, float]:
    """The median over rounds of the seconds of each contender over those of the first one
    in the same round, after a first call that compiles; every round has another order."""
    order, shuffle = list(contenders), random.Random(0).shuffle
    first, found = order[0], {name: [] for name in contenders}
    for run in contenders.values():
        run()
    for _ in range(rounds):
        shuffle(order)
        seconds = {name: _seconds(contenders[name], 3) for name in order}
        for name in order:
            found[name].append(seconds[name] / seconds[first])
    return {name: statistics.median(values) for name, values in found.items()}


def _seconds(run: Callable[[], Any], repeats: int) -> float:
    start = time.perf_counter()
    for _ in range(repeats):
        run()
    return (time.perf_counter() - start) / repeats


def processors() -> int:
    """That this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def load() -> str:
    """The load of the machine over the last minute, for the reader of the figures."""
    return f"load {os.getloadavg()[0]:.1f} on {processors()} processors"
