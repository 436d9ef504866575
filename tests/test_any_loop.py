"""Loops of sums, products and choices, which passes rewrite: the results of a plain loop.
Programs of all that lowers, against scan, are those of `test_random_programs`."""

import hypothesis.strategies as st
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from loops import REAL

from aslo_jax.engines._fused.program import Bodies, Program

pytest.importorskip("llvmlite")


# Operations, those twice that are common or make sums of products.
OPERATIONS = (
    *("add", "sub", "mul", "scaled", "by lane") * 2,
    *("more", "over", "over lane", "negative", "abs"),
    *("sine", "root", "choice", "none", "guard", "quotient"),
)
CONSTANTS = (0.5, -0.5, 2.0, -1.3, 0.7, 3.0, -0.25, 5.0)
ENDS = ("itself", "scaled", "more", "by lane", "other")
BOUND = 4.0  # what is larger is squashed
OTHER = (  # the first one zero in a lane, the second one a divisor
    np.array([0.7, 0.0, -1.9, 1.3, -0.4]),
    np.array([-0.6, 1.7, 0.9, -2.0, 1.1]),
)


@st.composite
def codes(draw):
    """A step: its operations, each on four of what is known before and a constant, what
    becomes of six entries of the carry, and what is recorded."""
    place, constant = st.integers(0, 14), st.sampled_from(CONSTANTS)
    places = st.tuples(place, place, place, place)
    operation = st.tuples(st.sampled_from(OPERATIONS), places, constant)
    end = st.tuples(st.sampled_from(ENDS), place, constant)
    lines = draw(st.lists(operation, min_size=20, max_size=40))
    return lines, draw(st.tuples(*[end] * 6)), draw(st.tuples(place, place))


class Evaluated:
    """A step on arrays of NumPy or of JAX. `near` has the distances from the conditions of
    its choices, which rounding may turn over where they are small."""

    def __init__(self, xp, code, carry, lane):
        self.xp, self.near, self.lane = xp, [], lane
        lines, ends, places = code
        # Values, and what they do not exceed; of two entries of the carry only a sum. Two
        # are the same for all lanes.
        *carried, left, right, clock, turn = carry
        self.known = [(v, 3.0) for v in (*carried, 0.7 * left - right)]
        self.known += [(v, 2.0) for v in (*lane, clock, turn)]
        for op, operands, constant in lines:
            value, bound = self._made(op, [self._at(p) for p in operands], constant)
            small = bound <= BOUND
            self.known.append((value, bound) if small else (self._squashed(value), 1.0))
        self.carry = [self._end(carry, i, *end) for i, end in enumerate(ends)]
        self.carry += [0.9 * clock + 0.1, 0.6 * turn + 0.3 * xp.sin(5.0 * clock)]
        self.record = [self._at(p)[0] for p in places]

    def _at(self, place):
        """One of the last six, or the first nine, of the carry and the lanes."""
        return self.known[-1 - place if place < 6 else place - 6]

    def _squashed(self, value):
        return value / (1.0 + abs(value))

    def _greater(self, x, y):
        self.near.append(abs(x - y))
        return x > y

    def _guarded(self, over, x, least):
        where, above = self.xp.where, self._greater(x, least)
        return where(above, over / where(above, x, 1.0), 0.0)

    def _made(self, op, operands, c):
        (x, most), (y, other), (z, third), (w, fourth) = operands
        xp, lane = self.xp, self.lane
        if op in ("add", "sub"):
            return (x + y if op == "add" else x - y), most + other
        if op == "mul":
            return x * y, most * other
        if op == "scaled":
            return c * x, abs(c) * most
        if op == "by lane":
            return lane[c > 0] * x, 2.0 * most
        if op == "more":
            return x + c, most + abs(c)
        if op == "over":
            return x / (1.0 + y * y), most
        if op == "over lane":
            return x / lane[1], most / 0.6
        if op in ("negative", "abs"):
            return (-x if op == "negative" else abs(x)), most
        if op == "sine":
            return xp.sin(c * x), 1.0
        if op == "root":
            return xp.sqrt(1.0 + x * x), 1.0 + most
        if op == "choice":
            return xp.where(self._greater(x, y + 0.01), z, w), max(third, fourth)
        if op == "none":
            return xp.where(self._greater(x, 0.1 * c), c * y, 0.0), abs(c) * other
        if op == "guard":
            return self._guarded(y, x, 0.2), 5.0 * other
        assert op == "quotient"
        large = self._greater(self._guarded(2.0, x, 0.1), 3.0)
        return xp.where(large, y, z), max(other, third)

    def _end(self, carry, i, end, place, c):
        """What an entry of the carry becomes, of about one."""
        value = self._squashed(self._at(place)[0])
        if end == "itself":
            return value
        if end == "scaled":
            return 0.3 * c * value
        if end == "more":
            return carry[i] + 0.1 * c * value
        return self.lane[c > 0] * value if end == "by lane" else carry[(i - 1) % 4]


def started(lane, same=jnp.asarray):
    a, b = lane
    own = [b, 0.5 * a, 0.3 + a * b, 0.0 * b, 0.4 * b, 0.3 - 0.1 * a]
    return [*own, same(0.4), same(-0.2)]


def ended(carry):
    a, b, c, d, *_, turn = carry
    return [a * 2.0, b - 0.3 * c, d, turn * 1.0]


ANY = given(codes(), st.sampled_from([(4,), (4,), (8,)]))


@settings(max_examples=50)
@ANY
def test_any_loop_has_the_results_of_a_plain_one(code, widths):
    check(code, widths)


@pytest.mark.slow
@settings(max_examples=220)
@ANY
def test_any_of_more_loops_has_the_results_of_a_plain_one(code, widths):
    check(code, widths)


def check(code, widths):
    def advance(k, carry, inputs):
        made = Evaluated(jnp, code, carry, inputs["lane"])
        return made.carry, made.record

    bodies = Bodies(
        lambda inputs: (started(inputs["lane"]), None),
        advance,
        lambda carry, inputs: ended(carry),
    )
    made = Program.of(bodies, {"lane": (REAL, REAL)}, widths)
    records, final = made({"lane": OTHER}, 5, 4)
    carry, clear = started(OTHER, lambda x: np.full(5, x)), np.full(5, True)
    for k in range(4):
        plain = Evaluated(np, code, carry, OTHER)
        clear &= np.all([near > 1e-6 for near in plain.near], axis=0)
        for ours, theirs in zip(records, plain.record, strict=True):
            np.testing.assert_allclose(ours[clear, k], theirs[clear], rtol=0, atol=1e-9)
        carry = plain.carry
    for ours, theirs in zip(final, ended(carry), strict=True):
        np.testing.assert_allclose(ours[clear], theirs[clear], rtol=0, atol=1e-9)
