"""Run a study: an experiment with a spread, chunk by chunk, into one dataset."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from .. import random
from .._continuous import AnyExperiment
from .._extras import require
from .._typing import Engine
from ..metrics._base import MakeMetric
from ._cluster import run_on_cluster, start_workers
from ._distributions import AbstractDistribution
from ._lock import locked
from ._problem import BLOCK, CHUNK, Problem, Study
from ._spread import Parameter, Spread
from ._store import (
    INTERNAL,
    Data,
    Schema,
    Store,
    current_attributes,
    open_store,
    order_of,
    refuse_damaged_files,
    refuse_taken,
    stored_attributes,
)

if TYPE_CHECKING:
    import xarray


def run(
    experiment: AnyExperiment,
    spread: Spread | Mapping[str, Parameter | tuple[Any, AbstractDistribution]],
    *,
    samples: int,
    key: random.KeyLike,
    metrics: Mapping[str, MakeMetric],
    steps: int | None = None,
    horizon: float | None = None,
    every: int | None = None,
    scale: Float[np.ndarray, " n"] | None = None,
    engine: Engine = "auto",
    threads: int | None = None,
    chunk: int | None = None,
    store: str | Path | None = None,
    resume: bool = False,
    repair: bool = False,
    client: Any = None,
    progress: bool = False,
    configuration: Mapping[str, Any] | None = None,
    units: Mapping[str, str] | None = None,
    entries: tuple[str, ...] | None = None,
) -> "xarray.Dataset":
    """Run `samples` experiments that differ by a spread and their random numbers.

    - `spread`: what varies, by name ([`Spread`][]); the keys of random disturbances vary by
      themselves, with the `key` and the sample;
    - `key`: of all random numbers, as `jax.random.key(0)`
    - `metrics`: by name, a class of `aslo_jax.metrics`, or any `metric(observer)` from the
      name of an observer, or an instance, of which every observer of the experiment gets
      one; an instance without an observer is the same for all;
    - `steps` of the experiment's interval, or the `horizon` (s) that they cover;
    - `every`: keeps the error of every `every`-th sample in time, its norm or that of the
      error over `scale`, shape `(n,)`, entry by entry; by default none is kept;
    - `engine`: as in [`run_batch`][]; `threads`: of the fused engine;
    - `chunk`: how many samples are run and written at a time, rounded up to a whole number
      of blocks of 256;
    - `store`: the path of a Zarr store to write; it must not exist, unless `resume` goes on
      with one that was interrupted, where chunks that are done are kept; with `repair`
      those that are damaged are run again, which are refused otherwise;
    - `client`: a `dask.distributed.Client` whose workers run the chunks, one thread each;
    - `progress`: a bar on stderr;
    - `configuration`, `units` (by variable), `entries` (names of what is estimated): kept
      with the results.

    A sample depends on the key and its index only. So the results have the same bits for
    any chunk, thread and worker count, interrupted or not, with one engine, one model of
    processor and one set of packages. With a store, memory does not grow with `samples`.

    **Returns:** an `xarray.Dataset`, read from the store on demand where there is one, with
    the dimensions `sample`, `observer`, and where they apply `entry` of what is estimated
    and `time` (s): every metric by its name, every parameter as `parameter_<name>`, and
    `error`.

    **Raises:** `ValueError` for arguments that do not fit, and for a store that is damaged,
    not of a study, or of other settings; it is left as it is.
    """
    if store is not None and not resume:
        refuse_taken(Path(store))  # before anything that takes time
    if repair and not (resume and store is not None):
        raise ValueError("Argument `repair` must go with `resume`, and with a `store`.")
    problem = Problem(
        experiment=experiment,
        spread=spread if isinstance(spread, Spread) else Spread(spread),
        samples=whole("samples", samples),
        seed=random.seed_of(key),
        steps=steps_of(experiment, steps, horizon),
        metrics=dict(metrics),
        every=every,
        scale=None if scale is None else np.asarray(scale, float),
        engine=engine,
        chunk=_chunk(chunk, store, resume),
        configuration=None if configuration is None else dict(configuration),
        units=dict(units or {}),
        entries=entries,
    )
    with nullcontext() if store is None else locked(Path(store)):
        starting = [] if client is None else start_workers(client)
        study = Study(problem, threads if client is None else 1)
        target = held = None
        if store is None:
            held = _allocated(study.schema)
        else:
            target = open_store(Path(store), study.schema, resume, repair)
        _fill(study, target, held, client, progress)
        del starting
    return open_study(store) if store is not None else _dataset(study.schema, held or {})


def _fill(
    study: Study, target: Store | None, whole: Any, client: Any, progress: bool
) -> None:
    """Run what is not done, into the store or into the arrays of the `whole`."""
    done = np.zeros(study.schema.chunks, bool) if target is None else target.done()
    with _progress(study.problem, study.schema, done, progress) as tell:
        todo = [int(k) for k in np.flatnonzero(~done)]
        if client is not None:
            path = None if target is None else target.path.resolve()
            found = run_on_cluster(client, study, path, todo)
        else:
            found = ((k, study.chunk(k)) for k in todo)
        for number, data in found:
            first, last = study.schema.range(number)
            if whole is not None and data is not None:
                for name, array in whole.items():
                    array[first:last] = data[name]
            elif target is not None and data is not None:
                target.write(number, data)
            tell(last - first)


def open_study(path: str | Path) -> "xarray.Dataset":
    """The results of a study in its store at `path`, complete or not: what is not done yet
    is NaN, zero or False. Read on demand.

    **Raises:** `ValueError` where there is no study of aslo_jax, or one whose coordinates
    or descriptions of arrays are damaged; a damaged chunk of samples raises as it is read.
    """
    attributes = current_attributes(Path(path))
    refuse_damaged_files(Path(path), attributes)
    xarray = require("xarray", "study")
    found = xarray.open_zarr(str(path), consolidated=False, chunks=None)
    # NumPy's new type of text, which older xarray calls objects, has few operations yet.
    coordinates = {
        name: (x.dims, np.array([str(each) for each in x.values]), x.attrs)
        if x.dtype.kind in "TO"
        else x.variable
        for name, x in found.coords.items()
    }
    # A group is listed in any order: as they are in memory.
    variables = {name: found[name].variable for name in order_of(attributes)[1:]}
    dims = dict.fromkeys(["sample", *(d for x in variables.values() for d in x.dims)])
    return xarray.Dataset(
        variables,
        {name: coordinates[name] for name in dims if name in coordinates},
        {k: x for k, x in found.attrs.items() if k not in INTERNAL},
    )


def _allocated(schema: Schema) -> dict[str, np.ndarray]:
    return {
        name: np.empty((schema.samples, *v.shape), v.dtype)
        for name, v in schema.variables.items()
    }


def _dataset(schema: Schema, data: Data) -> "xarray.Dataset":
    xarray = require("xarray", "study")
    described = schema.coordinate_attributes
    coordinates = {"sample": np.arange(schema.samples)} | schema.coordinates
    return xarray.Dataset(
        {name: (v.dims, data[name], v.attributes) for name, v in schema.variables.items()},
        {name: (name, x, described.get(name, {})) for name, x in coordinates.items()},
        schema.attributes | {"aslo_jax_study": 1},
    )


@contextmanager
def _progress(
    problem: Problem, schema: Schema, done: np.ndarray, wanted: bool
) -> Iterator[Callable[[int], Any]]:
    """What is told of samples done: a bar that counts steps of trajectories."""
    if not wanted:
        yield lambda samples: None
        return
    sizes = [schema.range(int(k)) for k in np.flatnonzero(done)]
    bar = require("tqdm", "study").tqdm(
        total=schema.samples * problem.steps,
        initial=sum(last - first for first, last in sizes) * problem.steps,
        unit=" steps",
        unit_scale=True,
    )
    with bar:
        yield lambda samples: bar.update(samples * problem.steps)


def whole(name: str, x: int) -> int:
    """A whole number from 1."""
    if x < 1 or x != int(x):
        raise ValueError(f"Argument `{name}` must be a whole number from 1, but got {x}.")
    return int(x)


def _chunk(chunk: int | None, store: str | Path | None, resume: bool) -> int:
    """Whole blocks; those of a store that is gone on with, which its arrays are cut by."""
    if chunk is not None:
        return -(-whole("chunk", chunk) // BLOCK) * BLOCK
    if resume and store is not None and Path(store).exists():
        return int(stored_attributes(Path(store)).get("chunk", CHUNK))
    return CHUNK


def steps_of(experiment: AnyExperiment, steps: int | None, horizon: float | None) -> int:
    """The number of intervals, as given or in the `horizon` (s)."""
    if (steps is None) == (horizon is None):
        raise ValueError("One of the arguments `steps` and `horizon` must be given.")
    if steps is not None:
        return whole("steps", steps)
    interval = float(experiment.interval)
    assert horizon is not None
    count = round(horizon / interval)
    if count < 1 or not math.isclose(count * interval, horizon, rel_tol=1e-6):
        raise ValueError(
            "Argument `horizon` must be a whole number of the experiment's intervals of "
            f"{interval:g} s, but got {horizon:g} s."
        )
    return count
