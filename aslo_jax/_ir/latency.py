"""How many cycles operations take until their result is there (latencies)."""

from .node import Node

# Cycles until a result is there; one for all others.
LATENCY = {
    "const": 0,
    "input": 0,
    "add": 3,
    "sub": 3,
    "mul": 4,
    "fma": 4,
    "muladd": 4,
    "mulsub": 4,
    "submul": 4,
    "convert": 4,
    "floor": 8,
    "ceil": 8,
    "rint": 8,
    "div": 13,
    "sqrt": 20,
    "dot": 40,
    "call": 40,
}


def latency(node: Node) -> int:
    return LATENCY.get(node.op, 1)
