"""The experiments of the paper's section 2: the double integrator and its chain.

The plant is `x1' = x2, x2' = u, y = x1`. The paper gives no units; here x1 is a position
(m), x2 a speed (m/s), u an acceleration (m/s^2), and every gain is in rad/s. The paper
does not print its gains either, except lambda = 3, gamma = 2, gamma_L = 3 and
lambda = 2.5: the other values below are ours.

Printed observers start as printed: every state at zero, F[1] settled.
"""

from collections.abc import Callable
from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ... import filters, random
from ..._completions import Repeat
from ..._filters import AbstractFilter, LowPass
from ..._realise import Pass
from ..._simulate import Simulation, simulate
from ..._typing import FilterStart
from ...disturbances import AbstractMemoryless, ParasiticLag, SampledNoise
from ...observers import (
    AbstractObserver,
    AlgebraicObserver,
    Asymptotic,
    Estimate,
    ReducedLuenberger,
)
from ...plants import IntegratorChain
from .._batch import one_by_one

RATES = (1.0, 2.5, 5.0, 10.0)  # lambda, and gamma_L, of figure 1 (rad/s)
GAINS = (1.0, 2.0, 5.0, 10.0)  # gamma of figure 1c (rad/s)
RATE, GAIN = 3.0, 2.0  # lambda = gamma_L and gamma of the robustness tests (rad/s)
RATE_1C = 2.5  # lambda of figure 1c (rad/s)
SPEED = 0.1  # x2(0) (m/s)
BIAS = 0.2  # delta of O4 (m on y, m/s^2 on u)
RIPPLE, RIPPLE_FREQUENCY = 0.1, 5.0  # a sinusoid on the sensor (m, rad/s)
INTENSITY, INTERVAL = 1e-3, 0.01  # white noise on u (two-sided, m^2/s^3), held for (s)
REALISATIONS, NOISE_SPAN = 8, 100.0  # of the noise, each that long (s)
LAGS = (0.05, 0.2, 0.5, 1.0)  # tau of figure 3 (s)
FREQUENCY = 0.02  # of u = cos(0.02 t) (rad/s)


def aslo(
    rate: Array | float, start: FilterStart = "paper", order: int = 2
) -> AlgebraicObserver:
    """The ASLO of Prop. 1 (and O3) with lambda = `rate` (rad/s)."""
    return filtered(LowPass(rate), start, order)


def filtered(
    filter: AbstractFilter, start: FilterStart = "paper", order: int = 2
) -> AlgebraicObserver:
    """The ASLO of a chain of `order` integrators, with any filter."""
    relation = IntegratorChain(order).relation()
    return AlgebraicObserver(relation, filter, Repeat(), guard=None, start=start)


def a_aslo(
    rate: Array | float, gain: Array | float, start: FilterStart = "paper"
) -> Asymptotic:
    """The A-ASLO of Cor. 1 with lambda = `rate` and gamma = `gain` (rad/s), from zero."""
    return Asymptotic(aslo(rate, start), gain, initial=jnp.zeros(1))


def luenberger(gain: Array | float) -> ReducedLuenberger:
    """The reduced-order Luenberger observer (eq. lueobs), gamma_L = `gain` (rad/s)."""
    return ReducedLuenberger.of_chain(2, gain)  # pyright: ignore[reportArgumentType]


class Printed(NamedTuple):
    """The observers that the claims of section 2 are about, as functions of their gains."""

    aslo: Callable[..., AbstractObserver] = aslo
    a_aslo: Callable[..., AbstractObserver] = a_aslo
    luenberger: Callable[..., AbstractObserver] = luenberger
    filtered: Callable[..., AbstractObserver] = filtered


class PrintedChain(AbstractObserver):
    """O3's formulas for the fourth-order chain with lambda = 1, line by line.

    `corrected=False` takes equations (x4) and (x3) as printed. The estimate is
    `(x2, x3, x4)`, except that x2 and x3 are computed from the right x4 and x3, so that
    the error of each line is its own.
    """

    corrected: bool = eqx.field(static=True)

    def equations(self, F: Pass, u: Array, y: Array) -> Estimate:
        F = F.using(LowPass(1.0), "paper")
        u1 = F(u)
        u2 = F(u1)
        u3 = F(u2)
        y1 = F.p(y)
        y2 = F.p(y1)
        y3 = F.p(y2)
        x4 = y3 + u3 + u2 + u1
        x3 = y2 + 2.0 * x4 - 2.0 * u1 - u2
        x2 = y1 + x3 - x4 + u1
        if not self.corrected:
            x3, x4 = y2 + 2.0 * x4 - u2, y3 + u3 + u2 + u2
        value = jnp.stack([x2, x3, x4])
        return Estimate(value, jnp.ones_like(x2), jnp.asarray(False))


class Added(AbstractMemoryless):
    """Adds `signal(t)`, a function of time (s) in the units of what it disturbs."""

    signal: Callable[[Float[Array, ""]], Array]

    def __call__(self, t, state, signal, output=None):
        del state, output
        return signal + self.signal(t)


def paper_input(t: Float[Array, ""]) -> Float[Array, ""]:
    """`u = cos(0.02 t)` (m/s^2), t in s."""
    return jnp.cos(FREQUENCY * t)


def simulated(
    observers: dict[str, AbstractObserver], ts: np.ndarray, **options
) -> Simulation:
    """One simulation at tight tolerance, at the paper's input and start by default."""
    options = {
        "plant": IntegratorChain(2),
        "controller": paper_input,
        "initial": jnp.array([0.0, SPEED]),
        "solver": diffrax.Dopri8(),
        "stepsize_controller": diffrax.PIDController(rtol=1e-11, atol=1e-12),
        "adjoint": diffrax.ForwardMode(),  # compiles faster
        **options,
    }
    plant, controller = options.pop("plant"), options.pop("controller")
    options["ts"] = jnp.asarray(ts)
    return simulate(plant, controller, observers, t1=float(ts[-1]), **options)


def transients(printed: Printed) -> Simulation:
    """Figures 1a, 1b and 1d, batched over lambda = gamma_L in `RATES`; the exact start
    beside the printed one."""

    def one(rate):
        observers = {
            "ASLO": printed.aslo(rate),
            "A-ASLO": printed.a_aslo(rate, GAIN),
            "Luenberger": printed.luenberger(rate),
            "ASLO exact": printed.aslo(rate, "exact"),
            "A-ASLO exact": printed.a_aslo(rate, GAIN, "exact"),
        }
        return simulated(observers, _instants(8.0))

    return one_by_one(one, jnp.array(RATES))


def gains(printed: Printed) -> Simulation:
    """Figure 1c, batched over gamma in `GAINS`, lambda = 2.5."""

    def one(gain):
        observers = {
            "A-ASLO": printed.a_aslo(RATE_1C, gain),
            "A-ASLO exact": printed.a_aslo(RATE_1C, gain, "exact"),
        }
        return simulated(observers, _instants(8.0))

    return one_by_one(one, jnp.array(GAINS))


def three(printed: Printed) -> dict[str, AbstractObserver]:
    """The three observers with the gains of the robustness tests."""
    return {
        "ASLO": printed.aslo(RATE),
        "A-ASLO": printed.a_aslo(RATE, GAIN),
        "Luenberger": printed.luenberger(RATE),
    }


def noise(printed: Printed) -> Simulation:
    """Figure 2, batched over realisations of white noise on the u that the observers see.

    Noise on the u of the plant instead gives the same errors with the sign changed.
    """
    deviation = (INTENSITY / INTERVAL) ** 0.5
    ts = np.arange(0.0, NOISE_SPAN + INTERVAL / 2, 4 * INTERVAL)

    def one(key):
        return simulated(
            three(printed),
            ts,
            input_sensor=SampledNoise(deviation, INTERVAL, key),
            solver=diffrax.Tsit5(),
            stepsize_controller=diffrax.ConstantStepSize(),
            dt0=INTERVAL,
        )

    keys = jax.vmap(random.fold, (None, 0))(random.key(2), jnp.arange(REALISATIONS))
    return one_by_one(one, keys)


def parasitics(printed: Printed) -> Simulation:
    """Figure 3, batched over tau in `LAGS`: `tau u' = -u + v`, u(0) = 0, observers see v.

    It runs to a quarter period of v, where the slope of v is largest.
    """
    slow = np.linspace(10, np.pi / 2 / FREQUENCY, 200)
    ts = np.unique(np.concatenate([np.linspace(0, 10, 501), slow]))

    def one(tau):
        return simulated(three(printed), ts, actuator=ParasiticLag(tau))

    return one_by_one(one, jnp.array(LAGS))


class Scenario(NamedTuple):
    """One run of O1 and O4."""

    initial: tuple[float, float] = (0.0, SPEED)  # m, m/s
    amplitude: float = 1.0  # of u (m/s^2)
    input_bias: float = 0.0  # on the u that the observers see (m/s^2)
    output_bias: float = 0.0  # on y (m)
    ripple: float = 0.0  # amplitude of a sinusoid on y (m)


SCENARIOS = {
    "free": Scenario(amplitude=0.0),
    "displaced": Scenario(initial=(0.7, SPEED)),
    "input bias": Scenario(input_bias=BIAS),
    "output bias": Scenario(output_bias=BIAS),
    "ripple": Scenario(ripple=RIPPLE),
}


def scenarios(printed: Printed) -> dict[str, Simulation]:
    """The runs of O1 and O4, by name, with other filters beside the first-order one."""
    observers = three(printed) | {
        "ASLO exact": printed.aslo(RATE, "exact"),
        "bias-rejecting": printed.filtered(filters.bias_rejecting(RATE)),
        "sinusoid-rejecting": printed.filtered(
            filters.sinusoid_rejecting(RATE, RIPPLE_FREQUENCY)
        ),
    }

    def one(s):
        return simulated(
            observers,
            _instants(20.0),
            controller=lambda t: s.amplitude * paper_input(t),
            initial=jnp.stack(s.initial),
            input_sensor=Added(lambda t: s.input_bias),
            sensor=Added(
                lambda t: s.output_bias + s.ripple * jnp.sin(RIPPLE_FREQUENCY * t)
            ),
        )

    stacked = jax.tree.map(lambda *xs: jnp.array(xs), *SCENARIOS.values())
    batch = one_by_one(one, stacked)
    return {name: member(batch, i) for i, name in enumerate(SCENARIOS)}


def chain_input(t: Float[Array, ""]) -> Float[Array, ""]:
    """`u = sin(1.3 t)` (m/s^4), t in s."""
    return jnp.sin(1.3 * t)


def chain(printed: Printed, order: int) -> Simulation:
    """O3: the chain of `order` integrators from rest at zero, lambda = 1, with the printed
    lines of the fourth-order chain beside the library's observer.

    Batched over an offset of y: none, and `BIAS`.
    """
    observers = {"ASLO": printed.aslo(1.0, order=order)}
    if order == 4:
        observers["printed"] = PrintedChain(corrected=False)
        observers["corrected"] = PrintedChain(corrected=True)
    # Four periods to settle, which five instants cover, and one period to measure.
    period = 2 * np.pi / 1.3
    ts = np.concatenate([np.arange(5), 4 + np.arange(1, 65) / 64]) * period

    def one(offset):
        return simulated(
            observers,
            ts,
            plant=IntegratorChain(order),
            controller=chain_input,
            initial=jnp.zeros(order),
            sensor=Added(lambda t: offset),
        )

    return one_by_one(one, jnp.array([0.0, BIAS]))


def error(run: Simulation, name: str) -> np.ndarray:
    """Estimate less truth of an observer, in a run or a batch, shape (..., N, n)."""
    return np.asarray(run.estimates[name].value) - np.asarray(run.hidden)


def member(batch: Simulation, index: int) -> Simulation:
    """One simulation of a batch."""
    return jax.tree.map(lambda x: x[index], batch)


def _instants(t1: float) -> np.ndarray:
    # From 1 ms on, so that "for all t > 0" is tested where it is hardest.
    return np.unique(np.concatenate([[0.0, 1e-3, 3e-3], np.arange(0.01, t1 + 0.005, 0.01)]))
