"""The filter of [`Adaptive`][], as a law that a state follows: first algebraic fits over a
bank of parameters, then one Kalman filter for each of them, then one for all."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from .._filters import AbstractLaw
from .._typing import PyTree
from ._adaptive_member import LEARNING, Member, mirrored, stepped
from ._adaptive_model import Model, slope_by_y
from ._adaptive_start import Fit, Found, emptied, fitted, joined

# The bank covers so many deviations of the first parameter, and each of its filters so much
# of what is between two of them.
REACH, OVERLAP = 3.0, 0.7
MOST, ENOUGH = 0.96, 0.6  # of the bank: certain, at once or after
PATIENCE = 2.5  # times the samples that it took
WIDENED = 64.0  # times the shortest window
MERGING = 1.0  # s, the least that the bank is kept
ALIVE = 1e-3  # the weight of a rival
AGREE = 0.8  # the cosine between directions of one solution
UNTRIED = 10.0  # times as fast as not to be held
FAR = 0.1  # of its size: an x that may be off by so much in a hole is begun again


class AdaptiveBelief(NamedTuple):
    """`fits` and `members` of the bank; the samples that the fits have, the length of their
    window, when enough of them were certain (0 before); whether the filters have `started`,
    and how long ago (s); whether they are `merged`, and whether the parameters are held;
    the `one` that is of all members that agree with the best, and the weight of the
    others."""

    fits: Fit
    members: Member
    samples: Float[Array, ""]
    window: Float[Array, ""]
    enough: Float[Array, ""]
    started: Bool[Array, ""]
    age: Float[Array, ""]
    merged: Bool[Array, ""]
    held: Bool[Array, ""]
    one: Member
    rivals: Float[Array, ""]

    @property
    def mean(self) -> Float[Array, " N"]:
        return self.one.mean

    @property
    def covariance(self) -> Float[Array, "N N"]:
        return self.one.covariance


class AdaptiveKalman(AbstractLaw):
    """The belief, driven by `(u, y, hole)`: how many samples in a row are missing, up to
    this one; `None` where none can be."""

    model: Model
    deviations: Float[Array, " q"]
    drift: Float[Array, " q"]
    hold: Float[Array, ""]
    initial: Float[Array, " n"] | None
    bank: int = eqx.field(static=True)

    def grid(self) -> Float[Array, " j"]:
        """The relative errors of the first parameter in the bank."""
        places = jnp.linspace(-1.0, 1.0, self.bank, dtype=self.deviations.dtype)
        return REACH * self.deviations[0] * places

    def errors(self, first: Array) -> Float[Array, " q"]:
        """Those of all parameters where the first one has this."""
        return jnp.zeros_like(self.deviations).at[0].set(first)

    def start(self, u: PyTree, y: PyTree) -> AdaptiveBelief:
        """The first belief, with the first y."""
        dtype = self.model.dtype(u, y)
        z = self.model.row(self.errors(jnp.zeros((), dtype)), u, y).z
        n, q, J = z.shape[0], self.deviations.shape[0], self.bank
        smooth, _ = ravel_pytree(y)
        zero, no = jnp.zeros((), dtype), jnp.asarray(False)
        x = jnp.zeros_like(z) if self.initial is None else self.initial.astype(dtype)
        mean = jnp.concatenate([x, jnp.zeros(q, dtype)])
        vague = jnp.full(n, 1.0 / float(jnp.finfo(dtype).eps), dtype)
        P = jnp.diag(jnp.concatenate([vague, self.deviations.astype(dtype) ** 2]))
        alike = lambda a: jnp.broadcast_to(a, (J, *a.shape))
        unit = jnp.zeros_like(smooth).at[0].set(1.0)
        one = Member(mean, P, smooth, smooth, unit, zero, zero)
        join = lambda e: joined(emptied(z), self.model, self.errors(e), u, y)
        return AdaptiveBelief(
            jax.vmap(join)(self.grid()),
            jax.tree.map(alike, one),
            zero + 1.0,
            zero,
            zero,
            no,
            zero,
            no,
            no,
            one,
            zero + 1.0,
        )

    def flow(self, X: PyTree, v: PyTree) -> Any:
        del v
        return jax.tree.map(jnp.zeros_like, X)

    def discretise(self, h: Any) -> Any:
        return h

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> Any:
        (u, y0, before), (_, y1, hole) = v0, v1
        h = jnp.asarray(coefficients, X.mean.dtype)
        sample = u, y0, y1, hole, h
        settled = lambda X: self._settled(X, sample)
        compete, begin = (
            lambda X: self._compete(X, sample),
            lambda X: self._begin(X, sample),
        )
        others = lambda X: jax.lax.cond(X.started, compete, begin, X)
        X = jax.lax.cond(X.merged, settled, others, X)
        if hole is None:
            return X
        n = X.mean.shape[0] - self.deviations.shape[0]
        unknown = jnp.trace(X.covariance[:n, :n]) > FAR**2 * jnp.sum(X.mean[:n] ** 2)

        def again(X):
            new = self.start(u, y1)
            return new._replace(one=new.one._replace(mean=X.mean))

        # Until the first sample after the hole, with which the fits begin.
        beside = (hole > 0.0) | (before > 0.0)
        return jax.lax.cond(beside & (unknown | ~X.started), again, lambda X: X, X)

    def _settled(self, X: AdaptiveBelief, sample: Any) -> AdaptiveBelief:
        """One filter; what it came from stays as it was."""
        one, held, _ = stepped(self.model, X.one, self.hold, self.drift, sample)
        return X._replace(one=one, age=X.age + sample[-1], held=held)

    def _compete(self, X: AdaptiveBelief, sample: Any) -> AdaptiveBelief:
        """A filter for each member; they merge where no rival is left."""
        step = lambda m: stepped(self.model, m, self.hold, self.drift, sample, X.age)
        members, held, loss = jax.vmap(step)(X.members)
        # What noise feigns, or a model that is nearly right, does not tell them apart.
        score = members.score - jnp.where(jnp.all(held), 0.0, loss)
        members = members._replace(score=score - jnp.max(score))
        one, rivals, best = _agreed(members)
        age = X.age + sample[-1]
        merged = (age >= MERGING) & (rivals < ALIVE)
        return X._replace(
            members=members,
            age=age,
            merged=merged,
            held=jnp.sum(best * held) > 0.5,
            one=one,
            rivals=jnp.where(merged, 0.0, rivals),
        )

    def _begin(self, X: AdaptiveBelief, sample: Any) -> AdaptiveBelief:
        """Fits, from which the filters start where they are certain."""
        u, y0, y1, hole, h = sample
        missing = jnp.asarray(False) if hole is None else hole > 0.0
        model, grid = self.model, self.grid()

        def onward(fit, e):
            errors = self.errors(e)
            z = model.row(errors, u, y0).z + model.row(errors, u, y1).z
            fit = fit._replace(moved=fit.moved + 0.5 * h * z)
            with_y = joined(fit, model, errors, u, y1)
            return jax.tree.map(lambda a, b: jnp.where(missing, a, b), fit, with_y)

        fits = jax.vmap(onward)(X.fits, grid)
        count = X.samples + jnp.where(missing, 0.0, 1.0)
        fit = lambda f, e: fitted(f, count, model, self.errors(e), u, y1, h)
        found = jax.vmap(fit)(fits, grid)
        share = jnp.mean(found.certain.astype(count.dtype))
        enough = jnp.where((X.enough == 0.0) & (share > ENOUGH), count, X.enough)
        late = (enough > 0.0) & (count >= PATIENCE * enough)
        started = ((share > MOST) | late) & ~missing
        # Where nothing has turned within a window, the next one is longer.
        shortest = jnp.min(2.0 * found.steady)
        window = jnp.maximum(X.window, shortest)
        over = (count >= window) & (enough == 0.0)
        window = jnp.where(over, jnp.minimum(2.0 * window, WIDENED * shortest), window)
        fits = jax.tree.map(lambda a: jnp.where(over, 0.0, a), fits)
        members = self._members(found, X.members, u, y1)
        initial = X.mean[: found.x.shape[1]]
        z = model.row(self.errors(0.0 * h), u, y0).z
        z = z + model.row(self.errors(0.0 * h), u, y1).z
        mean = X.mean.at[: initial.shape[0]].set(initial + 0.5 * h * z)
        one, rivals, _ = _agreed(members)
        chosen = lambda a, b: jax.tree.map(lambda a, b: jnp.where(started, a, b), a, b)
        return X._replace(
            fits=fits,
            members=chosen(members, X.members),
            samples=jnp.where(over, 0.0, count),
            window=window,
            enough=enough,
            started=started,
            one=chosen(one, X.one._replace(mean=mean)),
            rivals=jnp.where(started, rivals, 1.0),
        )

    def _members(self, found: Found, like: Member, u: PyTree, y: PyTree) -> Member:
        """The filters at their start, from the fits."""
        grid, n = self.grid(), found.x.shape[1]
        spacing = grid[1] - grid[0]
        of_first = (OVERLAP * spacing) ** 2
        x = jnp.where(found.certain[:, None], found.x, like.mean[:, :n])
        along = _slopes(x) / spacing  # how x depends on the first parameter
        bent = 0.5 * OVERLAP**2 * _bends(x)  # and what of that is not a straight line
        flat, _ = ravel_pytree(y)
        # None is held before it has shown how fast it learns.
        fast = UNTRIED / (self.hold**2 * LEARNING)

        def member(x, certain, P, e, along, bent):
            mean = jnp.concatenate([x, self.errors(e)])
            by_first = jnp.concatenate([along, self.errors(jnp.ones_like(e))])
            rest = self.errors(0.0 * e).at[1:].set(self.deviations[1:] ** 2)
            own = jnp.zeros((mean.size, mean.size), mean.dtype)
            P = P + bent[:, None] * bent
            own = own.at[:n, :n].set(jnp.where(certain, P, jnp.eye(n, dtype=P.dtype)))
            own = own + jnp.diag(jnp.concatenate([jnp.zeros(n, mean.dtype), rest]))
            P = own + by_first[:, None] * by_first * of_first
            direction, _ = slope_by_y(self.model, mean, u, y)
            prior = -0.5 * (e / self.deviations[0]) ** 2
            score = jnp.where(certain, prior, -1e6)
            return Member(mean, mirrored(P), flat, flat, direction, fast, score)

        return jax.vmap(member)(x, found.certain, found.covariance, grid, along, bent)


def _slopes(x: Float[Array, "j n"]) -> Float[Array, "j n"]:
    """By how much it changes from one member to the next, at each."""
    steps = x[1:] - x[:-1]
    inner = 0.5 * (steps[1:] + steps[:-1])
    return jnp.concatenate([steps[:1], inner, steps[-1:]])


def _bends(x: Float[Array, "j n"]) -> Float[Array, "j n"]:
    """Its second differences, at each member."""
    inner = x[2:] - 2.0 * x[1:-1] + x[:-2]
    return jnp.concatenate([inner[:1], inner, inner[-1:]])


def _agreed(members: Member) -> tuple[Member, Float[Array, ""], Float[Array, " j"]]:
    """What is left of the members that agree with the best on the direction of the row, the
    weight of the others, and which is the best."""
    top = jnp.max(members.score)
    best = (members.score == top).astype(top.dtype)
    best = best / jnp.sum(best)
    weight = jnp.exp(members.score - top)
    cosine = members.direction @ (best @ members.direction)
    same = jnp.where(cosine > AGREE, weight, 0.0)
    total = jnp.sum(same)
    share = same / total
    mean = share @ members.mean
    away = members.mean - mean
    spread = members.covariance + away[:, :, None] * away[:, None, :]
    P = jnp.sum(share[:, None, None] * spread, axis=0)
    one = jax.tree.map(lambda x: jnp.tensordot(best, x, 1), members)
    one = one._replace(mean=mean, covariance=mirrored(P), score=jnp.zeros_like(top))
    return one, 1.0 - total / jnp.sum(weight), best
