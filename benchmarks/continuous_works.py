"""The work of the benchmark `continuous`: the open-loop motor with the filters of its ASLO,
for the library and written out for heyoka, and the plants of the other benchmarks."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo
from aslo_jax.completions import AbstractCompletion
from aslo_jax.control import OpenLoop

from . import motor_loop
from .loops import Work
from .works import GAIN, RATE, WORKS

END = 0.1  # s, of the open-loop motor
AMPLITUDE, SPEED, LOAD, CUTOFF = 40.0, 100.0, 0.5, 200.0  # V, rad/s, N m, rad/s


class Regressor(AbstractCompletion):
    """The filters of least squares alone, without the scale of their certificate, whose
    derivative has kinks: all of the vector field is smooth."""

    def __call__(self, F, row):
        r, b, z = row.r, row.b, row.z
        M = F.hidden(F.inject(r[:, None] * r), "M")
        v = F.hidden(F.inject(r * b) + jnp.sum(M * z, axis=-1), "v")
        determinant = M[0, 0] * M[1, 1] - M[0, 1] ** 2
        x = jnp.stack([M[1, 1] * v[0] - M[0, 1] * v[1], M[0, 0] * v[1] - M[0, 1] * v[0]])
        return x / determinant, jnp.ones(())


def load(t):
    return jnp.full_like(t, LOAD)


def voltage(t):
    return AMPLITUDE * jnp.stack([jnp.cos(SPEED * t), jnp.sin(SPEED * t)])


MOTOR = aslo.plants.PMSM.bmp0701f(load=load)
FILTERS = aslo.AlgebraicObserver(
    MOTOR.flux_relation(), aslo.LowPass(CUTOFF), Regressor(), guard=None
)


def motors(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Resistances (ohm) and magnet fluxes (Wb)."""
    rng = np.random.default_rng(7)
    spread = rng.uniform(0.9, 1.1, count), rng.uniform(0.95, 1.05, count)
    return 8.875 * spread[0], 0.2086 * spread[1]


def open_loop(sample, **how: Any) -> jax.Array:
    """The flux and its estimate at the end (Wb), shape `(4,)`."""
    where: Any = lambda m: (m.resistance, m.magnet_flux)
    motor = eqx.tree_at(where, MOTOR, tuple(map(jnp.asarray, sample)))
    run = aslo.simulate(
        motor, voltage, {"ASLO": FILTERS}, t1=END, ts=np.array([END]), **how
    )
    return jnp.concatenate([run.x.flux[0], run.estimates["ASLO"].value[0]])


def batch(one, samples, **how: Any):
    """A function without arguments that runs all samples, compiled in its first call."""
    run = jax.jit(jax.vmap(lambda sample: one(sample, **how)))
    return lambda: np.asarray(run(samples))


class Heyoka:
    """The same by heyoka's batches of Taylor series, 8 at a time."""

    def __init__(self, samples, tolerance: float, **choice: Any) -> None:
        import heyoka as hy  # pyright: ignore[reportMissingImports]

        self.samples, names = samples, "f0 f1 w a H K0 K1 W M00 M01 M11 v0 v1"
        variables = hy.make_vars(*names.split())
        field = _field(variables, hy.par[0], hy.par[1], hy.time, hy.sin, hy.cos)
        self.integrator = hy.taylor_adaptive_batch(
            list(zip(variables, field, strict=True)),
            np.zeros((13, 8)),
            tol=tolerance,
            pars=np.zeros((2, 8)),
            **choice,
        )

    def __call__(self) -> np.ndarray:
        resistance, magnet = self.samples
        count, of = len(resistance), self.integrator
        out = np.empty((13, count))
        for k in range(0, count, 8):
            of.state[:] = 0
            of.state[0] = magnet[k : k + 8]
            of.pars[0], of.pars[1] = resistance[k : k + 8], magnet[k : k + 8]
            of.set_time(0.0)
            of.propagate_until([END] * 8)
            out[:, k : k + 8] = of.state
        M00, M01, M11, v0, v1 = out[8:13]
        d = M00 * M11 - M01 * M01
        return np.stack(
            [out[0], out[1], (M11 * v0 - M01 * v1) / d, (M00 * v1 - M01 * v0) / d], axis=1
        )


def _field(x, resistance, magnet, t, sin, cos):
    """The vector field of `open_loop`, by hand: the observer has the nominal motor."""
    f0, f1, w, a, H, K0, K1, W, M00, M01, M11, v0, v1 = x
    R, L, m, n = (
        float(getattr(MOTOR, name))
        for name in ("resistance", "inductance", "magnet_flux", "pole_pairs")
    )
    J, rate = float(MOTOR.inertia), CUTOFF
    u0, u1 = AMPLITUDE * cos(SPEED * t), AMPLITUDE * sin(SPEED * t)
    c, s = cos(n * a), sin(n * a)
    y0, y1 = (f0 - magnet * c) / L, (f1 - magnet * s) / L
    torque = 1.5 * n * magnet * (c * y1 - s * y0)
    z0, z1 = u0 - R * y0, u1 - R * y1
    d = 0.5 * (m * m / L - L * (y0 * y0 + y1 * y1))
    r0, r1, b = K0 - H * y0, K1 - H * y1, H * d + W
    return [
        u0 - resistance * y0,
        u1 - resistance * y1,
        (torque - LOAD) / J,
        w,
        rate * (1.0 - H),
        rate * (y0 - K0) + H * z0 / L,
        rate * (y1 - K1) + H * z1 / L,
        K0 * z0 + K1 * z1 - rate * (d + W),
        rate * (r0 * r0 - M00),
        rate * (r0 * r1 - M01),
        rate * (r1 * r1 - M11),
        rate * (r0 * b - v0) + M00 * z0 + M01 * z1,
        rate * (r1 * b - v1) + M01 * z0 + M11 * z1,
    ]


# ---- the other plants ------------------------------------------------------------------


LEG = aslo.plants.RoboticLeg(m1=jnp.asarray(1.0), m2=jnp.asarray(4.0))
FORM = aslo.structure_of(LEG)


def torques(t):
    """On the leg (N m, N)."""
    return jnp.stack([0.5 * jnp.cos(2.0 * t), 0.3 * jnp.sin(3.0 * t)])


def leg(sample, noisy: bool = False) -> aslo.Experiment:
    del noisy
    mass, _ = sample
    observer = aslo.velocity_observer(LEG, aslo.LowPass(RATE), form=FORM)
    smooth = aslo.velocity_observer(LEG, aslo.LowPass(RATE), gain=GAIN, form=FORM)
    return aslo.Experiment(
        eqx.tree_at(lambda x: x.m2, LEG, mass),
        OpenLoop(torques),
        {"ASLO": observer, "A-ASLO": smooth},
        1e-3,
    )


def masses(count: int):
    rng = np.random.default_rng(14)
    return rng.uniform(3.5, 4.5, count), np.zeros(count)


PLANTS = {
    "PMSM": motor_loop.LOOP,
    **WORKS,
    "leg": Work(leg, masses, WORKS["ball and beam"].keep, 1e-3),
}


def closed(work: Work, end: float):
    """A sample's run to an end (s): what is kept of its last instant, and how it is run."""

    def one(sample, **how: Any):
        loop = work.make(sample)
        run = aslo.simulate(
            loop.plant,
            loop.controller,
            loop.observers,
            t1=end,
            ts=np.array([end]),
            initial=loop.initial,
            feedback=loop.feedback,
            **how,
        )
        return work.keep(jax.tree.map(lambda x: x[0], run))

    return one
