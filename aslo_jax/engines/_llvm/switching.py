"""Which way a step with switches goes: branches on what all lanes of a vector agree on."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

from ..._ir.node import BOOL
from .writer import Writer

# The blocks of the ways: all switches are as usual, none is, or some are.
WAYS = ("usual", "other", "differs")


class Condition(NamedTuple):
    """The `name` of a boolean, of one for each lane where it is a `vector`, and what it
    usually is."""

    name: str
    vector: bool
    usual: bool


def branch(out: Writer, conditions: Sequence[Condition], agreed: bool) -> None:
    """To the way that conditions lead to; there are two if they are always `agreed`."""
    usual, other, differs = WAYS
    pairs = []  # as usual, and not
    for name, vector, expected in conditions:
        opposite = out.operation("not", BOOL, BOOL, [name], vector)
        pairs.append((name, opposite) if expected else (opposite, name))

    def everywhere(which: int) -> str:
        names = [
            pair[which] for pair, c in zip(pairs, conditions, strict=True) if not c.vector
        ]
        masks = [pair[which] for pair, c in zip(pairs, conditions, strict=True) if c.vector]
        if masks:
            mask = _all(out, masks, f"<{out.width} x i1>")
            names.append(out.agree(mask, True))
        return _all(out, names, "i1")

    if agreed:
        out.line(f"br i1 {everywhere(0)}, label %{usual}, label %{other}")
        return
    out.line(f"br i1 {everywhere(0)}, label %{usual}, label %unlike")
    out.label("unlike")
    out.line(f"br i1 {everywhere(1)}, label %{other}, label %{differs}")


def _all(out: Writer, names: list[str], kind: str) -> str:
    return functools.reduce(lambda a, b: out.define(f"and {kind} {a}, {b}"), names)
