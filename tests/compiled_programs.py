"""Random programs as C, beside the oracle of `program_checks`."""

import ctypes
from pathlib import Path
from typing import Any

import jax
import numpy as np
from compiled_c import compiled as built
from program_checks import ORACLE, Outcome, _compare, _noise, _runs
from random_programs import Code, compiled, recorded, sampled, source

from aslo_jax._ir.loop import Loop
from aslo_jax.engines import NotFusible, Runner
from aslo_jax.engines._c.body import Body, Target
from aslo_jax.engines._c.types import c_type
from aslo_jax.engines._c.unit import Unit
from aslo_jax.engines._fused.program import Bodies, Traced, looped
from aslo_jax.engines._passes import optimised
from aslo_jax.export._traced import PORTABLE, UNFIT


def outcome(code: Code, folder: Path) -> Outcome:
    """Of a program compiled for one lane, in every lane of the oracle."""
    make = compiled(source(code), f"program_{code.seed}.py")
    samples, found = sampled(code.seed, code.real, ORACLE), Outcome(code.seed)
    like = lambda tree: jax.tree.map(
        lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), tree
    )
    bodies = Bodies(
        lambda inputs: _without_noise(make(inputs["lane"]).init()),
        lambda k, carry, inputs: _without_noise(
            make(inputs["lane"]).advance(k, carry, None)
        ),
        lambda carry, inputs: (),
    )
    try:
        loop, traced = looped(bodies, {"lane": like(samples)}, PORTABLE)
    except NotFusible as error:
        found.refused = str(error)
        return found
    ours = _run(optimised(loop, without=UNFIT), traced, samples, code.steps, folder)
    noisy = samples | {"noise": _noise(code, 0)}
    scan = Runner(
        make, like(noisy), code.steps, every=1, engine="scan", metrics={}, record=recorded
    )
    _compare(found, ours, _runs(code, lambda many: scan(many).record, samples), "")
    return found


def _without_noise(both: tuple[Any, Any]) -> tuple[Any, Any]:
    carry, record = both
    return carry, recorded(record)


def _run(loop: Loop, traced: Traced, samples: Any, steps: int, folder: Path) -> Any:
    """The records of every lane, with a second axis of steps."""
    graph = loop.graph
    entries = [
        x.dtype
        for x in jax.tree.leaves(jax.tree.map(np.asarray, samples))
        for _ in range(int(np.prod(x.shape[1:], dtype=int)))
    ]
    lane, record = _struct(entries), _struct([graph.dtype(n) for n in loop.record])
    carry = _struct([graph.dtype(n) for n in loop.carry])
    unit = Unit("program")
    begin = Body(unit, graph, [*loop.first, *loop.begin], _place)
    _put(begin, loop.first, "record[0]")
    _put(begin, loop.begin, "(*state)")
    step = Body(unit, graph, [*loop.record, *loop.carry], _place, loop.carry)
    _put(step, loop.record, "record[k + 1]")
    for number in dict.fromkeys(loop.carry):
        if graph.nodes[number].op == "input":
            step.copied([number])
    _put(step, loop.carry, "(*state)")
    structs = {"lane": lane, "record": record, "carry": carry}
    headers = ("float", "stdbool", "stddef", "stdint")
    lines = [
        *(f"#include <{name}.h>" for name in headers),
        *(_declared(name, struct) for name, struct in structs.items()),
        *unit.parts,
        "void run(const lane_t *lane, record_t *record, int64_t steps);",
        "void run(const lane_t *lane, record_t *record, int64_t steps)\n{",
        "carry_t there; carry_t *state = &there; int64_t k; (void)lane; (void)state;",
        "{",
        *begin.declarations,
        *begin.lines,
        "}",
        "for (k = 0; k < steps; ++k) {",
        *step.declarations,
        *step.lines,
        "}",
        "}",
    ]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "program.c").write_text("\n".join(lines))
    flags = ("-O1", "-shared", "-fPIC", "-ffp-contract=off", "-Wno-overlength-strings")
    library = ctypes.CDLL(str(built(folder, "program.c", *flags)))
    given = np.zeros(ORACLE, lane)
    columns = [
        c
        for x in jax.tree.leaves(jax.tree.map(np.asarray, samples))
        for c in x.reshape(ORACLE, -1).T
    ]
    for k, column in enumerate(columns):
        given[f"x{k}"] = column
    out = np.zeros((ORACLE, steps + 1), record)
    for k in range(ORACLE):
        library.run(
            given[k : k + 1].ctypes.data_as(ctypes.c_void_p),
            out[k].ctypes.data_as(ctypes.c_void_p),
            ctypes.c_int64(steps),
        )
    leaves, tree = jax.tree.flatten(traced.record)
    found, at = [], 0
    for leaf in leaves:
        size = int(np.prod(leaf.shape, dtype=int))
        parts = [out[f"x{at + j}"] for j in range(size)]
        found.append(np.stack(parts, axis=-1).reshape(ORACLE, steps + 1, *leaf.shape))
        at += size
    return jax.tree.unflatten(tree, found)


def _struct(dtypes: list[np.dtype]) -> np.dtype:
    return np.dtype([(f"x{k}", d) for k, d in enumerate(dtypes)], align=True)


def _declared(name: str, struct: np.dtype) -> str:
    fields = struct.fields or {}
    members = " ".join(f"{c_type(dtype)} {x};" for x, (dtype, *_) in fields.items())
    return f"typedef struct {{ {members} }} {name}_t;"


def _place(slot: tuple[str, int]) -> str:
    kind, k = slot
    return {"lane": f"lane->x{k}", "carry": f"state->x{k}", "step": "k"}[kind]


def _put(body: Body, numbers: tuple[int, ...], where: str) -> None:
    for k, number in enumerate(numbers):
        body.put(Target(f"{where}.x{k}", (number,), False))
