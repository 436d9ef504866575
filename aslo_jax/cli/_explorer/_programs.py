"""Compiled loops whose arguments are all numbers of an experiment, so that no slider
compiles anything."""

import dataclasses
import threading
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..._experiment import Experiment, Record
from ..._module import Module
from ...engines import Runner
from ...study._config import experiment_in
from ...study._designs import make_design
from ...study._leaves import Layout
from ...study._spread import Spread, names_of
from ._scene import Moved

KEPT = 8  # compiled loops
RUNS = 256  # of a band
POINTS = 250  # of it in time, about


class Everything(Module):
    """What is kept of the one run that is drawn."""

    def __call__(self, record: Record[Any]) -> dict[str, Any]:
        estimates = {
            name: {"value": e.value, "certificate": e.certificate, "coasting": e.coasting}
            for name, e in record.estimates.items()
        }
        x = record.x
        angle = (x.angle, x.speed) if hasattr(x, "angle") else None
        return {
            "u": record.u,
            "y": record.y,
            "hidden": record.hidden,
            "angle": angle,
            "estimates": estimates,
        }


class Errors(Module):
    """What is kept of the runs of a band: the norm of every error, over a `scale`."""

    scale: Float[np.ndarray, " n"] | None

    def __call__(self, record: Record[Any]) -> Any:
        def norm(estimate: Any) -> Any:
            e = estimate.value - record.hidden
            e = e if self.scale is None else e / self.scale
            return jnp.sqrt(jnp.sum(e * e))

        return {name: norm(each) for name, each in record.estimates.items()}


@dataclasses.dataclass(frozen=True, eq=False)
class _Program:
    """A compiled loop: of experiments with this `tree` and these `still` leaves, which are
    no numbers, and this `kind` of record."""

    runner: Runner
    tree: Any
    still: tuple[Any, ...]
    shapes: tuple[Any, ...]
    kind: tuple[Any, ...]

    def suits(self, other: tuple[Any, ...]) -> bool:
        return (self.tree, self.still, self.shapes, self.kind) == other


class Programs:
    """The loops that were compiled lately; `traced` counts how often an experiment was
    traced, which takes a new structure, and no other number."""

    def __init__(self) -> None:
        self.traced = 0
        self._programs: list[_Program] = []
        self._lock = threading.Lock()

    def run(
        self,
        layout: Layout,
        lanes: list[np.ndarray],
        steps: int,
        every: int,
        record: Callable[[Record[Any]], Any],
        kind: tuple[Any, ...],
    ) -> Any:
        """What `record` keeps of runs of an experiment, with a leading axis for them.

        - `layout`: of the experiment; `lanes`: its numbers, with that axis;
        - `kind`: what tells the record from others.
        """
        program = self._program(layout, steps, every, record, kind)
        return jax.tree.map(np.asarray, program.runner(lanes).record)

    def _program(self, layout, steps, every, record, kind) -> _Program:
        moved = [is_number(leaf) for leaf in layout.leaves]
        still = tuple(x for x, m in zip(layout.leaves, moved, strict=True) if not m)
        like = numbers(layout)
        shapes = tuple((x.shape, str(x.dtype)) for x in like)
        wanted = layout.tree, still, shapes, (steps, every, *kind)
        with self._lock:
            found = next((p for p in self._programs if p.suits(wanted)), None)
            if found is None:
                shapes_of = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in like]
                make = self._make(layout, moved)
                runner = Runner(make, shapes_of, steps, every=every, record=record)
                found = _Program(runner, *wanted)
            else:
                self._programs.remove(found)
            self._programs = [found, *self._programs[: KEPT - 1]]
        return found

    def _make(self, layout: Layout, moved: list[bool]) -> Callable[[Any], Experiment]:
        def make(values: list[Any]) -> Experiment:
            self.traced += 1
            rest = iter(values)
            leaves = [
                next(rest) if m else leaf
                for leaf, m in zip(layout.leaves, moved, strict=True)
            ]
            return jax.tree.unflatten(layout.tree, leaves)

        return make


def is_number(leaf: Any) -> bool:
    """Whether a leaf of an experiment is an array."""
    return eqx.is_array(leaf) or isinstance(leaf, np.ndarray)


def numbers(layout: Layout) -> list[np.ndarray]:
    """Those of an experiment."""
    return [np.asarray(leaf) for leaf in layout.leaves if is_number(leaf)]


def layout_of(moved: Moved, seed: int) -> Layout:
    """The leaves of the experiment of a content, with its errors in the plant, and noise of
    that `seed`."""
    layout = Layout(experiment_in(moved.content))
    for key, error in moved.errors.items():
        if error:
            for leaf, entry in layout.places(f"plant.{key}"):
                assert not entry
                layout.leaves[leaf] = np.asarray(layout.leaves[leaf]) * (1.0 + error)
    (word,) = words(seed, 1)
    for leaf in layout.random_keys():
        layout.leaves[leaf] = word
    return layout


def words(seed: int, count: int) -> np.ndarray:
    """Keys of random numbers, of which no two runs have the same, shape `(count, 2)`."""
    generator = np.random.Philox(key=[seed, 0])
    return generator.random_raw(count).view(np.uint32).reshape(count, 2)


def band_lanes(
    layout: Layout, tolerances: Spread, seed: int, tolerance: float
) -> list[np.ndarray]:
    """The numbers of `RUNS` runs: of the plant's parameters those of the study's relative
    `tolerances`, times `tolerance`, and noise of their own."""
    leaves = [
        np.repeat(np.asarray(leaf)[None], RUNS, axis=0) if is_number(leaf) else leaf
        for leaf in layout.leaves
    ]
    for where, values in drawn(tolerances, seed):
        factors = 1.0 + tolerance * (values - 1.0)
        for leaf, entry in layout.places(where):
            part = (slice(None), *entry)
            leaves[leaf][part] *= factors.reshape(-1, *[1] * (leaves[leaf][part].ndim - 1))
            if layout.paths[leaf] == "plant.magnet_flux":  # starts without current
                for start, _ in layout.places("initial.flux"):
                    leaves[start] *= factors[:, None]
    keys = words(seed, RUNS + 1)[1:]
    for leaf in layout.random_keys():
        leaves[leaf] = keys
    return [leaf for leaf in leaves if is_number(leaf)]


def drawn(tolerances: Spread, seed: int) -> list[tuple[Any, np.ndarray]]:
    """What each number of a spread sets, and its values, shape `(RUNS,)`."""
    names = names_of(tolerances)
    points = make_design(tolerances.design, names, seed, RUNS)(0, RUNS)
    found, first = [], 0
    for each in tolerances.parameters.values():
        last = first + each.distribution.dimension
        values = each.distribution.quantiles(points[:, first:last])
        where: Any = each.where
        wheres = [where] if isinstance(where, str) or callable(where) else where
        found += zip(wheres, values.T, strict=True)
        first = last
    return found
