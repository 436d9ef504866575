"""The chunks of a study as tasks of a Dask cluster."""

import functools
import threading
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax

from .._extras import require
from .problem import Problem, Study
from .store import Data, Store

AHEAD = 3  # tasks in flight for each thread of the cluster; the rest wait here
RETRIES = 5  # of a chunk whose task failed
_LOCK = threading.Lock()


def run_on_cluster(
    client: Any, problem: Problem, engine: str, store: Path | None, chunks: Iterable[int]
) -> Iterator[tuple[int, Data | None]]:
    """Run chunks on the workers of a `dask.distributed.Client`, in any order.

    A task computes a chunk and writes it to its own region of the `store`, which every
    worker must reach under the same path; without one it returns the results. Doing a chunk
    twice is harmless, so that Dask may run it again when a worker dies."""
    distributed = require("dask.distributed", "study")
    pickled = require("cloudpickle", "study").dumps(problem)
    wide = bool(jax.config.jax_enable_x64)  # pyright: ignore[reportAttributeAccessIssue]
    waiting, run = iter(chunks), uuid.uuid4().hex

    def submit(number: int) -> Any:
        return client.submit(
            compute,
            pickled,
            wide,
            engine,
            None if store is None else str(store),
            number,
            key=f"aslo_jax-{run}-{number}",
            pure=False,
            retries=RETRIES,
        )

    threads = sum(client.nthreads().values())
    first = [
        submit(k) for _, k in zip(range(AHEAD * max(threads, 1)), waiting, strict=False)
    ]
    queue = distributed.as_completed(first, with_results=True)
    for future, (number, data) in queue:
        future.release()
        for further in waiting:
            queue.add(submit(further))
            break
        yield number, data


def compute(
    pickled: bytes, wide: bool, engine: str, store: str | None, number: int
) -> tuple[int, Data | None]:
    """One chunk, on a worker."""
    # A worker is a process of its own, and has to compute in the precision of the client.
    jax.config.update("jax_enable_x64", wide)
    with _LOCK:  # so that threads of one worker compile it once
        study = _study(pickled, engine)
    data = study.chunk(number)
    if store is None:
        return number, data
    Store(Path(store), study.schema).write(number, data)
    return number, None


@functools.lru_cache(maxsize=2)
def _study(pickled: bytes, engine: str) -> Study:
    """Compiled once in each worker. A worker's cluster decides how many threads run."""
    problem = require("cloudpickle", "study").loads(pickled)
    study = Study(problem, threads=1)
    if study.runner.engine != engine:
        raise RuntimeError(
            f'The client runs with engine="{engine}", but this worker with '
            f'"{study.runner.engine}"; install the same packages on both.'
        )
    return study


@contextmanager
def local_cluster(workers: int) -> Iterator[Any]:
    """The client of a cluster of `workers` processes on this machine, one thread each."""
    distributed = require("dask.distributed", "study")
    with (
        distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            memory_limit=0,
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client
