"""One attempted step of an embedded pair, with PI control of its length, as a function of
JAX for a lane: what depends on the lane is chosen with `where`."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..._frontend.entrywise import entrywise
from .locating import Kinks, begun, following, judged
from .pairs import Pair


class Field(NamedTuple):
    """A vector field: `rate(t, x, sides)`, its value and those of its `switches`, switching
    functions, with their sides, or None where it has none."""

    rate: Callable[[Any, Any, Any], tuple[Any, Any]]
    switches: int = 0

    def at(self, t: Any, x: Any) -> Any:
        """The value alone, with no side held."""
        return self.rate(t, x, self.none(x))[0]

    def none(self, x: Any) -> Any:
        """The sides where none is held."""
        return jnp.zeros(self.switches, x.dtype) if self.switches else None

    def until(self, end: Any) -> "Field":
        """The field up to an instant, and no further."""
        rate = lambda t, x, sides: self.rate(jnp.minimum(t, end), x, sides)
        return Field(rate, self.switches)


SAFETY, LEAST, MOST = 0.9, 0.2, 2.5  # of the next step over this one
STARTING, FIRST = 5, 12.0  # so many steps may become as many times longer
ITERATIONS = 6  # of the largest rate
BOUNDED = 0.8  # of the stable interval
LITTLE, MUCH = 1e-10, 1e20  # an error over what is tolerated, as small or large as any
WORTH = 500  # steps below which nothing else would take less
UNFOLLOWED = 30.0  # the error over what is tolerated where switching functions are not
SMALLEST = 4.0  # units of the last place of time: a step below is none

RUNNING, ENDED, DIVERGED = 0, 1, 2


class Lane(NamedTuple):
    """Where a lane is: `code`, whether it runs, has ended at the last instant, or has come
    to a point from which no step leads on; t and x, the length h to be tried, the binary
    logarithm of the last error over what is tolerated, how many steps were `accepted` and
    how many `rejected`, and its `kinks`, None without any."""

    code: Int[Array, ""]
    t: Float[Array, ""]
    x: Float[Array, " n"]
    peak: Float[Array, " n"]
    slope: Float[Array, " n"] | None
    h: Float[Array, ""]
    error: Float[Array, ""]
    accepted: Float[Array, ""]
    rejected: Float[Array, ""]
    kinks: Kinks | None


class Dense(NamedTuple):
    """A step from t to `end`, h long, from x, with the slopes `k` of its stages and the
    sides of switching functions; whether it was `accepted`."""

    accepted: Any
    t: Any
    end: Any
    h: Any
    x: Any
    k: list[Any]
    sides: Any


class Stepper(NamedTuple):
    """Steps of a pair with a scale of tolerated errors `absolute + relative |x|`."""

    pair: Pair
    relative: Any
    absolute: Any
    jumps: bool = False

    def reuses(self, field: Field) -> bool:
        """Whether the last slope of a step is the first of the next one: with switching
        functions, that at its end."""
        return (self.pair.reuses or field.switches > 0) and not self.jumps

    def begin(self, field: Field, t0: Any, t1: Any, x: Any) -> Lane:
        """At t0, with a first step by Hairer's rule (Hairer, Norsett, Wanner, Solving
        Ordinary Differential Equations I, section II.4)."""
        f0, values = field.rate(t0, x, field.none(x))
        span, scale = t1 - t0, self._scale(jnp.abs(x))
        size, slope = _norm(x / scale), _norm(f0 / scale)
        tiny = (size < 1e-5) | (slope < 1e-5)
        h = jnp.where(tiny, 1e-6 * span, 0.01 * size / jnp.where(tiny, 1.0, slope))
        h = jnp.minimum(h, span)
        later, after = field.rate(t0 + h, x + h * f0, field.none(x))
        bent = _norm((later - f0) / scale) / h
        steepest = jnp.maximum(slope, bent)
        flat = steepest <= 1e-15
        power = (0.01 / jnp.where(flat, 1.0, steepest)) ** (1.0 / self.pair.falls)
        h = jnp.minimum(
            100.0 * h, jnp.where(flat, jnp.maximum(1e-6 * span, 1e-3 * h), power)
        )
        zero = jnp.zeros_like(t0)
        first = jnp.asarray(math.log2(1e-4), jnp.float32)
        code = jnp.asarray(RUNNING, jnp.int32)
        h = jnp.minimum(h, span)
        kinks = None if values is None else begun(values, after)
        slope = f0 if self.reuses(field) else None
        return Lane(code, t0, x, jnp.abs(x), slope, h, first, zero, zero, kinks)

    def step(self, field: Field, lane: Lane, t1: Any) -> tuple[Lane, Dense]:
        """The lane after an attempted step, which ends at t1 at the latest."""
        pair, t, x = self.pair, lane.t, lane.x
        running = lane.code == RUNNING
        left = t1 - t
        last = left <= lane.h * (1.0 + 1e-10)
        h = jnp.where(last, left, lane.h)
        kinks, seen, known = lane.kinks, [], []
        if lane.slope is not None:
            known = [lane.slope]
        elif kinks is not None:  # which may have jumped
            slope, values = field.rate(t, x, field.none(x))
            kinks, known = kinks.at(values), [slope]
        sides = None if kinks is None else kinks.sides

        def rate(t, x):
            slope, values = field.rate(t, x, sides)
            seen.append(values)
            return slope

        nodes = pair.nodes[len(known) : pair.main].tolist()
        k = slopes(pair, rate, t, x, h, range(len(known), pair.main), known)
        end = stepped(x, h, pair.weights, k)
        peak = _larger(jnp.abs(end), lane.peak)
        # How long a step may be need not be known to more than some digits.
        scale = self._scale(peak).astype(jnp.float32)
        wrong = jnp.abs(weighted(pair.error, k).astype(jnp.float32) / scale)
        largest = _largest(wrong) * h.astype(jnp.float32)
        sound = jnp.isfinite(jnp.sum(wrong))
        least = SMALLEST * jnp.finfo(x.dtype).eps * jnp.maximum(jnp.abs(t), jnp.abs(t1))
        slope, verdict, values = k[-1], None, None
        if kinks is not None:
            slope, values = field.rate(t + h, end, field.none(x))
            off = jnp.abs((slope - k[-1]).astype(jnp.float32) / scale)
            off = jnp.where(jnp.isfinite(jnp.sum(off)), _largest(off), MUCH)
            off = off.astype(h.dtype)
            seen.append(values)
            verdict = judged(kinks, nodes, pair.error, seen, off, h, least)
            largest = jnp.where(verdict.follow, largest, _larger(largest, UNFOLLOWED))
        precise = (largest <= 1.0) & sound
        fine = True if verdict is None else verdict.fine
        accepted = running & precise & fine
        size = _log2(_larger(jnp.where(sound & (largest < MUCH), largest, MUCH), LITTLE))
        after = h * self._factor(lane, size, accepted).astype(h.dtype)
        after = jnp.where(accepted & last, jnp.maximum(after, lane.h), after)
        if kinks is not None and verdict is not None:
            nearer = jnp.minimum(jnp.where(precise, jnp.inf, after), verdict.shorter)
            onward = jnp.maximum(jnp.minimum(after, verdict.longest), verdict.resumed)
            after = jnp.where(accepted, onward, jnp.where(verdict.fine, after, nearer))
            kinks = following(kinks, verdict, values, h, accepted, running)
        stuck = ~accepted & (h <= least)
        code = jnp.where(
            running,
            jnp.where(accepted & last, ENDED, jnp.where(stuck, DIVERGED, RUNNING)),
            lane.code,
        ).astype(lane.code.dtype)
        one = running.astype(t.dtype)
        more = jnp.where(accepted, one, 0.0)
        now = jnp.where(accepted, jnp.where(last, t1, t + h), t)
        moved = Lane(
            code,
            now,
            jnp.where(accepted, end, x),
            jnp.where(accepted, peak, lane.peak),
            None if lane.slope is None else jnp.where(accepted, slope, lane.slope),
            jnp.where(running, after, lane.h),
            jnp.where(accepted, _larger(size, math.log2(1e-4)), lane.error),
            lane.accepted + more,
            lane.rejected + (one - more),
            kinks,
        )
        return moved, Dense(accepted, t, now, h, x, k, sides)

    def _factor(self, lane: Lane, size: Any, accepted: Any) -> Any:
        """Of the length of the next step over this one, for the logarithm of its error over
        what is tolerated."""
        pair, power = self.pair, 1.0 / self.pair.falls
        exponent = jnp.where(
            accepted,
            pair.gain * lane.error - (power - 0.75 * pair.gain) * size,
            -power * size,
        )
        most = jnp.where(lane.accepted < STARTING, math.log2(FIRST), math.log2(MOST))
        exponent = _larger(exponent + math.log2(SAFETY), math.log2(LEAST))
        exponent = jnp.where(exponent < most, exponent, most)
        return _exp2(jnp.where(accepted | (exponent < 0.0), exponent, 0.0))

    def stiff(self, field: Field, lane: Lane, t1: Any) -> Any:
        """Whether the next step would be bounded by stability: its length times the largest
        rate of the linearised system, by some steps of the power iteration, is near the end
        of the interval on the negative real axis where the pair is stable."""
        scale = self._scale(lane.peak)
        f = field.at(t1, lane.x)
        v = jnp.where(f >= 0.0, scale, -scale)
        rate = jnp.zeros_like(lane.t)
        for _ in range(ITERATIONS):
            near = entrywise(lambda x, v: x + v)(lane.x, v)
            far = field.at(t1, near)
            square = lambda far, f, scale: ((far - f) / scale) ** 2
            size = jnp.sqrt(jnp.mean(entrywise(square)(far, f, scale)))
            square = lambda v, scale: (v / scale) ** 2
            rate = size / jnp.sqrt(jnp.mean(entrywise(square)(v, scale)))
            over = jnp.where(size > 0.0, size, 1.0)
            v = entrywise(lambda far, f, over: (far - f) / over)(far, f, over)
        many = lane.accepted >= WORTH
        return (lane.code == ENDED) & many & (lane.h * rate > BOUNDED * self.pair.stable)

    def prepared(self, field: Field, dense: Dense) -> Dense:
        """With the slopes of all stages of the interpolant."""
        pair = self.pair
        within = lambda t, x: field.until(dense.end).rate(t, x, dense.sides)[0]
        more = range(pair.main, len(pair.stages))
        k = slopes(pair, within, dense.t, dense.x, dense.h, more, dense.k)
        return dense._replace(k=k)

    def at(self, dense: Dense, t: Any) -> Any:
        """The state at an instant of a step that is prepared."""
        part = (t - dense.t) / dense.h
        weights, used = [], []
        for row, k in zip(self.pair.dense, dense.k, strict=True):
            if row.any():
                weight = 0.0
                for c in row[::-1]:
                    weight = (weight + float(c)) * part
                weights.append(weight)
                used.append(k)

        def interpolated(x, h, *given):
            total = 0.0
            for weight, k in zip(given[: len(used)], given[len(used) :], strict=True):
                total = total + weight * k
            return x + h * total

        return entrywise(interpolated)(dense.x, dense.h, *weights, *used)

    def _scale(self, peak: Any) -> Any:
        return self.absolute + self.relative * peak


def slopes(
    pair: Pair,
    rate: Callable[[Any, Any], Any],
    t: Any,
    x: Any,
    h: Any,
    stages: range,
    known: list[Any],
) -> list[Any]:
    """Those that are `known`, and then those of further `stages`."""
    k = list(known)
    for i in stages:
        k.append(rate(t + float(pair.nodes[i]) * h, moved(x, h, pair.stages[i], k)))
    return k


def moved(x: Any, h: Any, weights: Any, k: list[Any]) -> Any:
    """x after a step of h with weighted slopes."""
    weights, k = used(weights, k)

    def moved(x, h, *k):  # what each adds is small: rounding it in turn does no harm
        for w, each in zip(weights, k, strict=True):
            x = x + (h * w) * each
        return x

    return entrywise(moved)(x, h, *k)


def stepped(x: Any, h: Any, weights: Any, k: list[Any]) -> Any:
    """x after a step of h with the weighted slopes, these added up first."""
    weights, k = used(weights, k)
    return entrywise(lambda x, h, *k: x + h * added(weights, k))(x, h, *k)


def weighted(weights: Any, k: list[Any]) -> Any:
    """The sum of weighted slopes."""
    weights, k = used(weights, k)
    return entrywise(lambda *k: added(weights, k))(*k)


def used(weights: Any, k: list[Any]) -> tuple[list[float], list[Any]]:
    """The weights that are not zero, and their slopes."""
    pairs = [(float(w), each) for w, each in zip(weights, k, strict=False) if w]
    return [w for w, _ in pairs], [each for _, each in pairs]


def added(weights: list[float], k: Sequence[Any]) -> Any:
    """Products, one after the other."""
    total = weights[0] * k[0]
    for w, each in zip(weights[1:], k[1:], strict=True):
        total = total + w * each
    return total


def _larger(x: Any, y: Any) -> Any:
    """y where x is no number: one instruction, as `jnp.maximum` is not."""
    return jnp.where(x > y, x, y)


def _largest(x: Any) -> Any:
    """Of numbers, pair by pair: chains of operations are short."""
    while len(x) > 1:
        half = len(x) // 2
        x = jnp.concatenate([_larger(x[:half], x[half : 2 * half]), x[2 * half :]])
    return x[0]


# Of the step controller, with relative errors of 5e-4 and continuous: of a normal number
# the binary logarithm, by its exponent and a polynomial of its mantissa less one, without
# the first factor, and the power of two.
LOG2 = (-0.08065, 0.31815, -0.67588, 1.43838)
EXP2 = (0.07914, 0.225, 0.69586, 1.0)


def _log2(x: Any) -> Any:
    bits = jax.lax.bitcast_convert_type(x, jnp.int32)
    power = ((bits >> 23) - 127).astype(x.dtype)
    part = jax.lax.bitcast_convert_type((bits & 0x7FFFFF) | 0x3F800000, x.dtype) - 1.0
    return power + part * _horner(LOG2, part)


def _exp2(x: Any) -> Any:
    whole = jnp.floor(x)
    # The low bits of the sum are the exponent: a conversion has no instruction for vectors.
    bits = jax.lax.bitcast_convert_type(whole + (2.0**23 + 127.0), jnp.int32) << 23
    part = x - whole
    return jax.lax.bitcast_convert_type(bits, x.dtype) * _horner(EXP2, part)


def _horner(coefficients: Sequence[float], x: Any) -> Any:
    total: Any = coefficients[0]
    for c in coefficients[1:]:
        total = total * x + c
    return total


def _norm(x: Any) -> Any:
    return jnp.sqrt(jnp.mean(x * x))
