"""Which observer is the most robust?

A study of the double integrator: 2,000 samples with other initial speeds and levels of
noise, the same for each observer, which are then compared sample by sample. The Luenberger
observer of the same rate passes the noise of each sample on to its estimate at once.
"""

import jax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo
from aslo_jax import study
from aslo_jax.control import OpenLoop
from aslo_jax.disturbances import SampledNoise
from aslo_jax.metrics import RMSError
from aslo_jax.study import LogNormal, Normal, Spread

jax.config.update("jax_enable_x64", True)
plant = aslo.plants.IntegratorChain(2)
exact = aslo.AlgebraicObserver(plant.relation(), aslo.LowPass(5.0))
experiment = aslo.Experiment(
    plant,
    OpenLoop(lambda t: jnp.cos(3.0 * t)),  # m/s^2
    {
        "ASLO": exact,
        "A-ASLO": aslo.Asymptotic(exact, 5.0),
        "Luenberger": aslo.ReducedLuenberger.of_chain(2, 5.0),
    },
    interval=0.01,
    sensor=SampledNoise(0.01, 0.01, aslo.random.key(0)),
)
spread = Spread(
    {
        "speed": ("initial.1", Normal(0.0, 0.5)),  # m/s
        "noise": ("sensor.deviation", LogNormal(0.01, 0.5)),  # m
    }
)
dataset = study.run(
    experiment,
    spread,
    samples=2_000,
    key=jax.random.key(1),
    steps=200,
    every=4,
    metrics={"rms": lambda observer: RMSError(observer, after=0.5)},
    units={"rms": "m/s", "error": "m/s"},
)

figure = aslo.plot.bands(dataset)
figure.set_size_inches(7.2, 3.0)
rms = {
    name: dataset["rms"].sel(observer=name).values[:, 0] for name in experiment.observers
}
best, *rest = study.ranking(rms)
print([place.observer for place in (best, *rest)])
ratio = np.median(rms["Luenberger"] / rms["A-ASLO"])
headline = "Luenberger over A-ASLO, median of the samples", ratio, ""
