"""Functions of scalars that have several results."""

from typing import Any, NamedTuple


class Several(NamedTuple):
    """A function of scalars with several results: a graph whose inputs have the slots
    `("argument", k)`, of which the first `moving` change over time. Where the first one of
    a `gated` function is zero, so are its results: nothing is computed if it is so in all
    lanes that are computed together."""

    graph: Any  # a `Graph`
    results: tuple[int, ...]
    moving: int
    gated: bool = False

    @property
    def size(self) -> int:
        """Operations, over the number of results."""
        own = self.graph.reachable(list(self.results))
        return -(-sum(self.graph.nodes[n].size for n in own) // len(self.results))
