"""The charge of a battery.

State of charge and polarisation of a cell whose open-circuit voltage has an exponential
in it, from voltage and current: a derived observer with three entries, two of them
states. Nothing is integrated from a guess, so that there is none to be wrong.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo

jax.config.update("jax_enable_x64", True)


def open_circuit(charge):  # V
    return 3.3 + 0.7 * charge - 0.6 * jnp.exp(-14.0 * charge)


battery = aslo.Model(
    f=lambda x, y, u: [-u[0] / 900.0, -x[1] / 8.0 + u[0] / 400.0],
    h=lambda x, y, u: [open_circuit(x[0]) - x[1] - 0.02 * u[0] - y[0]],
    states={"charge": (0, 1), "v1": (-0.1, 0.1)},
    outputs={"voltage": (3, 4)},
    inputs={"current": (-5, 15)},
)
derived = aslo.derive(battery)
print(derived)
h = 0.01  # s
t = h * np.arange(20_001)
current = 3.0 + 4.0 * np.sin(0.9 * t) + 3.0 * np.sin(0.17 * t)  # A


def step(s, i):
    charge, v1 = s
    after = (
        charge - h * i / 900.0,
        jnp.exp(-h / 8) * v1 + 8 / 400 * i * (1 - jnp.exp(-h / 8)),
    )
    return after, (charge, v1)


_, (charge, v1) = jax.lax.scan(step, (0.8, 0.02), jnp.asarray(current))
voltage = np.asarray(open_circuit(charge) - v1 - 0.02 * current)
observer = derived.observer(aslo.LowPass(0.5), guard=aslo.Guard(1e-9))
found = aslo.replay(observer, t, current[:, None], voltage[:, None])
certified = ~np.asarray(found.coasting)

figure = Figure(figsize=(7.2, 3.6), layout="constrained")
above, below = figure.subplots(2, 1, sharex=True)
above.plot(t, voltage, color="black", linewidth=0.8)
above.set(ylabel="voltage (V)")
below.plot(t, 100 * charge, color="0.75", linewidth=4, label="true")
below.plot(t[certified], 100 * found.value[certified, 0], label="estimated")
below.set(xlabel="t (s)", ylabel="charge (%)", ylim=(0, 100))
below.legend(ncols=2)
error = np.abs(np.asarray(found.value[:, 0] - charge))[certified & (t > 20.0)].max()
headline = "Error of the charge after 20 s", 100 * error, "points at most"
