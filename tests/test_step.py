"""The step of a kernel: entries of the carry that are read after their successors are made,
values and masks that wait in memory, and how many lanes it advances at a time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aslo_jax.engines import step
from aslo_jax.engines.host import register
from aslo_jax.engines.program import Bodies, Program

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


def by_hand(a, b, steps):
    inputs = {"lane": (jnp.asarray(a), jnp.asarray(b))}
    carry, _ = begin(inputs)
    records = []
    for k in range(steps):
        carry, record = advance(k, carry, inputs)
        records.append(record)
    return [np.stack(x, axis=1) for x in zip(*records, strict=True)], finish(carry, inputs)


@pytest.mark.parametrize("holding", [2, 5, 14])
@pytest.mark.parametrize("widths", [(2,), (4,), (8,), (4, 8)])
def test_a_carry_in_memory(widths, holding, monkeypatch):
    monkeypatch.setitem(step.HOLDING, register(), holding)
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 13))
    program = Program.of(Bodies(begin, advance, finish), {"lane": (REAL, REAL)}, widths)
    record, final = program({"lane": (a, b)}, 13, 6)
    records, last = by_hand(a, b, 6)
    for ours, theirs in zip((*record, *final), (*records, *last), strict=True):
        assert ours.dtype == theirs.dtype
        np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-14)


def test_long_steps_take_fewer_lanes_at_a_time(monkeypatch):
    made = lambda: Program.of(
        Bodies(begin, advance, finish), {"lane": (REAL, REAL)}, (4, 8)
    )
    a, b = np.random.default_rng(4).normal(size=(2, 13))
    wide = made()
    assert wide.width == 8
    monkeypatch.setattr(step, "DECODED", 10)
    narrow = made()
    assert narrow.width == 4
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
