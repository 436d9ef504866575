"""Prescribed motions with closed-form signals, and a reference integration at 1e-12."""

from collections.abc import Callable

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from accurate import integrated
from jaxtyping import Array, Float

import aslo_jax as aslo


class PrescribedPMSM(eqx.Module):
    """A PMSM whose speed is `2 + 0.5 sin t` rad/s and whose torque current is
    `1 + 0.3 sin 3t` A, with a direct current too: everything is known in closed form."""

    resistance: float = 8.875
    inductance: float = 40.03e-3
    magnet_flux: float = 0.2086
    pole_pairs: int = 5
    angle0: float = 0.3
    direct: float = -0.2

    def angle(self, t):
        """Electrical angle (rad)."""
        return self.pole_pairs * (2 * t + 0.5 * (1 - jnp.cos(t))) + self.angle0

    def current(self, t):
        theta, q = self.angle(t), 1 + 0.3 * jnp.sin(3 * t)
        d_axis = jnp.stack([jnp.cos(theta), jnp.sin(theta)])
        q_axis = jnp.stack([-jnp.sin(theta), jnp.cos(theta)])
        return self.direct * d_axis + q * q_axis

    def flux(self, t):
        theta = self.angle(t)
        magnet = self.magnet_flux * jnp.stack([jnp.cos(theta), jnp.sin(theta)])
        return self.inductance * self.current(t) + magnet

    def voltage(self, t):
        _, derivative = jax.jvp(self.flux, (t,), (jnp.ones_like(t),))
        return self.resistance * self.current(t) + derivative

    def mean_voltage(self, t0, t1):
        """The voltage that, held over the interval, gives the same change of flux as the
        current does on a straight line: what a sampled log records."""
        current = 0.5 * (self.current(t0) + self.current(t1))
        return self.resistance * current + (self.flux(t1) - self.flux(t0)) / (t1 - t0)

    def relation(self):
        return aslo.plants.FluxRelation(self.resistance, self.inductance, self.magnet_flux)


class Prescribed(eqx.Module):
    """A machine with every winding fed, whose mechanical angle (rad) and winding currents
    (A) are given functions of time."""

    machine: aslo.plants.AbstractMachine
    angle: Callable
    current: Callable

    def flux(self, t):
        theta, y = self.machine.pole_pairs * self.angle(t), self.current(t)
        L = self.machine.inductances(theta)
        linked = L * y if L.ndim == 0 else L @ y
        return linked + self.machine.magnet(theta)

    def _voltage(self, derivative, y):
        return derivative - self.machine.flux_rate(jnp.zeros_like(y), y)

    def voltage(self, t):
        _, derivative = jax.jvp(self.flux, (t,), (jnp.ones_like(t),))
        return self._voltage(derivative, self.current(t))

    def mean_voltage(self, t0, t1):
        """As for [`PrescribedPMSM`][]."""
        current = 0.5 * (self.current(t0) + self.current(t1))
        return self._voltage((self.flux(t1) - self.flux(t0)) / (t1 - t0), current)


class PrescribedBearing(eqx.Module):
    """A motion q(t) with a common part of the fluxes that varies: the fluxes that it takes,
    and so currents and voltages, in closed form. `clock(t)` bends time."""

    bearing: aslo.plants.MagneticBearing
    clock: Callable = lambda t: t

    def position(self, t):
        s = self.clock(t)
        return 1e-4 * jnp.sin(40 * s + 0.4) + 5e-5 * jnp.cos(90 * s)

    def velocity(self, t):
        return jax.jvp(self.position, (t,), (jnp.ones_like(t),))[1]

    def flux(self, t):
        acceleration = jax.jvp(self.velocity, (t,), (jnp.ones_like(t),))[1]
        unequal = self.bearing.force_constant * self.bearing.mass * acceleration
        common = (8e-3) ** 2 * (1 + 0.3 * jnp.sin(60 * self.clock(t)))
        return jnp.sqrt(common + jnp.stack([0.5, -0.5]) * unequal)

    def state(self, t):
        return aslo.plants.BearingState(self.flux(t), self.position(t), self.velocity(t))

    def current(self, t):
        return self.bearing.output(self.state(t))

    def voltage(self, t):
        rate = jax.jvp(self.flux, (t,), (jnp.ones_like(t),))[1]
        return rate + self.bearing.resistance * self.current(t)

    def mean_voltage(self, t0, t1):
        """As for [`PrescribedPMSM`][]."""
        current = 0.5 * (self.current(t0) + self.current(t1))
        rate = (self.flux(t1) - self.flux(t0)) / (t1 - t0)
        return rate + self.bearing.resistance * current

    def truth(self, t):
        return self.bearing.hidden(self.state(t))


class PrescribedMechanism(eqx.Module):
    """A mechanical system whose coordinates are given functions of time, shape `(n,)`, that
    its inputs can bring about: these by inverse dynamics."""

    system: aslo.plants.AbstractMechanicalSystem
    position: Callable

    def velocity(self, t):
        return jax.jvp(self.position, (t,), (jnp.ones_like(t),))[1]

    def acceleration(self, t):
        return jax.jvp(self.velocity, (t,), (jnp.ones_like(t),))[1]

    def force(self, t):
        """The generalised forces u: `G u` is what the acceleration lacks without them."""
        q, v = self.position(t), self.velocity(t)
        free = self.system.acceleration(q, v, self.system.no_input(q))
        lacking = self.system.inertia(q) @ (self.acceleration(t) - free)
        return jnp.linalg.lstsq(self.system.input_matrix(q), lacking)[0]

    def mean_force(self, t0, t1):
        """The mean over an interval, by Gauss's rule of order 6."""
        middle, half = 0.5 * (t0 + t1), 0.5 * (t1 - t0) * 0.6**0.5
        u = [self.force(middle + side * half) for side in (-1.0, 0.0, 1.0)]
        return (5.0 * u[0] + 8.0 * u[1] + 5.0 * u[2]) / 18.0


class Together(aslo.AbstractObserver):
    """Several observers in one pass, so that they are compiled and integrated at once."""

    observers: dict[str, aslo.AbstractObserver]

    def equations(self, F, u, y):
        pairs = self.observers.items()
        return {name: o.equations(F.scope(name), u, y) for name, o in pairs}


@eqx.filter_jit
def observe(
    observer: aslo.AbstractObserver,
    u: Callable,
    y: Callable,
    ts: Float[Array, " N"],
    rtol: float = 1e-12,
    atol: float = 1e-20,
) -> aslo.Estimate:
    """The observer's estimates at `ts`, driven by functions of time from t = 0.

    States that start at zero are tiny at first and carry the estimate all the same, hence
    an absolute tolerance far below the relative one. The solver steps to each of `ts`,
    since dense output is less accurate than the steps. Compiled as a whole: settings are
    arguments, so that the next observer of the same kind is not compiled again."""

    def rate(t, states, args):
        del args
        state = aslo.ObserverState(states, y(t))
        return observer.vector_field(t, state, u(t), y(t)).states

    def record(t, states, args):
        del args
        return observer.estimate(t, aslo.ObserverState(states, y(t)), u(t), y(t))

    zero = jnp.zeros(())
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rate),
        diffrax.Dopri8(),
        0.0,
        ts[-1],
        None,
        observer.init(y(zero), u(zero)).states,
        saveat=diffrax.SaveAt(ts=ts, fn=record),
        stepsize_controller=diffrax.ClipStepSizeController(
            diffrax.PIDController(rtol=rtol, atol=atol), step_ts=ts
        ),
        adjoint=diffrax.ForwardMode(),  # compiles faster
        max_steps=100_000,
    )
    return solution.ys


def observe_by_scipy(
    observer: aslo.AbstractObserver,
    u: Callable,
    y: Callable,
    ts: Float[Array, " N"],
    rtol: float = 1e-12,
    atol: float = 1e-20,
) -> aslo.Estimate:
    """[`observe`][], for a few seconds of smooth signals, over which compiling the solver
    would take longer than the steps do."""
    return integrated(_start, _rate, _estimate, (observer, u, y), ts, rtol, atol)


def _start(given):
    observer, u, y = given
    zero = jnp.zeros(())
    return observer.init(y(zero), u(zero)).states


def _rate(given, t, states):
    observer, u, y = given
    return observer.vector_field(t, aslo.ObserverState(states, y(t)), u(t), y(t)).states


def _estimate(given, t, states):
    observer, u, y = given
    return observer.estimate(t, aslo.ObserverState(states, y(t)), u(t), y(t))
