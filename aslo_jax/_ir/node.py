"""One operation of a graph."""

from typing import Any, NamedTuple

import numpy as np

# The types of numbers that a graph may compute with, by name.
NUMBERS = ("float64", "float32", "bool")
NUMBERS += tuple(f"{kind}{8 * size}" for kind in ("int", "uint") for size in (1, 2, 4, 8))
BOOL = np.dtype(bool)
LANEWISE = ("lane", "lane log", "carry", "saving", "argument")  # inputs
LOOPED = ("dot", "call", "part")  # done in functions, on arrays in memory
COMPARISONS = ("eq", "ne", "lt", "le", "gt", "ge")  # their results are booleans
COMMUTES = {"add", "mul", "and", "or", "xor", "eq", "ne"}


class Node(NamedTuple):
    """One operation on scalars. `data`: the value of a `const`, the slot of an `input`, the
    entries of a `table`, the function of a `call`; of a `part`, the function with several
    results and which of these it is."""

    op: str
    dtype: np.dtype
    args: tuple[int, ...] = ()
    data: Any = None

    @property
    def size(self) -> int:
        """How many operations it takes, a product with a sum counted as two."""
        if self.op in ("const", "input"):
            return 0
        if self.op == "call":
            return self.data.graph.size(self.data.result)
        if self.op == "part":
            return self.data[0].size  # each result has its share
        return {"fma": 2, "dot": len(self.args) - 1}.get(self.op, 1)

    def varies(self, args: list[tuple[bool, bool]]) -> tuple[bool, bool]:
        """Whether it changes over time, and over lanes, as its arguments do."""
        if self.op == "input":
            kind = self.data[0]
            return kind not in ("shared", "lane"), kind in LANEWISE
        return any(time for time, _ in args), any(lane for _, lane in args)
