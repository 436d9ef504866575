"""The step of a kernel: entries of the carry that are read after their successors are made,
values and masks that wait in memory, and how many lanes it advances at a time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aslo_jax.engines._backend.cost import LINE_CYCLES, PRODUCTS, cycles
from aslo_jax.engines._backend.step import Body, Step, chosen
from aslo_jax.engines._backend.target import AVX2, AVX512
from aslo_jax.engines._fused.program import Bodies, Program
from aslo_jax.engines._runtime.host import target

REAL = jax.ShapeDtypeStruct((), np.float64)


def begin(inputs):
    a, b = inputs["lane"]
    return (a, b, a - b, a + 2.0 * b, a > b, b > 0.5), None


def advance(k, carry, inputs):
    """Entries that trade places, follow each other, stay, or are needed at the end."""
    a, b, c, d, above, flag = carry
    early = 0.5 * a + 0.25 * jnp.sin(b)
    many = [jnp.cos(early + 0.1 * j * d) for j in range(8)]
    mask = [early > 0.1 * j for j in range(4)]
    total = sum((j + 1.0) * x for j, x in enumerate(many))
    some = sum(jnp.where(m, x, -0.5 * x) for m, x in zip(mask, many[::-1], strict=False))
    after = (b, early, c, 0.01 * total + 0.1 * c, flag, mask[2] | (above & ~mask[3]))
    return after, (a, after[3], a * b + c, above, some, after[1])


def finish(carry, inputs):
    a, *_, flag = carry
    return a + inputs["lane"][0], flag


WHOLE = Bodies(begin, advance, finish)


def begin_mixed(inputs):
    a, b = inputs["lane"]
    whole, short = jnp.floor(8.0 * a), (jnp.rint(4.0 * b) / 4.0).astype(jnp.float32)
    natural = jnp.abs(whole).astype(jnp.uint32)
    flags = (a > b, short > 0.5, whole.astype(jnp.int32) > 2)
    return (a, b, short, whole.astype(jnp.int32), natural, *flags), None


def advance_mixed(k, carry, inputs):
    """Values of 32 and of 64 bits, and masks of both, that are made of each other. The
    short ones are few bits long, so that no rounding hides an error."""
    a, b, short, whole, natural, above, large, odd = carry
    real = a + 0.3 * jnp.sin(b) * short.astype(jnp.float64)
    steps = jnp.rint(4.0 * real).astype(jnp.float32) * jnp.float32(0.25)
    after = jnp.where(above, short * jnp.float32(0.5), steps)
    less, more = steps < short, real > b
    both = jnp.where(less, real, 0.5 * b + whole.astype(jnp.float64) / 64.0)
    count = jnp.where(more & ~large, whole + natural.astype(jnp.int32), -whole // 3)
    bits = jnp.where(odd | less, natural * jnp.uint32(3), natural >> (natural & 3))
    bits = (bits + jnp.floor(jnp.abs(both)).astype(jnp.uint32)) & jnp.uint32(1023)
    wide = (whole.astype(jnp.int64) << 3) - bits.astype(jnp.int64)
    carry = (
        0.7 * both - 0.1 * bits.astype(jnp.float64) / 256.0,
        0.5 * a + jnp.where(large, 0.25, after.astype(jnp.float64) * 0.1),
        after,
        (count & 255) - (wide % 7).astype(jnp.int32),
        bits,
        less ^ more,
        (after > jnp.float32(0.5)) | (above & more),
        jnp.where(more, large, (bits & 1) == 1),
    )
    return carry, (real, after, whole, bits, wide, less, more, above, large & odd)


def finish_mixed(carry, inputs):
    a, _, short, whole, natural, *flags = carry
    return a + short.astype(jnp.float64), whole, natural, short, tuple(flags)


MIXED = Bodies(begin_mixed, advance_mixed, finish_mixed)


def by_hand(a, b, steps, bodies=WHOLE):
    inputs = {"lane": (jnp.asarray(a), jnp.asarray(b))}
    carry, _ = bodies.begin(inputs)
    records = []
    for k in range(steps):
        carry, record = bodies.advance(k, carry, inputs)
        records.append(record)
    stacked = [np.stack(x, axis=1) for x in zip(*records, strict=True)]
    return stacked, bodies.finish(carry, inputs)


def run(bodies, widths, lanes=21, steps=6, on=None):
    """What a program finds, for a target or for this host, and what it was given."""
    a, b = np.random.default_rng(5).normal(size=(2, lanes))
    program = Program.of(bodies, {"lane": (REAL, REAL)}, widths, target=on)
    assert program.width in widths
    return jax.tree.leaves(program({"lane": (a, b)}, lanes, steps)), (a, b, steps)


@pytest.mark.parametrize("holding", [2, 5, 14])
@pytest.mark.parametrize("widths", [(2,), (4,), (8,), (4, 8)])
def test_a_carry_in_memory(widths, holding):
    few = target()._replace(registers=holding)
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 13))
    program = Program.of(WHOLE, {"lane": (REAL, REAL)}, widths, target=few)
    record, final = program({"lane": (a, b)}, 13, 6)
    records, last = by_hand(a, b, 6)
    for ours, theirs in zip((*record, *final), (*records, *last), strict=True):
        assert ours.dtype == theirs.dtype
        np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("holding", [2, 14])
@pytest.mark.parametrize("widths", [(2,), (4,), (8,), (16,), (4, 8)])
def test_values_of_32_bits_meet_values_of_64(widths, holding):
    """In one step, with conversions both ways and masks of both."""
    few = target()._replace(registers=holding)
    found, (a, b, steps) = run(MIXED, widths, on=few)
    expected = jax.tree.leaves(by_hand(a, b, steps, MIXED))
    for ours, theirs in zip(found, expected, strict=True):
        assert ours.dtype == theirs.dtype
        if ours.dtype == np.float64:
            np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-14)
        else:
            np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("holding", [3, 28])
@pytest.mark.parametrize("widths", [(8,), (16,), (32,)])
@pytest.mark.parametrize("bodies", [WHOLE, MIXED], ids=["doubles", "mixed"])
def test_no_bits_depend_on_the_bytes_of_a_register(bodies, widths, holding):
    """Registers of 64 bytes, each of which this host may make of two of its own."""
    narrow, _ = run(bodies, (4,), on=AVX2)
    wide, _ = run(bodies, widths, on=AVX512._replace(registers=holding))
    for ours, theirs in zip(wide, narrow, strict=True):
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)


def test_long_steps_take_fewer_lanes_at_a_time():
    made = lambda on: Program.of(WHOLE, {"lane": (REAL, REAL)}, (4, 8), target=on)
    a, b = np.random.default_rng(4).normal(size=(2, 13))
    wide = made(AVX2)
    one = Step(Body(wide.loop), 4, AVX2)
    short = AVX2._replace(decoded=one.instructions(), fetched=0.5)
    narrow = made(short)
    assert (wide.width, narrow.width) == (8, 4)
    both = (p({"lane": (a, b)}, 13, 6) for p in (wide, narrow))
    for x, y in zip(*map(jax.tree.leaves, both), strict=True):
        np.testing.assert_array_equal(x, y)


def test_a_record_reads_the_log_of_a_lane():
    """Only there, or in an operation of its own."""

    def advance(k, carry, inputs):
        log = inputs["lane log"]
        return 0.5 * carry + log, (log, 2.0 * log + carry)

    bodies = Bodies(
        lambda inputs: (inputs["lane"], None), advance, lambda carry, inputs: carry
    )
    program = Program.of(bodies, {"lane": REAL, "lane log": REAL}, (4, 8))
    x, log = np.arange(5.0), np.random.default_rng(0).normal(size=(5, 7))
    (first, second), final = program({"lane": x, "lane log": log}, 5, 7)
    np.testing.assert_array_equal(first, log)
    for k in range(7):
        np.testing.assert_allclose(second[:, k], 2.0 * log[:, k] + x, rtol=1e-14)
        x = 0.5 * x + log[:, k]
    np.testing.assert_allclose(final, x, rtol=1e-14)


def test_the_step_is_taken_that_promises_the_fewest_cycles_a_lane():
    """Among all orders and widths, for processors that are short of different things."""
    loop = Program.of(WHOLE, {"lane": (REAL, REAL)}, (4,)).loop
    body = Body(loop)
    for on in (AVX2, AVX512, AVX512._replace(cache=2_000), AVX2._replace(decoded=300)):
        both = [Step(body, w, on, o) for w in on.widths for o in (0, 1)]
        assert chosen(loop, on.widths, on).cycles == min(step.cycles for step in both)


def test_a_step_takes_as_long_as_what_the_processor_is_short_of():
    """Products, loads, room in the caches: never less than each of these by itself."""
    body = Body(Program.of(WHOLE, {"lane": (REAL, REAL)}, (8,)).loop)
    events = Step(body, 8, AVX512, 0).usual.events
    ops = [e.instruction.op for e in events if e.instruction]
    products = sum(op in PRODUCTS for op in ops)
    loads = sum(e.action == "load" for e in events)
    count = sum(e.action in ("load", "store", "do") for e in events)
    free = AVX512._replace(products=9, loads=9, rate=9.0, ahead=1_000)
    longest = lambda **scarce: cycles(body.loop, events, free._replace(**scarce))
    assert 10 < products < longest(products=1) < 2 * products + longest()
    assert 0 < loads < longest(loads=1)
    assert longest(decoded=count, fetched=0.5) == longest()
    assert longest(decoded=count - 1, fetched=0.5) == 2.0 * count
    assert longest(cache=64) - longest(cache=128) == LINE_CYCLES
