"""Loops whose lanes take steps of their own, traced, compiled and run."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from ..._frontend.lower import check_numbers, flatten
from ..._ir.goal import Goal
from ..._ir.loop import Adaptive, Loop
from ..._typing import PyTree
from .._fused.program import Inputs, Program, flat, numbered, uncollected
from .._runtime.host import target as of_host

# Passes for what a step has in common with the next one, with all lanes, or with what is
# fixed: of a step whose length varies that is little, and they take longer than all else.
WITHOUT = ("commoning", "correlation", "factors", "timetable", "unswitching")


class Bodies(NamedTuple):
    """What a loop does, as functions of trees of arrays, for `inputs` that are constant in
    time by kind (`shared`, `lane`):

    - `begin(inputs) -> (carry, saving, kept)`: the first carry, and what goes on from row
      to row, None where nothing is saved; what is kept is for all steps;
    - `advance(carry, inputs, kept) -> (carry, done, dense)`: an attempted step;
    - `save(saving, dense, inputs, kept) -> (due, written, row, saving, columns)`: the next
      row of a step, see `Adaptive`;
    - `first(inputs) -> columns`: of the row 0, before any step; None where that is saved
      like the others;
    - `finish(carry, saving, inputs) -> final`.
    """

    begin: Callable[..., tuple[PyTree, PyTree, PyTree]]
    advance: Callable[..., tuple[PyTree, Any, PyTree]]
    finish: Callable[..., PyTree]
    save: Callable[..., tuple[Any, Any, Any, PyTree, PyTree]] | None = None
    first: Callable[..., PyTree] | None = None


@uncollected()
def adaptive(
    bodies: Bodies, inputs: dict[str, PyTree], widths: Sequence[int], **choice: Any
) -> Program:
    """Of functions, traced for inputs of the given shapes."""
    make = lambda f, *given: jax.make_jaxpr(f, return_shape=True)(*given)
    check_numbers(inputs, "the samples have")
    begin, (carry, saving, kept) = make(bodies.begin, inputs)
    advance, (_, _, dense) = make(bodies.advance, carry, inputs, kept)
    target = choice.get("target") or of_host()
    given = Inputs(carry, inputs, Goal(inverts=True, outlined=target.outlined))
    graph, size = given.graph, len(given.carry)
    begun = flatten(graph, begin, given.fixed)
    more = len(jax.tree.leaves(saving))
    kept_numbers = begun[size + more :]
    stepped = flatten(graph, advance, [*given.carry, *given.fixed, *kept_numbers])
    after, done, of_step = stepped[:size], stepped[size], stepped[size + 1 :]
    record, first, columns, entries = list(flat([done])), [], None, 0
    now = numbered(graph, "saving", saving)
    if bodies.save is not None:
        save, (*_, columns) = make(bodies.save, saving, dense, inputs, kept)
        saved = flatten(graph, save, [*now, *of_step, *given.fixed, *kept_numbers])
        due, written, row, *rest = flat(saved)
        record += [due, written, graph.convert(row, np.int64), *rest]
        starts = flat(begun[size : size + more])
        entries = len(starts)
        head = [graph.const(False, bool)] * 3 + [graph.const(0, np.int64)]
        blank: Sequence[int] = [
            graph.const(0, graph.dtype(n)) for n in record[4 + entries :]
        ]
        if bodies.first is not None:
            blank = flat(flatten(graph, make(bodies.first, inputs)[0], given.fixed))
        first = [*head, *starts, *blank]
    finish, final = make(bodies.finish, carry, saving, inputs)
    loop = Loop(
        graph,
        flat(begun[:size]),
        flat(after),
        record=tuple(record),
        first=tuple(first),
        final=flat(flatten(graph, finish, [*given.carry, *now, *given.fixed])),
        adaptive=Adaptive(entries),
    )
    return Program(loop, columns, final, widths, without=WITHOUT, **choice)
