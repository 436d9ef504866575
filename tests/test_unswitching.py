"""A body for each outcome of a branch: the results of `scan`, and the same bits whichever
body a lane goes through, which its neighbours decide."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loops import PAIRS, by_hand, ends, program, series

from aslo_jax._ir.loop import varying
from aslo_jax._ir.rewrite import moving_roots
from aslo_jax._ir.specialisation import specialised
from aslo_jax.engines._fused.program import Bodies, Program

pytest.importorskip("llvmlite")
STEPS, LANES, TERMS = 40, 1025, 20


def right(begin, advance, finish):
    """The loop, found right."""
    made = program(begin, advance, finish, x=PAIRS)
    found = made({"lane": PAIRS}, 3, 5)
    expected = by_hand(begin, jax.jit(advance), finish, 5, x=PAIRS)
    for ours, theirs in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)
    return made.loop


def bits(tree):
    return [
        np.ascontiguousarray(x).view(f"u{x.dtype.itemsize}") for x in jax.tree.leaves(tree)
    ]


# -- bits --------------------------------------------------------------------------------


def advance(k, carry, inputs):
    """A product that each branch adds to something: alone, it would be a part of the sum
    and not be rounded. A filter that only one branch moves, a mask, a counter, an entry
    that is the same for all lanes, entries that trade places in a branch, and three
    more that stay as they are in the other, one of which is recorded as it was."""
    a, b, left, right, count, flag, clock, kept, moved, still = carry
    x, until = inputs["lane"]
    product, log = a * b, inputs["log"]

    def costly(a, left, right, kept, moved, still):
        more = series(a, b + 0.1 * log)
        after = 0.7 * jnp.sin(product + x) + 0.2 * more
        trade = moved * after, kept * after, 0.5 * still + kept
        return after, right, left, more > 0.2, more * b, *trade

    def plain(a, left, right, kept, moved, still):
        right = 0.9 * right + 0.1 * a
        return jnp.cos(x - product), left, right, flag, b - x, kept, moved, still

    starts = count < until
    was = still
    out = jax.lax.cond(starts, costly, plain, a, left, right, kept, moved, still)
    after, left, right, flag, output, kept, moved, still = out
    b = 0.7 * b + 0.2 * jnp.sin(after + clock) * inputs["lane log"]
    both = jnp.where(flag, a, b) * clock
    carry = after, b, left, right + 0.0 * both, count + 1, flag, 0.9 * clock + 0.01
    carry = *carry, kept, moved, still
    return carry, (output * x + both, after, jnp.where(starts, output, left), flag, was)


def begin(inputs):
    x, _ = inputs["lane"]
    same = jnp.asarray(0.3, x.dtype)
    moving = x, 0.5 - 0.5 * x, 0.1 * x, 0.0 * x, jnp.int32(0), x > 0.0, same
    return (*moving, 0.2 * x, x, x - 0.3), None


def finish(carry, inputs):
    a, b, left, right, count, flag, _, *kept = carry
    return a - b, left, right, count, flag, *kept


def given(dtype):
    rng = np.random.default_rng(0)
    until = rng.integers(0, 30, LANES).astype(np.int32)
    until[200:240] = 12  # neighbours that agree
    return {
        "lane": (rng.uniform(-1.0, 1.0, LANES).astype(dtype), until),
        "log": rng.uniform(-1.0, 1.0, STEPS).astype(dtype),
        "lane log": rng.uniform(-1.0, 1.0, (LANES, STEPS)).astype(dtype),
    }


def some(inputs, lanes):
    each = lambda tree: jax.tree.map(lambda x: x[lanes], tree)
    return {k: v if k == "log" else each(v) for k, v in inputs.items()}


def by_scan(inputs):
    def one(lane, row):
        fixed = {"lane": lane}

        def step(carry, now):
            k, log, lane_log = now
            return advance(k, carry, fixed | {"log": log, "lane log": lane_log})

        times = jnp.arange(STEPS), inputs["log"], row
        carry, record = jax.lax.scan(step, begin(fixed)[0], times)
        return jax.tree.map(lambda r: r[4::5], record), finish(carry, fixed)

    return jax.jit(jax.vmap(one))(inputs["lane"], inputs["lane log"])


@functools.cache
def made(dtype, width):
    inputs = given(dtype)
    shapes = {k: jax.tree.map(lambda x: x[0], v) for k, v in inputs.items()}
    shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), shapes)
    shapes["lane log"] = shapes["log"]
    return Program.of(Bodies(begin, advance, finish), shapes, (width,))


@functools.cache
def alone(dtype):
    """Twelve lanes, each without neighbours that could disagree."""
    inputs, run = given(dtype), made(dtype, 4)
    each = [run(some(inputs, [k]), 1, STEPS, every=5, threads=1) for k in range(195, 207)]
    return [np.concatenate(x) for x in zip(*map(bits, each), strict=True)]


@pytest.mark.parametrize("width", [4, 16])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_bits_do_not_depend_on_the_neighbours(dtype, width):
    inputs, run = given(dtype), made(dtype, width)
    assert len(run.loop.switches) == 1
    whole = run(inputs, LANES, STEPS, every=5, threads=2)
    for ours, theirs in zip(*map(jax.tree.leaves, (whole, by_scan(inputs))), strict=True):
        assert ours.dtype == theirs.dtype
        precision = 1e-11 if dtype == np.float64 else 2e-4
        np.testing.assert_allclose(ours, theirs, precision, 0.1 * precision)
    expected = bits(whole)
    for ours, theirs in zip(expected, alone(dtype), strict=True):
        np.testing.assert_array_equal(ours[195:207], theirs)
    for first, count in ((190, 1), (0, 3), (198, 7), (180, 65), (0, 1025)):
        lanes = slice(first, first + count)
        found = run(some(inputs, lanes), count, STEPS, every=5, threads=1)
        for ours, theirs in zip(bits(found), expected, strict=True):
            np.testing.assert_array_equal(ours, theirs[lanes])


# -- which branches ----------------------------------------------------------------------


def start(x):
    a, b = x
    return 0.5 * a, 0.3 * b, 0.0 * a


def of(condition, costly=lambda a, b: series(a, b), plain=lambda a, b: 0.5 * a - 0.1 * b):
    """A loop with such branches; its third entry counts steps."""

    def advance(k, carry, x):
        a, b, count = carry
        starts = condition(k, carry, x)
        after = jax.lax.cond(starts, costly, plain, a, b)
        return after, 0.9 * b + 0.1 * jnp.cos(after), count + 1.0

    return start, advance, lambda carry: carry[:2]


CONDITIONS = {
    "state": lambda k, carry, x: carry[2] < 3.0 + x[0],
    "not": lambda k, carry, x: ~(carry[2] >= 3.0 + x[0]),
    "both": lambda k, carry, x: (carry[2] < 3.0) & (x[1] > 0.0),
    "lane": lambda k, carry, x: x[0] > 0.0,
    "time": lambda k, carry, x: k < 3,
    "uniform state": lambda k, carry, x: (2 * k + 1) % 3 == 0,
}


@pytest.mark.parametrize("name", CONDITIONS)
def test_a_step_switches(name):
    loop = right(*of(CONDITIONS[name]))
    whole, costly, plain = ends(loop)
    assert plain < 50 and 100 < costly <= whole
    (number,) = loop.conditions
    over_lanes = varying(loop.graph, loop.needed())[number][1]
    assert over_lanes == ("time" not in name and "uniform" not in name)


def test_a_branch_may_leave_what_is_always_so_in_the_carry():
    """A latch: in the body of that branch a boolean is a constant that no step has."""

    def begin(x):
        return *start(x), x[0] > 9.0

    def advance(k, carry, x):
        a, b, count, latched = carry

        searching = lambda a, b, so: (series(a, b), count > 2.0 + x[0])
        settled = lambda a, b, so: (0.5 * a + 0.1 * b, so)
        a, latched = jax.lax.cond(latched, settled, searching, a, b, latched)
        return a, 0.9 * b, count + 1.0, latched

    loop = right(begin, advance, lambda carry: (carry[0], carry[3]))
    _, costly, plain = ends(loop)
    assert plain < costly - 100


def test_of_several_branches_a_step_switches_on_the_one_that_saves_most():
    """Beside and within each other."""

    def advance(k, carry, x):
        a, b, count = carry

        def outer(a, b):
            inner = lambda a, b: series(a, b, 12)
            return jax.lax.cond(a > 0.1, inner, lambda a, b: a - b, a, b) - series(b, a, 12)

        after = jax.lax.cond(count < 3.0 + x[0], outer, lambda a, b: 0.5 * a, a, b)
        which = jnp.clip(count.astype(int), 0, 2)
        twigs = [lambda b: 0.9 * b, lambda b: 0.8 * b, lambda b: series(b, b, 4)]
        return after, jax.lax.switch(which, twigs, b), count + 1.0

    loop = right(start, advance, lambda carry: carry[:2])
    whole, costly, plain = ends(loop)
    assert plain < whole - 100 and costly <= whole


def test_a_step_switches_on_several_branches_at_once():
    """Of which one is usually taken and the other is not, one depends on the lane and the
    other on time alone; in some steps a lane takes one costly branch or both."""

    def advance(k, carry, x):
        a, b, count = carry
        costly = lambda a, b: series(a, b) + jnp.sin(a * b)
        plain = lambda a, b: jnp.cos(a * b) - 0.1 * b
        a = jax.lax.cond(count < 2.0 + x[0], costly, plain, a, b)
        return a, jax.lax.cond(k >= 3, plain, costly, b, 0.5 * a), count + 1.0

    loop = right(start, advance, lambda carry: carry[:2])
    assert sorted(usual for _, usual in loop.switches) == [False, True]
    whole, costly, plain = ends(loop)
    assert plain < whole - 200 and costly < whole
    made = program(start, advance, lambda carry: carry[:2], x=PAIRS)
    _, together = made({"lane": PAIRS}, 3, 5)
    for k in range(3):
        _, one = made({"lane": jax.tree.map(lambda x: x[k : k + 1], PAIRS)}, 1, 5)  # noqa: B023
        for ours, theirs in zip(bits(together), bits(one), strict=True):
            np.testing.assert_array_equal(ours[k], theirs[0])


@pytest.mark.parametrize(
    "choose",
    [
        lambda c, a, b: jax.lax.cond(c, lambda: 0.3 * a + b, lambda: 0.5 * a),
        lambda c, a, b: jnp.where(c, series(a, b), 0.5 * a),
    ],
)
def test_a_step_chooses_where_branches_are_cheap_or_none(choose):
    def advance(k, carry, x):
        a, b, count = carry
        after = choose(count < 3.0 + x[0], a, b)
        return after, 0.9 * b + 0.1 * jnp.cos(after), count + 1.0

    loop = right(start, advance, lambda carry: carry[:2])
    assert not loop.switches and not loop.branches


def test_what_a_branch_computes_twice_is_not_kept_by_all():
    """At the start of a step what it computed at the end of the one before: that is kept
    where it is needed anyway, but not to save one branch a half and cost the other all."""

    def advance(k, carry, x):
        a, b, count = carry
        after = 0.9 * b + 0.1 * jnp.sin(count)

        def costly(a, b, after):
            return 0.5 * (series(0.0, b) + series(0.1, after))

        plain = lambda a, b, after: 0.5 * a - 0.1 * b
        value = jax.lax.cond(count < 3.0 + x[0], costly, plain, a, b, after)
        return value, after, count + 1.0

    def same(k, carry, x):
        """The same function at both ends."""
        a, b, count = carry
        after = 0.9 * b + 0.1 * jnp.sin(count)
        costly = lambda a, b, after: 0.5 * (series(0.2, b) + series(0.2, after))
        plain = lambda a, b, after: 0.5 * a - 0.1 * b
        value = jax.lax.cond(count < 3.0 + x[0], costly, plain, a, b, after)
        return value, after, count + 1.0

    for step in (advance, same):
        loop = right(start, step, lambda carry: carry[:2])
        _, costly, plain = ends(loop)
        assert plain < costly - 100


def test_a_specialised_step_has_no_other_operations():
    """Nodes keep their numbers, operations and, but for choices, their arguments."""
    loop = program(*of(CONDITIONS["both"]), x=PAIRS).loop
    graph = loop.graph
    for holds in (True, False):
        left = specialised(graph, moving_roots(loop), {loop.conditions[0]: holds})
        assert loop.conditions[0] not in left.nodes
        for number, node in left.nodes.items():
            assert node == graph.nodes[number]._replace(args=node.args)
            assert node.args == tuple(left.same[a] for a in graph.nodes[number].args)


# -- what users write --------------------------------------------------------------------
