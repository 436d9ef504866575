"""Gains by gradients.

The double integrator behind noise, its velocity unknown at the start: the two rates of
an A-ASLO, from the paper's 5 rad/s, by gradients through 32 noisy runs at once. Drawn
is the loss over both rates, and the way to its minimum.
"""

import jax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo
from aslo_jax import tune
from aslo_jax.control import OpenLoop
from aslo_jax.disturbances import SampledNoise
from aslo_jax.tune import losses

jax.config.update("jax_enable_x64", True)
plant, step = aslo.plants.IntegratorChain(2), 0.02  # s


def unknown_velocity(gains, key):
    inner = aslo.AlgebraicObserver(
        plant.relation(), aslo.LowPass(gains["lambda"]), aslo.Repeat(), None, "paper"
    )
    return aslo.Experiment(
        plant,
        OpenLoop(jnp.zeros_like),
        {"A-ASLO": aslo.Asymptotic(inner, gains["gamma"], initial=jnp.zeros(1))},
        step,
        sensor=SampledNoise(0.1, step, key),
        input_sensor=SampledNoise(3.0, step, key, stream=1),
        initial=jnp.array([0.0, 3.0]),
    )


def where(gains):
    return gains["lambda"], gains["gamma"]


paper = {"lambda": jnp.array(5.0), "gamma": jnp.array(5.0)}
loss = losses.MonteCarlo(
    unknown_velocity, losses.MeanSquare("A-ASLO"), samples=32, steps=400
)
found = tune.fit(paper, loss, where=where, bounds=[(0.3, 50.0)] * 2)
print(found)
rates = np.geomspace(0.5, 20.0, 10)
over = tune.surface(paper, loss, where=where, first=rates, second=rates)
figure = aslo.plot.landscape(
    found, over, names=("lambda (rad/s)", "gamma (rad/s)"), label="mean square (m²/s²)"
)
headline = (
    "Loss after over before",
    found.validation / found.initial_validation,
    "(unseen noise)",
)
