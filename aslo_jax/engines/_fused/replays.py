"""Many recorded logs by observers that a function makes, in one loop."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..._typing import PyTree
from ...observers import AbstractObserver
from .._runtime.host import widths
from .kept import shape_of
from .program import Bodies, Program

# Passes that take longer than what they save in one reading of some thousand rows: 2 s of
# the 8 s to compile nine observers of three velocities.
WITHOUT = ("commoning", "correlation", "factors", "timetable", "unswitching")


class Replays:
    """Replays of logs, traced for the first ones and compiled once; each begins by itself.

    - `make(sample, y)`: the observer of a sample and of the first y of its log;
    - `keep(estimate)`: what is returned of an estimate;
    - `interval` between samples (s).
    """

    def __init__(
        self,
        make: Callable[[PyTree, Any], AbstractObserver[Any]],
        keep: Callable[[Any], PyTree],
        interval: float,
    ) -> None:
        self.make, self.keep, self.interval = make, keep, interval
        self._program: Program | None = None

    def __call__(self, samples: PyTree, u: np.ndarray, y: np.ndarray) -> PyTree:
        """For the samples, a tree of arrays with a leading axis of lanes, and logs of shape
        `(lanes, N, ...)`, as [`replay`][] takes them: leaves of that shape."""
        lane = {"sample": samples, "u": u[:, 0], "y": y[:, 0]}
        lane = jax.tree.map(np.asarray, lane)
        log = {"u": np.asarray(u[:, :-1]), "y": np.asarray(y[:, 1:])}
        if self._program is None:
            shapes = lambda tree, drop: jax.tree.map(lambda x: shape_of(x, drop), tree)
            inputs = {"lane": shapes(lane, 1), "lane log": shapes(log, 2)}
            # Of many observers beside each other a step is long whatever the width.
            bodies, narrow = self._bodies(), widths()[:1]
            self._program = Program.of(bodies, inputs, narrow, without=WITHOUT)
        lanes, steps = log["y"].shape[:2]
        found, _ = self._program({"lane": lane, "lane log": log}, lanes, steps)
        return found

    def _bodies(self) -> Bodies:
        def made(inputs):
            lane = inputs["lane"]
            return self.make(lane["sample"], lane["y"]), lane["u"], lane["y"]

        def begin(inputs):
            observer, u, y = made(inputs)
            state = observer.init(y, u)
            first = observer.estimate(jnp.zeros(()), state, u, y)
            laws = observer.allocate(y, u).discretise(jnp.asarray(self.interval))
            return state, self.keep(first), laws

        def advance(k, state, inputs, laws):
            observer, log = made(inputs)[0], inputs["lane log"]
            state, estimate = observer.advance(state, log["u"], log["y"], laws)
            return state, self.keep(estimate)

        return Bodies(begin, advance, lambda state, inputs: ())
