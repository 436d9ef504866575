"""What a study computes: its description, and the computation of one chunk of it."""

import dataclasses
import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._continuous import AnyExperiment
from .._experiment import Record
from .._module import Module
from .._typing import Engine
from ..engines import Runner
from ..metrics import AbstractMetric
from ..metrics._base import MakeMetric, metric_of
from ._leaves import Layout
from ._names import check_names
from ._possible import refuse_impossible
from ._spread import Sampler, Spread, names_of
from ._store import Data, Schema, Variable

# Samples are run in whole blocks that begin at a multiple of this, so that a sample is
# always in the same place of its block. A multiple of every width of the fused engine.
BLOCK = 256
CHUNK = 1024  # by default: a progress every few seconds, ten pieces of 10,000 samples


@dataclasses.dataclass(frozen=True)
class Problem:
    """Everything that decides the numbers of a study; it can be sent to other processes.
    Fields are as in [`run`][]."""

    experiment: AnyExperiment
    spread: Spread
    samples: int
    seed: int
    steps: int
    metrics: dict[str, MakeMetric]
    every: int | None
    scale: np.ndarray | None
    engine: Engine
    chunk: int
    configuration: dict[str, Any] | None
    units: dict[str, str]
    entries: tuple[str, ...] | None

    def __post_init__(self) -> None:
        if not self.experiment.observers:
            raise ValueError("Argument `experiment` must have an observer, but has none.")
        check_names(self.experiment.observers, self.metrics, names_of(self.spread))
        if self.every is not None and (self.every < 1 or self.steps % self.every):
            raise ValueError(
                f"Argument `every` must divide the number of steps, {self.steps}, but got "
                f"{self.every}."
            )
        if self.samples > 2**31:
            raise ValueError(
                f"Argument `samples` must be at most 2**31, but got {self.samples}."
            )

    @property
    def observers(self) -> list[str]:
        return list(self.experiment.observers)


class ErrorNorms(Module):
    """The norm of the error of every observer, or of the error over `scale`."""

    observers: tuple[str, ...] = eqx.field(static=True)
    scale: Float[Array, " n"] | None

    def __call__(self, record: Record) -> Float[Array, " observers"]:
        norms = []
        for name in self.observers:
            e = record.estimates[name].value - record.hidden
            e = e if self.scale is None else e / self.scale
            norms.append(jnp.sqrt(jnp.sum(e * e)))
        return jnp.stack(norms)


def of_each(
    metrics: Mapping[str, MakeMetric], observers: Iterable[str]
) -> dict[str, AbstractMetric]:
    """Every metric of every observer, by `metric/observer`."""
    return {
        f"{metric}/{observer}": metric_of(make, observer)
        for metric, make in metrics.items()
        for observer in observers
    }


class Study:
    """A problem, traced: `schema` of its results, and [`Study.chunk`][] of them. It can be
    sent to other processes; what is not compiled yet is compiled there."""

    def __init__(self, problem: Problem, threads: int | None = None) -> None:
        self.problem = problem
        self.sampler = Sampler(
            problem.experiment, problem.spread, problem.seed, problem.samples
        )
        refuse_impossible(self.sampler, problem.samples)
        metrics = of_each(problem.metrics, problem.observers)
        scale = None if problem.scale is None else jnp.asarray(problem.scale)
        norms = ErrorNorms(tuple(problem.observers), scale)
        self.runner = Runner(
            self.sampler.make,
            self.sampler.like(),
            problem.steps,
            metrics=metrics,
            record=None if problem.every is None else norms,
            every=problem.every,
            engine=problem.engine,
            threads=threads,
            block=BLOCK,
        )
        self.schema = self._schema()

    def chunk(self, number: int) -> Data:
        """The results of a chunk of samples, by variable."""
        first, last = self.schema.range(number)
        values = self.sampler.values(first, last)
        # Whole blocks, the last sample repeated.
        padded = np.minimum(
            np.arange(first, first + -(-(last - first) // BLOCK) * BLOCK), last - 1
        )
        batch = self.runner(self.sampler(padded, values[padded - first]))
        count, found = last - first, {}
        for metric in self.problem.metrics:
            each = [
                np.asarray(batch.metrics[f"{metric}/{observer}"])[:count]
                for observer in self.problem.observers
            ]
            found[metric] = np.stack(each, axis=1)
        for k, name in enumerate(self.sampler.names):
            found[f"parameter_{name}"] = values[:, k]
        if self.problem.every is not None:
            found["error"] = np.asarray(batch.record)[:count]
        return found

    def _schema(self) -> Schema:
        problem, variables = self.problem, {}
        width = jax.eval_shape(lambda: _hidden(problem.experiment)).shape[0]
        observers = problem.observers
        coordinates: dict[str, np.ndarray] = {"observer": np.array(observers)}
        described: dict[str, dict[str, str]] = {}
        for metric in problem.metrics:
            shapes = {self.runner.shapes.metrics[f"{metric}/{o}"].shape for o in observers}
            dtypes = {self.runner.shapes.metrics[f"{metric}/{o}"].dtype for o in observers}
            if len(shapes) > 1 or len(dtypes) > 1 or any(len(s) > 1 for s in shapes):
                raise ValueError(
                    f"Argument `metrics`: `{metric}` must give a number, or an array of "
                    "one axis, of the same shape and type for every observer, but gives "
                    f"shapes {sorted(shapes)}."
                )
            (shape,), (dtype,) = shapes, dtypes
            own = "entry" if shape == (width,) else f"{metric}_entry"
            dims = ("sample", "observer", *([own] if shape else []))
            if shape == (width,):
                names = problem.entries or tuple(str(k + 1) for k in range(width))
                coordinates["entry"] = np.array(names)
            about = self._about(metric)
            if shape == (width,) and problem.scale is not None:
                about["scale"] = problem.scale.tolist()
            variables[metric] = Variable(
                dims, (len(observers), *shape), np.dtype(dtype), about
            )
        for name in self.sampler.names:
            about = self._about(f"parameter_{name}")
            variables[f"parameter_{name}"] = Variable(
                ("sample",), (), np.dtype(float), about
            )
        if problem.every is not None:
            kept = self.runner.shapes.record
            interval = float(problem.experiment.interval)
            time = np.arange(problem.steps // problem.every + 1) * problem.every * interval
            coordinates["time"] = time
            described["time"] = {"units": "s", "long_name": "time"}
            variables["error"] = Variable(
                ("sample", "time", "observer"),
                (len(time), len(observers)),
                np.dtype(kept.dtype),
                self._about("error", "norm of the error of the estimate"),
            )
        return Schema(
            problem.samples,
            problem.chunk,
            variables,
            coordinates,
            described,
            self._attributes(),
        )

    def _about(self, name: str, text: str | None = None) -> dict[str, Any]:
        text = name.replace("_", " ") if text is None else text
        return {"units": self.problem.units.get(name, ""), "long_name": text}

    def _attributes(self) -> dict[str, Any]:
        problem = self.problem
        given = problem.configuration
        return {
            "configuration": json.dumps(_described(problem) if given is None else given),
            "fingerprint": fingerprint(problem),
            "seed": str(problem.seed),  # 64 bits are more than JSON keeps
            "samples": problem.samples,
            "steps": problem.steps,
            "interval": float(problem.experiment.interval),
            "engine": self.runner.engine,
            "precision": str(jnp.zeros(()).dtype),
            "chunk": problem.chunk,
            "versions": json.dumps(versions()),
        }


def _hidden(experiment: AnyExperiment) -> Float[Array, " n"]:
    """What is estimated, at the start."""
    start = experiment.initial
    start = experiment.plant.initial() if start is None else start
    return experiment.plant.hidden(jax.tree.map(jnp.asarray, start))


def versions() -> dict[str, str]:
    """Of the packages that decide the bits of a study."""
    found = {}
    for package in ("aslo_jax", "jax", "jaxlib", "equinox", "numpy", "scipy", "llvmlite"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "none"
    return found


def _described(problem: Problem) -> dict[str, Any]:
    """A problem that comes from no file, in words."""
    return {
        "experiment": eqx.tree_pformat(problem.experiment, short_arrays=False),
        "spread": str(problem.spread),
        "metrics": {
            name: eqx.tree_pformat(metric_of(make, "observer"), short_arrays=False)
            for name, make in problem.metrics.items()
        },
    }


def fingerprint(problem: Problem) -> str:
    """A digest of what decides the numbers and is in no other attribute: the parameters to
    the last bit, spread and metrics, and functions by name and code."""
    layout = Layout(problem.experiment)
    found = hashlib.sha256()

    def add(*parts: Any) -> None:
        for part in parts:
            # Without addresses in memory, which are those of one process.
            found.update(re.sub(r" at 0x[0-9a-f]+", "", str(part)).encode() + b"\0")

    add(layout.tree)
    for path, leaf in zip(layout.paths, layout.leaves, strict=True):
        add(path, _content(leaf))
    for name, parameter in problem.spread.parameters.items():
        where = parameter.where
        wheres = [where] if isinstance(where, str) or callable(where) else list(where)
        add(name, parameter.distribution, parameter.relative)
        for each in wheres:
            add(*(layout.paths[p.leaf] + str(p.entry) for p in layout.places(each)))
    add(problem.spread.design, problem.every)
    add(None if problem.scale is None else problem.scale.tolist())
    for name, make in problem.metrics.items():
        metric = metric_of(make, "observer")
        add(name, type(metric).__qualname__, *map(_content, jax.tree.leaves(metric)))
        add(jax.tree.structure(metric))
    return found.hexdigest()


def _content(leaf: Any) -> str:
    if hasattr(leaf, "dtype"):
        array = np.asarray(leaf)
        return f"{array.dtype}{array.shape}{array.tobytes().hex()}"
    code = getattr(leaf, "__code__", None)
    if code is None:
        return f"{type(leaf).__qualname__} {getattr(leaf, '__qualname__', leaf)}"
    cells = [cell.cell_contents for cell in leaf.__closure__ or ()]
    plain = [c for c in (*code.co_consts, *cells) if isinstance(c, int | float | str)]
    plain += [_content(cell) for cell in cells if hasattr(cell, "dtype")]
    return f"{leaf.__module__} {leaf.__qualname__} {code.co_code.hex()} {plain}"
