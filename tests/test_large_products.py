"""Large products and functions of many entries, which the fused engine does in loops: the
same as by JAX, for any width, wherever they are in a loop over time."""

import pickle
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax._frontend.large import is_large
from aslo_jax._ir.goal import Goal
from aslo_jax._ir.graph import Graph
from aslo_jax.engines import run_batch
from aslo_jax.engines._fused.program import Bodies, Program

pytest.importorskip("llvmlite")
RNG = np.random.default_rng(3)
UNITS, LANES = 33, 5
ROW = RNG.normal(size=(LANES, UNITS))
A, B = (RNG.normal(size=(UNITS, UNITS)) / 8 for _ in range(2))
OWN = {
    "w": RNG.normal(size=(LANES, UNITS, UNITS)) / 8,
    "in": RNG.normal(size=(LANES, UNITS, 2)),
    "out": RNG.normal(size=(LANES, 2, UNITS)) / 8,
    "x": RNG.normal(size=(LANES, 2)),
}


def run(begin, advance, finish, x, *, record=None, widths=(8,), steps=4, log=None):
    """What the engine finds, and JAX step by step, for each lane: records and the end."""
    lane = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape[1:], a.dtype), x)
    inputs, given = {"lane": lane}, {"lane": x}
    if log is not None:
        inputs["log"] = jax.ShapeDtypeStruct(log.shape[1:], log.dtype)
        given["log"] = log
    kept = (lambda s: None) if record is None else record
    bodies = Bodies(
        lambda i: (begin(i["lane"]), None),
        lambda k, s, i: (
            advance(s, i["lane"], *([] if log is None else [i["log"]])),
            kept(s),
        ),
        lambda s, i: finish(s),
    )
    program = Program.of(bodies, inputs, widths)
    found = program(given, len(jax.tree.leaves(x)[0]), steps)

    def one(x):
        def step(s, row):
            return advance(s, x, *([] if log is None else [row])), kept(s)

        rows = jnp.zeros(steps) if log is None else jnp.asarray(log[:steps])
        last, records = jax.lax.scan(step, begin(x), rows)
        return records, finish(last)

    return program, found, jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(x))


def agree(found, expected, rtol=1e-12):
    pairs = list(zip(*map(jax.tree.leaves, (found, expected)), strict=True))
    assert pairs
    for ours, theirs in pairs:
        assert ours.dtype == theirs.dtype
        np.testing.assert_allclose(ours, theirs, rtol=rtol, atol=rtol)


def operations(program):
    nodes = program.loop.graph.nodes
    return [nodes[n].op for n in program.loop.needed()]


def network(x, w):
    return w["out"] @ jnp.tanh(w["w"] @ jnp.tanh(w["in"] @ x))


def test_what_is_large():
    assert is_large(Graph(), 64, 1, 64)
    assert is_large(Graph(), 1, 1, 1000)
    assert not is_large(Graph(), 3, 3, 3)
    assert not is_large(Graph(), 16, 1, 16)
    assert not is_large(Graph(), 1000, 1000, 1), "sums of one product"
    assert is_large(Graph(Goal(large=100)), 5, 5, 5), "where loops are to be short"


def test_network_with_weights_of_each_lane():
    """Two layers, whose weights every lane has, and whose last step is rounded alike for
    any width."""
    advance = lambda s, w: 0.9 * s + 0.1 * network(s, w)
    found = {}
    for width in (2, 8, 16):
        program, found[width], expected = run(
            lambda w: w["x"], advance, lambda s: s, OWN, record=jnp.sum, widths=(width,)
        )
        agree(found[width], expected)
        assert operations(program).count("dot") == UNITS
        assert operations(program).count("call") == 2 * UNITS
    for other in (8, 16):
        jax.tree.map(np.testing.assert_array_equal, found[2], found[other])


def test_network_on_threads_and_parts_of_lanes():
    """The same bits for any number of threads, and for lanes run in two parts."""
    bodies = Bodies(
        lambda i: (i["lane"]["x"], None),
        lambda k, s, i: (s + network(s, i["lane"]), None),
        lambda s, i: s,
    )
    shapes = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape[1:], a.dtype), OWN)
    many = jax.tree.map(lambda a: np.concatenate([a, -a, 2 * a, a]), OWN)
    program = Program.of(bodies, {"lane": shapes}, (4,))
    _, whole = program({"lane": many}, 4 * LANES, 5, threads=1)
    _, threaded = program({"lane": many}, 4 * LANES, 5, threads=3)
    np.testing.assert_array_equal(whole, threaded)
    cut = lambda s: jax.tree.map(lambda a: a[s], many)
    halves = [cut(slice(0, 7)), cut(slice(7, None))]
    parts = [program({"lane": h}, len(h["x"]), 5)[1] for h in halves]
    np.testing.assert_array_equal(whole, np.concatenate(parts))


CASES = {
    "constant": lambda s, x: A @ jnp.sin(s) + x,
    "transposed": lambda s, x: jnp.sin(s) @ A + A.T @ x,
    "two products of one vector": lambda s, x: jnp.cos(A @ s) * (B @ s),
    "the carry itself": lambda s, x: A @ s,
    "a product of products": lambda s, x: A @ (B @ s + x),
    "permuted": lambda s, x: (A @ s[::-1])[::-1] + s[jnp.roll(jnp.arange(UNITS), 3)] / 9,
    "some rows": lambda s, x: jnp.concatenate([(A @ s)[:7], x[7:]]),
    "powers": lambda s, x: jnp.exp(-jnp.abs(s)) ** 1.5 + jnp.arctan2(s, 2.0 + x**2),
    "chosen": lambda s, x: jnp.where(s > 0, A @ jnp.tanh(s), jnp.log1p(x * x)),
    "mixed": lambda s, x: jnp.tanh(jnp.asarray(A).at[3].set(x) @ (s * x)),
    "fixed in time": lambda s, x: 0.5 * s + jnp.tanh(A @ jnp.tanh(B @ x)),
}


def test_wherever_entries_come_from():
    """Constants, the carry, other products, what a step makes, what each lane has."""
    names = list(CASES)

    def advance(s, x):
        return {name: CASES[name](s[name], x) for name in names}

    _, found, expected = run(
        lambda x: dict.fromkeys(names, x), advance, lambda s: s, ROW, widths=(8,)
    )
    agree(found, expected)


def test_in_all_parts_of_a_loop():
    """In the first carry, in records alone, at the end, and of a log of all lanes."""
    log = RNG.normal(size=(4, UNITS))
    _, found, expected = run(
        lambda x: jnp.tanh(A @ x),
        lambda s, x, row: 0.5 * s + 0.1 * (B @ row) + 0.1 * jnp.tanh(row * x),
        lambda s: (A @ jnp.tanh(B @ s), jnp.exp(s)),
        ROW,
        record=lambda s: (B @ jnp.sin(s))[::2],
        log=log,
    )
    agree(found, expected)


def test_records_of_what_a_step_makes():
    def advance(s, x):
        return jnp.tanh(A @ s)

    _, found, expected = run(
        lambda x: x,
        advance,
        lambda s: s[3],
        ROW,
        record=lambda s: (A @ s, jnp.tanh(A @ s) * 2.0, s),
    )
    agree(found, expected)


def test_matrices_and_batches():
    """A matrix times a matrix, also with each lane's own; and many networks of which each
    has weights of its own."""
    stack = RNG.normal(size=(3, UNITS, UNITS)) / 8
    state = {
        "X": RNG.normal(size=(LANES, UNITS, 2)),
        "v": RNG.normal(size=(LANES, 3, UNITS)),
    }

    def advance(s, x):
        several = jax.vmap(lambda w, v: jnp.tanh(w @ v))(stack, s["v"])
        return {"X": jnp.cos(A @ s["X"]) + (s["X"].T @ B).T / 9, "v": several}

    _, found, expected = run(lambda x: x, advance, lambda s: s, state, steps=3)
    agree(found, expected)


def test_weights_that_all_lanes_share():
    """Inputs that are the same for all lanes, and what they alone make."""
    shared = {"w": A, "v": ROW[0]}
    bodies = Bodies(
        lambda i: (i["lane"], None),
        lambda k, s, i: (
            jnp.tanh(i["shared"]["w"] @ s)
            + jnp.tanh(i["shared"]["w"] @ i["shared"]["v"])
            + i["shared"]["w"] @ jnp.sin(k * i["shared"]["v"]),
            jnp.sin(k * i["shared"]["v"])[::4],
        ),
        lambda s, i: s,
    )
    like = lambda a: jax.ShapeDtypeStruct(a.shape, a.dtype)
    shapes = {
        "lane": jax.ShapeDtypeStruct((UNITS,), np.float64),
        "shared": jax.tree.map(like, shared),
    }
    program = Program.of(bodies, shapes, (8,))
    record, final = program({"lane": ROW, "shared": shared}, LANES, 3)
    s = ROW
    for k in range(3):
        wave = np.sin(k * ROW[0])
        np.testing.assert_allclose(record[:, k], np.tile(wave[::4], (LANES, 1)), 1e-12)
        s = np.tanh(s @ A.T) + np.tanh(A @ ROW[0]) + A @ wave
    np.testing.assert_allclose(final, s, rtol=1e-12)


def test_derivative_in_the_weights():
    """A product has two tangents. A chain follows what a network makes of its measured
    position: as by JAX through its own loop, and by differences."""
    chain = aslo.plants.IntegratorChain(2)
    own = {"w": OWN["w"], "in": OWN["in"][..., 0], "out": OWN["out"][:, 0]}
    rates = jax.tree.map(lambda a: RNG.normal(size=a.shape), own)

    def make(w):
        def command(t):
            inner = jnp.tanh(w["in"] * jnp.cos(9.0 * t))
            return w["out"] @ jnp.tanh(w["w"] @ inner)

        start = jnp.array([0.2, 1.0])
        control = aslo.control.OpenLoop(command)
        return aslo.Experiment(chain, control, {}, 1e-2, initial=start)

    def batch(engine):
        keep = lambda record: record.x
        return lambda w: run_batch(make, w, 5, engine=engine, record=keep).record

    (value, ours), (other, theirs) = (
        jax.jvp(batch(engine), (own,), (rates,)) for engine in ("fused", "scan")
    )
    np.testing.assert_allclose(value, other, rtol=1e-12)
    np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=1e-13)
    moved = lambda h: jax.tree.map(lambda a, r: a + h * r, own, rates)
    up, down = (np.asarray(batch("fused")(moved(h))) for h in (1e-5, -1e-5))
    np.testing.assert_allclose(ours, (up - down) / 2e-5, rtol=1e-5, atol=1e-9)
    assert (np.abs(ours[:, -1]) > 1e-6).all()


def test_single_precision():
    own = jax.tree.map(lambda a: a.astype(np.float32), OWN)
    advance = lambda s, w: 0.9 * s + 0.1 * network(s, w)
    results = {}
    for width in (4, 32):
        _, results[width], expected = run(
            lambda w: w["x"], advance, lambda s: s, own, widths=(width,)
        )
        agree(results[width], expected, rtol=1e-5)
    jax.tree.map(np.testing.assert_array_equal, results[4], results[32])


def test_two_types():
    """Of a product of single and double precision, and of their result in one of them."""

    def advance(s, x):
        product = jax.lax.dot_general(
            A.astype(np.float32),
            s.astype(np.float32),
            (((1,), (0,)), ((), ())),
            preferred_element_type=np.float64,
        )
        return product + jnp.tanh(x.astype(np.float32)).astype(np.float64)

    _, found, expected = run(lambda x: x, advance, lambda s: s, ROW, steps=2)
    agree(found, expected, rtol=1e-6)


def test_an_infinite_entry_stays_where_it_is():
    own = ROW.copy()
    own[1, 4], own[2, 0] = np.inf, np.nan
    _, found, expected = run(
        lambda x: x, lambda s, x: jnp.tanh(A @ s), lambda s: s, own, steps=1
    )
    agree(found, expected)
    _, final = found
    assert np.isfinite(final[[0, 3, 4]]).all()
    assert not np.isfinite(final[2]).any()


def test_sent_to_another_process():
    program, found, _ = run(
        lambda w: w["x"], lambda s, w: s + network(s, w), lambda s: s, OWN
    )
    again = pickle.loads(pickle.dumps(program))
    both = again({"lane": OWN}, LANES, 4)
    jax.tree.map(np.testing.assert_array_equal, found, both)


def test_more_memory_than_a_thread_has_stack():
    """Weights of 64 units in 16 lanes take twice the stack that this thread has."""
    weights, start = RNG.normal(size=(LANES, 64, 64)) / 8, RNG.normal(size=(LANES, 64))
    program, found, expected = run(
        lambda w: w["x"],
        lambda s, w: jnp.tanh(w["w"] @ s),
        lambda s: s,
        {"w": weights, "x": start},
        widths=(16,),
    )
    agree(found, expected)
    again = []
    before = threading.stack_size(1 << 18)
    try:
        given = {"lane": {"w": weights, "x": start}}
        work = lambda: again.append(program(given, LANES, 4, threads=1)[1])
        thread = threading.Thread(target=work)
        thread.start()
    finally:
        threading.stack_size(before)
    thread.join()
    np.testing.assert_array_equal(again[0], found[1])
