"""Which outputs of a loop may depend on which of its inputs."""

import numpy as np

from .emit import Loop

CUT = {"eq", "ne", "lt", "le", "gt", "ge"}  # whose results have no derivative


def depends(loop: Loop, sources: set[tuple[str, int]]) -> np.ndarray:
    """For every entry of the carry, whether it may change smoothly with `sources`, slots of
    inputs."""
    moving: dict[int, bool] = {}
    for number in loop.graph.reachable(list(loop.carry)):
        node = loop.graph.nodes[number]
        if node.op == "input":
            moving[number] = node.data in sources
        elif node.op in CUT:
            moving[number] = False
        else:
            args = node.args[1:] if node.op == "select" else node.args
            moving[number] = any(moving[a] for a in args)
    return np.array([moving[n] for n in loop.carry], bool)
