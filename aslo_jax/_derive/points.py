"""Points at which the coefficients of a model are compared."""

from typing import Any, Literal

import numpy as np

from .evaluation import Lots, at_points
from .symbols import Symbolic

Drawn = Literal["all", "branches", "nothing"]


class Points:
    """Points at which coefficients are compared: values of inputs by slot, shape `(N,)`.

    `drawn` says what of a model is by lot ([`Lots`][]): `"all"`, `"branches"` or
    `"nothing"`; within an elimination, whose conditions belong together, nothing is."""

    def __init__(self, inputs: dict[Any, np.ndarray], seed: int, drawn: Drawn) -> None:
        self.inputs = inputs
        self.count = len(next(iter(inputs.values()))) if inputs else 1
        self.seed = seed
        self.drawn = drawn
        self.good = np.ones(self.count, bool)
        self._found: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    @property
    def size(self) -> int:
        """How many of them are good."""
        return int(self.good.sum())

    def of(self, graph: Symbolic, nodes: list[int]) -> list[np.ndarray]:
        lots = None
        if self.drawn != "nothing":
            lots = Lots(self.seed, self.count, self.drawn == "all", graph.eliminates)
        found = self._found
        order = [n for n in graph.reachable(nodes) if n not in found]
        at_points(graph.nodes, order, self.inputs, lots, found)
        return [self._whole(graph, n, found[n], lots) for n in nodes]

    def _whole(
        self, graph: Symbolic, number: int, found: tuple[np.ndarray, ...], lots: Lots | None
    ) -> np.ndarray:
        """Value and magnitude at the good points. What is zero at all of them by no
        cancellation, as a number that is too small is, may be none elsewhere."""
        both = np.stack([np.broadcast_to(np.asarray(x, float), self.count) for x in found])
        nothing = lots is not None and lots.wild and not both.any()
        varies = any(kind != "p" for kind, _ in graph.inputs(number))
        if nothing and varies and graph.value(number) is None:
            assert lots is not None
            both = np.stack([lots.numbers(number), np.ones(self.count)])
        return both[:, self.good]
