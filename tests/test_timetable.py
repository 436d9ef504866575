"""What is the same for all lanes: computed once, before the loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loops import PAIRS, REAL, X, check, count

from aslo_jax.engines._fused.program import Bodies, Program

pytest.importorskip("llvmlite")
SEVEN = jnp.asarray(0.7)


def test_an_entry_that_is_the_same_for_all_lanes_is_carried_once():
    """The state of a filter that 1 drives, whose products with constants are columns of
    the table, and which is no entry of the carry of each lane."""

    def advance(k, carry, x):
        filtered, value = carry
        after = 0.9 * filtered + 0.1
        return after, value + 0.3 * (after * (x - 2.0 * filtered * value))

    made = check(lambda x: (SEVEN, x), advance, lambda carry: carry[1])
    assert len(made.raw.carry) == 2 and len(made.loop.carry) == 1
    assert made.loop.tables.along is not None and len(made.loop.tables.along.carry) == 1
    assert count(made.loop, "mul") <= 3


def test_an_entry_that_is_the_same_for_all_lanes_may_be_needed_at_the_end():
    def advance(k, carry, x):
        a, b = carry
        return 0.9 * a + 0.01 * k, 0.5 * b + a * x

    record = lambda carry: (carry[0] * 3.0, carry[1])
    check(lambda x: (SEVEN, x), advance, lambda c: (c[0], c[0] * c[1]), record=record)


def test_an_angle_that_is_the_same_for_all_lanes_keeps_its_scale():
    """The sine of five times an angle that turns with constant speed."""

    def advance(k, carry, x):
        angle, value = carry
        after = angle + 0.0625
        return after, 0.5 * value + x * jnp.sin(5.0 * after)

    record = lambda carry: carry[0]
    check(lambda x: (SEVEN, x), advance, lambda c: c, record=record, steps=23)


def test_masks_and_whole_numbers_may_be_the_same_for_all_lanes():
    def advance(k, carry, x):
        odd, number, value = carry
        value = jnp.where(odd, value + x, 0.5 * value) + 0.1 * (number % 5)
        return ~odd, number + 3, value

    begin = lambda x: (jnp.asarray(True), jnp.asarray(2, jnp.int32), x)
    made = check(begin, advance, lambda carry: carry[2], steps=11)
    assert len(made.loop.carry) == 1


@pytest.mark.parametrize("which", ["begin", "drive", "through another"])
def test_an_entry_that_any_lane_moves_is_not_the_same_for_all(which):
    def begin(x):
        return (0.7 + x if which == "begin" else SEVEN), x

    def advance(k, carry, x):
        a, b = carry
        drive = {"begin": 0.1, "drive": 0.1 * x, "through another": 0.1 * b}[which]
        return 0.9 * a + drive, 0.5 * b + a

    made = check(begin, advance, lambda carry: carry)
    assert made.loop.tables.along is None and len(made.loop.carry) == 2


def test_where_all_is_the_same_for_all_lanes():
    made = check(
        lambda x: (SEVEN, 2.0 * SEVEN),
        lambda k, carry, x: (0.5 * carry[0] + 0.1 * carry[1], jnp.cos(carry[0])),
        lambda carry: carry[0] - carry[1],
        record=lambda carry: carry[1],
    )
    assert made.loop.tables.along is not None


def test_a_factor_of_a_lane_does_not_meet_one_of_time_in_a_step():
    """The product of what differs between lanes and of what changes over time would have
    to be computed in every step."""

    def advance(k, carry, lane):
        gain, value = carry
        rate, other = lane
        after = 0.8 * gain + 0.3
        first, second = after * value, (0.3 + gain) * value
        return after, 0.4 * value + rate * first - other * second + rate * jnp.sin(0.1 * k)

    begin = lambda lane: (SEVEN, lane[0] - lane[1])
    check(begin, advance, lambda carry: carry[1], x=PAIRS, steps=13)


def test_logs_move_what_they_drive_in_every_lane():
    """The state that a log moves is the same for all lanes, but no table has it."""

    def advance(k, carry, inputs):
        return 0.5 * carry[0] + inputs["log"], carry[1] + inputs["lane"] * carry[0]

    begin, finish = lambda inputs: (SEVEN, inputs["lane"]), lambda carry, inputs: carry
    bodies = Bodies(
        lambda inputs: (begin(inputs), None),
        lambda k, carry, inputs: (advance(k, carry, inputs), None),
        finish,
    )
    made = Program.of(bodies, {"lane": REAL, "log": REAL}, (4,))
    log = np.sin(0.7 * np.arange(9.0))
    _, final = made({"lane": X, "log": log}, len(X), 9)
    state, value = 0.7, X.copy()
    for u in log:
        state, value = 0.5 * state + u, value + X * state
    np.testing.assert_allclose(final[0], np.full(3, state), rtol=1e-13)
    np.testing.assert_allclose(final[1], value, rtol=1e-13)
    assert jax.tree.leaves(made.loop.tables.along) == []
