"""A motor calibrated from its own log.

Resistance and inductance that are 5 % off, and 5 mA of noise on the currents of the
recorded motor. The relation that the observer rests on must hold at every sample: no
truth is needed. Drawn are the parameters with their intervals, the likelihood over
each, and the spectrum of what is left.
"""

import jax
import numpy as np

import aslo_jax as aslo
from aslo_jax.logs import read_log

jax.config.update("jax_enable_x64", True)
log = read_log("aslo_jax/data/pmsm_log.csv")
rows = slice(0, 4000)
noise = np.random.default_rng(0).standard_normal(log.y.shape)
t, u, y = log.t[rows], log.u[rows], (log.y + 5e-3 * noise)[rows]
relation = aslo.plants.FluxRelation(resistance=1.05 * 8.875, inductance=0.95 * 40.03e-3)
observer = aslo.AlgebraicObserver(relation, aslo.LowPass(150.0))
found = aslo.tune.calibrate(
    observer, t, u, y, where=lambda o: (o.relation.resistance, o.relation.inductance)
)
print(found)

figure = aslo.plot.calibration(found)
figure.set_size_inches(7.2, 5.4)
off = abs(found.after["resistance"] / 8.875 - 1)
headline = "Resistance off by", 1e6 * off, "ppm, from 50,000 ppm"
