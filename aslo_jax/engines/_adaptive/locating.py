"""Kinks that depend on the state: where in a step one is, and what is tried next.

Over a step the sides of all switching functions are held, so that its field is smooth, and
the step is to end a little behind the first kink that it meets. What it goes too far costs
`(end - kink) |f - f_held| / 2` at most where the field is continuous, which is held to a
part of what is tolerated. A switching function that changes its side and comes back between
both ends of a step is seen at its stages: the step is tried again up to the first of them.

Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section II.6.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..._frontend.outlining import ALWAYS, name_of

OVER, AIMED = 0.2, 0.05  # of what is tolerated, by going behind a kink
CAUTION = 2.0  # times so much may a step go too far as straight lines say
TRIES, STRAYS = 12, 3  # before no side is held, and where one changes for a while
SLIDING = 5.0  # steps that may end behind a kink, one after the other
HELD = 0.25  # of the largest number
APART = 0.2  # so far in a step are stages of which all is looked at
NEAR = 0.3  # values over the largest at which all of a step is looked at
INNER = 0.99  # of a step: a stage after that is at its end
LEAST = 1e-4  # of a step that is tried again
FOLLOWED = 0.05  # of what numbers at random give
BEYOND = 1.02  # times what a straight line says is left up to a kink


class Kinks(NamedTuple):
    """Of a lane: the `values` of its switching functions at the start of a step; whether
    their sides are `held`; how many `tries` there were for the next kink, and how long the
    step was `meant` to be before, 0 while none is sought; how many steps more have ended
    behind one than not, `slides`."""

    values: Float[Array, " m"]
    held: Bool[Array, ""]
    tries: Float[Array, ""]
    meant: Float[Array, ""]
    slides: Float[Array, ""]

    @property
    def side(self) -> Float[Array, " m"]:
        """1 where a switching function is positive at the start, and otherwise -1."""
        one = jnp.ones_like(self.values)
        return jnp.where(self.values > 0.0, one, -one)

    @property
    def sides(self) -> Float[Array, " m"]:
        """What is added to switching functions: where they are held, more than they can be,
        and otherwise 0."""
        most = HELD * float(jnp.finfo(self.values.dtype).max)
        return jnp.where(self.held, most, 0.0) * self.side

    def at(self, values: Any) -> "Kinks":
        """With the values at the start of a step, zeros on the side that is known."""
        return self._replace(values=jnp.where(values == 0.0, self.values, values))


class Verdict(NamedTuple):
    """Of a step: whether its stages `follow` the switching functions, and it may end where
    it does, `fine`; whether it has gone behind a kink at its end, `crossed`, and whether
    too many have, `lost`. If it may not end there, how long it is to be tried, `shorter`;
    if it may, how long the next one is at most, `longest`, and at least, `resumed`."""

    follow: Any
    fine: Any
    crossed: Any
    lost: Any
    shorter: Any
    longest: Any
    resumed: Any


def begun(values: Any, after: Any) -> Kinks:
    """At the first instant, and a little `after`: one that is zero is on the side to which
    it goes."""
    tiny = jnp.finfo(values.dtype).tiny
    start = jnp.where(values == 0.0, jnp.sign(after) * tiny, values)
    zero = jnp.zeros((), values.dtype)
    return Kinks(start, jnp.asarray(True), zero, zero, zero)


def judged(
    kinks: Kinks,
    nodes: Sequence[float],
    error: np.ndarray,
    seen: list[Any],
    wrong: Any,
    h: Any,
    least: Any,
) -> Verdict:
    """Of a step of length h: the switching functions at the `nodes` of its stages,
    fractions of a step, and at its end, `seen`; the weights `error` of the pair; what
    `wrong` the field is at the end with the sides held, over what is tolerated in a unit of
    time. A step of the `least` length ends where it may."""
    side = kinks.side  # all are positive at the start
    values = [side * values for values in (kinks.values, *seen)]
    fractions = [0.0, *nodes, 1.0]
    coarse = [g for _, g in _coarse(_ordered(fractions, values))]
    smallest, largest = (
        functools.reduce(best, each)
        for best, each in ((jnp.minimum, values), (jnp.maximum, coarse))
    )
    # Integrals are not followed where the estimate of their errors is not small beside what
    # numbers at random would give: what is between stages could change its side unseen.
    total = sum(float(e) * g for e, g in zip(error, values[:-1], strict=True) if e)
    most = FOLLOWED * float(np.linalg.norm(error)) * jnp.maximum(largest, -smallest)
    follow = jnp.all(jnp.abs(total) <= most)
    near = ~jnp.all(smallest >= NEAR * largest) | (kinks.meant > 0.0)
    count = len(side)

    def located(gate, given):
        parts = jnp.split(given, [count * k for k in range(1, len(values) + 1)])
        found = _located(_ordered(fractions, parts[:-1]), *parts[-1])
        return jnp.where(gate > 0.0, jnp.stack(found), 0.0)

    located.__name__ = name_of(ALWAYS, gated=True)
    gate = jnp.where(kinks.held & near, 1.0, 0.0).astype(h.dtype)
    short, seeking = (x.astype(h.dtype) for x in (h <= least, kinks.meant > 0.0))
    rest = jnp.stack([h * wrong, kinks.tries, short, seeking])
    found = jax.jit(located)(gate, jnp.concatenate([*values, rest]))
    crossed, turned, lost, cut, cap = found
    return Verdict(
        follow | ~kinks.held,
        turned == 0.0,
        crossed > 0.0,
        lost > 0.0,
        h * (1.0 - cut),
        jnp.where(cap > 0.0, h / jnp.where(cap > 0.0, cap, 1.0), jnp.inf),
        jnp.where(crossed > 0.0, kinks.meant, 0.0),
    )


def _located(
    every: list[tuple[float, Any]], wrong: Any, tries: Any, short: Any, seeking: Any
) -> list[Any]:
    """Where all of a step is looked at: whether it has `crossed` a kink, is turned back,
    and lost; which part of it is to be cut, and this step over the longest one after it, 0
    where any may be."""
    path = _coarse(every)
    (early, before), (_, end) = path[-2:]
    switched = end < 0.0
    crossed = jnp.any(switched)
    # The first change of each that has changed at the end, by a line between two.
    t0, g0, length, g1 = early, before, 1.0 - early, end
    for (ta, a), (tb, b) in zip(path[-3::-1], path[-2:0:-1], strict=True):
        changes = b < 0.0
        t0, length = jnp.where(changes, ta, t0), jnp.where(changes, tb - ta, length)
        g0, g1 = jnp.where(changes, a, g0), jnp.where(changes, b, g1)
    first = t0 + length * (g0 / jnp.where(switched, g0 - g1, 1.0))
    kink = jnp.min(jnp.where(switched, first, 1.0))
    stray = jnp.minimum(_stray(every, switched), _returning(path))
    strays = stray < 1.0
    over = 0.5 * wrong * jnp.minimum(CAUTION * (1.0 - kink), 1.0)
    fine = ~strays & (~crossed | (over <= OVER)) | (short > 0.0)
    kept = jnp.minimum(AIMED / jnp.where(over > AIMED, over, AIMED), 0.5)
    part = jnp.minimum(jnp.where(crossed, kink + (1.0 - kink) * kept, 1.0), stray)
    part = jnp.where(part < LEAST, LEAST, part)
    # In vain so far: the step as it was, and what a field with kinks makes of its error.
    lost = tries >= jnp.where(strays, STRAYS, TRIES)
    # Up to the next kink, if a step was meant to end at one.
    nearer = (end >= 0.0) & (end < before)
    left = jnp.where(nearer, end / jnp.where(nearer, before - end, 1.0), jnp.inf)
    longest = BEYOND * (1.0 - early) * jnp.min(left)
    cap = jnp.where((seeking > 0.0) & ~crossed, 1.0 / longest, 0.0)
    numbers = (x.astype(end.dtype) for x in (crossed, ~fine, lost))
    return [*numbers, jnp.where(lost, 0.0, 1.0 - part), cap]


def _ordered(fractions: Sequence[float], values: Sequence[Any]) -> list[tuple[float, Any]]:
    """Pairs by ascending fractions of a step."""
    return sorted(zip(fractions, values, strict=True), key=lambda each: each[0])


def _coarse(every: list[tuple[float, Any]]) -> list[tuple[float, Any]]:
    """Of stages in the order of their nodes some with distance, and both ends."""
    path = [every[-1]]
    for each in every[-2:0:-1]:
        if each[0] < INNER and path[0][0] - each[0] > (APART if len(path) > 1 else 0.0):
            path.insert(0, each)
    return [every[0], *path]


def _stray(every: list[tuple[float, Any]], switched: Any) -> Any:
    """The fraction of a step at which the first of its switching functions is on another
    side at a stage but not at the end; 1 without any."""
    found: Any = 1.0
    for t, g in every[-2:0:-1]:
        if t < INNER:
            found = jnp.where(jnp.any((g < 0.0) & ~switched), t, found)
    return found


def _returning(path: list[tuple[float, Any]]) -> Any:
    """The same for one between three stages, by the end of a parabola through them."""
    found: Any = 1.0
    for (ta, a), (t, b), (tc, c) in zip(path, path[1:], path[2:], strict=False):
        before, after = (b - a) / (t - ta), (c - b) / (tc - t)
        bent = (after - before) / (tc - ta)
        slope = before + bent * (t - ta)
        turns = (a >= 0.0) & (b >= 0.0) & (c >= 0.0) & (slope * slope > 4.0 * bent * b)
        first, last = slope + 2.0 * bent * (ta - t), slope + 2.0 * bent * (tc - t)
        turns = turns & (first < 0.0) & (last > 0.0)
        found = jnp.minimum(found, jnp.where(jnp.any(turns), t, 1.0))
    return found


def following(
    kinks: Kinks, verdict: Verdict, end: Any, h: Any, accepted: Any, running: Any
) -> Kinks:
    """After a step of length h that was `accepted` or not, with the switching functions at
    its end."""
    turned = running & ~accepted & ~verdict.fine
    nearer = accepted & (kinks.meant > 0.0)
    tries = jnp.where(turned | nearer, kinks.tries + 1.0, kinks.tries)
    held = kinks.held & ~(turned & verdict.lost)
    # Along a kink, as in a sliding mode, every step ends at once if sides are held.
    more = jnp.where(jnp.any(kinks.side * end < 0.0), 1.0, -1.0)
    slides = jnp.clip(kinks.slides + jnp.where(accepted, more, 0.0), 0.0, SLIDING + 1.0)
    there = accepted & (verdict.crossed | ~kinks.held | (tries > TRIES))
    meant = jnp.where(turned & (h > kinks.meant), h, kinks.meant)
    return Kinks(
        jnp.where(accepted, end, kinks.values),
        jnp.where(accepted, slides <= SLIDING, held),
        jnp.where(there, 0.0, tries),
        jnp.where(there, 0.0, meant),
        slides,
    )
