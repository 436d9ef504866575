"""The discrete-time model of a sample of a study, for the bound on observers."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .._experiment import Carry, Experiment, Record
from .._module import Module
from .._runge_kutta import runge_kutta
from .._typing import PyTree
from ..disturbances import AbstractDisturbance, SampledNoise
from ._unknown import Unknown

Square = Float[Array, "n n"]


class Linearised(Module):
    """The discrete-time model of one sample, linearised about its trajectory: of the state
    and of the relative errors of what is unknown, which are zero along it."""

    make: Callable[[PyTree], Experiment]
    prior: PyTree
    process: PyTree | None
    noise: Any
    unknown: Unknown

    def first(self, sample: PyTree) -> tuple[Carry, Record, Square]:
        experiment = self.make(sample)
        carry, record = experiment.init()
        known = flat(self.prior, carry.x), self.unknown.start(experiment.plant)
        return carry, record, jnp.diag(jnp.concatenate(known) ** 2)

    def onward(self, sample: PyTree, carry: Carry, prepared: Any, k: Any):
        """The next carry and record, F and Q."""
        experiment = self.make(sample)
        x, back = ravel_pytree(carry.x)
        u, held = ravel_pytree(carry.command)
        t, h = k * experiment.interval, experiment.interval
        errors = jnp.zeros_like(self.unknown.start(experiment.plant))

        def flow(x, errors, u):
            state, part = back(x), h / experiment.plant_steps
            plant = self.unknown.at(experiment.plant, errors)
            rate = lambda t, x: plant.vector_field(t, x, held(u))
            for j in range(experiment.plant_steps):
                state = runge_kutta(rate, t + j * part, state, part)
            return ravel_pytree(state)[0]

        F, by_errors, G = jax.jacfwd(flow, (0, 1, 2))(x, errors, u)
        noise = _variance(experiment.actuator, carry.command)
        noise = noise + _variance(experiment.input_sensor, carry.command)
        Q = (G * noise) @ G.T
        if self.process is not None:
            Q = Q + h * jnp.diag(flat(self.process, carry.x) ** 2)
        if errors.size:
            q = errors.size
            F = jnp.block([[F, by_errors], [jnp.zeros((q, x.size)), jnp.eye(q)]])
            Q = jnp.pad(Q, (0, q))
        return *experiment.advance(k, carry, prepared), F, Q

    def measured(self, sample: PyTree, carry: Carry):
        """The rows of `R^-1/2 H`, and the Jacobian of what is hidden and unknown."""
        plant, sensor = self.make(sample).plant, self.make(sample).sensor
        x, back = ravel_pytree(carry.x)
        errors = jnp.zeros_like(self.unknown.start(plant))

        def seen(x, errors):
            at = self.unknown.at(plant, errors)
            return ravel_pytree(at.output(back(x)))[0], at.hidden(back(x))

        H, C = jax.jacfwd(lambda X: seen(X[: x.size], X[x.size :]))(
            jnp.concatenate([x, errors])
        )
        C = jnp.concatenate([C, jnp.eye(H.shape[1])[x.size :]])
        if self.noise is None:
            if not _noises(sensor):
                raise ValueError(
                    "Argument `noise` must be given where the experiment's sensor has no "
                    "`SampledNoise`, but got None."
                )
            R = _variance(sensor, plant.output(carry.x))
        else:
            R = flat(self.noise, plant.output(carry.x)) ** 2
        return H / jnp.sqrt(R)[:, None], C


def _noises(part: AbstractDisturbance | None) -> list[SampledNoise]:
    """The white noises among the parts of a disturbance."""
    parts = getattr(part, "parts", (part,))
    return [p for p in parts if isinstance(p, SampledNoise)]


def _variance(part: AbstractDisturbance | None, signal: PyTree) -> Float[Array, " p"]:
    total = jnp.zeros_like(ravel_pytree(signal)[0])
    for noise in _noises(part):
        total = total + flat(noise.deviation, signal) ** 2
    return total


def flat(deviation: PyTree, like: PyTree) -> Float[Array, " n"]:
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
