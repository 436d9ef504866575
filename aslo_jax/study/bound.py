"""The Cramer-Rao bound: how well any observer could do on the noisy samples of a study."""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree

from .._runge_kutta import runge_kutta
from ..disturbances import AbstractDisturbance, SampledNoise
from ..experiment import Carry, Experiment
from . import statistics

Square = Float[Array, "n n"]


class Bound(eqx.Module):
    """The bound at the instants `t` (s) of the samples in time, shape `(T,)`: `variance` of
    each entry of the hidden state in its squared unit, shape `(N, T, m)`, for N
    trajectories, or one where they were averaged before."""

    t: Float[np.ndarray, " T"]
    variance: Float[np.ndarray, "N T m"]

    @property
    def deviation(self) -> Float[np.ndarray, "T m"]:
        """The least rms error over samples of each entry at each instant."""
        return np.sqrt(self.variance.mean(0))

    @property
    def norm(self) -> Float[np.ndarray, " T"]:
        """The least rms over samples of the norm of the error, at each instant."""
        return np.sqrt(self.variance.sum(2).mean(0))

    def rms(
        self, after: float = 0.0, confidence: float = 0.95, seed: int = 0
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
        return statistics.rms(size, confidence, seed)


def cramer_rao(
    make: Callable[[PyTree], Experiment],
    samples: PyTree,
    steps: int,
    *,
    prior: PyTree,
    process: PyTree | None = None,
    noise: Any = None,
    average: str = "bounds",
) -> Bound:
    """The Cramer-Rao bound on the error of any observer that knows the plant, the inputs
    and the statistics of the noises, for `make(sample)` over `steps` samples in time.

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
    - `average`: `"bounds"` takes the bound along each trajectory, then the mean of their
      squares; `"information"` takes expectations inside the recursion, as Tichavsky does.

    [`SampledNoise`][] of the `actuator` or the `input_sensor` is unknown to an observer
    either way, and enters as noise of the input. Other disturbances act on the
    trajectories, and are taken as known: what an observer does not know of them only makes
    it worse.

    With `x[k+1] = f(x[k], u[k]) + w`, `y[k] = h(x[k]) + v`, F and H the Jacobians, Q and R
    the covariances, the inverse J of the bound P obeys
    `J[k+1] = (F J[k]^-1 F' + Q)^-1 + H'R^-1 H`, which holds for singular Q, zero included;
    it is computed in P, so that what is known exactly stays so. `"information"` holds for
    every observer, however biased, but needs noise on every state: without, it is zero as
    soon as F differs between trajectories. `"bounds"` is never smaller, and is what is
    attained where the noise is small; along one trajectory it is the bound of unbiased
    observers. Both are the covariance of the Kalman filter where the plant is linear.

    Sources: Tichavsky, Muravchik, Nehorai 1998, doi:10.1109/78.668800; Taylor 1979,
    doi:10.1109/TAC.1979.1101979, for the bound along a trajectory.

    **Raises:** `ValueError` in single precision, for a sensor without noise, or for
    `"information"` without noise on every state.
    """
    if average not in ("bounds", "information"):
        raise ValueError(
            f'Argument `average` must be "bounds" or "information", but got {average!r}.'
        )
    if jnp.result_type(float) != jnp.float64:
        raise ValueError(
            "The bound needs double precision, but JAX is in single; call "
            '`jax.config.update("jax_enable_x64", True)` first.'
        )
    samples = jax.tree.map(jnp.asarray, samples)
    model = _Model(make, prior, process, noise)
    t, variance, definite = _run(model, samples, steps, average == "information")
    if average == "information" and not bool(definite):
        raise ValueError(
            'Argument `average` must be "bounds" where some state has no noise, but got '
            '"information"; or give `process` for every state.'
        )
    return Bound(np.asarray(t), np.asarray(variance))


def with_bound(dataset: Any, bound: Bound, after: Mapping[str, float]) -> Any:
    """The `xarray.Dataset` of a study with the bound, for its report.

    - `after` (s) by the name of each metric of the dataset that is an `RMSError`.
    """
    found = {f"cramer_rao_{name}": bound.rms(t).value for name, t in after.items()}
    dataset = dataset.assign(found)
    if "time" in dataset.coords:
        at = np.abs(bound.t[None] - dataset.time.values[:, None]).argmin(1)
        dataset = dataset.assign(cramer_rao=(("time",), bound.norm[at]))
    return dataset


class _Model(eqx.Module):
    """The discrete-time model of one sample, linearised about its trajectory."""

    make: Callable[[PyTree], Experiment]
    prior: PyTree
    process: PyTree | None
    noise: Any

    def first(self, sample: PyTree) -> tuple[Carry, dict[str, PyTree], Square]:
        experiment = self.make(sample)
        carry, _ = experiment.init()
        return carry, experiment.prepare(carry), jnp.diag(_flat(self.prior, carry.x) ** 2)

    def onward(self, sample: PyTree, carry: Carry, prepared: Any, k: Any):
        """The next carry, F and Q."""
        experiment = self.make(sample)
        x, back = ravel_pytree(carry.x)
        u, held = ravel_pytree(carry.command)
        t, h = k * experiment.interval, experiment.interval

        def flow(x, u):
            state, part = back(x), h / experiment.plant_steps
            rate = lambda t, x: experiment.plant.vector_field(t, x, held(u))
            for j in range(experiment.plant_steps):
                state = runge_kutta(rate, t + j * part, state, part)
            return ravel_pytree(state)[0]

        F, G = jax.jacfwd(flow, (0, 1))(x, u)
        unknown = _variance(experiment.actuator, carry.command)
        unknown = unknown + _variance(experiment.input_sensor, carry.command)
        Q = (G * unknown) @ G.T
        if self.process is not None:
            Q = Q + h * jnp.diag(_flat(self.process, carry.x) ** 2)
        return experiment.advance(k, carry, prepared)[0], F, Q

    def measured(self, sample: PyTree, carry: Carry):
        """`H'R^-1 H`, and the Jacobian of what is hidden."""
        plant, sensor = self.make(sample).plant, self.make(sample).sensor
        x, back = ravel_pytree(carry.x)
        output = lambda x: ravel_pytree(plant.output(back(x)))[0]
        H, C = jax.jacfwd(lambda x: (output(x), plant.hidden(back(x))))(x)
        if self.noise is None:
            if not _noises(sensor):
                raise ValueError(
                    "Argument `noise` must be given where the experiment's sensor has no "
                    "`SampledNoise`, but got None."
                )
            R = _variance(sensor, plant.output(carry.x))
        else:
            R = _flat(self.noise, plant.output(carry.x)) ** 2
        return (H.T / R) @ H, C


@eqx.filter_jit
def _run(model: _Model, samples: PyTree, steps: int, inside: bool):
    carries, prepared, P = jax.vmap(model.first)(samples)
    information, C = jax.vmap(model.measured)(samples, carries)
    if inside:
        P, information = P.mean(0, keepdims=True), information.mean(0, keepdims=True)

    def seen(C, P):
        C = C.mean(0, keepdims=True) if inside else C
        return jnp.einsum("nij,njk,nik->ni", C, P, C)

    P = jax.vmap(_added)(P, information)
    first = seen(C, P)

    def step(state, k):
        carries, P = state
        carries, F, Q = jax.vmap(model.onward, (0, 0, 0, None))(
            samples, carries, prepared, k
        )
        information, C = jax.vmap(model.measured)(samples, carries)
        definite = jnp.asarray(True)
        if inside:
            F, Q, known, definite = _expected(F, Q)
            P, information = _added(P[0], known)[None], information.mean(0, keepdims=True)
        P = jax.vmap(lambda P, F, Q: F @ P @ F.T + Q)(P, F, Q)
        P = jax.vmap(_added)(P, information)
        return (carries, P), (seen(C, P), definite)

    _, (rest, definite) = jax.lax.scan(step, (carries, P), jnp.arange(steps))
    variance = jnp.concatenate([first[:, None], jnp.swapaxes(rest, 0, 1)], axis=1)
    interval = model.make(jax.tree.map(lambda x: x[0], samples)).interval
    return jnp.arange(steps + 1) * interval, variance, definite.all()


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
    return expected[None], mean[None], known, definite


def _noises(part: AbstractDisturbance | None) -> list[SampledNoise]:
    """The white noises among the parts of a disturbance."""
    parts = getattr(part, "parts", (part,))
    return [p for p in parts if isinstance(p, SampledNoise)]


def _variance(part: AbstractDisturbance | None, signal: PyTree) -> Float[Array, " p"]:
    total = jnp.zeros_like(ravel_pytree(signal)[0])
    for noise in _noises(part):
        total = total + _flat(noise.deviation, signal) ** 2
    return total


def _flat(deviation: PyTree, like: PyTree) -> Float[Array, " n"]:
    """The entries of a pytree beside those of one `like` it, or one number for all."""
    shape = jax.tree.structure(like)
    if jax.tree.structure(deviation) != shape:
        if len(jax.tree.leaves(deviation)) != 1:
            raise ValueError(
                "A deviation must have the structure of what deviates, "
                f"{shape}, but has {jax.tree.structure(deviation)}."
            )
        (one,) = jax.tree.leaves(deviation)
        deviation = jax.tree.map(lambda _: one, like)
    spread = jax.tree.map(
        lambda d, x: jnp.broadcast_to(jnp.asarray(d, x.dtype), x.shape), deviation, like
    )
    return ravel_pytree(spread)[0]
