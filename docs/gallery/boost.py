"""A converter without a current sensor.

The current in the coil of a boost converter, from its output voltage and its duty
cycle. The observer is derived from the two equations of the circuit.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo

jax.config.update("jax_enable_x64", True)
L, C, R, r, E = 1.7e-3, 330e-6, 23.0, 0.35, 12.0  # H, F, ohm, ohm, V


def coil(i, v, duty):  # i'
    return (E - r * i - (1 - duty) * v) / L


def capacitor(i, v, duty):  # v'
    return ((1 - duty) * i - v / R) / C


model = aslo.Model(
    lambda x, y, u: [coil(x[0], y[0], u[0])],
    lambda x, y, u: [capacitor(x[0], y[0], u[0])],
    states={"i": (0, 5)},
    outputs={"v": (12, 30)},
    inputs={"duty": (0.1, 0.7)},
)
derived = aslo.derive(model)
print(derived)
h = 2e-5  # s
t = h * np.arange(2501)
duty = np.where(t < 0.02, 0.3, 0.5)


def step(s, held):
    i, v = s
    for _ in range(10):
        i, v = i + h / 10 * coil(i, v, held), v + h / 10 * capacitor(i, v, held)
    return (i, v), s


_, (current, voltage) = jax.lax.scan(step, (0.2, 13.0), jnp.asarray(duty))
noisy = np.asarray(voltage) + 5e-3 * np.random.default_rng(0).standard_normal(t.size)
observer = derived.observer(aslo.LowPass(2000.0), guard=aslo.Guard(1e-6))
found = aslo.replay(observer, t, duty[:, None], noisy[:, None]).value[:, 0]

figure = Figure(figsize=(7.2, 3.6), layout="constrained")
above, below = figure.subplots(2, 1, sharex=True)
above.plot(1e3 * t, noisy, color="black", linewidth=0.8)
above.set(ylabel="voltage (V), measured")
below.plot(1e3 * t, current, color="0.75", linewidth=4, label="true")
below.plot(1e3 * t[25:], found[25:], label="from the voltage")
below.set(xlabel="t (ms)", ylabel="current (A)")
below.legend(ncols=2)
rms = np.sqrt(np.mean((found - current)[t > 0.002] ** 2))
headline = "Error of the current", 1e3 * rms, "mA (rms)"
