"""Random programs, run by the fused engine and by an oracle.

The oracle is the engine "scan", in several runs of every lane: one as the program stands,
the others with each rounded intermediate value moved by a random part of `SHARE` units in
the last place, in pairs that move oppositely, and each zero of random sign. Where all runs
have one whole number or boolean, it is settled, and the fused engine must have it; where
they have finite numbers, it must be within twice the largest distance that a run moved;
where they are infinite alike, or no numbers, so must it be. A few units in the last place
are granted besides, since a state may be kept in other units than its own. A choice by a
comparison of rounded numbers that is within rounding of a tie is made differently by one
run of a pair, and what depends on it is not compared there.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from random_programs import SITES, Code, Sum, compiled, recorded, sampled, source

from aslo_jax.engines import Batch, NotFusible, Runner
from aslo_jax.engines._backend.step import Body, Step
from aslo_jax.engines._backend.target import AVX2, AVX512
from aslo_jax.engines._fused.program import Program as Loop

LANES = (1, 3, 7, 65, 1025)
ORACLE = 65  # lanes of the oracle; those beyond repeat them
PAIRS = 3  # of moved runs
NOISE = ("near", "turned", "over", "sign")  # what `Moved` is made of
SHARE = 32.0
# Lanes, and what they are for.
WIDTHS = ((4, AVX2), (8, AVX512), (16, AVX512), (8, AVX2), (32, AVX512), (2, AVX2))


@dataclasses.dataclass
class Outcome:
    """What a program came to: `refused` says why it was, `wrong` what differs; of all
    numbers, how many were `compared`, and how many were not `settled`."""

    seed: int
    refused: str = ""
    wrong: str = ""
    compared: int = 0
    unsettled: int = 0


def outcome(code: Code) -> Outcome:
    """Raises nothing but what the engine raises that is no refusal."""
    name = f"program_{code.seed}.py"
    make = compiled(source(code), name)
    samples = sampled(code.seed, code.real, ORACLE)
    found = Outcome(code.seed)
    settings = dict(metrics={"sum": Sum()}, record=recorded)
    like = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), samples)
    try:
        fused = Runner(
            make, like, code.steps, every=code.every, engine="fused", threads=1, **settings
        )
    except NotFusible as error:
        found.refused = str(error)
        if name not in found.refused:
            found.wrong = f"a refusal without the line of {name}: {error}"
        if error.__cause__ is not None:
            found.wrong = f"a rule that fails: {error}"
        return found
    noisy = samples | {"noise": _noise(code, 0)}
    like = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), noisy)
    # Of each step, since XLA compiles a step twice where some are not recorded.
    each = Runner(make, like, code.steps, every=1, engine="scan", **settings)

    def scan(samples):
        found = each(samples)
        return Batch(
            found.metrics, jax.tree.map(lambda x: x[:, :: code.every], found.record)
        )

    whole = fused(samples)
    if code.smooth:
        _derivatives(found, code, fused, scan, samples)
    else:
        _compare(found, whole, _runs(code, scan, samples), "")
    _same_bits(found, code, fused, samples, whole)
    return found


def _noise(code: Code, seed: int) -> dict[str, np.ndarray]:
    """For every lane; none of seed 0, and of an odd one what is opposite to the next, but
    for signs."""
    F = np.dtype(code.real)
    shape = (ORACLE, SITES + 12)
    if not seed:
        return {name: np.ones(shape, F) for name in NOISE}
    part = np.random.default_rng([code.seed, (seed + 1) // 2]).uniform(-1, 1, shape)
    turned = 1 if seed % 2 else -1
    near = (1 + turned * SHARE * np.finfo(F).eps * part).astype(F)
    # A pattern over the runs for each place, never all alike: where a zero passes several
    # places, their signs must not cancel in every run.
    pattern = np.random.default_rng(code.seed).integers(1, 4**PAIRS, shape)
    sign = (1 - 2 * (pattern >> (seed - 1) & 1)).astype(F)
    over = np.full(shape, 1.0 if seed % 2 else np.inf, F)
    return dict(zip(NOISE, (near, sign * near, over, sign), strict=True))


def _runs(code: Code, call: Any, samples: dict[str, Any]) -> Any:
    """The results of the oracle, with a leading axis of its runs."""
    count = 2 * PAIRS + 1
    noise = jax.tree.map(
        lambda *x: np.concatenate(x), *(_noise(code, n) for n in range(count))
    )
    many = jax.tree.map(lambda x: np.concatenate([x] * count), samples) | {"noise": noise}
    split = lambda x: np.asarray(x).reshape(count, ORACLE, *x.shape[1:])
    return jax.tree.map(split, call(many))


def _compare(
    found: Outcome,
    ours: Any,
    runs: Any,
    what: str,
    scale: np.ndarray | None = None,
    known: list[np.ndarray] | None = None,
) -> list[np.ndarray]:
    """Which numbers of each leaf are settled: of those that are `known`, where given."""
    leaves = jax.tree.leaves(runs)
    known = [np.asarray(True)] * len(leaves) if known is None else known
    pairs = zip(jax.tree_util.tree_leaves_with_path(ours), leaves, known, strict=True)
    of_all = []
    for (path, a), b, of in pairs:
        a, name = np.asarray(a), what + jax.tree_util.keystr(path)
        if a.dtype != b.dtype or a.shape != b.shape[1:]:
            found.wrong += f"{name}: {a.dtype}{a.shape}, not {b.dtype}{b.shape[1:]}\n"
            of_all.append(np.asarray(False))
            continue
        settled, right, off = _judged(a, b, scale)
        settled = settled & of
        of_all.append(settled)
        found.compared += int(settled.sum())
        found.unsettled += int((~settled).sum())
        bad = np.argwhere(settled & ~right)
        if len(bad):
            at = tuple(bad[0])
            found.wrong += (
                f"{name}{[int(i) for i in at]}: {a[at]!r}, not {b[0][at]!r}, settled to "
                f"{off[at]:.2g}; {len(bad)} of {a.size} wrong\n"
            )
    return of_all


def _judged(
    a: np.ndarray, runs: np.ndarray, scale: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each number, whether it is settled, is right, and how far it may be off."""
    expected = runs[0]
    if a.dtype.kind != "f":
        return (runs == expected).all(0), a == expected, np.zeros(a.shape)
    with np.errstate(all="ignore"):
        finite = np.isfinite(runs).all(0)
        kinds = np.where(np.isnan(runs), 2.0, np.where(np.isinf(runs), np.sign(runs), 0.0))
        off = np.where(finite, 2.0 * np.abs(runs - expected).max(0), 0.0)
        limits = np.finfo(a.dtype)
        off = off + np.where(finite, 4 * limits.eps * np.abs(expected), 0.0)
        if scale is not None:
            off += SHARE * limits.eps * scale.reshape(-1, *[1] * (a.ndim - 1))
        # What is less than the least normal number may be nothing, and constants times it.
        off = off + 16 * limits.tiny
        near = np.isfinite(a) & (np.abs(a - expected) <= off)
    own = np.where(np.isnan(a), 2.0, np.where(np.isinf(a), np.sign(a), 0.0))
    alike = (kinds == kinds[0]).all(0)
    # What rounding moves by a thousandth, it may move by any amount: it is some 1e12 times
    # as large as what is rounded, and a product fused with a difference rounds elsewhere.
    alike &= ~finite | (off <= 1e-3 * np.maximum(1.0, np.abs(expected)))
    return alike, np.where(finite, near, own == kinds[0]), off


# -- the same bits -------------------------------------------------------------------------


def _same_bits(found: Outcome, code: Code, fused: Runner, samples: Any, whole: Any) -> None:
    """For any number of lanes and threads, and vectors of another size."""
    rng = np.random.default_rng(code.seed)
    for lanes in LANES:
        chosen = np.resize(rng.permutation(ORACLE), lanes)
        part = _at(samples, chosen)
        for threads in (1, 2):
            fused._fused.threads = threads
            what = f"of {lanes} lanes, {threads} threads"
            _equal(found, _at(whole, chosen), fused(part), what)
    fused._fused.threads = 1
    width, target = WIDTHS[code.seed % len(WIDTHS)]
    made = fused._fused.program
    other = Loop(made.raw, made.record, made.final, (width,))
    other.__dict__["loop"] = made.loop
    other.__dict__["_step"] = Step(Body(made.loop), width, target)
    fused._fused.__dict__["program"] = other
    _equal(found, whole, fused(samples), f"of {width} lanes at a time")
    fused._fused.__dict__["program"] = made


def _at(tree: Any, places: np.ndarray) -> Any:
    return jax.tree.map(lambda x: np.asarray(x)[places], tree)


def _equal(found: Outcome, whole: Any, part: Any, what: str) -> None:
    for (path, a), b in zip(
        jax.tree_util.tree_leaves_with_path(whole), jax.tree.leaves(part), strict=True
    ):
        if _bits(a) != _bits(b):
            found.wrong += f"other bits {what}: {jax.tree_util.keystr(path)}\n"
            return


def _bits(x: Any) -> bytes:
    x = np.array(x)
    if x.dtype.kind == "f":
        x[np.isnan(x)] = np.nan
    return x.tobytes()


# -- derivatives ---------------------------------------------------------------------------


def _derivatives(
    found: Outcome, code: Code, fused: Runner, scan: Callable, samples: Any
) -> None:
    """In three real leaves of the samples at once, of all that is real; beside them the
    values too. Moved runs move these leaves and their rates. Terms of a rule, such as those
    of 1 - tanh(x)², which no mark reaches, may cancel: errors count beside the largest
    derivative of a lane. That of a value that is not settled is not compared: at another
    value its rule may overflow, which scan's may do in every run."""

    def push(runner, samples):
        point, rates = {}, {}
        for n, name in enumerate(("x", "y", "c")):
            x = jnp.asarray(samples[name])
            rate = jnp.full_like(x, 1.0 - 0.3 * n)
            if "noise" in samples:
                near = samples["noise"]["near"]
                x = x * near[:, n : n + x[0].size].reshape(x.shape)
                rate = rate * near[:, n + 9 : n + 9 + x[0].size].reshape(x.shape)
            point[name], rates[name] = x, rate
        return jax.jvp(lambda q: runner(samples | q), (point,), (rates,))

    is_real = lambda x: x.dtype == code.real
    real = lambda tree: [x for x in jax.tree.leaves(tree) if is_real(x)]
    ours, rates = push(fused, samples)
    theirs, runs = _runs(code, lambda many: push(scan, many), samples)
    known = _compare(found, ours, theirs, "beside its derivative, ")
    known = [a for a, x in zip(known, jax.tree.leaves(ours), strict=True) if is_real(x)]
    size = [np.nan_to_num(np.abs(x[0]), posinf=0.0).reshape(ORACLE, -1) for x in real(runs)]
    largest = np.concatenate(size, axis=1).max(axis=1)
    _compare(found, real(rates), real(runs), "derivative of ", largest, known)
