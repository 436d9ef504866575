"""A derived observer: speed and load of a DC motor.

Written down are two equations of a motor whose current is measured; its speed is not,
and its load is a constant that nobody knows. `aslo.derive` finds an equation in what is
measured, and an observer of both. The load is there all the time; what is found of it
is there once certified.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import aslo_jax as aslo

jax.config.update("jax_enable_x64", True)
motor = aslo.Model(
    f=lambda x, y, u, p: [(p["K"] * y[0] - p["b"] * x[0] - p["load"]) / p["J"]],  # speed'
    g=lambda x, y, u, p: [(u[0] - p["R"] * y[0] - p["K"] * x[0]) / p["L"]],  # current'
    states={"speed": (-200, 200)},
    outputs={"current": (-5, 5)},
    inputs={"voltage": (-12, 12)},
    parameters={"L": 4e-3, "R": 0.9, "K": 0.06, "J": 3e-4, "b": 2e-4, "load": 0.03},
    unknown=["load"],
)
derived = aslo.derive(motor)
print(derived)
observer = derived.observer(aslo.LowPass(100.0), guard=aslo.Guard(threshold=1e-6))
t = np.linspace(0.0, 0.5, 2501)
u = (6 + 4 * np.sin(30 * t) + 2 * np.sin(83 * t))[:, None]


def step(s, held):
    speed, current = s
    for _ in range(10):
        h = (t[1] - t[0]) / 10
        speed, current = (
            speed + h * (0.06 * current - 2e-4 * speed - 0.03) / 3e-4,
            current + h * (held[0] - 0.9 * current - 0.06 * speed) / 4e-3,
        )
    return (speed, current), s


_, (speed, current) = jax.lax.scan(step, (11.0, 0.5), jnp.asarray(u))
found = aslo.replay(observer, t, u, np.asarray(current)[:, None])
certified = ~np.asarray(found.coasting)

figure = Figure(figsize=(7.2, 3.8), layout="constrained")
above, below = figure.subplots(2, 1, sharex=True)
above.plot(t, speed, color="0.75", linewidth=4, label="true")
above.plot(t[certified], found.value[certified, 0], label="from the current")
above.set(ylabel="speed (rad/s)")
above.legend(ncols=2)
below.axhline(30.0, color="0.75", linewidth=4)
below.plot(t[certified], 1e3 * found.value[certified, 1])
below.set(xlabel="t (s)", ylabel="load (mN m)", ylim=(20, 40))
error = np.abs(np.asarray(found.value)[t > 0.1, 1] - 0.03).max() / 0.03
headline = "Error of the load after 0.1 s", 100 * error, "% at most"
