"""The Cramer-Rao bound: how well any observer could do on the noisy samples of a study."""

import dataclasses
import importlib.util
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .. import _choices, random
from .._checks import one_of
from .._experiment import Carry, Experiment, Record
from .._module import Module
from .._typing import Average, PyTree
from ..engines import run_batch
from . import _statistics as statistics
from ._linearised import Linearised, Square
from ._tables import BOUND
from ._unknown import unknown_of

KNOWN = "known"  # beside BOUND, that of observers who know all parameters


class Bound(Module):
    """The bound at the instants `t` (s) of the samples in time, shape `(T,)`: `variance` of
    each entry of the hidden state in its squared unit, shape `(N, T, m)`, for N
    trajectories, or one where they were averaged before; and `parameters`, the variance of
    the relative error of each parameter that is unknown, by name, shape `(N, T, ...)`.

    **Raises:** `ValueError` for an rms after a time that is past the last sample.
    """

    t: Float[np.ndarray, " T"]
    variance: Float[np.ndarray, "N T m"]
    parameters: dict[str, Float[np.ndarray, "N T ..."]] = dataclasses.field(
        default_factory=dict
    )

    @property
    def deviation(self) -> Float[np.ndarray, "T m"]:
        """The least rms error over samples of each entry at each instant."""
        return np.sqrt(self.variance.mean(0))

    @property
    def norm(self) -> Float[np.ndarray, " T"]:
        """The least rms over samples of the norm of the error, at each instant."""
        return np.sqrt(self.variance.sum(2).mean(0))

    def rms(
        self,
        after: float = 0.0,
        confidence: float = 0.95,
        key: random.KeyLike | None = None,
    ) -> statistics.Interval:
        """The least rms, over samples and over time from `after` (s) on, of the norm of the
        error: the bound on the rms over samples of the metric `RMSError`. The interval is
        that of so many trajectories."""
        counted = self.variance[:, self.t >= after]
        if counted.shape[1] == 0:
            raise ValueError(
                f"Argument `after` must not be past the last sample, at {self.t[-1]:.6g} "
                f"s, but got {after}."
            )
        size = np.sqrt(counted.sum(2).mean(1))
        return statistics.rms(size, confidence, key)


def cramer_rao(
    make: Callable[[PyTree], Experiment],
    samples: PyTree,
    steps: int,
    *,
    prior: PyTree,
    process: PyTree | None = None,
    noise: Any = None,
    unknown: Mapping[str, Any] | None = None,
    average: Average = "bounds",
) -> Bound:
    """The Cramer-Rao bound on the error of any observer that knows the plant, the inputs
    and the statistics of the noises, for `make(sample)` over `steps` samples in time; but
    for parameters of the plant that are `unknown`.

    - `samples`: as of [`run_batch`][], a few hundred: the trajectories over which is
      averaged;
    - `prior`: the standard deviation of each entry of the plant's first state, a pytree
      like that state; zero where it is known;
    - `process`: by default none; the root of the intensity of white noise on the derivative
      of each entry of the state, in its unit per root second, a pytree like it. A load
      torque of deviation s (N m), renewed every h seconds, is `s sqrt(h) / inertia` on the
      speed;
    - `noise`: the standard deviation of each entry of y; by default that of the
      [`SampledNoise`][] in the experiment's `sensor`;
    - `unknown`: by default none; parameters of the plant by name, fields joined by dots, to
      the standard deviation of their relative error a priori: `{"resistance": 0.1}` is one
      that is known to 10 %. They are constant states beside those of the plant, and `make`
      gives their true values. Inputs are what was applied, whatever a controller knew;
    - `average`: `"bounds"` takes the bound along each trajectory, then the mean of their
      squares; `"information"` takes expectations inside the recursion, as Tichavsky does.

    [`SampledNoise`][] of the `actuator` or the `input_sensor` is unknown to an observer
    either way, and enters as noise of the input. Other disturbances act on the
    trajectories, and are taken as known: what an observer does not know of them only makes
    it worse.

    With `x[k+1] = f(x[k], u[k]) + w`, `y[k] = h(x[k]) + v`, F and H the Jacobians, Q and R
    the covariances, the inverse J of the bound P obeys
    `J[k+1] = (F J[k]^-1 F' + Q)^-1 + H'R^-1 H`, which holds for singular Q, zero included;
    it is computed in P, so that what is known exactly stays so. `"bounds"` is run by
    [`run_batch`][], on its fused engine where llvmlite is installed.

    `"information"` holds for every observer, however biased, but needs noise on every
    state: without, it is zero as soon as F differs between trajectories. `"bounds"` is
    never smaller, and is what is attained where the noise is small; along one trajectory it
    is the bound of unbiased observers. Both are the covariance of the Kalman filter where
    the plant is linear.

    Sources: Tichavsky, Muravchik, Nehorai 1998, doi:10.1109/78.668800; Taylor 1979,
    doi:10.1109/TAC.1979.1101979, for the bound along a trajectory.

    **Raises:** `ValueError` in single precision, for a [`ContinuousExperiment`][], for a
    sensor without noise, for
    `"information"` without noise on every state, which parameters never have, and for
    `unknown` ones that the plant does not have, or that are zero.
    """
    one_of("average", average, _choices.Average)
    if jnp.result_type(float) != jnp.float64:
        raise ValueError(
            "The bound needs double precision, but JAX is in single; call "
            '`jax.config.update("jax_enable_x64", True)` first.'
        )
    samples = jax.tree.map(jnp.asarray, samples)
    model = Linearised(make, prior, process, noise, unknown_of(unknown, make, samples))
    if average == "information":
        if unknown:
            raise ValueError(
                'Argument `average` must be "bounds" where parameters are `unknown`, which '
                'have no noise, but got "information".'
            )
        t, variance, definite = _together(model, samples, steps)
        if not bool(definite):
            raise ValueError(
                'Argument `average` must be "bounds" where some state has no noise, but '
                'got "information"; or give `process` for every state.'
            )
    else:
        t, found = _each(model, samples, steps)
        variance = found[BOUND]
    return _bound(model, t, variance)


def both_bounds(
    make: Callable[[PyTree], Experiment],
    samples: PyTree,
    steps: int,
    *,
    prior: PyTree,
    unknown: Mapping[str, Any],
) -> tuple[Bound, Bound]:
    """[`cramer_rao`][] with the parameters known, and with them `unknown`, along the same
    trajectories, which take most of the time."""
    samples = jax.tree.map(jnp.asarray, samples)
    model = Linearised(make, prior, None, None, unknown_of(unknown, make, samples))
    t, found = _each(model, samples, steps, beside=True)
    return Bound(np.asarray(t), np.asarray(found[KNOWN])), _bound(model, t, found[BOUND])


def _bound(model: Linearised, t: ArrayLike, variance: ArrayLike) -> Bound:
    """Of the variances of what is hidden, then of what is unknown."""
    t, variance = np.asarray(t), np.asarray(variance)
    if not model.unknown.names:
        return Bound(t, variance)
    size = variance.shape[2] - model.unknown.size
    return Bound(t, variance[:, :, :size], model.unknown.split(variance[:, :, size:]))


def with_bound(
    dataset: Any, bound: Bound, after: Mapping[str, float], unknown: Bound | None = None
) -> Any:
    """The `xarray.Dataset` of a study with the `bound`, for its report.

    - `after` (s) by the name of each metric of the dataset that is an `RMSError`;
    - `unknown`: the bound of those to whom the parameters that are spread are unknown,
      which becomes the attribute of that name.
    """
    dataset = dataset.assign(
        {f"{BOUND}_{name}": bound.rms(t).value for name, t in after.items()}
    )
    if unknown is not None:
        for name, t in after.items():
            dataset[f"{BOUND}_{name}"].attrs["unknown"] = unknown.rms(t).value
    if "time" in dataset.coords:
        at = np.abs(bound.t[None] - dataset.time.values[:, None]).argmin(1)
        dataset = dataset.assign(cramer_rao=(("time",), bound.norm[at]))
    return dataset


class _Along(Module):
    """The bound along the trajectory of one sample, as an experiment that an engine runs:
    its carry is the experiment's and P, its record the variances of what is hidden; with
    `beside`, those with all parameters known beside them, of the same linearisation."""

    model: Linearised
    sample: PyTree
    beside: bool = eqx.field(static=True, default=False)

    def _parts(self, M: Array, across: bool = True) -> dict[str, Array]:
        """A matrix of state and parameters, and the part of it that knows these."""
        if not self.beside:
            return {BOUND: M}
        q = self.model.unknown.size
        rows = M.shape[0] - q if across else M.shape[0]
        return {BOUND: M, KNOWN: M[:rows, : M.shape[1] - q]}

    def init(self) -> tuple[tuple[Carry, dict[str, Square]], Record]:
        carry, record, P = self.model.first(self.sample)
        return self._measured(carry, record, self._parts(P))

    def prepare(self, carry: tuple[Carry, Any]) -> dict[str, PyTree]:
        return self.model.make(self.sample).prepare(carry[0])

    def advance(
        self, k: Any, carry: tuple[Carry, dict[str, Square]], prepared: dict[str, PyTree]
    ):
        before, P = carry
        after, record, F, Q = self.model.onward(self.sample, before, prepared, k)
        F, Q = self._parts(F), self._parts(Q)
        P = {name: _symmetric(F[name] @ P[name] @ F[name].T + Q[name]) for name in P}
        return self._measured(after, record, P)

    def _measured(self, carry: Carry, record: Record, P: dict[str, Square]):
        rows, C = self.model.measured(self.sample, carry)
        rows, C = self._parts(rows, across=False), self._parts(C)
        P = {name: _known(P[name], rows[name]) for name in P}
        variance = {name: jnp.sum((C[name] @ P[name]) * C[name], axis=1) for name in P}
        return (carry, P), dataclasses.replace(record, estimates=variance)


def _each(model: Linearised, samples: PyTree, steps: int, beside: bool = False):
    """The instants, and the variances along each trajectory."""
    make: Any = lambda sample: _Along(model, sample, beside)
    engine = "auto" if importlib.util.find_spec("llvmlite") else "scan"
    kept = lambda record: (record.t, record.estimates)
    batch = run_batch(make, samples, steps, record=kept, every=1, engine=engine)
    t, variance = batch.record
    return t[0], variance


def _known(P: Square, rows: Float[Array, "p n"]) -> Square:
    """`(P^-1 + rows' rows)^-1`, for a singular P too: one measurement of unit variance
    after the other, in Joseph's form. It is arithmetic alone, and what is small in P is as
    accurate as what is large, where `(1 + P rows' rows)^-1 P` loses the square of the
    ratio of what was known to what is measured."""
    for row in rows:
        g = P @ row
        gain = g / (1.0 + row @ g)
        P = P - jnp.outer(gain, g)
        P = _symmetric(P + jnp.outer(gain - P @ row, gain))
    return P


def _symmetric(P: Square) -> Square:
    """Of the upper triangle, so that the lower one need not be computed."""
    n = P.shape[0]
    return jnp.where(np.tri(n, k=-1, dtype=bool), P.T, P)


@eqx.filter_jit
def _together(model: Linearised, samples: PyTree, steps: int):
    """The instants, the variances with expectations inside the recursion, and whether Q is
    definite."""
    carries, begin, P = jax.vmap(model.first)(samples)
    prepared = jax.vmap(lambda s, carry: model.make(s).prepare(carry))(samples, carries)

    def measured(carries, P):
        rows, C = jax.vmap(model.measured)(samples, carries)
        P = _added(P, jnp.einsum("npi,npj->ij", rows, rows) / rows.shape[0])
        C = C.mean(0)
        return P, jnp.sum((C @ P) * C, axis=1)

    def step(state, k):
        carries, P = state
        carries, record, F, Q = jax.vmap(model.onward, (0, 0, 0, None))(
            samples, carries, prepared, k
        )
        F, Q, known, definite = _expected(F, Q)
        P = F @ _added(P, known) @ F.T + Q
        P, variance = measured(carries, P)
        return (carries, P), (record.t[0], variance, definite)

    P, variance = measured(carries, P.mean(0))
    first = begin.t[0], variance, jnp.asarray(True)
    _, rest = jax.lax.scan(step, (carries, P), jnp.arange(steps))
    join = lambda a, b: jnp.concatenate([a[None], b])
    t, variance, definite = jax.tree.map(join, first, rest)
    return t, variance[None], definite.all()


def _added(P: Square, information: Square) -> Square:
    """`(P^-1 + information)^-1`, for a singular P too."""
    P = jnp.linalg.solve(jnp.eye(P.shape[0], dtype=P.dtype) + P @ information, P)
    return 0.5 * (P + P.T)


def _expected(F: Float[Array, "N n n"], Q: Float[Array, "N n n"]):
    """F, Q, and what is added to J, that give Tichavsky's recursion in the form of one
    trajectory: with `D11 = E[F'Q^-1 F]`, `D12 = -E[F'Q^-1]`,
    `E[Q^-1]^-1 + F (J + D11 - F'E[Q^-1] F)^-1 F'`, where `F = E[Q^-1]^-1 E[Q^-1 F]`."""
    # A singular Q is told by its pivots, each relative to its own diagonal entry.
    unit = jnp.sqrt(jax.vmap(jnp.diagonal)(Q))
    correlation = Q / jnp.where(unit > 0, unit, 1.0)[:, :, None]
    correlation = correlation / jnp.where(unit > 0, unit, 1.0)[:, None, :]
    definite = (jnp.linalg.eigvalsh(correlation)[:, 0] > 1e-12).all()
    inverse = jnp.linalg.inv(Q)
    mean = jnp.linalg.inv(inverse.mean(0))
    expected = mean @ (inverse @ F).mean(0)
    # The mean of squares about the mean: the difference of D11 would cancel.
    apart = F - expected
    known = (jnp.swapaxes(apart, 1, 2) @ inverse @ apart).mean(0)
    return expected, mean, known, definite
