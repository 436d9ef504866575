"""Which entries of the carry of a loop may depend on which of its inputs (activity
analysis)."""

from .loop import Loop
from .node import COMPARISONS

CUT = {*COMPARISONS, "table"}  # whose results have no derivative


def depends(loop: Loop, sources: set[tuple[str, int]]) -> set[int]:
    """The places in the carry whose value may change smoothly with `sources`, slots of
    inputs."""
    order = loop.graph.reachable([*loop.begin, *loop.carry])
    carried: set[int] = set()
    while True:
        moving: dict[int, bool] = {}
        for number in order:
            node = loop.graph.nodes[number]
            if node.op == "input":
                kind, i = node.data
                moving[number] = i in carried if kind == "carry" else node.data in sources
            elif node.op in CUT:
                moving[number] = False
            else:
                args = node.args[1:] if node.op == "select" else node.args
                moving[number] = any(moving[a] for a in args)
        pairs = enumerate(zip(loop.begin, loop.carry, strict=True))
        more = {i for i, pair in pairs if any(moving[n] for n in pair)}
        if more == carried:
            return carried
        carried = more
