"""The Kalman filter of a lifted relation, as a law that a state follows."""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from .._factored import (
    Rows,
    array,
    divided,
    dot,
    factored,
    less,
    measured,
    orthogonalised,
    packed,
    plus,
    product,
    reciprocal,
    stacked,
    times,
    transposed_times,
)
from .._filters import AbstractLaw
from .._realise import Pass
from .._relations import AbstractTerms, Linear
from .._typing import PyTree
from ._lifted_belief import LiftedBelief, Lists, lists_of
from ._lifted_flow import flow
from ._lifting import (
    Growth,
    Motion,
    Noise,
    Relation,
    added,
    blurred,
    entries,
    growth_of,
    has_moved,
    measurement_of,
    motion_of,
    noise_of,
    rows_of,
    scaled,
    spread,
    squares,
    trace,
)

FAR = 3.0  # times its size: an x that may be off by so much is unknown


class Stage(NamedTuple):
    """What the filter did at one sample, for smoothing. First
    `X = transition X + shift + noise + by_y n`, the noise with `covariance`, shapes
    `(N, N)`, `(N,)`, `(N, N)` and `(N, p)`, n the noise of this y in its standard
    deviations. Then, row by row, `values = rows X + own n + noise` of `variances`, shapes
    `(k,)`, `(k, N)`, `(k, p)` and `(k,)`, and after each of them the mean moved by the
    covariance times its `information`, shape `(k, N)`: the noise of the row has to do with
    that of the value."""

    transition: Float[Array, "N N"]
    shift: Float[Array, " N"]
    covariance: Float[Array, "N N"]
    by_y: Float[Array, "N p"]
    values: Float[Array, " k"]
    rows: Float[Array, "k N"]
    own: Float[Array, "k p"]
    variances: Float[Array, " k"]
    information: Float[Array, "k N"]


class Run(AbstractLaw):
    """How many samples in a row are missing, where the drive is 1 over an interval of which
    one is and else 0."""

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        return jnp.zeros_like(X)

    def discretise(self, h: Any) -> Any:
        return h

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        return jnp.asarray(v1 * (X + 1.0), X.dtype)


def hole_of(F: Pass, dtype: Any, blind: bool = False) -> Float[Array, ""] | None:
    """How many samples in a row are missing, up to that of this pass, or where `blind` how
    many inputs; `None` where none can be."""
    none = jnp.zeros((), dtype)
    missing = F.blind if blind else F.missing
    drive = none if F.certain else missing.astype(dtype)
    rows = F.evolve(Run(), drive, none, "hole")
    return None if F.certain else rows


def grown(hole: Float[Array, ""]) -> Float[Array, ""]:
    """The variance that the last of so many missing samples adds, in units of that of one:
    all that is held over a hole may be wrong in the same way, so that the deviation grows
    with its length, not with the root."""
    return jnp.maximum(2.0 * hole - 1.0, 0.0)


class LiftedKalman(AbstractLaw):
    """The belief, driven by `(u, y)`: sampled, a prediction over the interval with u held,
    and an update by every row at the y at its end; in continuous time Riccati's equation,
    for noise of these deviations on samples `interval` (s) apart."""

    relation: Relation
    output_deviation: PyTree[Float[Array, "..."]]
    input_deviation: PyTree[Float[Array, "..."]]
    prior: Float[Array, "*n"] | None
    initial: Float[Array, " n"] | None
    interval: Float[Array, ""] | None
    missing: Bool[Array, ""] | None = None

    def start(self, u: PyTree, y: PyTree) -> LiftedBelief:
        """The first belief, with the first y."""
        rows, noise = self.at(u, y)
        n, dtype = rows[0].z.shape[0], rows[0].z.dtype
        one = jnp.ones((), dtype)
        x = [0.0 * one] * n if self.initial is None else entries(self.initial)
        variance = [v * one for v in self.variance(n, dtype)]
        P = [[variance[i] if i == j else 0 for j in range(n)] for i in range(n)]
        sigmas = added(rows)
        r = sum(k is not None for k in sigmas)
        mean, U, d = [], [], []
        # The first y of a row with a sigma says what sigma is.
        every = zip(rows, sigmas, noise.rows, noise.rows_by_u, strict=True)
        for row, k, by_y, by_u in every:
            if k is None:
                continue
            m = measurement_of(row, by_y, by_u, x)
            mean.append(times(m.sign, less(m.value, dot(m.h, x))))
            onward = [times(-m.sign, e) for e in m.h]
            U.append([1 if i == k else 0 for i in range(r)] + onward)
            d.append(plus(blurred(m, P), plus(dot(m.J, m.J), m.by_u)))
        lists = Lists(r, mean + x, U + _unit(n, r), d + variance, [0.0 * one] * r)
        linear = tuple(k is None for k in sigmas)
        still = [[0] * len(noise.rows[0].d) for _ in range(r + n)]
        lists, _ = _measured(lists, rows, noise, None, still, linear)
        return _packed(lists, dtype)

    def variance(self, n: int, dtype: Any) -> list[Any]:
        """That of the first belief of each entry of x."""
        if self.prior is None:
            return [1.0 / float(jnp.finfo(dtype).eps)] * n
        return entries(jnp.broadcast_to(self.prior**2, (n,)))

    def blind(self, hole: Float[Array, ""], u: PyTree, y: PyTree) -> "LiftedKalman":
        """As it is, or where a sample is missing, the last of a `hole` of so many, with
        deviations of what is held in its place, all of which may be wrong."""
        missing = hole > 0.0

        def wide(deviation: PyTree, signal: PyTree, name: str) -> PyTree:
            v, back = ravel_pytree(signal)
            size = jnp.sqrt(grown(hole)).astype(v.dtype) * jnp.linalg.norm(v)
            own = spread(deviation, signal, name)
            return back(jnp.where(missing, jnp.maximum(own, size), own))

        return dataclasses.replace(
            self,
            missing=missing,
            input_deviation=wide(self.input_deviation, u, "input"),
            output_deviation=wide(self.output_deviation, y, "output"),
        )

    def discretise(self, h: Any) -> Any:
        return h

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> Any:
        after = self.stage(X, v0, v1, coefficients)[0]
        return after if self.missing is None else self.again(after, *v1)[0]

    def again(
        self, after: LiftedBelief, u: PyTree, y: PyTree
    ) -> tuple[LiftedBelief, Bool[Array, ""]]:
        """The belief `after` a sample that may be missing, and whether it is a new one:
        once x may be off by far more than it is large, nothing is known of it any more."""
        assert self.missing is not None
        lists, begun = lists_of(after), self.start(u, y)
        far = trace(_unit(len(lists.x)), lists.spread()) > FAR**2 * dot(lists.x, lists.x)
        again = self.missing & far
        return jax.tree.map(lambda a, b: jnp.where(again, a, b), begun, after), again

    def stage(
        self, X: LiftedBelief, v0: PyTree, v1: PyTree, h: Any
    ) -> tuple[LiftedBelief, Stage]:
        """[`LiftedKalman.advance`][], and what it did."""
        (u, y0), (_, y1) = v0, v1
        left = rows_of(self.relation, u, y0)
        right, noise = self.at(u, y1)
        dtype = right[0].z.dtype
        h = jnp.asarray(h, dtype)
        motion = motion_of(left[0], right[0], h)
        lists = lists_of(X)
        W = scaled(noise.z(), h * h)
        every = zip(left, right, noise.rows, noise.rows_by_u, strict=True)
        grown = [
            growth_of(a, b, by_y, by_u, W, motion, lists.x, h)
            for a, b, by_y, by_u in every
            if not isinstance(b, Linear)
        ]
        lists, by_y, moved = _predicted(lists, grown, motion, noise)
        every = (True,) * len(right)
        lists, done = _measured(lists, right, noise, grown, by_y, every)
        values, rows, own, variances, information = map(list, zip(*done, strict=True))
        transition, shift, Q = moved
        taken = Stage(
            array(transition, dtype),
            stacked(shift, dtype),
            array(Q, dtype),
            array(by_y, dtype),
            stacked(values, dtype),
            array(rows, dtype),
            array(own, dtype),
            stacked(variances, dtype),
            array(information, dtype),
        )
        return _packed(lists, dtype), taken

    def flow(self, X: PyTree, v: PyTree) -> Any:
        rows, noise = self.at(*v)
        return flow(rows, noise, self.interval, X)

    def at(self, u: PyTree, y: PyTree) -> tuple[tuple[AbstractTerms, ...], Noise]:
        rows = rows_of(self.relation, u, y)
        deviations = self.input_deviation, self.output_deviation
        return rows, noise_of(self.relation, u, y, *deviations)


def _packed(lists: Lists, dtype: Any) -> LiftedBelief:
    factors = packed(lists.U, lists.d, dtype)
    mean, unsteady = stacked(lists.mean, dtype), stacked(lists.unsteady, dtype)
    return LiftedBelief(mean, factors, unsteady)


def _unit(n: int, before: int = 0) -> Rows:
    """The rows of the identity, after so many zeros."""
    return [[0] * before + [1 if i == j else 0 for j in range(n)] for i in range(n)]


def _predicted(
    lists: Lists, grown: list[Growth], motion: Motion, noise: Noise
) -> tuple[Lists, Rows, tuple[Rows, list[Any], Rows]]:
    """The belief at the end of an interval; what noise of the y there has added to it; and
    transition, shift and covariance without that."""
    r, mean, U, d, unsteady = lists
    n, before = len(mean) - r, lists.spread()
    by_u, by_y = motion.integrated(noise.z_by_u), motion.integrated(noise.z_by_y)

    def spread(x: Rows) -> Rows:
        """With what each sigma has of noises that add these columns to x."""
        of = [[dot(g.column, list(c)) for c in zip(*x, strict=True)] for g in grown]
        return of + x

    moved = _unit(n) if motion.transition is None else motion.transition
    one = _unit(r)
    transition = [one[k] + g.a for k, g in enumerate(grown)]
    transition += [[0] * r + row for row in moved]
    # What the noise of a row does with what is not known of x: of each sigma its own.
    own_blur = [trace(g.regressors, before) for g in grown]
    added_by_u, added_by_y = spread(by_u), spread(by_y)
    for k, g in enumerate(grown):
        for added_by, own in ((added_by_u, g.own_by_u), (added_by_y, g.own)):
            added_by[k] = [plus(a, b) for a, b in zip(added_by[k], own, strict=True)]
    if all(isinstance(e, int) for g in grown for e in g.own):
        # No row has noise of its own: all of it comes by x, which has fewer entries.
        both = [a + b for a, b in zip(by_u, by_y, strict=True)]
        columns, weights = factored(squares(both))
        columns = spread(columns)
    else:
        both = [a + b for a, b in zip(added_by_u, added_by_y, strict=True)]
        columns, weights = factored(squares(both))
    fresh = [e + (one[i] if i < r else [0] * r) for i, e in enumerate(columns)]
    wide = [a + b for a, b in zip(product(transition, U), fresh, strict=True)]
    new, pivots = orthogonalised(wide, d + weights + own_blur)
    shift = [g.b for g in grown] + motion.shift
    ahead = [plus(dot(t, mean), s) for t, s in zip(transition, shift, strict=True)]
    Q = squares(added_by_u)
    for k, extra in enumerate(own_blur):
        Q[k][k] = plus(Q[k][k], extra)
    lists = Lists(r, ahead, new, pivots, [w + 1.0 for w in unsteady])
    return lists, added_by_y, (transition, shift, Q)


def _measured(
    lists: Lists,
    rows: tuple[AbstractTerms, ...],
    noise: Noise,
    grown: list[Growth] | None,
    by_y: Rows,
    taken: tuple[bool, ...],
) -> tuple[Lists, list[tuple[Any, ...]]]:
    """The belief with the rows that are `taken`; value, row, own, variance and information
    of each, as in [`Stage`][]. The noise of y has also entered the state, by `by_y`."""
    done = []
    p = len(by_y[0])
    known_n, spread_n = [0] * p, _unit(p)  # of the noise of y, mean and covariance
    every = zip(rows, added(rows), noise.rows, noise.rows_by_u, strict=True)
    for index, (row, k, s, s_by_u) in enumerate(every):
        if not taken[index]:
            continue
        r, mean, U, d, unsteady = lists
        P, x = lists.spread(), slice(lists.r, None)
        m = measurement_of(row, s, s_by_u, lists.x)
        blur, own = plus(blurred(m, P), m.by_u), dot(m.J, [dot(e, m.J) for e in spread_n])
        h = [m.sign if i == k else 0 for i in range(r)] + m.h
        f = transposed_times(U, h)
        gathered = None
        if k is not None:
            assert grown is not None
            gathered = scaled(grown[k].regressors, unsteady[k])
        moved = has_moved(m, d[x], f[x], P, gathered)
        innovation = less(less(m.value, dot(h, mean)), dot(m.J, known_n))
        value = plus(plus(innovation, dot(h, mean)), dot(m.J, known_n))
        # The noise of the value is in part in the state, so that the state tells of it.
        shared, V = divided(U, [dot(e, m.J) for e in by_y]), plus(blur, own)
        told = [times(e, reciprocal(q)) for e, q in zip(shared, d, strict=True)]
        seen = [plus(a, b) for a, b in zip(f, told, strict=True)][:r]
        share = dot([times(a, b) for a, b in zip(d[:r], seen, strict=True)], seen)
        U, d, gain, inverse = measured(U, d, f, V, shared, moved)
        if index + 1 < len(rows):
            inverse = jnp.where(moved, inverse, reciprocal(less(V, dot(shared, told))))
            # What the next row has to know of the noise of y.
            q = [
                plus(dot(h, [e[j] for e in by_y]), dot(spread_n[j], m.J)) for j in range(p)
            ]
            known_n = [
                plus(a, times(b, times(inverse, innovation)))
                for a, b in zip(known_n, q, strict=True)
            ]
            by_y = [
                [less(e, times(g, b)) for e, b in zip(row_y, q, strict=True)]
                for row_y, g in zip(by_y, gain, strict=True)
            ]
            spread_n = [
                [less(e, times(times(a, b), inverse)) for e, b in zip(line, q, strict=True)]
                for line, a in zip(spread_n, q, strict=True)
            ]
        mean = [plus(a, times(b, innovation)) for a, b in zip(mean, gain, strict=True)]
        information: list[Any] = [0] * len(mean)
        if m.common is not None:
            # The gain has the noise of h, and so a mean product with that of the value.
            weight = jnp.where(moved, -1.0 / plus(own, blur), 0.0)
            information[x] = [times(weight, e) for e in m.common]
            by = [
                times(a, b)
                for a, b in zip(d, transposed_times(U, information), strict=True)
            ]
            mean = [plus(a, dot(e, by)) for a, e in zip(mean, U, strict=True)]
            known_n = [
                plus(a, dot([e[j] for e in by_y], information))
                for j, a in enumerate(known_n)
            ]
        done.append((value, h, m.J, blur, information))
        if k is not None:
            kept = jnp.where(moved, 1.0 - share * inverse, 1.0)
            unsteady = [*unsteady]
            unsteady[k] = unsteady[k] * kept * kept
        lists = Lists(r, mean, U, d, unsteady)
    return lists, done
