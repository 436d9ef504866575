"""The chunks of a study as tasks of a Dask cluster."""

import functools
import logging
import threading
import uuid
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from .._extras import require
from ._problem import Study, versions
from ._store import Data, Store

AHEAD = 3  # tasks in flight for each thread of the cluster; the rest wait here
RETRIES = 5  # of a chunk whose task failed
_LOCK = threading.Lock()


def start_workers(client: Any) -> list[Any]:
    """Let every worker of a `dask.distributed.Client` import what it needs, which takes
    seconds, while the client traces the study. The futures are to be kept meanwhile."""
    return [
        client.submit(_prepared, _wide(), workers=[address], pure=False)
        for address in client.nthreads()
    ]


def _prepared(wide: bool) -> None:
    jax.config.update("jax_enable_x64", wide)
    jnp.zeros(()).block_until_ready()
    for package in ("zarr", "llvmlite.binding"):
        with suppress(ModuleNotFoundError):  # where it is needed, that is said later
            require(package, "study")


def _wide() -> bool:
    return bool(jax.config.jax_enable_x64)  # pyright: ignore[reportAttributeAccessIssue]


def run_on_cluster(
    client: Any, study: Study, store: Path | None, chunks: Iterable[int]
) -> Iterator[tuple[int, Data | None]]:
    """Run chunks on the workers of a `dask.distributed.Client`, in any order. The study is
    traced here, and compiled once by each of them.

    A task computes a chunk and writes it to its own region of the `store`, which every
    worker must reach under the same path; without one it returns the results. Doing a chunk
    twice is harmless, so that Dask may run it again when a worker dies."""
    distributed = require("dask.distributed", "study")
    # With every task, so that it can run on any worker; small, some 100 kB.
    packed = zlib.compress(require("cloudpickle", "study").dumps(study), 1)
    waiting, run = iter(chunks), uuid.uuid4().hex

    def submit(number: int) -> Any:
        return client.submit(
            compute,
            packed,
            _wide(),
            versions(),
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
    packed: bytes, wide: bool, client: dict[str, str], store: str | None, number: int
) -> tuple[int, Data | None]:
    """One chunk, on a worker."""
    if client != versions():
        raise RuntimeError(
            f"The client runs {client}, but this worker {versions()}; install the same "
            "packages on both."
        )
    # A worker is a process of its own, and has to compute in the precision of the client.
    jax.config.update("jax_enable_x64", wide)
    with _LOCK:  # so that threads of one worker have one
        study = _study(packed)
    data = study.chunk(number)
    if store is None:
        return number, data
    Store(Path(store), study.schema).write(number, data)
    return number, None


@functools.lru_cache(maxsize=2)
def _study(packed: bytes) -> Study:
    """Kept between chunks, and its machine code with it. Its engine runs one thread: how
    many of them run is decided by the cluster."""
    return require("cloudpickle", "study").loads(zlib.decompress(packed))


@contextmanager
def local_cluster(workers: int) -> Iterator[Any]:
    """The client of a cluster of `workers` processes on this machine, one thread each."""
    distributed = require("dask.distributed", "study")
    logger = logging.getLogger("distributed.nanny")
    before = logger.level
    try:
        with distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=":0",  # any free port
            memory_limit=0,
        ) as cluster:
            try:
                with distributed.Client(cluster) as client:
                    yield client
            finally:
                # On a busy machine a worker ends late, is killed, and Dask warns of it.
                logger.setLevel(logging.ERROR)
    finally:
        logger.setLevel(before)
