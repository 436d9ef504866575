"""Ten thousand motors at once.

The flux error of an A-ASLO in a closed loop, for 10,000 motors whose resistance is up
to 30 % above what the observer takes it for, each with noise of its own: one batch in
the fused engine, which keeps the metric and every fiftieth sample.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo
from aslo_jax.control import FieldOriented, MotorFeedback
from aslo_jax.disturbances import SampledNoise
from aslo_jax.metrics import RMSError

jax.config.update("jax_enable_x64", True)
motor = aslo.plants.PMSM.bmp0701f(load=lambda t: jnp.full_like(t, 1.0))
flux = aslo.AlgebraicObserver(
    motor.flux_relation(), aslo.LowPass(50.0), guard=aslo.Guard(1e-3)
)


def make(sample):
    warm = eqx.tree_at(lambda m: m.resistance, motor, sample["resistance"])
    return aslo.Experiment(
        warm,
        FieldOriented(motor, lambda t: 20.0 + 5.0 * jnp.sin(t), current_limit=2.3),
        {"A-ASLO": aslo.Asymptotic(flux, 20.0)},
        interval=2e-4,
        feedback=lambda y, x, e: MotorFeedback(y, 5 * x.angle, x.speed),
        sensor=SampledNoise(0.01, 2e-4, sample["key"]),
    )


count = 10_000
samples = {
    "resistance": motor.resistance * jnp.linspace(1.0, 1.3, count),
    "key": jax.vmap(aslo.random.key)(jnp.arange(count)),
}
batch = aslo.run_batch(
    make,
    samples,
    steps=1_500,
    metrics={"rms": RMSError("A-ASLO", after=0.1)},
    record=lambda r: jnp.linalg.norm(r.estimates["A-ASLO"].value - r.hidden),
    every=50,
)
error = np.linalg.norm(batch.metrics["rms"], axis=1) / motor.magnet_flux

figure = Figure(figsize=(7.2, 3.0), layout="constrained")
left, right = figure.subplots(1, 2)
t = 2e-4 * 50 * np.arange(batch.record.shape[1])
for k in np.linspace(0, count - 1, 60).astype(int):
    left.semilogy(
        t[1:], batch.record[k, 1:] / 0.2086, linewidth=0.5, color="#0072B2", alpha=0.4
    )
left.set(xlabel="t (s)", ylabel="flux error / magnet flux")
off = 100 * (np.asarray(samples["resistance"]) / motor.resistance - 1)
right.plot(off, 100 * error, ",", color="#D55E00")
right.set(xlabel="resistance too large by (%)", ylabel="rms flux error (%)", ylim=(0, None))
headline = "Flux error of the hottest motor", 100 * error[-1], "% of the magnet flux"
