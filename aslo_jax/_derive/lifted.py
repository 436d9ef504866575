"""What a model is once it is lowered and sampled: its polynomials, and their closure."""

import dataclasses
from typing import Any

import numpy as np

from .closure import Closure, close, remainder
from .model import Model
from .polynomials import Drawn, Points, Polynomial, Ring, Sampled, Top
from .symbols import Symbolic, lowered

POINTS = 48
LEAST = 12  # of them at which a model must be finite
Rows = list[tuple[str, int, Polynomial | Top]]


class NotFinite(ValueError):
    """A model that is not finite where it is said to be used."""


@dataclasses.dataclass(frozen=True)
class Lowered:
    """The polynomials of a model: `rates` of its states, and `rows`, which tell of these.

    `measured` are states that are taken as measured; they have no generator."""

    model: Model
    graph: Symbolic
    ring: Ring
    rates: list[Polynomial | Top]
    rows: Rows
    nodes: dict[str, list[int]]

    def sampled(
        self, seed: int, parameters: np.ndarray | None = None, drawn: Drawn = "all"
    ) -> Sampled:
        """Coefficients at points of the ranges at which the model is finite, of the model's
        parameters or others; `drawn`: what is by lot.

        **Raises:** [`NotFinite`][]."""
        points = self._points(seed, parameters, drawn)
        true = self._points(seed, parameters, "nothing")
        true.good = self._finite(true)
        if true.size < LEAST:
            raise NotFinite(
                "The model must be finite on the ranges of its outputs and inputs, but is "
                f"not at {POINTS - true.size} of {POINTS} points of these; narrow them."
            )
        if drawn == "nothing":
            return Sampled(self.graph, true)
        points.good = true.good if drawn == "all" else self._finite(points)
        return Sampled(self.graph, points if points.size >= LEAST else true)

    def _finite(self, points: Points) -> np.ndarray:
        """At which points all coefficients are numbers, shape `(N,)`."""
        every = [*self.rates, *(r for *_, r in self.rows)]
        nodes = {c for p in every if not isinstance(p, Top) for c in p.values()}
        good = np.ones(points.count, bool)
        for value in points.of(self.graph, sorted(nodes)):
            good &= np.isfinite(value).all(axis=0)
        return good

    def _points(self, seed: int, parameters: np.ndarray | None, drawn: Drawn) -> Points:
        rng = np.random.default_rng(seed)
        model, inputs = self.model, {}
        groups = {"x": model.ranges, "y": model.outputs, "u": model.inputs}
        for kind, ranges in groups.items():
            for k, (low, high) in enumerate(ranges.values()):
                inputs[kind, k] = rng.uniform(low, high, POINTS)
        values = model.values() if parameters is None else parameters
        for k, value in enumerate(values):
            inputs["p", k] = np.full(POINTS, value)
        return Points(inputs, seed, drawn)


def lower(model: Model, measured: tuple[str, ...] = ()) -> Lowered:
    """The polynomials of a model, in whose ring the states that are `measured` are none.

    **Raises:** `NotFusible` for a primitive that the engine's frontend does not know."""
    graph, sizes = Symbolic(), model.sizes
    nodes = {
        "f": lowered(graph, model.rates, sizes),
        "h": lowered(graph, model.equations, sizes),
    }
    outputs: list[int] = []

    def rates(*signals: Any) -> list[Any]:
        found = model.measured_rates(*signals)
        outputs[:] = list(found)
        return list(found.values())

    nodes["g"] = lowered(graph, rates, sizes)
    names = tuple(model.ranges)
    ring = Ring(graph, names, frozenset(names.index(name) for name in measured))
    rows: Rows = [("rate", k, ring.of(n)) for k, n in zip(outputs, nodes["g"], strict=True)]
    rows += [("equation", k, ring.of(n)) for k, n in enumerate(nodes["h"])]
    own = [
        ("state", names.index(name), ring.of(nodes["f"][names.index(name)]))
        for name in measured
    ]
    found = [ring.of(n) for n in nodes["f"]]
    return Lowered(model, graph, ring, found, [*rows, *own], nodes)


def closed(
    lowered: Lowered, parameters: np.ndarray | None = None
) -> tuple[Closure, Sampled]:
    """The closure of the rows, which holds at fresh points too, for the model's parameters
    or others."""
    algebra = lowered.sampled(0, parameters)
    found = close(lowered.ring, algebra, *_at(lowered, algebra))
    if found.rows:
        fresh = lowered.sampled(7, parameters)
        if remainder(lowered.ring, fresh, found, *_at(lowered, fresh)):
            found = dataclasses.replace(found, rows=(), basis=(), pivots=())
    return found, algebra


def _at(lowered: Lowered, algebra: Sampled) -> tuple[list[Polynomial | Top], Rows]:
    rates = [algebra.at(p) for p in lowered.rates]
    return rates, [(kind, k, algebra.at(p)) for kind, k, p in lowered.rows]
