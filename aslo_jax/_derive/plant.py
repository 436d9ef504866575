"""A model as a plant: to simulate, to study, and to fit to a log."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import real
from .._signals import check_shapes
from .._typing import PyTree
from ..observers import AbstractModel
from ..plants import AbstractPlant
from .model import Model
from .polynomials import Polynomial, Ring, Top
from .symbols import Program, Symbolic, lowered, program


@dataclasses.dataclass(frozen=True, eq=False)
class Code:
    """The equations of a plant, as straight-line code.

    - `states`, `outputs`: the names of what is not measured, unknown parameters the last of
      it, and of what is; `inputs` how many; `estimated`: the states that are estimated;
    - `moving`: the outputs that are states, by number; `rates` of all states, these too;
    - `given`: the matrix and the right-hand side, entry by entry, of the other outputs;
      `through`: the inputs that these depend on;
    - `derived`: what was derived from the model, if anything.
    """

    states: tuple[str, ...]
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    estimated: tuple[str, ...]
    moving: tuple[int, ...]
    rates: Program
    given: Program | None
    through: tuple[str, ...]
    derived: Any = dataclasses.field(repr=False, default=None)

    @property
    def names(self) -> tuple[str, ...]:
        """Those of the state: what is not measured, then the outputs that are states."""
        return (*self.states, *(self.outputs[k] for k in self.moving))

    @property
    def fixed(self) -> tuple[int, ...]:
        """The outputs that equations give, by number."""
        return tuple(k for k in range(len(self.outputs)) if k not in self.moving)


class ModelPlant(AbstractPlant):
    """A model as a plant; its state is a dictionary: what is not measured, unknown
    parameters too, which do not change, and the outputs whose rates are known, by name.

    - `parameters`: those of the model that are known, by name;
    - `start`: the state at the first instant, by name: the middle of the ranges;
    - `code`: its equations.

    Its input has the shape `(m,)`, its output `(p,)`; `hidden` are the states that are
    estimated, shape `(k,)`.

    **Raises:** `ValueError` for an input of another shape, and where an output is asked for
    that depends on the input at the instant.
    """

    parameters: dict[str, Array]
    start: dict[str, Array]
    code: Code = eqx.field(static=True)

    def initial(self) -> PyTree:
        return dict(self.start)

    def vector_field(self, t: Float[Array, ""], x: PyTree, u: PyTree) -> PyTree:
        del t
        return self.named(self.drift(self.vector(x), u))

    def output(self, x: PyTree) -> PyTree:
        if self.code.through:
            raise ValueError(
                f"The output of a plant must not depend on its input, but that of this "
                f"model depends on {', '.join(self.code.through)}; make it an output that "
                "has a rate."
            )
        return self.measured(self.vector(x), jnp.zeros(len(self.code.inputs)))

    def hidden(self, x: PyTree) -> Float[Array, " k"]:
        return jnp.stack([x[name] for name in self.code.estimated])

    def no_input(self, y: PyTree) -> Any:
        return jnp.zeros(len(self.code.inputs), jnp.result_type(y))

    def vector(self, x: Mapping[str, Array]) -> Float[Array, " n"]:
        """The state as a vector, in the order of the model."""
        return jnp.stack([jnp.asarray(x[name]) for name in self.code.names])

    def named(self, x: Float[Array, " n"]) -> dict[str, Array]:
        """The state by name."""
        return dict(zip(self.code.names, x, strict=True))

    def drift(self, x: Float[Array, " n"], u: Float[Array, " m"]) -> Float[Array, " n"]:
        """The derivative of the state, both as vectors (units per second)."""
        check_shapes("ModelPlant", {"u": (len(self.code.inputs),)}, u, None)
        signals = self._signals(x, u, self.measured(x, u))
        dtype = jnp.result_type(x)
        return jnp.stack([jnp.asarray(r, dtype) for r in self.code.rates(signals)])

    def measured(self, x: Float[Array, " n"], u: Float[Array, " m"]) -> Float[Array, " p"]:
        """The outputs at a state."""
        code, n = self.code, len(self.code.states)
        y = jnp.zeros(len(code.outputs), jnp.result_type(x))
        if code.moving:
            y = y.at[jnp.array(code.moving)].set(x[n:])
        if code.given is None:
            return y
        k = len(code.fixed)
        found = [jnp.asarray(v, x.dtype) for v in code.given(self._signals(x, u, y))]
        C, d = jnp.stack(found[: k * k]).reshape(k, k), jnp.stack(found[k * k :])
        solved = d / C[0] if k == 1 else jnp.linalg.solve(C, d)
        return y.at[jnp.array(code.fixed)].set(solved)

    def _signals(self, x: Array, u: Array, y: Array) -> dict[str, Any]:
        p = tuple(self.parameters.values())
        return {"x": x[: len(self.code.states)], "y": y, "u": u, "p": p}

    def held(self, signal: Any) -> Any:
        """A signal for its inputs: numbers in it become one for each."""
        size = len(self.code.inputs)
        wide = lambda x: jnp.broadcast_to(x, (size,)) if jnp.ndim(x) == 0 else x
        return jax.tree.map(wide, signal)


class ModelOfPlant(AbstractModel):
    """A `plant` for the extended Kalman filter, its state a vector in the order of the
    model; the estimate are the states that an observer of the model gives."""

    plant: ModelPlant

    def drift(self, x: Float[Array, " n"], u: PyTree) -> Float[Array, " n"]:
        return self.plant.drift(x, u)

    def output(self, x: Float[Array, " n"]) -> Float[Array, " p"]:
        plant = self.plant
        return plant.output(plant.named(x))

    def select(self, x: Float[Array, " n"]) -> Float[Array, " k"]:
        return self.plant.hidden(self.plant.named(x))

    def signals_of(self, n: int) -> dict[str, tuple[int, ...]]:
        del n
        return {"u": (len(self.plant.code.inputs),), "y": (len(self.plant.code.outputs),)}


def plant_of(model: Model, derived: Any = None) -> ModelPlant:
    """The plant of a model, of which the states are estimated that were `derived`, by
    default all of them.

    **Raises:** `ValueError` where its equations do not give the outputs without rates, as a
    regular linear system.
    """
    graph, sizes = Symbolic(), model.sizes
    roots = lowered(graph, model.rates, sizes)
    moving: list[int] = []

    def rates(*signals: Any) -> list[Any]:
        found = model.measured_rates(*signals)
        moving[:] = list(found)
        return list(found.values())

    roots += lowered(graph, rates, sizes)
    fixed = tuple(k for k in range(len(model.outputs)) if k not in moving)
    given, through = _given(model, fixed) if fixed else (None, ())
    states, outputs = tuple(model.ranges), tuple(model.outputs)
    every = model.ranges | {outputs[k]: model.outputs[outputs[k]] for k in moving}
    code = Code(
        states,
        outputs,
        tuple(model.inputs),
        states if derived is None else derived.states,
        tuple(moving),
        program(graph, roots),
        given,
        through,
        derived,
    )
    parameters = {name: real(value) for name, value in model.known.items()}
    middle = {name: real(0.5 * (low + high)) for name, (low, high) in every.items()}
    return ModelPlant(parameters, middle, code)


def _given(model: Model, fixed: tuple[int, ...]) -> tuple[Program, tuple[str, ...]]:
    """The linear equations of the outputs that are `fixed` by others, and the inputs in
    them: the equations of the model as polynomials in these outputs."""
    graph, names = Symbolic(), [list(model.outputs)[k] for k in fixed]
    listed = ", ".join(names)

    def equations(z: Array, x: Array, y: Array, u: Array, p: Array) -> list[Array]:
        return model.equations(x, y.at[jnp.array(fixed)].set(z), u, p)

    sizes = {"z": len(fixed)} | model.sizes
    nodes = lowered(graph, equations, sizes)
    # To the ring what is looked for is x, whatever it is in the model.
    ring = Ring(graph, tuple(names), kind="z")
    rows: list[Polynomial] = []
    for node in nodes:
        p = ring.of(node)
        if isinstance(p, Top) or any(len(m) > 1 for m in p):
            raise ValueError(
                f"The equations of a model must be linear in the outputs without a rate, "
                f"{listed}, for it to be simulated, but {graph.described(node)} is not."
            )
        if any(p):
            rows.append(p)
    if len(rows) != len(fixed):
        raise ValueError(
            f"A model must have a rate, or an equation, for every output to be simulated, "
            f"but has {len(rows)} equations for the outputs {listed}."
        )
    zero, inputs = graph.zero, set[int]()
    places = [(k,) for k in range(len(fixed))]
    for p in rows:
        for c in p.values():
            inputs |= {k for kind, k in graph.inputs(c) if kind == "u"}
    C = [p.get(place, zero) for p in rows for place in places]
    d = [graph.op("neg", p[()]) if () in p else zero for p in rows]
    through = tuple(list(model.inputs)[k] for k in sorted(inputs))
    return program(graph, [*C, *d]), through
