"""Levitated by its currents alone.

A body of 1 kg between two magnets, without a position sensor. It lies on its touch-down
bearing, the fluxes are unknown, and the currents have 10 mA of noise. A ripple of 10 V
at 500 Hz makes the position observable while the body stands still; it is lifted, held,
and pushed with 5 N.
"""

import jax
import jax.numpy as jnp
from matplotlib.figure import Figure

import aslo_jax as aslo
from aslo_jax.control import BearingFeedback, MagneticLevitation
from aslo_jax.disturbances import SampledNoise

jax.config.update("jax_enable_x64", True)
gap, interval = 0.5e-3, 5e-5  # m, s


def outer(t):  # N, the weight and a push
    return -9.81 + jnp.where(t < 0.2, 0.0, 5.0)


def self_sensing(y, x, estimates):
    found = estimates["ASLO"].value
    return BearingFeedback(y, found[:2], position=found[2], velocity=found[3])


bearing = aslo.plants.MagneticBearing.laboratory(force=outer, touchdown=0.75 * gap)
fluxes = aslo.AlgebraicObserver(
    bearing.flux_relation(),
    aslo.LowPass(1000.0),
    aslo.LeastSquares(forgetting=aslo.LowPass(80.0)),
    guard=aslo.Guard(5e-5),
)
levitation = MagneticLevitation(
    bearing,
    reference=jnp.zeros_like,
    bias=1.0,
    voltage_limit=60.0,
    ripple=10.0,
    ripple_frequency=2 * jnp.pi * 500,
    rest=0.05,
)
loop = aslo.Experiment(
    bearing,
    levitation,
    {"ASLO": aslo.BearingObserver(fluxes, aslo.LowPass(1000.0), aslo.Guard(1e-3))},
    interval,
    feedback=self_sensing,
    sensor=SampledNoise(0.01, interval, aslo.random.key(1)),
    initial=aslo.plants.BearingState(
        flux=jnp.full(2, 0.01), position=jnp.array(-0.754 * gap), velocity=jnp.array(0.0)
    ),
)
run = loop.run(8_000, every=4)
found = run.estimates["ASLO"].value[:, 2]

figure = Figure(figsize=(7.2, 3.4), layout="constrained")
above, below = figure.subplots(2, 1, sharex=True)
above.plot(run.t, run.x.position / gap, color="0.75", linewidth=4, label="true")
above.plot(run.t[5:], found[5:] / gap, linewidth=0.8, label="from the currents")
above.axhline(-0.75, color="black", linewidth=0.8, linestyle="--")
above.set(ylabel="position / gap", ylim=(-1, 0.5))
above.legend(ncols=2)
below.plot(run.t, run.y, linewidth=0.5)
below.set(xlabel="t (s)", ylabel="currents (A)")
held = (run.t > 0.12) & (run.t < 0.2) | (run.t > 0.3)
rms = jnp.sqrt(jnp.mean((run.x.position[held] / gap) ** 2))
headline = "Held within", 100 * rms, "% of the gap (rms)"
