"""What is exported: a start and a step of something with a state, parameters, and signals
in and out."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._typing import PyTree
from ..control import AbstractController
from ..filters import AbstractFilter
from ..observers import AbstractObserver

__all__ = ["Block", "Chain", "block_of"]


class Block(NamedTuple):
    """Functions of a `module`, whose arrays may be parameters.

    - `start(module, first) -> (state, output)`: of the inputs that are named in `first`;
    - `step(module, state, inputs, dt) -> (state, output)`: after an interval of dt (s);
    - `inputs`: the shapes of the inputs, trees by name.
    """

    module: PyTree
    start: Callable[[Any, dict[str, PyTree]], tuple[PyTree, PyTree]]
    step: Callable[[Any, PyTree, dict[str, PyTree], Any], tuple[PyTree, PyTree]]
    inputs: dict[str, PyTree]
    first: tuple[str, ...]


class Chain(eqx.Module):
    """An `observer` and the `controller` that is fed with what it estimates, as one step
    of a control loop, in the order of [`Experiment`][]: measure, observe, control, hold.

    - `feedback(y, estimate)`: what the controller is fed.

    The state keeps the input that was commanded last. The output is a dictionary with
    `u`, the new command, and `estimate`.
    """

    observer: AbstractObserver[Any]
    controller: AbstractController
    feedback: Callable[[PyTree, Any], PyTree]


def block_of(
    part: Any,
    signals: Mapping[str, PyTree],
    *,
    substeps: int = 1,
    coasts: bool = False,
    outputs: Callable[[Any], PyTree] | None = None,
) -> Block:
    """How an observer, a filter, a controller or a chain starts and steps.

    `signals` are examples of its inputs by name, `outputs` makes of what it gives what is
    wanted.

    **Raises:** `ValueError` for anything else, and for inputs that are not given.
    """
    wanted = outputs or (lambda output: output)
    if isinstance(part, AbstractObserver):
        made = _observer(part, signals, substeps, coasts)
    elif isinstance(part, Chain):
        made = _chain(part, signals, substeps, coasts)
    elif isinstance(part, AbstractFilter):
        made = _filter(part, signals)
    elif isinstance(part, AbstractController):
        made = _controller(part, signals)
    else:
        raise ValueError(
            "Argument `observer` must be an observer, a filter, a controller or a "
            f"`Chain` of them, but got {type(part).__name__}."
        )

    def start(module, first):
        state, output = made.start(module, first)
        return state, wanted(output)

    def step(module, state, inputs, dt):
        state, output = made.step(module, state, inputs, dt)
        return state, wanted(output)

    return made._replace(start=start, step=step)


def _shapes(name: str, signals: Mapping[str, PyTree], default: PyTree) -> PyTree:
    """Those of an example, or of the shape that is declared."""
    given = signals.get(name)
    if given is None and (default is None or None in default):
        raise ValueError(
            f"Argument `{name}` must be given: an example of the input `{name}`, of which "
            "only the shape matters, since the exported module does not declare it."
        )
    if given is None:
        given = jax.ShapeDtypeStruct(tuple(default), np.dtype(float))
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct(np.shape(x), np.dtype(float)), given)


def _zeros(shapes: PyTree) -> PyTree:
    return jax.tree.map(lambda s: jnp.zeros(s.shape), shapes)


def _observer(
    observer: AbstractObserver[Any],
    signals: Mapping[str, PyTree],
    substeps: int,
    coasts: bool,
) -> Block:
    declared = getattr(observer, "signals", {})
    inputs = {name: _shapes(name, signals, declared.get(name)) for name in ("u", "y")}
    seen = _Seen(inputs["u"], substeps, coasts)
    return Block(observer, seen.start, seen.step, inputs, ("y",))


class _Seen(NamedTuple):
    """How an observer starts and steps."""

    u: PyTree
    substeps: int
    coasts: bool

    def start(self, observer: Any, first: dict[str, PyTree]) -> tuple[PyTree, PyTree]:
        y, u = first["y"], _zeros(self.u)
        state = observer.init(y, u)
        return state, observer.estimate(jnp.zeros(()), state, u, y)

    def step(
        self, observer: Any, state: PyTree, inputs: dict[str, PyTree], dt: Any
    ) -> tuple[PyTree, PyTree]:
        u, y = inputs["u"], inputs["y"]
        coefficients = observer.allocate(state.y, u).discretise(dt / self.substeps)
        if self.coasts:
            return observer.take(state, u, y, dt, coefficients, substeps=self.substeps)
        return observer.advance(state, u, y, coefficients, substeps=self.substeps)


def _chain(
    chain: Chain, signals: Mapping[str, PyTree], substeps: int, coasts: bool
) -> Block:
    declared = getattr(chain.observer, "signals", {})
    u, y = (_shapes(name, signals, declared.get(name)) for name in ("u", "y"))
    seen = _Seen(u, substeps, coasts)

    def start(chain, first):
        state, estimate = seen.start(chain.observer, first)
        fed = chain.feedback(first["y"], estimate)
        control, t = chain.controller.init(fed), jnp.zeros(())
        command = _command(chain.controller, t, control, fed)
        output = {"u": command, "estimate": estimate}
        begun = {"observer": state, "controller": control, "fed": fed, "u": command, "t": t}
        return begun, output

    def step(chain, state, inputs, dt):
        controller, t, fed = chain.controller, state["t"], state["fed"]
        control = _advanced(controller, t, state["controller"], fed, dt)
        before = {"u": state["u"], "y": inputs["y"]}
        observed, estimate = seen.step(chain.observer, state["observer"], before, dt)
        t, fed = t + dt, chain.feedback(inputs["y"], estimate)
        command = _command(controller, t, control, fed)
        after = {"observer": observed, "controller": control, "fed": fed, "u": command}
        return after | {"t": t}, {"u": command, "estimate": estimate}

    return Block(chain, start, step, {"y": y}, ("y",))


def _command(controller: Any, t: Any, state: PyTree, fed: PyTree) -> PyTree:
    return jax.tree.map(jnp.asarray, controller(t, state, fed))


def _advanced(controller: Any, t: Any, state: PyTree, fed: PyTree, dt: Any) -> PyTree:
    rate = controller.vector_field(t, state, fed)
    return jax.tree.map(lambda s, r: s + dt * r, state, rate)


def _controller(controller: AbstractController, signals: Mapping[str, PyTree]) -> Block:
    """Its state advances over the interval that ends now, from what it was fed at its
    beginning, as in a sampled loop."""
    fed = _shapes("y", signals, None)

    def start(controller, first):
        state, t = controller.init(first["y"]), jnp.zeros(())
        command = _command(controller, t, state, first["y"])
        return {"controller": state, "fed": first["y"], "t": t}, {"u": command}

    def step(controller, state, inputs, dt):
        control = _advanced(controller, state["t"], state["controller"], state["fed"], dt)
        t, y = state["t"] + dt, inputs["y"]
        after = {"controller": control, "fed": y, "t": t}
        return after, {"u": _command(controller, t, control, y)}

    return Block(controller, start, step, {"y": fed}, ("y",))


def _filter(law: AbstractFilter, signals: Mapping[str, PyTree]) -> Block:
    """The filtered signal, from zero."""
    y = _shapes("y", signals, None)

    def output(law, X, s):
        return {"value": law.output(X) + law.feedthrough(s)}

    def start(law, first):
        s = first["y"]
        X = jnp.zeros_like(law.inject(s))
        return {"X": X, "y": s}, output(law, X, s)

    def step(law, state, inputs, dt):
        before, s = state["y"], inputs["y"]
        coefficients = law.discretise(dt)
        X = law.advance(state["X"], law.inject(before), law.inject(s), coefficients)
        return {"X": X, "y": s}, output(law, X, s)

    return Block(law, start, step, {"y": y}, ("y",))
